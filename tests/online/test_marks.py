"""Point landmarks in the online engine, against batch and against themselves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.core.drive import Drive
from fgloc.core.evaluation import evaluate
from fgloc.core.measurements import Floats, LandmarkSightings
from fgloc.estimator import Result
from fgloc.online.checkpoint import restore, save
from fgloc.online.online import OnlineSmoother
from fgloc.online.replay import packets
from fgloc.online.settings import OnlineSettings
from fgloc.smoothing.batch import BatchSmoother

from .driving import engine_for, feed, run, sound
from .mutations import bad_values
from .surroundings import marks_drive

SHORT = OnlineSettings(lag_s=3.0, calibration_walk=0.0)


@pytest.fixture(scope="module")
def seen() -> tuple[Drive, Floats]:
    """Return a drive with marks that come and go, and where these are."""
    return marks_drive(seed=3)


@pytest.fixture(scope="module")
def short(seen: tuple[Drive, Floats]) -> Result:
    """Return the drive by a window of three seconds: most marks are aside most of the time."""
    return OnlineSmoother(SHORT).estimate(seen[0])


def test_newest_pose_is_as_exact_as_batch(seen: tuple[Drive, Floats], short: Result) -> None:
    """A window of 3 s with all else put aside knows at the end what the whole graph knows."""
    whole = BatchSmoother(OnlineSettings(calibration_walk=0.0)).estimate(seen[0]).trajectory
    assert whole.covariances is not None
    assert short.trajectory.covariances is not None
    sigma = np.sqrt(np.diag(whole.covariances[-1]))
    np.testing.assert_allclose(np.sqrt(np.diag(short.trajectory.covariances[-1])), sigma, rtol=0.02)
    assert (np.abs(short.trajectory.poses[-1] - whole.poses[-1]) < 0.3 * sigma).all()


def test_marks_are_where_they_are(seen: tuple[Drive, Floats], short: Result) -> None:
    """Each within four of its own sigmas, and all of them as uncertain as they should be."""
    assert short.map is not None
    assert short.map.marks is not None
    marks, points = short.map.marks, seen[1]
    error = marks.positions - points[marks.landmark]
    whitened = np.linalg.solve(marks.covariance, error[..., None])[..., 0]
    squares = np.einsum("ka,ka->k", error, whitened)
    # Two numbers a mark; they have the robot's errors in common, so no tight bound holds.
    assert squares.max() < 16.0 + 4.0
    assert marks.sightings.sum() == short.counts["marks"].accepted
    assert evaluate(short.trajectory, seen[0].truth).ate_rmse_m < 0.15  # type: ignore[arg-type]


def test_surveyed_marks_tell_where_the_robot_is() -> None:
    """Within the noise of a few sightings, wherever the wheels would have led it."""
    drive, points = marks_drive(seed=1, seconds=30, surveyed=True)
    result = OnlineSmoother(SHORT).estimate(drive)
    assert drive.truth is not None
    scored = evaluate(result.trajectory, drive.truth)
    assert scored.ate_rmse_m < 0.1
    assert scored.nees is not None
    assert 1.5 < scored.nees < 5.0
    assert result.map is not None
    assert result.map.marks is not None
    found = result.map.marks
    np.testing.assert_allclose(found.positions, points[found.landmark], atol=0.04)


def test_a_restored_engine_goes_on_to_the_last_bit(
    seen: tuple[Drive, Floats], tmp_path: Path
) -> None:
    """Marks in use and aside included, with sightings that wait."""
    drive = seen[0]
    sent = list(packets(drive))
    engine = engine_for(drive, SHORT)
    for packet in sent[:700]:
        feed(engine, packet)
    assert engine.window.landmarks.aside.numbers
    assert engine.window.landmarks.used
    save(engine, tmp_path / "state.npz")
    other = restore(
        tmp_path / "state.npz",
        drive.robot,
        drive.sensors,
        drive.truth,
        SHORT,
        drive.wheels.resolution,
    )
    for packet in sent[700:]:
        feed(engine, packet)
        feed(other, packet)
        assert np.array_equal(engine.propagation.state, other.propagation.state)
    assert np.array_equal(engine.propagation.joint(), other.propagation.joint())


def test_nonsense_among_sightings_is_counted_and_does_no_harm(seen: tuple[Drive, Floats]) -> None:
    """Bad numbers, marks taken for others, unknown ones."""
    drive = seen[0]
    rng = np.random.default_rng(0)
    sent = bad_values(list(packets(drive)), rng)
    for k in rng.integers(len(sent), size=60).tolist():
        if sent[k].sensor == "marks":
            wrong = sent[k].values.copy()
            wrong[0] = rng.integers(-1, 30)
            sent[k] = replace(sent[k], values=wrong)
    engine = engine_for(drive, SHORT)
    run(engine, sent, every=5)
    engine.finish()
    sent_marks = sum(packet.sensor == "marks" for packet in sent)
    count = engine.tally["marks"].count()
    assert count.accepted + count.down_weighted + count.rejected == sent_marks
    assert count.rejected > 0
    truth = drive.truth
    assert truth is not None
    error = engine.propagation.state[:2] - truth.trajectory.poses[-1, :2]
    assert np.hypot(*error) < 0.5


def test_a_window_that_is_given_up_keeps_its_landmarks(seen: tuple[Drive, Floats]) -> None:
    """The solver breaks for good: dead reckoning goes on, and known marks bring it back."""
    engine = engine_for(seen[0], SHORT)
    sent = list(packets(seen[0]))
    for packet in sent[:500]:
        feed(engine, packet)
    known = len(engine.window.landmarks.places)
    before = engine.propagation.covariance()
    joint = engine.propagation.joint()
    dropped = engine.map_smoother.abandon(engine.now_ns, engine.propagation.state, joint)
    engine._settle(dropped)
    sound(engine)
    assert len(engine.window.landmarks.aside.numbers) == known
    assert not engine.window.landmarks.used
    # What they have in common is lost, and allowed for.
    np.testing.assert_allclose(engine.propagation.covariance(), 2.0 * before, rtol=0.2)
    run(engine, sent[500:], every=10)
    error = engine.propagation.state[:2] - seen[0].truth.trajectory.poses[-1, :2]  # type: ignore[union-attr]
    assert np.hypot(*error) < 0.5


def test_isam2_engine_says_that_it_does_not_use_sightings(seen: tuple[Drive, Floats]) -> None:
    """They are counted as not used, and the wheels alone localise."""
    drive = seen[0]
    few = replace(
        drive,
        sensors=tuple(
            replace(
                s,
                stamps_ns=s.stamps_ns[:5],
                landmark=s.landmark[:5],
                range_m=s.range_m[:5],
                bearing=s.bearing[:5],
            )
            for s in drive.each(LandmarkSightings)
        ),
    )
    engine = engine_for(few, OnlineSettings(engine="isam2"))
    for packet in list(packets(few))[:60]:
        feed(engine, packet)
    assert engine.tally["marks"].rejected == {"not used by this engine": 5}
