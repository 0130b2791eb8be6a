"""`faults`: sensors that are wrong as real ones are, and what the smoothers make of it.

Simulated drives of a 4×4 with gyro, yaw and camera; a fault is put into one sensor, and the
estimate is compared with that of the healthy sensor and of none at all.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.evaluation import evaluate
from fgloc.core.geometry import compose
from fgloc.core.measurements import CameraPoses, Floats, Sensor, Yaw
from fgloc.estimator import Result, run
from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.fixes import with_fixes
from fgloc.experiments.methods import create
from fgloc.report.experiment_report import Cell, Column, Report, Row, Table

SEEDS = 8
"""Drives of each kind."""
METHODS = ("batch", "online")
"""Who is tried."""
OPTIONS = "duration=100&gyro=on&slip=off"
"""What all drives have."""
FAR = 3.0
"""A parameter so many prior sigmas from nominal is remarked on by every command."""
FIXES = (10.0, 0.02)
"""Period [s] and noise [m] of position fixes, where there are any."""


@dataclass(frozen=True)
class Fault:
    """One way to be wrong."""

    id: str
    """Row key."""
    title: str
    """What it is."""
    sensor: str
    """Which sensor has it, "camera" or "yaw"."""
    change: Callable[[Sensor], Sensor]
    """Makes a healthy stream faulty."""
    parameter: str = ""
    """The parameter that it moves, where there is one."""
    moved: Callable[[float], float] = float
    """What it makes of the parameter's true value."""


def camera_scaled(factor: float) -> Callable[[Sensor], Sensor]:
    """Return what makes a camera measure ways that are too long or too short."""

    def change(s: Sensor) -> Sensor:
        assert isinstance(s, CameraPoses)
        return replace(s, poses=s.poses * np.array([factor, factor, 1.0]))

    return change


def camera_turned(angle: float) -> Callable[[Sensor], Sensor]:
    """Return what turns a camera on its mount by an angle [rad]."""

    def change(s: Sensor) -> Sensor:
        assert isinstance(s, CameraPoses)
        there = compose(s.poses, np.array([0.0, 0.0, angle]))
        return replace(s, poses=compose(np.array([0.0, 0.0, -angle]), there))

    return change


def yaw_changed(wrong: Callable[[Floats, Floats], Floats]) -> Callable[[Sensor], Sensor]:
    """Return what replaces a heading sensor's readings by a function of time [s] and reading."""

    def change(s: Sensor) -> Sensor:
        assert isinstance(s, Yaw)
        seconds = (s.stamps_ns - s.stamps_ns[0]) * 1e-9
        return replace(s, yaw=wrong(seconds, np.unwrap(s.yaw)))

    return change


FAULTS = (
    Fault(
        "scale-up",
        "camera measures 20 % too long",
        "camera",
        camera_scaled(1.2),
        "camera_scale",
        lambda v: 1.2 * v,
    ),
    Fault(
        "scale-down",
        "camera measures 20 % too short",
        "camera",
        camera_scaled(0.8),
        "camera_scale",
        lambda v: 0.8 * v,
    ),
    Fault(
        "turned",
        "camera turned by 5° on its mount",
        "camera",
        camera_turned(math.radians(5.0)),
        "camera_yaw",
        lambda v: v + math.radians(5.0),
    ),
    Fault(
        "yaw-jump",
        "yaw off by 0.5 rad for 3 s",
        "yaw",
        yaw_changed(lambda t, y: y + 0.5 * ((t > 40) & (t < 43))),
    ),
    Fault("yaw-drift", "yaw drifts by 0.05 rad/s", "yaw", yaw_changed(lambda t, y: y + 0.05 * t)),
    Fault("yaw-sign", "yaw counts the other way", "yaw", yaw_changed(lambda t, y: -y)),
    Fault(
        "yaw-stuck",
        "yaw stands still after 30 s",
        "yaw",
        yaw_changed(lambda t, y: np.where(t < 30, y, y[np.argmax(t >= 30)])),
    ),
)
"""All faults."""


@dataclass(frozen=True)
class Found:
    """What a method made of it."""

    healthy: float
    """Position RMSE with the sound sensor [m]."""
    without: float
    """Without it [m]."""
    faulty: float
    """With the fault [m]."""
    said: bool
    """Whether the fault is told: a note about the sensor, or a parameter far from its prior."""
    off: float
    """By how many sigmas the moved parameter is off; NaN without one."""


def work(key: tuple[str, int, bool]) -> dict[str, Found]:
    """Return what every method makes of a fault (its id), on a seed, with or without fixes."""
    from fgloc.datasets.registry import load_drive

    name, seed, fixes = key
    fault = next(f for f in FAULTS if f.id == name)
    sensors = "camera=on&yaw=off" if fault.sensor == "camera" else "camera=on&yaw=on"
    drive = load_drive(f"sim:random?seed={seed}&{OPTIONS}&{sensors}")
    if fixes:
        drive = with_fixes(drive, *FIXES, seed)
    wrong = tuple(fault.change(s) if s.sensor == fault.sensor else s for s in drive.sensors)
    less = tuple(s for s in drive.sensors if s.sensor != fault.sensor)
    found = {}
    for method in METHODS:
        results = [
            run(create(method), replace(drive, sensors=s)) for s in (drive.sensors, less, wrong)
        ]
        errors = [_error(r, drive) for r in results]
        told, off = _told(results[2], fault), _off(results[2], fault, drive)
        found[method] = Found(errors[0], errors[1], errors[2], told, off)
    return found


def _error(result: Result, drive: Drive) -> float:
    """Return the position RMSE [m]."""
    assert drive.truth is not None
    return evaluate(result.trajectory, drive.truth).ate_rmse_m


def _told(result: Result, fault: Fault) -> bool:
    """Return whether a user reads of the fault."""
    if any(note.startswith(fault.sensor) or f" {fault.sensor} " in note for note in result.notes):
        return True
    return any(
        c.name.startswith(fault.sensor) and abs(c.value - c.nominal) > FAR * c.prior_sigma
        for c in result.calibration
        if c.prior_sigma > 0.0
    ) or any(
        c.name == fault.parameter and abs(c.value - c.nominal) > 2.0 * c.prior_sigma
        for c in result.calibration
    )


def _off(result: Result, fault: Fault, drive: Drive) -> float:
    """Return by how many sigmas the moved parameter is off."""
    true = (drive.true_calibration or {}).get(fault.parameter)
    for c in result.calibration:
        if true is not None and c.name == fault.parameter and c.sigma > 0.0:
            return abs(c.value - fault.moved(true)) / c.sigma
    return math.nan


def execute(context: Context) -> Report:
    """Return the table of all faults."""
    keys = [
        (f.id, seed, fixes)
        for f in FAULTS
        for fixes in (False, True)
        for seed in context.over(SEEDS)
    ]
    outcomes = context.map(work, keys, lambda k: f"{k[0]} seed {k[1]}{' fixes' * k[2]}")
    found: dict[tuple[str, bool, str], list[Found]] = {}
    for (name, _, fixes), outcome in zip(keys, outcomes, strict=True):
        for method, one in outcome.items():
            found.setdefault((name, fixes, method), []).append(one)
    return Report(
        f"Sensors that are wrong, {len(context.over(SEEDS))} simulated drives of 100 s each",
        (_table(found),),
        (
            "Medians of the position RMSE. Told: a note names the sensor, or a parameter of it "
            "stands more than 2 prior sigmas from nominal.",
            "Without fixes nobody but the wheels tells a distance: a camera whose scale is wrong "
            "is then known as well as the wheels' radii, 3 %.",
        ),
        (),
        {"seeds": len(context.over(SEEDS)), "options": OPTIONS, "fixes": FIXES},
    )


def _table(found: Mapping[tuple[str, bool, str], Sequence[Found]]) -> Table:
    """Return errors with and without each fault."""
    rows = []
    for (name, fixes, method), all_ in found.items():
        fault = next(f for f in FAULTS if f.id == name)
        without = statistics.median(f.without for f in all_)
        cells: dict[str, Cell | str] = {
            "healthy": Cell(statistics.median(f.healthy for f in all_), 3),
            "without": Cell(without, 3),
            "faulty": Cell(statistics.median(f.faulty for f in all_), 3, target=1.1 * without),
            "told": f"{sum(f.said for f in all_)} of {len(all_)}",
        }
        off = [f.off for f in all_ if math.isfinite(f.off)]
        if off:
            cells["off"] = Cell(statistics.median(off), 2, target=3.0)
        rows.append(Row((fault.title, "yes" if fixes else "no", method), cells))
    return Table(
        "faults",
        "Position RMSE with a sound sensor, without it, and with the fault",
        ("fault", "fixes", "method"),
        (
            Column("healthy", "sound", "m"),
            Column("without", "without the sensor", "m"),
            Column("faulty", "with the fault", "m"),
            Column("told", "told"),
            Column("off", "estimate off the injected value", "σ"),
        ),
        tuple(rows),
    )


EXPERIMENT = Experiment(
    "faults",
    "a camera of wrong scale, a turned mount, a yaw that lies: told, estimated, left out",
    (),
    execute,
)
