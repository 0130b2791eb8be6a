"""Models beyond the geometry, by answers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.motion_models import MODELS, free_icr, lateral_scale, rotation_scale, turning_radius
from fgloc.errors import FglocError

ORDER = ("fl", "fr", "rl", "rr")
DIFFERENTIAL = bases.differential(0.1, 0.1, 0.5)


def test_a_spin_is_scaled_whole_an_arc_in_part_a_straight_not_at_all() -> None:
    base = rotation_scale(DIFFERENTIAL)
    # Spin: ±1 rad of 0.1 m wheels, 0.5 m apart: 0.4 rad, times 1.5.
    # Arc: 2 and 1 rad: way 0.15, turn 0.2; half track 0.25: s = 0.05² / (0.05² + 0.15²) = 0.1.
    # Straight: no turn.
    moved = base.displacements(
        np.array([[-1.0, 1.0], [1.0, 2.0], [1.0, 1.0]]), values=np.array([0.1, 0.1, 0.5, 1.5])
    )
    np.testing.assert_allclose(moved[:, 2], [0.6, 0.2 * 1.05, 0.0], atol=1e-15)
    np.testing.assert_allclose(moved[:, 0], [0.0, 0.15, 0.1], atol=1e-15)


def test_the_way_to_the_left_is_scaled() -> None:
    base = lateral_scale(bases.mecanum(0.05, 0.2, 0.15, ORDER))
    aside = np.array([[-1.0, 1.0, 1.0, -1.0]])
    values = np.array([*base.nominal()[:-1], 1.2])
    np.testing.assert_allclose(base.displacements(aside, values=values), [[0.0, 0.06, 0.0]])


def test_the_radius_at_which_turns_are_half_scaled_is_that_of_the_wheels() -> None:
    skid = bases.skid_steer(("fl", "rl"), ("fr", "rr"), 0.1, 0.5)
    swerve = bases.four_wheel_steer(
        ORDER, [(0.3, 0.4), (0.3, -0.4), (-0.3, 0.4), (-0.3, -0.4)], [0.05] * 4
    )
    radii = [
        turning_radius(b) for b in (DIFFERENTIAL, bases.full_linear(DIFFERENTIAL), skid, swerve)
    ]
    np.testing.assert_allclose(radii, [0.25, 0.25, 0.25, 0.5])
    assert turning_radius(bases.mecanum(0.05, 0.2, 0.15, ORDER)) == pytest.approx(0.35)
    assert turning_radius(bases.tricycle(0.05, 0.3)) == pytest.approx(0.3)


def test_two_models_share_one_wheel_and_encoders_stay_as_they_are() -> None:
    base = lateral_scale(rotation_scale(DIFFERENTIAL))
    assert base.driven_names == DIFFERENTIAL.driven_names
    assert [w.kind for w in base.wheels].count("scale") == 1
    assert [p.name for p in base.parameters[-2:]] == ["rotation_scale", "lateral_scale"]
    with pytest.raises(FglocError, match="already has rotation_scale"):
        rotation_scale(base)
    with pytest.raises(FglocError, match="already has rotation_scale"):
        rotation_scale(bases.body_odometry())


def test_icr_is_freed_in_nominal_tracks() -> None:
    base = free_icr(bases.skid_steer(("left",), ("right",), 0.1, 0.5))
    assert next(p for p in base.parameters if p.name == "icr_x").prior_sigma == 0.125
    with pytest.raises(FglocError, match="no icr_x"):
        free_icr(DIFFERENTIAL)


def test_models_are_known_by_name() -> None:
    assert set(MODELS) == {"rotation-scale", "lateral-scale", "icr"}
    assert math.isclose(MODELS["rotation-scale"](DIFFERENTIAL).nominal()[-1], 1.0)
