"""The default extractor: which walls it finds, and what it does not take for one."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.measurements import Scans
from fgloc.errors import FglocError
from fgloc.lidar.lines import LineSettings, extract
from fgloc.lidar.scan import Cloud, cloud
from fgloc.lidar.segments import Segments
from tests.lidar.rooms import BOX, TURN, arc, scan_room


def found(scans: Scans, settings: LineSettings | None = None) -> Segments:
    """Return the segments of scans of a lidar at rest."""
    return extract(cloud(scans), scans, settings or LineSettings())


def lines_of(segments: Segments) -> list[tuple[float, float]]:
    """Return direction of the normal [deg] and distance [m] of each line from the lidar."""
    normal = np.stack([np.cos(segments.normal), np.sin(segments.normal)], axis=1)
    distance = -np.sum(normal * segments.middle, axis=1)
    return sorted(zip(np.degrees(segments.normal).tolist(), distance.tolist(), strict=True))


def test_a_box_by_hand() -> None:
    # Its walls stand 2 m to the right, 5 m ahead, 3 m to the left and 3 m behind; normals point
    # to the lidar.
    segments = found(scan_room(BOX, 20))
    assert segments.scan.tolist() == sorted([*range(20)] * 4)
    for k in range(20):
        lines = lines_of(segments.select(segments.scan == k))
        expected = [(-90.0, 3.0), (0.0, 3.0), (90.0, 2.0), (180.0, 5.0)]
        normals = [180.0 if a < -135.0 else a for a, _ in lines]
        for (_, distance), normal in zip(lines, normals, strict=True):
            best = min(expected, key=lambda e: abs(e[0] - normal))
            assert (normal, distance) == pytest.approx(best, abs=1.5)
            assert distance == pytest.approx(best[1], abs=0.04)
            expected.remove(best)


def test_ends_are_where_the_walls_end() -> None:
    # Nothing beyond the last beam on a wall is claimed, and no more is lost than beams are apart.
    segments = found(scan_room(BOX, 50))
    far = segments.select(np.abs(np.abs(segments.normal) - math.pi) < 0.3)
    right, left = far.ends[:, 0], far.ends[:, 1]
    # The wall ahead, seen from its own side: its right end is to the left of the lidar. Beams are
    # 0.12 m apart there, and the noise of 6 cm may take one or two of them for the other wall's.
    assert np.mean(np.abs(right[:, 1] - 3.0) < 0.25) > 0.95
    assert np.mean(np.abs(left[:, 1] + 2.0) < 0.25) > 0.95
    assert (right[:, 1] < 3.0 + 0.1).all()
    assert (left[:, 1] > -2.0 - 0.1).all()


def test_noise_of_6_cm_does_not_shatter_a_wall() -> None:
    segments = found(scan_room(((6.0, -6.0, 6.0, 6.0),), 200))
    assert np.mean(np.bincount(segments.scan, minlength=200) == 1) > 0.98


def test_an_open_door_is_not_bridged() -> None:
    # A wall 2 m ahead with a door of 0.9 m, and another wall 2 m behind it.
    walls = ((2.0, -3.0, 2.0, -0.4), (2.0, 0.5, 2.0, 3.0), (4.0, -4.0, 4.0, 4.0))
    segments = found(scan_room(walls, 100, max_range=8.0))
    near = segments.select(segments.middle[:, 0] < 3.0)
    assert np.mean(np.bincount(near.scan, minlength=100) == 2) > 0.95
    low, high = near.ends[..., 1].min(axis=1), near.ends[..., 1].max(axis=1)
    assert ((high < -0.3) | (low > 0.4)).all()


@pytest.mark.parametrize("width", [0.3, 0.8])
def test_a_wall_goes_on_behind_what_hides_it(width: float) -> None:
    walls = ((3.0, -3.0, 3.0, 3.0), (1.0, -width / 6, 1.0, width / 6))
    segments = found(scan_room(walls, 100))
    wall = segments.select(segments.middle[:, 0] > 2.0)
    assert np.mean(np.bincount(wall.scan, minlength=100) == 1) > 0.95
    assert np.median(wall.lengths) > 5.5


def test_a_wall_across_the_seam_is_one() -> None:
    # Scans begin and end behind the lidar, where a wall stands; the world without any jump of the
    # range is the hardest.
    segments = found(scan_room(BOX, 100))
    behind = segments.select(np.abs(segments.normal) < 0.3)
    assert np.mean(np.bincount(behind.scan, minlength=100) == 1) > 0.98
    assert np.median(behind.lengths) > 4.7


def test_the_first_beam_does_not_matter_nor_the_way_round() -> None:
    scans = scan_room(BOX, 10)
    there = lines_of(found(scans))
    turned = replace(
        scans,
        ranges=np.roll(scans.ranges, -123, axis=1),
        angle_min=scans.angle_min + 123 * scans.angle_increment,
    )
    np.testing.assert_allclose(lines_of(found(turned)), there, atol=1e-9)
    back = replace(
        scans,
        ranges=np.ascontiguousarray(scans.ranges[:, ::-1]),
        angle_min=scans.angle_min + 399 * scans.angle_increment,
        angle_increment=-scans.angle_increment,
    )
    assert len(lines_of(found(back))) == len(there)
    for a, b in zip(lines_of(found(back)), there, strict=True):
        # The seam is elsewhere, so that a beam here and there is counted otherwise.
        assert abs(math.remainder(a[0] - b[0], 360.0)) < 0.2
        assert abs(a[1] - b[1]) < 0.01


def test_half_a_turn_has_no_seam() -> None:
    # 180° of the box: the walls left and right are cut by the field of view, not joined.
    half = scan_room(BOX, 50, beams=200, angle_min=-math.pi / 2, sigma=0.01, share=0.0)
    segments = found(half)
    assert np.mean(np.bincount(segments.scan, minlength=50) == 3) > 0.95


def test_one_scan_alone_gives_what_it_gives_among_others() -> None:
    scans = scan_room(BOX, 5, dropout=0.02)
    together = found(scans)
    one = found(replace(scans, stamps_ns=scans.stamps_ns[3:4], ranges=scans.ranges[3:4]))
    same = together.select(together.scan == 3)
    np.testing.assert_array_equal(one.middle, same.middle)
    np.testing.assert_array_equal(one.covariance, same.covariance)
    np.testing.assert_array_equal(one.points, same.points)


@pytest.mark.parametrize(("radius", "ahead"), [(2.0, 0.0), (5.0, 0.0), (5.0, 2.0), (6.0, 3.0)])
@pytest.mark.parametrize(("sigma", "share"), [(0.01, 0.0), (1e-3, 0.01)])
def test_a_round_wall_is_none(radius: float, ahead: float, sigma: float, share: float) -> None:
    segments = found(scan_room(arc(radius, ahead, 0.0), 100, sigma=sigma, share=share))
    assert segments.scan.size <= 3


def test_round_columns_are_no_walls() -> None:
    walls = (*arc(0.3, 1.5, 0.5, 120), *arc(0.5, 0.0, -2.5, 120), *arc(1.0, -3.0, 0.0, 240))
    assert found(scan_room(walls, 100)).scan.size <= 10


def test_motion_during_a_turn_is_undone() -> None:
    # The lidar drives ahead at 1 m/s and turns at 1 rad/s; each beam is cast from where it is.
    from fgloc.core import geometry
    from fgloc.datasets.simulator.rays import cast

    twist = np.array([0.1, 0.0, 0.1])
    places = geometry.exp(twist * np.arange(400)[:, None] / 400)
    angles = -math.pi + TURN / 400 * np.arange(400)
    ranges = cast(
        np.ascontiguousarray(places[:, :2]), places[:, 2] + angles, 1, np.array(BOX, float), 50.0
    )
    scans = Scans(
        "lidar",
        np.zeros(1, np.int64),
        ranges[None],
        -math.pi,
        TURN / 400,
        beam_period=2.5e-4,
        range_sigma=0.01,
    )
    segments = extract(cloud(scans, twist[None]), scans)
    lines = np.array(lines_of(segments))
    np.testing.assert_allclose(np.abs(lines[:, 0]) % 90.0 % 89.99, 0.0, atol=0.02)
    np.testing.assert_allclose(np.sort(lines[:, 1]), [2.0, 3.0, 3.0, 5.0], atol=1e-3)
    still = np.array(lines_of(found(scans)))
    # Left as it is, the scan is bent by centimetres and degrees.
    assert np.abs(still[:, 0] / 90.0 - np.round(still[:, 0] / 90.0)).max() * 90.0 > 1.0


def test_every_other_beam_off_is_noise_and_not_clutter() -> None:
    # A scanner that takes every other beam half a turn later, while the robot moves 5 cm.
    scans = scan_room(((4.0, -3.0, 4.0, 3.0),), 50, sigma=0.01, share=0.0)
    ranges = scans.ranges.copy()
    ranges[:, ::2] = np.where(ranges[:, ::2] > 0.0, ranges[:, ::2] + 0.05, 0.0)
    segments = found(replace(scans, ranges=ranges))
    assert np.mean(np.bincount(segments.scan, minlength=50) == 1) > 0.95
    # The sigma of the offset grows as the noise does: from 1 cm to 2.5 cm and more.
    usual = found(scans)
    floor = LineSettings().flatness_m ** 2
    ratio = (np.median(segments.covariance[:, 1, 1]) - floor) / (
        np.median(usual.covariance[:, 1, 1]) - floor
    )
    assert 4.0 < ratio < 16.0


def test_floors_are_in_the_covariance() -> None:
    scans = scan_room(((1.0, -1.0, 1.0, 1.0),), 1, sigma=1e-3, share=0.0)
    plane = found(scans, LineSettings(flatness_m=0.0, roughness_m=0.0))
    wall = found(scans, LineSettings(flatness_m=0.01, roughness_m=0.0))
    added = wall.covariance - plane.covariance
    # A tilt is sqrt(12)·flatness over the length.
    np.testing.assert_allclose(added[0, 1, 1], 1e-4, rtol=1e-6)
    length = float(wall.lengths[0])
    np.testing.assert_allclose(added[0, 0, 0], 12.0 * 1e-4 / length**2, rtol=0.01)


def given(ranges: np.ndarray, **others: float) -> Scans:
    """Return scans of these ranges over a full turn."""
    stamps = np.arange(ranges.shape[0], dtype=np.int64)
    increment = TURN / max(ranges.shape[1], 1)
    return replace(Scans("lidar", stamps, ranges, -math.pi, increment), **others)


@pytest.mark.parametrize(
    "scans",
    [
        given(np.zeros((3, 400))),
        given(np.full((3, 400), 2.0)),
        given(np.full((3, 400), 1e-9)),
        given(np.full((3, 400), 5e8), max_range=1e9),
        given(np.full((3, 1), 2.0)),
        given(np.full((3, 2), 2.0)),
        given(np.full((3, 9), 2.0)),
        given(np.zeros((3, 0))),
        given(np.zeros((0, 400))),
        given(np.where(np.arange(400) == 7, 2.0, 0.0)[None]),
        given(np.tile([1.0, 7.0, 3.0, 0.0], (2, 100))),
        given(np.full((3, 400), 20.0), max_range=8.0),
    ],
)
def test_nothing_to_see(scans: Scans) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        segments = found(scans)
    assert segments.scan.size == 0
    assert segments.middle.shape == (0, 2)
    assert segments.covariance.shape == (0, 2, 2)


def test_points_that_are_no_numbers_are_no_points() -> None:
    scans = scan_room(BOX, 2)
    points = cloud(scans).points.copy()
    points[0] = math.nan
    points[1, 100:110] = math.inf
    ranges = np.full((2, 400), math.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        segments = extract(Cloud(points, ranges, np.ones((2, 400), np.bool_)), scans)
    assert set(segments.scan.tolist()) == {1}


def test_random_scans_never_fail() -> None:
    rng = np.random.default_rng(5)
    ranges = np.exp(rng.normal(0.0, 2.0, (300, 181)))
    ranges[rng.random(ranges.shape) < 0.3] = 0.0
    segments = found(given(ranges, max_range=30.0))
    assert np.isfinite(segments.middle).all()
    assert np.isfinite(segments.covariance).all()
    assert segments.scan.size < 30


def test_settings_that_make_no_sense_are_refused() -> None:
    for name, value in (("min_points", 3), ("most_missing", -1), ("gap_m", -0.1), ("same", 0.0)):
        with pytest.raises(FglocError, match=name):
            LineSettings(**{name: value})
    with pytest.raises(FglocError, match="penalty"):
        LineSettings(penalty=math.nan)
