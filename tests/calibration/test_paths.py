"""Open-loop paths and their derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fgloc.calibration.path_fit import Model, rows_of
from fgloc.calibration.paths import path, path_data, pieces
from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.geometry import EXACT, compose, integrate
from fgloc.core.kinematics import Parameter, WheeledBase
from fgloc.core.measurements import Floats, WheelIncrements
from fgloc.core.motion_models import rotation_scale
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError

STEP_NS = 50_000_000


def made(
    base: WheeledBase,
    angles: Floats,
    start: Floats,
    values: Floats | None = None,
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Drive:
    """Return a drive of (N, W) wheel angles whose truth is that of a robot with `values`."""
    stamps = STEP_NS * np.arange(angles.shape[0] + 1, dtype=np.int64)
    poses = integrate(base.displacements(angles, values=values), start, EXACT)
    wheels = WheelIncrements("wheels", stamps, angles, base.driven_names)
    offset = np.array(mount)
    truth = Reference(Trajectory(stamps, compose(poses, offset)), "mocap")
    return Drive("made", Robot("r", base), wheels, truth=truth)


def wandering(columns: int, seed: int = 0, count: int = 400) -> Floats:
    """Return (count, columns) wheel angles that change slowly."""
    rng = np.random.default_rng(seed)
    knots = rng.uniform(-0.3, 0.5, (12, columns))
    at = np.linspace(0, 11, count)
    return np.stack([np.interp(at, np.arange(12), knots[:, c]) for c in range(columns)], axis=1)


def test_a_path_at_the_true_values_has_no_error() -> None:
    base = bases.differential(0.1, 0.1, 0.5)
    drive = made(base, wandering(2), np.array([1.0, -2.0, 2.5]))
    assert drive.truth is not None
    found = path(path_data(drive), drive.robot, base.nominal(), np.zeros(3))
    np.testing.assert_allclose(found.residual, 0.0, atol=1e-12)


def test_a_path_by_hand() -> None:
    # A quarter of a circle: wheels 0.1 m, 0.5 m apart; left 9·pi/10, right 11·pi/10 in the end is
    # way 0.1·pi·... per step below: turn 0.5·pi, way 0.25·pi, so radius 0.5; the reference sits
    # 0.2 m ahead: it ends at (0.5, 0.5) + 0.2·(0, 1) as the base does.
    base = bases.differential(0.1, 0.1, 0.5)
    turn, way = 0.5 * np.pi, 0.25 * np.pi
    left, right = (way - 0.25 * turn) / 0.1, (way + 0.25 * turn) / 0.1
    drive = made(base, np.tile([left / 50, right / 50], (50, 1)), np.zeros(3), mount=(0.2, 0, 0))
    data = path_data(drive)
    found = path(data, drive.robot, base.nominal(), np.array([0.2, 0.0, 0.0]))
    np.testing.assert_allclose(found.residual[-1] + data.truth[-1], [0.5, 0.7, turn], atol=1e-12)
    np.testing.assert_allclose(data.truth[-1], [0.5, 0.7, turn], atol=1e-12)


@pytest.mark.parametrize(
    "base",
    [
        rotation_scale(bases.differential(0.1, 0.1, 0.5)),
        bases.full_linear(bases.omni3([0.05] * 3, 0.2, [-1.0, 1.0, 3.14])),
        bases.skid_steer(("l",), ("r",), 0.1, 0.4, icr_x=0.05, icr_prior=0.1),
    ],
    ids=["rotation-scale", "full-linear", "skid-steer"],
)
def test_derivatives_agree_with_finite_differences(base: WheeledBase) -> None:
    drive = made(base, wandering(len(base.driven)), np.array([0.3, 0.1, 1.0]))
    mount = tuple(Parameter(f"mocap_{a}", 0.05, 0.1) for a in ("x", "y", "yaw"))
    model = Model(drive.robot, mount, (Parameter("time_offset", 0.0, 0.1, unit="s"),), clock=True)
    rng = np.random.default_rng(1)
    u = 0.05 * rng.normal(size=len(model.parameters))
    local = np.array([0.13, -0.2])
    data = path_data(drive)
    rows = rows_of(data, model, u, local)
    # Times are nanoseconds, and rates change at every stamp: steps and tolerance are wide.
    for k, p in enumerate(model.parameters):
        h = 1e-3 if p.name == "time_offset" else 1e-6
        e = h * np.eye(u.size)[k]
        ends = [rows_of(data, model, v, local).residual for v in (u + e, u - e)]
        numeric = (ends[0] - ends[1]) / (2 * h)
        tolerance = 1e-2 if p.name == "time_offset" else 1e-6
        np.testing.assert_allclose(rows.shared[:, :, k], numeric, atol=tolerance, err_msg=p.name)
    for k in range(2):
        e = 1e-3 * np.eye(2)[k]
        ends = [rows_of(data, model, u, v).residual for v in (local + e, local - e)]
        np.testing.assert_allclose(
            rows.local[:, :, k], (ends[0] - ends[1]) / 2e-3, atol=1e-2, err_msg=str(k)
        )


def test_pieces_start_where_the_truth_is() -> None:
    base = bases.differential(0.1, 0.1, 0.5)
    drive = made(base, wandering(2), np.zeros(3))
    # The robot's track is wrong: a late piece would be far off, did it not start anew.
    wrong = replace(drive, robot=Robot("r", base.with_values({"effective_track": 0.6})))
    cut = pieces(path_data(wrong), 4)
    assert len(cut) == 4
    for piece in cut:
        found = path(piece, wrong.robot, wrong.robot.base.nominal(), np.zeros(3))
        assert np.abs(found.residual[0, :2]).max() < 0.01


def test_a_drive_without_truth_is_an_error() -> None:
    drive = replace(made(bases.differential(0.1, 0.1, 0.5), wandering(2), np.zeros(3)), truth=None)
    with pytest.raises(FglocError, match="no recorded truth"):
        path_data(drive)
