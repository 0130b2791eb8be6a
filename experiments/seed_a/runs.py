"""Methods on seed A's simulated drives: one job is one case of one scenario over some seeds."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fgloc.core.drive import Drive
from fgloc.core.trajectory import Trajectory
from fgloc.estimator import Estimator

SMOOTHED_TRACK = 0.48
"""Track [m] that methods which estimate it start from, with the prior of a skid-steer base."""
YAW_STEP = 0.01
"""Resolution of the yaw [rad]."""


@dataclass(frozen=True)
class Entrant:
    """One method as it takes part."""

    id: str
    """Column key."""
    title: str
    """Heading."""
    method: str
    """Method id."""
    nominal_track: float | None = SMOOTHED_TRACK
    """Nominal track [m]; None for the case's own, as Models 1 and 2 have it in the seed."""
    tuned: tuple[tuple[str, float], ...] = ()
    """Parameters in place of the method's own, by name (see `fgloc.experiments.tunables`)."""


@dataclass(frozen=True)
class Scenario:
    """One kind of drive, in all three cases."""

    key: str
    """Name in tables of results."""
    drive: str
    """Name of the drive with {case} in place of the case, e.g. "seed-a-{case}-slip20"."""
    query: str = ""
    """Further keys of the drive, e.g. "camera=on"."""
    seeds: int = 0
    """Number of seeds; 0 for a drive in which nothing is drawn."""
    selection: bool = False
    """Whether the encoders of each side are selected (equations 3.3 to 3.6)."""


@dataclass(frozen=True)
class Job:
    """Some seeds of one case of one scenario."""

    scenario: Scenario
    """What is driven."""
    case: str
    """Which motion."""
    seeds: tuple[int, ...]
    """Seeds of this job."""
    entrants: tuple[Entrant, ...]
    """Methods."""


@dataclass(frozen=True)
class End:
    """What one method made of one drive."""

    x_m: float
    """Error of map x at the end [m]; NaN if the method failed."""
    y_m: float
    """Error of map y at the end [m]."""
    turned_deg: float
    """Heading error at the end, unwrapped, counter-clockwise positive [deg]."""
    track: float | None = None
    """Estimated effective track [m], for methods that estimate it."""
    track_sigma: float | None = None
    """Its standard deviation [m]."""
    seconds: float = 0.0
    """Time taken."""
    failure: str = ""
    """Why the method failed; empty if it did not."""
    trajectory: Trajectory | None = None
    """The path, of drives without noise."""

    @property
    def position_m(self) -> float:
        """Return the distance from the truth at the end [m]."""
        return math.hypot(self.x_m, self.y_m)

    @property
    def heading_deg(self) -> float:
        """Return the absolute heading error at the end [deg]."""
        return abs(self.turned_deg)


TITLES = {"model1": "Model 1", "model2": "Model 2", "model3": "Model 3"}
"""Headings; other methods have their id."""
OWN_TRACK = ("model1", "model2", "pose-ekf", "rl-ekf")
"""Methods that do not estimate the track; they are given that of each case, as in the seed."""
Ends = dict[tuple[str, str, str], list[End]]
"""What was found, by scenario, case and entrant; one for each seed."""


def entrants(*wanted: str) -> tuple[Entrant, ...]:
    """Return the entrants of those methods that this version has, in the order given."""
    from fgloc.experiments.methods import available

    return tuple(
        Entrant(m, TITLES.get(m, m), m, None if m in OWN_TRACK else SMOOTHED_TRACK)
        for m in wanted
        if m in available()
    )


def drive_id(scenario: Scenario, case: str, seed: int, nominal_track: float | None) -> str:
    """Return the id of a drive, as any command takes it.

    In noisy scenarios the yaw's zero is drawn evenly within its resolution: the seed does not
    say when, within its seven seconds, the first step of the drift comes.
    """
    import numpy as np

    items = [scenario.query] if scenario.query else []
    if scenario.seeds:
        zero = float(np.random.default_rng(seed).uniform(-0.5, 0.5)) * YAW_STEP
        items += [f"seed={seed}", f"yaw_zero={zero:.6f}"]
    if nominal_track is not None:
        items.append(f"nominal_track={nominal_track:g}")
    query = "?" + "&".join(items) if items else ""
    return f"sim:{scenario.drive.format(case=case)}{query}"


def build(entrant: Entrant) -> Estimator:
    """Return the estimator; Model 1 takes the seed's midpoint step."""
    from fgloc.experiments.methods import create

    if entrant.tuned:
        from fgloc.experiments.tunables import TUNABLE

        return TUNABLE[entrant.method][1](dict(entrant.tuned))
    return create(entrant.method, integrator="midpoint")


def run_job(job: Job) -> dict[str, list[End]]:
    """Return what every entrant makes of every seed of a job."""
    estimators = {entrant: build(entrant) for entrant in job.entrants}
    found: dict[str, list[End]] = {entrant.id: [] for entrant in job.entrants}
    for seed in job.seeds:
        drives: dict[float | None, Drive] = {}
        for entrant, estimator in estimators.items():
            track = entrant.nominal_track
            if track not in drives:
                drives[track] = _drive(job, seed, track)
            found[entrant.id].append(_end(estimator, drives[track], not job.scenario.seeds))
    return found


def _drive(job: Job, seed: int, nominal_track: float | None) -> Drive:
    """Return one drive of a job, with its encoders selected where the scenario says so."""
    from fgloc.datasets.registry import load_drive

    drive = load_drive(drive_id(job.scenario, job.case, seed, nominal_track))
    if job.scenario.selection:
        from fgloc.core.encoder_selection import select_encoders

        drive = select_encoders(drive)
    return drive


def _end(estimator: Estimator, drive: Drive, keep: bool) -> End:
    """Return what an estimator makes of one drive; `keep` keeps the trajectory."""
    from fgloc.core.evaluation import error_series
    from fgloc.errors import FglocError
    from fgloc.estimator import run

    assert drive.truth is not None
    try:
        result = run(estimator, drive)
    except FglocError as error:
        return End(math.nan, math.nan, math.nan, failure=str(error))
    x, y, heading = error_series(result.trajectory, drive.truth).errors[-1].tolist()
    track = next((c for c in result.calibration if c.name == "effective_track"), None)
    return End(
        x,
        y,
        math.degrees(heading),
        None if track is None else track.value,
        None if track is None else track.sigma,
        result.seconds,
        trajectory=result.trajectory if keep else None,
    )


def split(scenario: Scenario, case: str, who: tuple[Entrant, ...], size: int) -> list[Job]:
    """Return the jobs of one case of a scenario, at most `size` seeds each."""
    seeds = tuple(range(1, scenario.seeds + 1)) or (1,)
    return [Job(scenario, case, seeds[k : k + size], who) for k in range(0, len(seeds), size)]


def gather(jobs: list[Job], results: list[dict[str, list[End]]]) -> Ends:
    """Return what all jobs found, the seeds of each case in order."""
    ends: Ends = {}
    for job, result in zip(jobs, results, strict=True):
        for entrant, found in result.items():
            ends.setdefault((job.scenario.key, job.case, entrant), []).extend(found)
    return ends


def describe(job: Job) -> str:
    """Return what a job was, for a line of progress."""
    text = f"{job.scenario.key} {job.case}"
    if job.scenario.seeds:
        text += f" seeds {job.seeds[0]} to {job.seeds[-1]}"
    return text
