"""`slip`: wheels that slip, found and timed, over many seeds of simulated drives.

The robot is a 4×4 with four encoders, gyro and camera, its true track and radii drawn from their
priors. On every drive, three times both wheels of one side slip at once: by 15 to 38 %, for 1 to
4 s, at random times. Wheels of a side that slip together do not contradict each other; only gyro
and camera tell, and only against the track that the drive itself calibrates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fgloc.core.drive import Drive
from fgloc.estimator import WheelSlip, run
from fgloc.experiments.experiment import Context, Experiment
from fgloc.experiments.methods import create
from fgloc.report.experiment_report import Cell, Column, Figure, Report, Row, Table

SEEDS = 100
"""Drives of each kind."""
METHODS = ("batch", "online")
"""Who looks for slip."""
SIDES = {"left": ("fl", "rl"), "right": ("fr", "rr")}
"""Wheels of each side."""
GRID_S = 0.05
"""Times at which truth and findings are compared are so far apart [s]."""
MARGIN_S = 0.25
"""So close to the ends of a slip a false alarm is none, but a slip that ends late [s]."""
MISSED_AT_MOST = 0.05
"""Time of slip that may be missed, as a part of all."""
FALSE_AT_MOST = 0.02
"""Time without slip that may be called slip, as a part of all."""
CERTAIN = 0.9
"""Probability from which on a stretch is called certain."""


@dataclass(frozen=True)
class Kind:
    """One kind of drive."""

    id: str
    """Row key."""
    title: str
    """What it is."""
    sensors: str
    """Options of the simulator."""
    wheels: tuple[tuple[str, ...], ...]
    """Groups of wheels that slip together; one is drawn for each slip. Empty: none slips."""


KINDS = (
    Kind(
        "sides",
        "both wheels of a side; gyro, camera",
        "gyro=on&camera=on",
        tuple(SIDES.values()),
    ),
    Kind(
        "sides-gyro",
        "both wheels of a side; gyro alone",
        "gyro=on&camera=off",
        tuple(SIDES.values()),
    ),
    Kind(
        "wheels",
        "one wheel; gyro, camera",
        "gyro=on&camera=on",
        (("fl",), ("fr",), ("rl",), ("rr",)),
    ),
    Kind("none", "no slip; gyro, camera", "gyro=on&camera=on", ()),
)
"""Kinds of drives; targets are for the first."""


@dataclass(frozen=True)
class Slip:
    """One slip that was simulated."""

    wheels: tuple[str, ...]
    """Who."""
    begin_s: float
    """From when on [s]."""
    end_s: float
    """Until when [s]."""
    factor: float
    """How much faster the wheels turn than they roll."""


@dataclass(frozen=True)
class Job:
    """One drive."""

    kind: Kind
    """What kind."""
    seed: int
    """Its seed."""


@dataclass(frozen=True)
class Found:
    """What a method found on one drive; times in seconds."""

    slipping: float
    """Time that wheels slipped while they turned, side by side."""
    hit: float
    """Of that, called slip of that side."""
    free: float
    """Time without slip, margins left out, while wheels turned."""
    false: float
    """Of that, called slip."""
    slips: int
    """Slips of at least 0.3 s of turning wheels."""
    hits: int
    """Of these, found for at least half of their time."""
    stretches: int
    """Stretches that were told."""
    certain: int
    """Of these, with a probability of 90 % or more."""
    right: int
    """Of the certain ones, how many lie mostly within a slip of that side."""


def drawn(job: Job) -> tuple[str, tuple[Slip, ...]]:
    """Return the id of a job's drive and its slips."""
    rng = np.random.default_rng(1000 + job.seed)
    slips, at = [], 6.0
    for _ in range(3 if job.kind.wheels else 0):
        begin = at + rng.uniform(0.0, 8.0)
        end = begin + rng.uniform(1.0, 4.0)
        who = job.kind.wheels[int(rng.integers(len(job.kind.wheels)))]
        slips.append(Slip(who, round(begin, 2), round(end, 2), round(rng.uniform(1.18, 1.6), 3)))
        at = end + 3.0
    told = ",".join(f"{'+'.join(s.wheels)}:{s.begin_s}:{s.end_s}:{s.factor}" for s in slips)
    options = f"seed={job.seed}&yaw=off&{job.kind.sensors}&slip={told or 'off'}"
    return f"sim:random?{options}", tuple(slips)


def work(job: Job) -> dict[str, Found]:
    """Return what each method found on a job's drive."""
    from fgloc.datasets.registry import load_drive

    name, slips = drawn(job)
    drive = load_drive(name)
    return {m: compared(drive, run(create(m), drive).slips, slips) for m in METHODS}


def compared(drive: Drive, told: Sequence[WheelSlip], slips: Sequence[Slip]) -> Found:
    """Return what stretches of slip are worth against those simulated."""
    wheels = drive.wheels
    begin = int(wheels.stamps_ns[0])
    times = np.arange(GRID_S / 2, drive.duration_s, GRID_S)
    packet = np.searchsorted((wheels.stamps_ns - begin) * 1e-9, times) - 1
    moving = np.abs(wheels.angles[np.clip(packet, 0, len(wheels.angles) - 1)]).max(axis=1) > 1e-3
    none = np.zeros(times.size, dtype=np.bool_)
    true, found = dict.fromkeys(SIDES, none), dict.fromkeys(SIDES, none)
    near = none
    for s in slips:
        inside = (times >= s.begin_s) & (times < s.end_s)
        true[_side(s.wheels[0])] = true[_side(s.wheels[0])] | inside
        near = near | ((times >= s.begin_s - MARGIN_S) & (times < s.end_s + MARGIN_S))
    certain = right = 0
    for t in told:
        seconds = ((t.begin_ns - begin) * 1e-9, (t.end_ns - begin) * 1e-9)
        inside = (times >= seconds[0]) & (times < seconds[1])
        found[_side(t.wheel)] = found[_side(t.wheel)] | inside
        if t.probability >= CERTAIN and inside.any():
            certain += 1
            right += int(np.mean(true[_side(t.wheel)][inside]) > 0.5)
    hits = count = 0
    for s in slips:
        inside = (times >= s.begin_s) & (times < s.end_s) & moving
        if np.sum(inside) * GRID_S >= 0.3:
            count += 1
            hits += int(np.mean(found[_side(s.wheels[0])][inside]) > 0.5)
    anywhere = found["left"] | found["right"]
    return Found(
        GRID_S * float(sum(np.sum(true[s] & moving) for s in SIDES)),
        GRID_S * float(sum(np.sum(true[s] & found[s] & moving) for s in SIDES)),
        GRID_S * float(np.sum(~near & moving)),
        GRID_S * float(np.sum(anywhere & ~near & moving)),
        count,
        hits,
        len(told),
        certain,
        right,
    )


def _side(wheel: str) -> str:
    """Return the side of a wheel."""
    return next(side for side, wheels in SIDES.items() if wheel in wheels)


def execute(context: Context) -> Report:
    """Return the table over all seeds."""
    seeds = context.over(SEEDS)
    jobs = [Job(kind, seed) for kind in KINDS for seed in seeds]
    outcomes = context.map(work, jobs, lambda j: f"{j.kind.id} seed {j.seed}")
    found: dict[tuple[str, str], list[Found]] = {}
    for job, outcome in zip(jobs, outcomes, strict=True):
        for method, one in outcome.items():
            found.setdefault((job.kind.id, method), []).append(one)
    return Report(
        f"Wheel slip found and timed, {len(seeds)} simulated drives of each kind",
        (_table(found),),
        (
            "Slips of 15 to 38 % (wheels turn 1.18 to 1.6 times as fast as they roll), 1 to 4 s "
            "long, three a drive of 60 s; the true track and radii are drawn from their priors. "
            "Time counts while wheels turn.",
            "With a gyro alone, wheels of a side that slip together look like another turn and "
            "another speed: nobody sees the speed, and which side it was only the sign of the "
            "wheels' torque tells.",
        ),
        (_figure(found),),
        {"seeds": len(seeds), "kinds": [k.id for k in KINDS]},
    )


def _table(found: Mapping[tuple[str, str], Sequence[Found]]) -> Table:
    """Return missed slip and false alarms by kind and method."""
    rows = []
    for kind in KINDS:
        for method in METHODS:
            all_ = found[(kind.id, method)]
            slipping, free = sum(f.slipping for f in all_), sum(f.free for f in all_)
            slips, certain = sum(f.slips for f in all_), sum(f.certain for f in all_)
            judged = kind is KINDS[0]
            cells: dict[str, Cell | str] = {
                "false": Cell(
                    100.0 * sum(f.false for f in all_) / max(free, 1e-9),
                    2,
                    target=100.0 * FALSE_AT_MOST if judged else None,
                ),
                "stretches": Cell(sum(f.stretches for f in all_), 0),
            }
            if slipping > 0.0:
                missed = 1.0 - sum(f.hit for f in all_) / slipping
                lost = 1.0 - sum(f.hits for f in all_) / max(slips, 1)
                target = 100.0 * MISSED_AT_MOST if judged else None
                cells["missed"] = Cell(100.0 * missed, 2, target=target)
                cells["lost"] = Cell(100.0 * lost, 2, target=target)
                cells["slips"] = Cell(slips, 0)
            if certain:
                cells["right"] = Cell(100.0 * sum(f.right for f in all_) / certain, 1)
            rows.append(Row((kind.title, method), cells))
    return Table(
        "slip",
        "Slip missed and false alarms",
        ("slip and sensors", "method"),
        (
            Column("slips", "slips"),
            Column("missed", "time of slip missed", "%"),
            Column("lost", "slips lost", "%"),
            Column("false", "false alarm", "% of time without slip"),
            Column("stretches", "stretches told"),
            Column("right", "of those with p ≥ 90 % right", "%"),
        ),
        tuple(rows),
        ("Recall is what is not missed: at least 95 % of time and of slips is wanted.",),
    )


def _figure(found: Mapping[tuple[str, str], Sequence[Found]]) -> Figure:
    """Return recall and false alarms of every drive with slipping sides."""

    def draw(path: Path) -> Path:
        from fgloc.report.figures import colour, new_figure, save

        figure = new_figure(6.5, 4.0)
        axes = figure.subplots()
        for method in METHODS:
            rows = found[("sides", method)]
            recall = np.sort([100.0 * f.hit / f.slipping for f in rows if f.slipping > 0.0])
            share = 100.0 * np.arange(1, recall.size + 1) / recall.size
            axes.step(recall, share, where="post", color=colour(method), label=method)
        axes.axvline(95.0, color="0.5", lw=0.8, ls="--")
        axes.set_xlabel("time of slip that was found on a drive [%]")
        axes.set_ylabel("drives with no more [%]")
        axes.set_title("Both wheels of a side slip; gyro and camera")
        axes.legend(frameon=False)
        axes.grid(alpha=0.3)
        return save(figure, path)

    return Figure(
        "recall", "How much of the time of slip was found, drive by drive (cumulative).", draw
    )


EXPERIMENT = Experiment(
    "slip", "wheels of a side that slip together, found and timed over 100 seeds", (), execute
)
