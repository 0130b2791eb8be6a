"""EKF-SLAM as a whole: against filterpy, its consistency, landmarks that come and go."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter

from fgloc.core.drive import Drive
from fgloc.core.geometry import Floats, wrap
from fgloc.core.measurements import LandmarkSightings, Survey
from fgloc.core.preintegration import preintegrate, split_at
from fgloc.errors import FglocError
from fgloc.estimator import Result
from fgloc.filters.ekf_slam import EkfSlam
from fgloc.filters.ekf_slam_settings import EkfSlamSettings
from fgloc.lidar.walls import Marks
from tests.filters import landmark_world as world

PLAIN = EkfSlamSettings(calibration=0.0, horizon_s=0.0)
"""Nothing but white noise, as textbook filters have it."""


def sightings(drive: Drive) -> LandmarkSightings:
    (marks,) = drive.each(LandmarkSightings)
    return marks


def marks_of(result: Result) -> Marks:
    assert result.map is not None
    assert result.map.marks is not None
    return result.map.marks


def with_marks(drive: Drive, marks: LandmarkSightings) -> Drive:
    return replace(drive, sensors=(marks,))


def test_one_landmark_as_filterpy_has_it() -> None:
    drive = world.drive(np.array([[1.0, 2.5]]), seed=3, steps=60)
    marks = sightings(drive)
    mount = np.array(world.MOUNT)
    stamps = drive.wheels.stamps_ns
    moved = preintegrate(split_at(drive.wheels, stamps), drive.robot)
    r = np.diag([0.05**2, 0.01**2])
    oracle = ExtendedKalmanFilter(3, 2)
    oracle.x = np.zeros(3)
    oracle.P = np.diag(np.array(world.START_SIGMA) ** 2)
    oracle.F = np.eye(3)

    def sensor(x: Floats) -> Floats:
        c, s = math.cos(x[2]), math.sin(x[2])
        return np.array([x[0] + c * mount[0] - s * mount[1], x[1] + s * mount[0] + c * mount[1]])

    def h(x: Floats) -> Floats:
        d = x[3:5] - sensor(x)
        return np.array([math.hypot(*d), math.atan2(d[1], d[0]) - x[2] - mount[2]])

    def jacobian(x: Floats) -> Floats:
        d = x[3:5] - sensor(x)
        q = float(d @ d)
        lever = sensor(x) - x[:2]
        by_point = np.stack([d / math.sqrt(q), np.array([-d[1], d[0]]) / q])
        by_heading = by_point @ np.array([lever[1], -lever[0]]) - np.array([0.0, 1.0])
        return np.column_stack([-by_point, by_heading, by_point])

    def residual(a: Floats, b: Floats) -> Floats:
        d = np.subtract(a, b)
        d[1] = wrap(d[1])
        return np.asarray(d)

    result = EkfSlam(PLAIN).estimate(drive)
    covariances = result.trajectory.covariances
    assert covariances is not None
    for k in range(stamps.size):
        if k:
            x, step = oracle.x, moved.displacement[k - 1]
            c, s = math.cos(x[2]), math.sin(x[2])
            a, g = np.eye(x.size), np.zeros((x.size, 3))
            a[0, 2], a[1, 2] = -s * step[0] - c * step[1], c * step[0] - s * step[1]
            g[:3] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
            oracle.x = x + g @ step
            oracle.P = a @ oracle.P @ a.T + g @ moved.covariance[k - 1] @ g.T
        for o in np.flatnonzero(marks.stamps_ns == stamps[k]):
            z = np.array([marks.range_m[o], marks.bearing[o]])
            if oracle.x.size == 3:
                turn = oracle.x[2] + mount[2] + z[1]
                u = np.array([math.cos(turn), math.sin(turn)])
                m = sensor(oracle.x) + z[0] * u
                d = m - oracle.x[:2]
                by_pose = np.array([[1.0, 0.0, -d[1]], [0.0, 1.0, d[0]]])
                by_z = np.column_stack([u, z[0] * np.array([-u[1], u[0]])])
                cross = by_pose @ oracle.P
                own = by_pose @ oracle.P @ by_pose.T + by_z @ r @ by_z.T
                grown = ExtendedKalmanFilter(5, 2)
                grown.x = np.concatenate([oracle.x, m])
                grown.P = np.block([[oracle.P, cross.T], [cross, own]])
                oracle = grown
            else:
                oracle.update(z, jacobian, h, R=r, residual=residual)
        np.testing.assert_allclose(result.trajectory.poses[k], oracle.x[:3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariances[k], oracle.P[:3, :3], rtol=0, atol=1e-9)
    marks_found = marks_of(result)
    np.testing.assert_allclose(marks_found.positions[0], oracle.x[3:], rtol=0, atol=1e-9)
    np.testing.assert_allclose(marks_found.covariance[0], oracle.P[3:, 3:], rtol=0, atol=1e-9)
    # One sighting made the landmark, all others corrected.
    assert result.counts["marks"].accepted == marks.stamps_ns.size
    assert len(result.residuals[0].values) == marks.stamps_ns.size - 1


def test_the_last_pose_is_as_sure_as_it_says() -> None:
    # 60 drives: the mean of 60 chi-squares of 3 degrees of freedom lies within 3 ± 0.82 in 99 %
    # (standard deviation sqrt(2·3/60) = 0.316, times 2.58).
    landmarks = world.circle_of_landmarks(12, 3.0)
    found = []
    for seed in range(60):
        drive = world.drive(landmarks, seed=seed, steps=120)
        result = EkfSlam(PLAIN).estimate(drive)
        assert drive.truth is not None
        assert result.trajectory.covariances is not None
        e = result.trajectory.poses[-1] - drive.truth.trajectory.poses[-1]
        found.append(e @ np.linalg.solve(result.trajectory.covariances[-1], e))
    assert 3.0 - 0.82 < np.mean(found) < 3.0 + 0.82


def test_the_map_is_found_and_grows_beyond_the_first_room() -> None:
    # More landmarks than the arrays have room for at first.
    landmarks = world.circle_of_landmarks(50)
    drive = world.drive(landmarks, seed=1, steps=250)
    marks = marks_of(EkfSlam(PLAIN).estimate(drive))
    assert sorted(marks.landmark) == list(range(50))
    order = np.argsort(marks.landmark)
    e = marks.positions[order] - landmarks
    assert np.hypot(*e.T).max() < 0.15
    squared = np.einsum("li,lij,lj->l", e, np.linalg.inv(marks.covariance[order]), e)
    # Errors of one map hang together: 50 of 2 degrees of freedom are 2 on average, roughly.
    assert 0.3 < squared.mean() < 6.0


def test_the_covariance_stays_symmetric_and_positive() -> None:
    from fgloc.filters.ekf_slam_events import merge
    from fgloc.filters.ekf_slam_run import Run

    drive = world.drive(world.circle_of_landmarks(20), seed=2, steps=2000)
    run = Run(merge(drive, PLAIN), PLAIN, np.zeros(3), np.array(world.START_SIGMA))
    run.filter()
    p = run.p[:43, :43]
    np.testing.assert_allclose(p, p.T, rtol=1e-12, atol=0)
    scale = np.sqrt(np.diag(p))
    assert np.linalg.eigvalsh(p / np.outer(scale, scale)).min() > 0.0
    np.testing.assert_array_equal(run.p[43:], 0.0)


def test_without_identities_the_nearest_landmark_is_taken_after_five_sightings() -> None:
    landmarks = world.circle_of_landmarks(12)
    known = world.drive(landmarks, seed=4)
    unknown = world.drive(landmarks, seed=4, identified=False)
    with_identity = EkfSlam(PLAIN).estimate(known)
    without = EkfSlam(PLAIN).estimate(unknown)
    marks = marks_of(without)
    assert marks.landmark.size == 12
    # The same map as with identities, whatever that is worth, but for the first four sightings.
    same = marks_of(with_identity).positions
    assert np.hypot(*(marks.positions[:, None] - same[None]).T).min(axis=0).max() < 0.3
    # All that are seen in time; the first four of each only tell of it.
    total = sightings(known).stamps_ns.size
    assert with_identity.counts["marks"].accepted == total
    assert without.counts["marks"].accepted == total - 4 * 12
    assert "48 sightings told of landmarks that were not in use" in without.notes[0]


def test_a_landmark_that_is_no_longer_there_is_forgotten() -> None:
    landmarks = world.circle_of_landmarks(12)
    settings = replace(PLAIN, lives=8)
    # A drive of two rounds; the first two landmarks vanish after half of it.
    there = world.drive(landmarks, seed=5, steps=380, identified=False)
    gone = world.drive(landmarks, seed=5, steps=380, identified=False, hidden=range(2))
    assert marks_of(EkfSlam(settings).estimate(there)).landmark.size == 12
    result = EkfSlam(settings).estimate(gone)
    marks = marks_of(result)
    assert marks.landmark.size == 10
    distance = np.hypot(*(marks.positions[:, None] - landmarks[None]).T)
    assert distance.min(axis=1)[:2].min() > 1.0
    assert distance.min(axis=1)[2:].max() < 0.2
    assert result.notes[0].startswith("12 landmarks entered the state, 2 of them were forgotten")
    # To the seed's letter whatever is out of sight for eight scans is forgotten.
    letter = EkfSlam(replace(settings, forget_unseen=True)).estimate(there)
    assert marks_of(letter).landmark.size < 10
    # A landmark with an identity is never forgotten.
    known = world.drive(landmarks, seed=5, steps=380, hidden=range(2))
    assert marks_of(EkfSlam(settings).estimate(known)).landmark.size == 12


def test_surveyed_landmarks_keep_the_robot_in_the_map() -> None:
    landmarks = world.circle_of_landmarks(12)
    drive = world.drive(landmarks, seed=6, steps=1000)
    survey = Survey(np.arange(12), landmarks, np.full((12, 2), 1e-3))
    surveyed = with_marks(drive, replace(sightings(drive), survey=survey))
    result, blind = EkfSlam(PLAIN).estimate(surveyed), EkfSlam(PLAIN).estimate(drive)
    assert drive.truth is not None
    e = result.trajectory.poses - drive.truth.trajectory.poses
    assert np.hypot(e[10:, 0], e[10:, 1]).max() < 0.1
    covariances, others = result.trajectory.covariances, blind.trajectory.covariances
    assert covariances is not None
    assert others is not None
    assert covariances[-1, 0, 0] < others[-1, 0, 0]
    assert marks_of(result).landmark.tolist() == list(range(12))
    # Those without an identity are found among the surveyed ones, which are used at once.
    stripped = replace(sightings(surveyed), landmark=np.full_like(sightings(drive).landmark, -1))
    found = EkfSlam(PLAIN).estimate(with_marks(drive, stripped))
    assert found.counts["marks"].rejected == 0
    np.testing.assert_allclose(found.trajectory.poses, result.trajectory.poses, atol=0.05)


def test_a_misread_identity_is_rejected() -> None:
    drive = world.drive(world.circle_of_landmarks(12), seed=7)
    marks = sightings(drive)
    wrong = marks.landmark.copy()
    wrong[-30] = (wrong[-30] + 6) % 12
    result = EkfSlam(PLAIN).estimate(with_marks(drive, replace(marks, landmark=wrong)))
    assert result.counts["marks"].rejected == 1
    assert int(np.sum(result.residuals[0].weights == 0.0)) == 1
    assert np.abs(result.residuals[0].normalised[result.residuals[0].weights == 0.0]).max() > 5.0


def test_what_no_filter_can_use_is_said() -> None:
    drive = world.drive(np.array([[1.0, 2.5]]), seed=8, steps=20)
    with pytest.raises(FglocError, match="needs scans or landmark sightings"):
        EkfSlam().estimate(replace(drive, sensors=()))
    marks = sightings(drive)
    far = replace(marks, range_m=np.append(marks.range_m[:-1], 1e300))
    with pytest.raises(FglocError, match="orders of magnitude"):
        EkfSlam(replace(PLAIN, identity_gate=math.inf)).estimate(with_marks(drive, far))
    # A stream that says nothing leaves wheel odometry.
    empty = replace(
        marks,
        stamps_ns=marks.stamps_ns[:0],
        landmark=marks.landmark[:0],
        range_m=marks.range_m[:0],
        bearing=marks.bearing[:0],
    )
    result = EkfSlam().estimate(with_marks(drive, empty))
    assert result.sensors_used == ("wheels",)
    assert marks_of(result).landmark.size == 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"extractor": "hough"}, "unknown extractor 'hough'; choose one of lines, ransac"),
        ({"lives": 0}, "lives must be at least 1"),
        ({"gate_m": 0.0}, "gate_m must be positive"),
        ({"calibration": -1.0}, "calibration must be finite and not negative"),
        ({"identity_gate": -1.0}, "identity_gate must be positive"),
        ({"seed": -1}, "seed must not be negative"),
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(FglocError, match=message):
        EkfSlamSettings(**settings)  # type: ignore[arg-type]
