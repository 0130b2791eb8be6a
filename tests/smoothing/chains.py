"""A simulated chain as factor tables, and its batch solution by other code than iSAM2's."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from fgloc.core.geometry import compose, rotate_covariance
from fgloc.core.measurements import Floats
from fgloc.factors.gtsam_factors import rows_of
from fgloc.factors.tables import FactorTable, Kind, linearise
from fgloc.smoothing.arrow import ArrowSolution, solve, stack
from fgloc.smoothing.isam import IncrementalGraph

PERIOD = 0.1
WHEEL_SIGMA = np.array([2e-3, 1e-3, 2e-3])
START_SIGMA = np.array([0.01, 0.01, 0.01])
FIX_SIGMA = 0.05
CALIBRATION_SIGMA = 0.01
NONE = slice(0, 0)


@dataclass
class Chain:
    """A robot with two wheels and three calibration variables, on a winding path."""

    seed: int = 0
    fix_every: int = 10
    """Keyframes from one position fix to the next, 0 for none."""
    calibration_sigma: float = CALIBRATION_SIGMA
    """Standard deviation of the calibration's prior, from which the truth is drawn."""
    truth: list[Floats] = field(default_factory=lambda: [np.zeros(3)])
    guesses: list[Floats] = field(default_factory=lambda: [np.zeros(3)])
    tables: list[FactorTable] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.u = self.rng.normal(size=3) * self.calibration_sigma

    @property
    def newest(self) -> int:
        return len(self.truth) - 1

    def start(self, graph: IncrementalGraph) -> None:
        """Give the graph its first keyframe."""
        pose = np.zeros((1, 6))
        prior = FactorTable(
            Kind.POSE_FIX, "start", np.array([0]), pose, np.diag(1 / START_SIGMA)[None], NONE
        )
        self.tables.append(prior)
        spread = np.eye(3) * self.calibration_sigma**2
        graph.start(0.0, 0, np.zeros(3), rows_of(prior), np.zeros(3), spread)
        graph.update()

    def fix(self, keyframe: int, offset: float = 0.0, sigma: float = FIX_SIGMA) -> FactorTable:
        """Return a measured position of a keyframe."""
        seen = self.truth[keyframe][:2] + self.rng.normal(size=2) * sigma + offset
        row = np.concatenate([seen, np.zeros(2)])[None]
        return FactorTable(
            Kind.POSITION_FIX, "fix", np.array([keyframe]), row, np.eye(2)[None] / sigma, NONE
        )

    def drive(self) -> tuple[FactorTable, Floats]:
        """Go on by one keyframe; return the wheels' table and the displacement's Jacobian."""
        k = len(self.truth)
        motion = np.array([0.1, 0.0, 0.05 * np.sin(0.01 * k)])
        jacobian = np.array([[0.05, 0.05, 0.0], [0.0, 0.0, 0.0], [-0.2, 0.2, -motion[2]]])
        self.truth.append(compose(self.truth[-1], motion))
        measured = motion - jacobian @ self.u + self.rng.normal(size=3) * WHEEL_SIGMA
        row = np.concatenate([measured, jacobian.ravel()])[None]
        root = np.diag(1 / WHEEL_SIGMA)[None]
        return FactorTable(
            Kind.WHEEL, "wheels", np.array([k - 1]), row, root, slice(0, 3)
        ), jacobian

    def step(self, graph: IncrementalGraph, update: bool = True) -> list[FactorTable]:
        """Drive one keyframe and give it to the graph, with a fix if it is time for one."""
        wheels, jacobian = self.drive()
        k = self.newest
        # A graph that was not updated cannot be asked for its newest state.
        before = graph.state(k - 1) if update else self.guesses[-1]
        u = graph.calibration() if update else np.zeros(3)
        guess = compose(before, wheels.measurements[0, :3] + jacobian @ u)
        self.guesses.append(guess)
        tables = [wheels]
        if self.fix_every and k % self.fix_every == 0:
            tables.append(self.fix(k))
        self.tables += tables
        graph.add(PERIOD * k, k, guess, [row for t in tables for row in rows_of(t)])
        if update:
            graph.update()
        return tables

    def run(self, graph: IncrementalGraph, keyframes: int) -> None:
        for _ in range(keyframes):
            self.step(graph)

    def batch(self) -> tuple[Floats, Floats, ArrowSolution]:
        """Return states, calibration and last step with covariances of the whole chain's batch."""
        tables, u = merged(self.tables), np.zeros(3)
        states, prior = np.array(self.guesses), np.eye(3) / self.calibration_sigma
        for _ in range(30):
            linear = []
            for t in tables:
                rows = linearise(t, states, u)
                linear.append((t, rows, t.loss.weight(rows.squared)))
            prior_rows = np.append(prior, -(prior @ u)[:, None], axis=1)
            step = solve(stack(linear, len(states), 3, prior_rows), with_covariance=True)
            assert step is not None
            states, u = compose(states, step.step), u + step.calibration_step
            if np.abs(step.step).max() < 1e-10:
                return states, u, step
        raise AssertionError("the batch did not converge")


def in_map(covariance: Floats, heading: float) -> Floats:
    """Return a (3, 3) covariance in map axes, given in body axes."""
    return rotate_covariance(covariance, heading)


def merged(tables: list[FactorTable]) -> list[FactorTable]:
    """Return one table for each kind, sensor and loss."""
    groups: dict[object, list[FactorTable]] = {}
    for t in tables:
        groups.setdefault((t.kind, t.sensor, t.loss), []).append(t)
    return [
        replace(
            some[0],
            first=np.concatenate([t.first for t in some]),
            measurements=np.concatenate([t.measurements for t in some]),
            sqrt_information=np.concatenate([t.sqrt_information for t in some]),
        )
        for some in groups.values()
    ]
