"""The seed's extraction by random draws, and how far it sees."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core.consistency import average, each_squared_normalised
from fgloc.errors import FglocError
from fgloc.experiments.rooms.detection import accepted, draws_accepted, wall_scans
from fgloc.lidar.lines import extract
from fgloc.lidar.ransac import RansacSettings, extract_ransac
from fgloc.lidar.scan import cloud
from tests.lidar.rooms import BOX, scan_room


def test_chance_that_a_draw_on_a_wall_is_accepted() -> None:
    # 25 beams of 1 % noise, at least 21 within 15 mm: at 1 m each is so with 0.866, at 1.5 m with
    # 0.683 (1.5 and 1 sigma); the sums of the binomial distribution from 21 on.
    binomial = [
        sum(math.comb(25, k) * p**k * (1 - p) ** (25 - k) for k in range(21, 26))
        for p in (math.erf(1.5 / math.sqrt(2)), math.erf(1.0 / math.sqrt(2)))
    ]
    assert accepted(1.0, 0.01, 25, 21, 0.015) == pytest.approx(binomial[0], rel=1e-9)
    assert accepted(1.5, 0.01, 25, 21, 0.015) == pytest.approx(binomial[1], rel=1e-9)
    assert binomial == pytest.approx([0.76, 0.06], abs=0.006)
    # A line fitted to the same beams is nearer to them than the wall is.
    assert 0.76 < draws_accepted(wall_scans(1.0, 1)) < 0.92
    assert 0.06 < draws_accepted(wall_scans(1.5, 1)) < 0.2


def test_near_walls_are_found_several_times_and_far_ones_never() -> None:
    # 1 % of 0.7 m to 3 m: 7 mm to 3 cm.
    box = ((-3.0, -0.7, 3.0, -0.7), (3.0, -0.7, 3.0, 3.0), (3.0, 3.0, -3.0, 3.0))
    scans = scan_room(box, 100)
    segments = extract_ransac(cloud(scans), scans, np.random.default_rng(2))
    near = segments.middle[:, 1] < -0.5
    assert near.sum() > 300
    assert (~near).sum() < 10
    np.testing.assert_allclose(segments.normal[near], math.pi / 2, atol=0.2)
    assert (segments.points >= 21).all()
    assert (segments.points <= 25).all()
    # The default finds the other two as well, and each once.
    assert extract(cloud(scans), scans).scan.size > 290


def test_a_draw_depends_on_the_generator_only() -> None:
    scans = scan_room(BOX, 20, sigma=5e-3, share=0.0)
    one, same, other = (
        extract_ransac(cloud(scans), scans, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.middle, same.middle)
    assert one.scan.size != other.scan.size or not np.array_equal(one.middle, other.middle)


def test_neighbours_go_round_the_end_of_a_full_turn_only() -> None:
    wall = ((-1.0, -0.45, -1.0, 0.45),)
    scans = scan_room(wall, 20, sigma=1e-3, share=0.0)
    # 53 beams on a wall behind the lidar, half of them at each end of the scan.
    many = RansacSettings(inliers=25)
    assert extract_ransac(cloud(scans), scans, np.random.default_rng(1), many).scan.size > 0
    cut = replace(scans, angle_increment=scans.angle_increment * 0.95)
    ranges = cut.ranges.copy()
    ranges[:, 24:376] = 0.0
    few = replace(cut, ranges=ranges)
    assert extract_ransac(cloud(few), few, np.random.default_rng(1), many).scan.size == 0


def test_covariance_where_no_beam_is_chosen_by_its_error() -> None:
    scans = scan_room(((1.5, -3.0, 1.5, 3.0),), 400, sigma=2e-3, share=0.0)
    segments = extract_ransac(
        cloud(scans), scans, np.random.default_rng(3), RansacSettings(attempts=1)
    )
    error = np.stack([np.abs(segments.normal) - math.pi, 1.5 - segments.middle[:, 0]], axis=1)
    error[:, 0] *= np.sign(segments.normal)
    assert segments.scan.size > 300
    assert average(each_squared_normalised(error, segments.covariance), 2, 0.99).verdict == "inside"


@pytest.mark.parametrize("beams", [1, 2, 24, 400])
def test_nothing_to_see(beams: int) -> None:
    scans = scan_room(BOX, 3, beams=beams)
    empty = replace(scans, ranges=np.zeros_like(scans.ranges))
    same = replace(scans, ranges=np.full_like(scans.ranges, 1e-7), min_range=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for given in (empty, same):
            found = extract_ransac(cloud(given), given, np.random.default_rng(1))
            assert np.isfinite(found.middle).all()
        assert extract_ransac(cloud(empty), empty, np.random.default_rng(1)).scan.size == 0


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(FglocError, match="inliers"):
        RansacSettings(inliers=26)
    with pytest.raises(FglocError, match="tolerance_m"):
        RansacSettings(tolerance_m=0.0)
