"""One graph of many drives: each has its own trajectory, the robot's calibration is shared.

The graph is a star: drives hang together by nothing but the calibration. Eliminating a drive's
poses, sensor zeros and landmarks leaves what it tells of the shared variables, a Gaussian message;
the calibration is where all messages and the prior balance. Each drive is minimised with the
prior and the messages of all others as its prior (belief propagation, which on a star is exact: a
fixed point is a stationary point of the joint cost, and its covariance the joint one). Messages are
made anew in rounds, as drives are linearised anew; memory is that of one message a drive and of the
drives' own states.

The recorded truth has no part in this: what there is to compare the wheels with are the drive's
sensors, and where four encoders contradict each other, the wheels themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fgloc.calibration.models import same_robot
from fgloc.calibration.result import DriveResiduals
from fgloc.core.drive import Drive
from fgloc.core.kinematics import Parameter, prior_covariance
from fgloc.core.measurements import CameraPoses, Floats, Sensor, Stamps
from fgloc.errors import FglocError
from fgloc.factors.tables import COMPONENTS, residuals
from fgloc.smoothing.minimise import CalibrationPrior, Point, linear_system, minimise
from fgloc.smoothing.network import step_of
from fgloc.smoothing.problem import HIDDEN, Problem
from fgloc.smoothing.sensors import KNOWN
from fgloc.smoothing.settings import Settings
from fgloc.smoothing.trust import solve_with_trust

LOCAL = ("_zero", "_drift", "_bias")
"""Endings of sensor variables that are another one in every drive."""
ROUNDS = 12
"""Most rounds over all drives."""
DONE = 1e-3
"""Changes of the shared variables by less, in sigmas of the joint posterior, end the rounds."""
Tell = Callable[[str], None]


@dataclass(frozen=True)
class GraphFit:
    """The joint minimum."""

    parameters: tuple[Parameter, ...]
    """The shared variables: the robot's, then mountings and scales of sensors."""
    u: Floats
    """(G,) their values in solver variables."""
    covariance: Floats
    """(G, G) their joint covariance."""
    residuals: tuple[DriveResiduals, ...]
    """What is left on every drive."""
    sensors: tuple[str, ...]
    """Sensors that were used in some drive, wheels excluded."""
    notes: tuple[str, ...]
    """Drives that describe the robot otherwise; sensors that were left out, drive by drive."""
    rounds: int
    """How often all drives were minimised."""
    converged: bool
    """Whether the last round changed little."""


@dataclass
class _Leaf:
    """One drive of the star, as it changes from round to round."""

    drive: Drive
    problem: Problem
    point: Point
    shared: Stamps
    """(g,) indices of its shared variables among all of them."""
    own: Stamps
    """(g,) indices of the same among its own variables."""
    information: Floats
    """(G, G) what it tells of the shared variables."""
    vector: Floats
    """(G,) information times mean."""


def fit_graph(
    drives: Sequence[Drive],
    settings: Settings | None = None,
    start: Mapping[str, float] | None = None,
    tell: Tell | None = None,
) -> GraphFit:
    """Return the calibration that all drives' sensors ask for together.

    Each drive is first solved alone (`solve_with_trust`), which decides which sensors are believed
    and where wheels slip. `start` are values by parameter name where the search begins (a closed
    form, say); the prior stays where it is. `tell` hears of progress. A few solves a drive.
    Raises FglocError for no drive or drives of different robots, and as the batch smoother does.
    """
    if not drives:
        raise FglocError("no drive to calibrate on was given")
    settings = Settings() if settings is None else settings
    drives, described_otherwise = same_robot(drives)
    begun = [_begin(d, start) for d in drives]
    leaves, parameters, notes = _leaves(drives, begun, settings, tell)
    prior = np.asarray(np.linalg.inv(prior_covariance(parameters)), dtype=np.float64)
    described = _nominal(drives[0])
    original = tuple(replace(p, nominal=described.get(p.name, p.nominal)) for p in parameters)
    # The search may begin elsewhere, but what was known before stays where it was.
    nominal = np.array([p.to_solver(o.nominal) for p, o in zip(parameters, original, strict=True)])
    u, converged = np.zeros(len(parameters)), False
    rounds = 0
    for rounds in range(1, ROUNDS + 1):
        before = u
        for leaf in leaves:
            _minimise(leaf, leaves, prior, nominal, settings)
        u, covariance = _balance(leaves, prior, nominal)
        moved = float(np.max(np.abs(u - before) / np.sqrt(np.diag(covariance)), initial=0.0))
        if tell is not None:
            tell(f"round {rounds}: moved by {moved:.2g} sigma")
        if moved < DONE:
            converged = True
            break
    left = tuple(r for leaf in leaves for r in _residuals(leaf))
    sensors = {r.sensor for r in left} - {"wheels", "start"}
    return GraphFit(
        original,
        # Scales and relative sizes are those of the variables around the start.
        np.array(
            [
                o.to_solver(p.to_value(float(v)))
                for o, p, v in zip(original, parameters, u, strict=True)
            ]
        ),
        covariance,
        left,
        tuple(sorted(sensors)),
        (*described_otherwise, *notes),
        rounds,
        converged,
    )


def _begin(drive: Drive, start: Mapping[str, float] | None) -> Drive:
    """Return the drive with its robot and its sensors where the search begins.

    Solver variables are relative to that place; `fit_graph` brings them back.
    """
    if not start:
        return drive
    base = drive.robot.base
    own = {p.name: v for p in base.parameters if (v := start.get(p.name)) is not None}
    sensors: list[Sensor] = []
    for s in drive.sensors:
        if isinstance(s, CameraPoses):
            names = [f"{s.sensor}_{axis}" for axis in ("x", "y", "yaw")]
            x, y, yaw = (start.get(n, v) for n, v in zip(names, s.mount, strict=True))
            s = replace(s, mount=(x, y, yaw))
        sensors.append(s)
    robot = replace(drive.robot, base=base.with_values(own)) if own else drive.robot
    return replace(drive, robot=robot, sensors=tuple(sensors))


def _nominal(drive: Drive) -> dict[str, float]:
    """Return the nominal values of a robot's parameters and of its sensors' places, by name."""
    found = {p.name: p.nominal for p in drive.robot.base.parameters}
    for s in drive.sensors:
        for axis, value in zip(("x", "y", "yaw"), getattr(s, "mount", ()), strict=False):
            found[f"{s.sensor}_{axis}"] = value
    return found


def _leaves(
    drives: Sequence[Drive],
    begun: Sequence[Drive],
    settings: Settings,
    tell: Tell | None,
) -> tuple[list[_Leaf], tuple[Parameter, ...], list[str]]:
    """Return every drive solved alone, the shared variables of all, and what was left out."""
    parameters: dict[str, Parameter] = {}
    solved, notes = [], []
    for k, drive in enumerate(begun, 1):
        problem, solution, left_out = solve_with_trust(replace(drive, truth=None), settings)
        for p in problem.parameters:
            if not p.name.endswith(LOCAL) and p.prior_sigma > KNOWN:
                parameters.setdefault(p.name, p)
        notes += [f"{drive.name}: {text}" for text in left_out.values()]
        solved.append((problem, solution.point))
        if tell is not None:
            tell(f"{drive.name} solved alone ({k} of {len(drives)})")
    names = list(parameters)
    free = [n for n in names if n in {p.name for p in begun[0].robot.base.parameters}]
    names = [*free, *(n for n in names if n not in free)]
    count = len(names)
    leaves = []
    for drive, (problem, point) in zip(begun, solved, strict=True):
        own = [k for k, p in enumerate(problem.parameters) if p.name in parameters]
        shared = [names.index(problem.parameters[k].name) for k in own]
        leaves.append(
            _Leaf(
                drive,
                problem,
                point,
                np.array(shared),
                np.array(own),
                np.zeros((count, count)),
                np.zeros(count),
            )
        )
    return leaves, tuple(parameters[n] for n in names), notes


def _balance(leaves: Sequence[_Leaf], prior: Floats, nominal: Floats) -> tuple[Floats, Floats]:
    """Return mean (G,) and covariance (G, G) of the shared variables, by prior and messages."""
    information = prior + sum((leaf.information for leaf in leaves), np.zeros_like(prior))
    vector = prior @ nominal + sum((leaf.vector for leaf in leaves), np.zeros_like(nominal))
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return covariance @ vector, covariance


def _minimise(
    leaf: _Leaf,
    leaves: Sequence[_Leaf],
    prior: Floats,
    nominal: Floats,
    settings: Settings,
) -> None:
    """Minimise one drive with the messages of all others, and make its own message anew."""
    mean, cavity = _balance([other for other in leaves if other is not leaf], prior, nominal)
    at = np.ix_(leaf.shared, leaf.shared)
    own_prior = leaf.problem.prior_covariance
    size = own_prior.shape[0]
    covariance, centre = own_prior.copy(), np.zeros(size)
    # Variables of the drive alone keep their own prior, independent of the shared ones.
    covariance[leaf.own, :] = 0.0
    covariance[:, leaf.own] = 0.0
    covariance[np.ix_(leaf.own, leaf.own)] = cavity[at]
    centre[leaf.own] = mean[leaf.shared]
    gaussian = CalibrationPrior.gaussian(centre, covariance)
    point, _, _ = minimise(
        leaf.problem,
        settings,
        leaf.point.states,
        leaf.point.u,
        settings.robust,
        gaussian,
        leaf.point.landmarks,
    )
    final = step_of(linear_system(gaussian, point), with_covariance=True)
    if final is None or final.calibration_covariance is None:
        raise FglocError(
            f"{leaf.drive.name}: the graph is indeterminate; a sensor's noise or the robot's "
            "dimensions may be wrong by orders of magnitude"
        )
    leaf.point = point
    inner = np.ix_(leaf.own, leaf.own)
    # The message is what the drive adds to its prior, seen from the shared variables alone.
    posterior = np.linalg.inv(final.calibration_covariance[inner])
    before = np.linalg.inv(cavity[at])
    leaf.information[:] = 0.0
    leaf.vector[:] = 0.0
    leaf.information[at] = posterior - before
    found = point.u + final.calibration_step
    leaf.vector[leaf.shared] = posterior @ found[leaf.own] - before @ mean[leaf.shared]


def _residuals(leaf: _Leaf) -> list[DriveResiduals]:
    """Return what is left of every sensor on one drive, less what the losses gave up."""
    rows = []
    point = leaf.point
    for table, linear, weights in zip(point.tables, point.linear, point.weights, strict=True):
        if table.kind in HIDDEN or table.sensor == "start" or not table.first.size:
            continue
        values = residuals(table, point.states, point.u, point.landmarks)
        share = weights / np.sum(weights)
        rms = np.sqrt(share @ values**2)
        normalised = np.sqrt(share @ linear.residual**2)
        names = COMPONENTS[table.kind]
        rows.append(
            DriveResiduals(
                leaf.drive.name,
                table.sensor,
                tuple(names),
                tuple(float(v) for v in rms),
                tuple(float(v) for v in normalised),
                int(table.first.size),
                float(np.mean(weights)),
            )
        )
    return rows
