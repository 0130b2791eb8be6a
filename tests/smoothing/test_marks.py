"""Point landmarks in batch: surveyed or to be mapped, with wrong sightings, over seeds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from fgloc.core.drive import Drive
from fgloc.core.geometry import Floats, between, wrap
from fgloc.core.measurements import LandmarkSightings, Survey
from fgloc.datasets.registry import load_drive
from fgloc.estimator import Result
from fgloc.experiments.withheld import without_identity, without_survey
from fgloc.filters.model1 import Model1
from fgloc.lidar.walls import Marks
from fgloc.smoothing.batch import BatchSmoother
from tests.filters import landmark_world as world
from tests.smoothing.drives import scores

POSTS = world.circle_of_landmarks(12)


def smooth(drive: Drive) -> Result:
    return BatchSmoother().estimate(drive)


def sightings(drive: Drive) -> LandmarkSightings:
    (found,) = drive.each(LandmarkSightings)
    return found


def with_sightings(drive: Drive, seen: LandmarkSightings) -> Drive:
    return replace(drive, sensors=(seen,))


def surveyed(drive: Drive, sigma: float = 1e-3) -> Drive:
    survey = Survey(np.arange(len(POSTS)), POSTS, np.full(POSTS.shape, sigma))
    return with_sightings(drive, replace(sightings(drive), survey=survey))


def certain(drive: Drive) -> Drive:
    """Return the drive with a robot whose dimensions are known exactly, as they were driven."""
    base = drive.robot.base
    fixed = tuple(replace(p, prior_sigma=0.0) for p in base.parameters)
    return replace(drive, robot=replace(drive.robot, base=replace(base, parameters=fixed)))


def marks(result: Result) -> Marks:
    assert result.map is not None
    assert result.map.marks is not None
    return result.map.marks


def pose_errors(drive: Drive, result: Result) -> Floats:
    """Return (K, 3) errors of poses in body axes; keyframes are the wheels' stamps here."""
    assert drive.truth is not None
    truth = drive.truth.trajectory
    assert np.array_equal(truth.stamps_ns, result.trajectory.stamps_ns)
    off = between(truth.poses, result.trajectory.poses)
    off[:, 2] = wrap(off[:, 2])
    return off


def test_unknown_landmarks_are_mapped() -> None:
    drive = world.drive(POSTS, seed=1)
    result = smooth(drive)
    found = marks(result)
    # Places are those of the identities, in their order.
    assert found.landmark.tolist() == list(range(12))
    # Seen some dozen times at 5 cm each, from poses known to 1 cm and 0.6° at first: 4 cm at 4 m.
    assert np.hypot(*(found.positions - POSTS).T).max() < 0.12
    assert found.sightings.sum() == sightings(drive).stamps_ns.size
    assert (
        scores(result, drive).ate_rmse_m < 0.5 * scores(Model1().estimate(drive), drive).ate_rmse_m
    )
    assert "converged" in result.convergence


def test_surveyed_landmarks_hold_the_path() -> None:
    drive = surveyed(world.drive(POSTS, seed=1))
    result = smooth(drive)
    found = marks(result)
    assert np.hypot(*(found.positions - POSTS).T).max() < 4e-3
    # Three landmarks or so of 5 cm and 0.01 rad at 3 m every 0.2 s.
    assert scores(result, drive).ate_rmse_m < 0.02
    assert result.trajectory.covariances is not None
    free = smooth(world.drive(POSTS, seed=1)).trajectory.covariances
    assert free is not None
    # What is known of the landmarks makes every pose more certain.
    assert np.all(np.linalg.eigvalsh(free - result.trajectory.covariances) > -1e-12)


def test_a_survey_that_is_hardly_known_is_none() -> None:
    drive = world.drive(POSTS, seed=2)
    result, vague = smooth(drive), smooth(surveyed(drive, sigma=100.0))
    np.testing.assert_allclose(vague.trajectory.poses, result.trajectory.poses, atol=1e-4)
    np.testing.assert_allclose(marks(vague).positions, marks(result).positions, atol=1e-4)


def test_errors_are_as_large_as_covariances_say() -> None:
    seeds = 16
    last, posts = [], []
    for seed in range(seeds):
        drive = certain(world.drive(POSTS, seed=seed, steps=100))
        result = smooth(drive)
        assert result.trajectory.covariances is not None
        assert drive.truth is not None
        off = result.trajectory.poses[-1] - drive.truth.trajectory.poses[-1]
        off[2] = wrap(off[2])
        last.append(off @ np.linalg.solve(result.trajectory.covariances[-1], off))
        found = marks(result)
        # One landmark a drive: those of one drive err together.
        k = int(np.argmax(found.sightings))
        e = found.positions[k] - POSTS[found.landmark[k]]
        posts.append(e @ np.linalg.solve(found.covariance[k], e))
    # Sums of squares of 3 and 2 numbers over independent drives; outside once in a thousand.
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 3 * seeds)
    assert low < np.sum(last) < high
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 2 * seeds)
    assert low < np.sum(posts) < high


@pytest.mark.parametrize("known", [True, False])
def test_one_sighting_in_five_is_wrong(known: bool) -> None:
    clean = world.drive(POSTS, seed=3, steps=120)
    seen = sightings(clean)
    rng = np.random.default_rng(8)
    n = seen.stamps_ns.size
    wrong = rng.random(n) < 0.2
    # Half of them are taken for another landmark, the others are anywhere.
    other = wrong & (rng.random(n) < 0.5)
    anywhere = wrong & ~other
    named = np.where(other, (seen.landmark + rng.integers(1, 12, n)) % 12, seen.landmark)
    spoilt = replace(
        seen,
        landmark=named,
        range_m=np.where(anywhere, rng.uniform(0.2, 3.0, n), seen.range_m),
        bearing=np.where(anywhere, rng.uniform(-np.pi, np.pi, n), seen.bearing),
    )
    drive = with_sightings(clean, spoilt)
    drive = surveyed(drive) if known else drive
    result = smooth(drive)
    good = smooth(surveyed(clean) if known else clean)
    found, usual = scores(result, drive).ate_rmse_m, scores(good, clean).ate_rmse_m
    assert found < 2.0 * usual + 0.01
    c = result.counts["marks"]
    assert c.accepted + c.down_weighted == n
    # A wrong one may be nearly right by chance; a right one is given up hardly ever.
    assert 0.8 * wrong.sum() < c.down_weighted < 1.1 * wrong.sum()


def test_a_landmark_that_is_seen_once() -> None:
    drive = world.drive(POSTS, seed=4)
    seen = sightings(drive)
    first = int(np.flatnonzero(seen.landmark == 5)[0])
    kept = (seen.landmark != 5) | (np.arange(seen.stamps_ns.size) == first)
    once = with_sightings(
        drive,
        replace(
            seen,
            stamps_ns=seen.stamps_ns[kept],
            landmark=seen.landmark[kept],
            range_m=seen.range_m[kept],
            bearing=seen.bearing[kept],
        ),
    )
    result = smooth(once)
    found = marks(result)
    at = int(np.flatnonzero(found.landmark == 5)[0])
    assert found.sightings[at] == 1
    off = found.positions[at] - POSTS[5]
    assert off @ np.linalg.solve(found.covariance[at], off) < 13.8
    # No better than the sighting: 5 cm along it, 0.01 rad of its range across.
    least = min(0.05, 0.01 * float(seen.range_m[first]))
    assert np.sqrt(np.linalg.eigvalsh(found.covariance[at])[0]) >= 0.99 * least


def test_sightings_without_identity_are_rejected_and_said_so() -> None:
    drive = world.drive(POSTS, seed=5)
    blind = without_identity(drive)
    result = smooth(blind)
    n = sightings(drive).stamps_ns.size
    assert (result.counts["marks"].accepted, result.counts["marks"].rejected) == (0, n)
    assert result.map is None
    assert result.sensors_used == ("wheels",)
    assert any("does not say which landmark" in note for note in result.notes)
    bare = smooth(replace(drive, sensors=()))
    assert scores(result, drive).ate_rmse_m == pytest.approx(
        scores(bare, drive).ate_rmse_m, rel=1e-6
    )
    # Some of them without: the others count as before.
    seen = sightings(drive)
    some = np.where(np.arange(n) % 3 == 0, -1, seen.landmark)
    part = smooth(with_sightings(drive, replace(seen, landmark=some)))
    assert part.counts["marks"].rejected == int(np.sum(some < 0))
    assert part.counts["marks"].accepted == int(np.sum(some >= 0))


def test_sightings_outside_the_drive_are_rejected() -> None:
    drive = world.drive(POSTS, seed=6, steps=60)
    seen = sightings(drive)
    late = replace(seen, stamps_ns=seen.stamps_ns + 3_000_000_000)
    result = smooth(with_sightings(drive, late))
    outside = int(np.sum(late.stamps_ns > drive.wheels.stamps_ns[-1]))
    assert outside > 0
    assert result.counts["marks"].rejected == outside


def test_the_sensor_that_sees_landmarks_is_found_where_it_is() -> None:
    drive = surveyed(world.drive(POSTS, seed=7))
    x, y, yaw = world.MOUNT
    moved = replace(
        sightings(drive), mount=(x + 0.03, y - 0.02, yaw + 0.04), mount_sigma=(0.03, 0.03, 0.05)
    )
    result = smooth(with_sightings(drive, moved))
    found = {c.name: c for c in result.calibration}
    for name, true in zip(("marks_x", "marks_y", "marks_yaw"), world.MOUNT, strict=True):
        assert abs(found[name].value - true) < 3.0 * found[name].sigma, name
    # The heading at the start, known to 0.01 rad, tells the yaw; nothing else does.
    assert found["marks_yaw"].sigma < 0.01


def test_no_landmark_is_found_where_the_first_guess_is_turned_far() -> None:
    # A track that is off by a tenth turns dead reckoning by some 0.7 rad in 20 s: landmarks placed
    # along it would lie metres apart.
    drive = world.drive(POSTS, seed=9, steps=300)
    track = tuple(
        replace(p, nominal=0.9 * p.nominal, prior_sigma=0.1) if "track" in p.name else p
        for p in drive.robot.base.parameters
    )
    wide = replace(
        drive, robot=replace(drive.robot, base=replace(drive.robot.base, parameters=track))
    )
    assert scores(Model1().estimate(wide), wide).ate_heading_rmse_deg > 20.0
    result = smooth(wide)
    assert scores(result, wide).ate_rmse_m < 0.06
    assert np.hypot(*(marks(result).positions - POSTS).T).max() < 0.15


def cut(drive: Drive, seconds: float) -> Drive:
    """Return the first part of a drive."""
    end = drive.wheels.stamps_ns[0] + int(seconds * 1e9)
    n = int(np.searchsorted(drive.wheels.stamps_ns, end))
    wheels = replace(
        drive.wheels,
        stamps_ns=drive.wheels.stamps_ns[: n + 1],
        angles=drive.wheels.angles[:n],
    )
    return replace(drive, wheels=wheels)


def test_a_recorded_drive(data_dir: Path) -> None:
    if not (data_dir / "utias-mrclam").is_dir():
        pytest.skip("utias-mrclam is not there")
    whole = load_drive("utias-mrclam:6/1", data_dir)
    drive = cut(whole, 120.0)
    bare = scores(Model1().estimate(drive), drive).ate_rmse_m
    assert bare > 0.3
    found = smooth(drive)
    assert scores(found, drive).ate_rmse_m < 0.5 * bare
    # 0.10 m, aligned, is what a whole drive is to reach without a survey.
    assert scores(found, drive).ate_aligned_rmse_m < 0.10
    assert scores(smooth(without_survey(drive)), drive).ate_aligned_rmse_m < 0.10
    (seen,) = drive.each(LandmarkSightings)
    begin, end = drive.wheels.stamps_ns[[0, -1]]
    inside = int(np.sum((seen.stamps_ns >= begin) & (seen.stamps_ns <= end)))
    c = found.counts["barcodes"]
    assert 0.9 * inside < c.accepted + c.down_weighted <= inside
    assert found.map is not None
