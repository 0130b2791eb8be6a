"""Model 3 step by step against filterpy, against the seed's cells, and where its sensor fails."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from fgloc.core import bases
from fgloc.core.drive import Drive, Reference
from fgloc.core.evaluation import evaluate
from fgloc.core.measurements import Floats, WheelIncrements, Yaw, YawRate
from fgloc.core.robot import Robot
from fgloc.core.trajectory import Trajectory
from fgloc.datasets.registry import load_drive
from fgloc.errors import FglocError
from fgloc.experiments.bench_filters import (
    filterpy_filter,
    filterpy_step,
    side_ways,
    varied_drive,
)
from fgloc.filters.model3 import Model3, Model3Settings

PLAIN = bases.differential(0.1, 0.1, 0.5)


def stamps(seconds: Floats) -> np.ndarray:
    return np.round(seconds * 1e9).astype(np.int64)


def wrapped(angle: Floats) -> Floats:
    return (angle + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("seed", [0, 1])
def test_equals_filterpy_at_every_step(seed: int) -> None:
    drive = varied_drive(1000, seed)
    ours = Model3().history(drive)
    (yaw,) = drive.each(Yaw)
    # The seed's values, written out: noise per packet, no truth to start from, track prior 35 %.
    settings = Model3Settings(1e-6, 1e-6, 1e-5, 1e-7, 1e-3, 0.1, 2.0, 0.0)
    ukf = filterpy_filter(settings, 1e-4, 0.35 * 0.48)
    states, covariances = [ukf.x.copy()], [ukf.P.copy()]
    for (left, right), reading in zip(side_ways(drive), yaw.yaw[1:], strict=True):
        filterpy_step(ukf, left, right, wrapped(np.array([reading - yaw.yaw[0]])))
        states.append(ukf.x.copy())
        covariances.append(ukf.P.copy())
    # The drive is varied indeed: it turns round several times both ways, and the track is learnt.
    assert np.ptp(ours.states[:, 2]) > 4 * np.pi
    assert abs(ours.track[-1] - 0.75) < 0.05
    assert ours.corrected.size == 1000
    off = ours.states - np.array(states)
    off[:, 2] = wrapped(off[:, 2])
    assert np.abs(off).max() < 1e-9
    assert np.abs(ours.covariances - np.array(covariances)).max() < 1e-9
    # Continuous: no step of the heading is larger than a packet can turn.
    assert np.abs(np.diff(ours.states[:, 2])).max() < 1.0


def turning(
    *sensors: Yaw | YawRate, true_track: float = 0.6, packets: int = 100, rate: float = 1.0
) -> Drive:
    """10 s at 10 Hz: forward 0.3 m/s and turning at `rate`; the nominal track is 0.5 m."""
    t = np.arange(packets + 1) * 0.1
    half = 0.5 * true_track * rate
    angles = np.tile([(0.3 - half) * 0.1 / 0.1, (0.3 + half) * 0.1 / 0.1], (packets, 1))
    wheels = WheelIncrements("wheels", stamps(t), angles, ("left", "right"))
    base = bases.differential(0.1, 0.1, 0.5)
    wide = replace(base.parameters[2], prior_sigma=0.15)
    base = replace(base, parameters=(*base.parameters[:2], wide))
    return Drive("turning", Robot("test", base), wheels, sensors)


@pytest.mark.parametrize(
    # Table 3.6 of the seed. Its circle, 0.532 m, follows from no initial track and variance.
    ("case", "position"),
    [("straight", 0.085), ("spin", 0.026)],
)
def test_slip_is_table_3_6(case: str, position: float) -> None:
    drive = load_drive(f"sim:seed-a-{case}-slip20?nominal_track=0.48")
    assert drive.truth is not None
    scores = evaluate(Model3().estimate(drive).trajectory, drive.truth)
    assert round(scores.end_position_m, 3) == position


@pytest.mark.parametrize(("case", "track"), [("spin", 0.72), ("circle", 0.9)])
def test_the_track_is_found(case: str, track: float) -> None:
    found = Model3().history(load_drive(f"sim:seed-a-{case}-ideal?nominal_track=0.48"))
    assert found.track[0] == 0.48
    assert found.track_sigma[0] == pytest.approx(0.35 * 0.48)
    assert abs(found.track[-1] - track) < found.track_sigma[-1] < 0.005
    (estimate,) = found.result.calibration
    assert (estimate.nominal, estimate.value) == (0.48, found.track[-1])
    assert estimate.prior_sigma == pytest.approx(0.35 * 0.48)
    assert estimate.observed


def test_a_straight_drive_tells_nothing_of_the_track() -> None:
    drive = load_drive("sim:seed-a-straight-ideal?nominal_track=0.48")
    (estimate,) = Model3().estimate(drive).calibration
    assert estimate.value == pytest.approx(0.48, abs=1e-9)
    # Fifty packets of the random walk on top of the prior.
    assert estimate.sigma == pytest.approx(math.sqrt(0.168**2 + 50e-7), rel=1e-6)
    assert not estimate.observed


def test_process_noise_grows_with_time_not_with_packets() -> None:
    # Robot at rest, nothing measured but the yaw once: covariance is the process noise alone.
    settings = Model3Settings(start_sigma=(0.0, 0.0, 0.0), track_sigma=0.1)
    for packets, period in ((10, 0.2), (40, 0.05)):
        t = np.arange(packets + 1) * period
        wheels = WheelIncrements("w", stamps(t), np.zeros((packets, 2)), ("left", "right"))
        yaw = Yaw("yaw", stamps(t[:1]), np.zeros(1), 0.01)
        drive = Drive("rest", Robot("test", PLAIN), wheels, (yaw,))
        last = Model3(settings).history(drive).covariances[-1]
        np.testing.assert_allclose(
            last, np.diag([1e-5, 1e-5, 1e-4, 0.01 + 1e-6]), rtol=1e-9, atol=1e-16
        )


def test_the_sensor_s_zero_and_wrapping_do_not_matter() -> None:
    t = np.arange(101) * 0.1
    plain = Model3().history(turning(Yaw("yaw", stamps(t), t, 0.01)))
    shifted = Model3().history(turning(Yaw("yaw", stamps(t), wrapped(t + 2.5), 0.01)))
    np.testing.assert_allclose(shifted.states, plain.states, rtol=0, atol=1e-12)
    assert plain.states[-1, 2] == pytest.approx(10.0, abs=0.02)
    assert plain.result.sensors_used == ("wheels", "yaw")
    assert plain.result.notes == ()
    assert plain.result.counts["yaw"].accepted == 100


def test_silence_is_predicted_with_the_track_learnt_so_far() -> None:
    t = np.arange(501) * 0.02
    # Nothing from 4 s to 9 s: five seconds at 1 rad/s, more than half a turn.
    t = t[(t <= 4.0) | (t >= 9.0)]
    found = Model3().history(turning(Yaw("yaw", stamps(t), wrapped(t), 0.01)))
    heading, sigma = found.states[:, 2], np.sqrt(found.covariances[:, 2, 2])
    track = found.track[40]
    assert track == pytest.approx(0.6, abs=0.01)
    # The wheels' turn over 0.5 m would be 1.2 rad/s.
    assert heading[80] - heading[40] == pytest.approx(4.0 * 0.6 / track, abs=1e-3)
    assert sigma[80] > 3 * sigma[40]
    assert heading[-1] == pytest.approx(10.0, abs=0.02)
    assert any("49 of 100 steps are predicted only" in note for note in found.result.notes)
    assert found.result.counts["yaw"].accepted == 51


def test_a_yaw_that_begins_late_is_set_to_the_heading_reached() -> None:
    t = np.arange(100, 501) * 0.02  # from 2 s on
    found = Model3().history(turning(Yaw("yaw", stamps(t), 7.0 + t, 0.01)))
    # Up to there the wheels: 20 steps of 0.12 rad over the nominal track, more over a track that is
    # known to 30 %, since the mean of 1/track is larger by 0.3² to second order.
    assert found.states[20, 2] == pytest.approx(2.4 * 1.09, abs=0.03)
    assert found.states[-1, 2] - found.states[20, 2] == pytest.approx(8.0, abs=0.05)
    assert found.corrected[0] == 21


def test_a_slow_sensor_s_readings_are_used_once_each() -> None:
    t = np.arange(26) * 0.4 + 0.03
    found = Model3().history(turning(Yaw("yaw", stamps(t), t, 0.01)))
    # A reading every fourth stamp; the first sets the zero, the last one (10.03 s) is nearest to
    # the last stamp.
    np.testing.assert_array_equal(found.corrected, np.arange(4, 101, 4))
    assert not any("silent" in note for note in found.result.notes)


def test_a_gyro_stands_in_for_a_yaw() -> None:
    t = np.arange(0, 1001) * 0.01
    gyro = YawRate("gyro", stamps(t), np.ones(t.size), 0.001)
    found = Model3().history(turning(gyro))
    assert found.states[-1, 2] == pytest.approx(10.0, abs=0.02)
    assert found.track[-1] == pytest.approx(0.6, abs=0.005)
    assert any("gyro" in note for note in found.result.notes)


def test_after_a_gyro_s_silence_its_zero_is_set_anew() -> None:
    t = np.arange(0, 1001) * 0.01
    # A gyro that tells nothing from 4 s to 6 s; the track is known by then.
    t = t[(t <= 4.0) | (t >= 6.0)]
    gyro = YawRate("gyro", stamps(t), np.ones(t.size), 0.001)
    found = Model3().history(turning(gyro))
    assert found.states[-1, 2] == pytest.approx(10.0, abs=0.05)
    assert found.track[-1] == pytest.approx(0.6, abs=0.005)
    assert any("20 of 100 steps are predicted only" in note for note in found.result.notes)
    assert found.result.counts["gyro"].accepted == 80


def test_a_heading_unknown_by_more_than_a_radian_still_has_a_mean() -> None:
    # A track known to 0.2 m of 0.5 m and no reading: after 5 rad the heading is open by 2 rad. The
    # sigma points' weighted unit vectors then add up to a vector that points the other way.
    yaw = Yaw("yaw", stamps(np.zeros(1)), np.zeros(1), 0.01)
    drive = turning(yaw, true_track=0.5, packets=80)
    found = Model3(Model3Settings(track_sigma=0.2)).history(drive)
    assert math.sqrt(found.covariances[-1, 2, 2]) > 2.0
    steps = np.diff(found.states[:, 2])
    # The mean of 1/track exceeds 1/(mean track) by (0.2/0.5)² to second order.
    np.testing.assert_allclose(steps, 0.1 * 1.16, rtol=0.02)


def test_a_known_track_and_start_stay_known() -> None:
    fixed = replace(PLAIN.parameters[2], prior_sigma=0.0)
    base = replace(PLAIN, parameters=(*PLAIN.parameters[:2], fixed))
    t = np.arange(101) * 0.1
    drive = turning(Yaw("yaw", stamps(t), t, 0.01), true_track=0.5)
    drive = replace(drive, robot=Robot("test", base))
    found = Model3(Model3Settings(start_sigma=(0.0, 0.0, 0.0))).history(drive)
    assert np.all(found.track == 0.5)
    assert np.all(found.track_sigma == 0.0)
    assert found.states[-1, 2] == pytest.approx(10.0, abs=1e-9)


def test_a_centre_of_rotation_off_the_middle_moves_the_base_sideways() -> None:
    base = bases.skid_steer(("left",), ("right",), 0.1, 0.5, icr_x=0.1)
    t = np.arange(101) * 0.1
    drive = turning(Yaw("yaw", stamps(t), t, 0.01), true_track=0.5)
    drive = replace(drive, robot=Robot("test", base))
    poses = Model3().estimate(drive).trajectory.poses
    # Forward 0.3 m/s about a centre 0.1 m ahead, 1 rad/s: v = (0.3, -0.1), a circle about
    # (0.1, 0.3), from the origin.
    centre = np.array([0.1, 0.3])
    radii = np.hypot(*(poses[:, :2] - centre).T)
    np.testing.assert_allclose(radii, math.hypot(0.1, 0.3), atol=2e-3)


def test_covariances_are_right_for_drives_from_the_filter_s_own_model() -> None:
    # 200 drives whose noise is what the filter is told. The NEES of 3 states is 3 on average, with
    # a standard deviation of sqrt(6/200) = 0.17.
    rng = np.random.default_rng(5)
    settings = Model3Settings(track_sigma=0.03, start_sigma=(1e-9, 1e-9, 1e-9))
    packets, nees = 100, []
    t = np.arange(packets + 1) * 0.2
    for _ in range(200):
        track = 0.5 + 0.03 * rng.standard_normal()
        sides = np.repeat(rng.uniform(0.0, 0.2, (10, 2)), 10, axis=0)
        pose, truth = np.zeros(3), [np.zeros(3)]
        for left, right in sides:
            turn, way = (right - left) / track, (left + right) / 2
            c, s = math.cos(pose[2] + turn / 2), math.sin(pose[2] + turn / 2)
            noise = rng.standard_normal(4) * np.sqrt([1e-6, 1e-6, 1e-5, 1e-7])
            pose = pose + np.array([way * c, way * s, turn]) + noise[:3]
            track += noise[3]
            truth.append(pose)
        readings = np.array(truth)[:, 2] + math.sqrt(1e-3) * rng.standard_normal(packets + 1)
        readings[0] = 0.0  # the zero is exact
        wheels = WheelIncrements("wheels", stamps(t), sides / 0.1, ("left", "right"))
        drive = Drive("own", Robot("test", PLAIN), wheels, (Yaw("yaw", stamps(t), readings, 0.03),))
        found = Model3(settings).estimate(drive).trajectory
        assert found.covariances is not None
        error = found.poses[-1] - pose
        nees.append(error @ np.linalg.solve(found.covariances[-1], error))
    assert abs(np.mean(nees) - 3.0) < 3 * 0.17


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        (turning(), "model3 needs a yaw sensor; turning has none"),
        (
            turning(Yaw("imu", stamps(np.zeros(0)), np.zeros(0), 0.01)),
            "imu: the stream is empty; model3 needs at least one reading",
        ),
        (
            Drive(
                "sideways",
                Robot("test", bases.mecanum(0.05, 0.2, 0.2, ("fl", "fr", "rl", "rr"))),
                WheelIncrements(
                    "wheels", stamps(np.arange(2.0)), np.ones((1, 4)), ("fl", "fr", "rl", "rr")
                ),
                (Yaw("yaw", stamps(np.arange(2.0)), np.zeros(2), 0.01),),
            ),
            "model3 needs a base with an effective track .* mecanum",
        ),
    ],
)
def test_what_it_cannot_do_is_said(drive: Drive, message: str) -> None:
    with pytest.raises(FglocError, match=message):
        Model3().estimate(drive)


def test_a_turn_that_no_track_explains_holds_the_track_above_zero() -> None:
    # The wheels say 0.6 rad/s, the yaw sensor 8 rad/s: the track would have to be 4 cm, and is
    # pushed through zero on the way.
    t = np.arange(101) * 0.1
    drive = turning(Yaw("yaw", stamps(t), 8.0 * t, 0.01), true_track=0.3)
    found = Model3().history(drive)
    assert found.track.min() == pytest.approx(0.05)  # a tenth of the nominal
    assert np.isfinite(found.states).all()
    assert np.linalg.eigvalsh(found.covariances).min() > -1e-12
    (note,) = [n for n in found.result.notes if "least value" in n]
    assert note.startswith(f"{int((found.track <= 0.05).sum())} of 100 steps")


def test_random_readings_never_break_it() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(101) * 0.1
    for _ in range(50):
        yaw = Yaw("yaw", stamps(t), rng.uniform(-np.pi, np.pi, 101), 0.01)
        found = Model3().history(turning(yaw))
        assert np.isfinite(found.states).all()
        assert np.linalg.eigvalsh(found.covariances).min() > -1e-12


def test_sigma_points_too_close_to_be_told_apart_break_it_down_with_a_reason() -> None:
    t = np.arange(101) * 0.1
    drive = turning(Yaw("yaw", stamps(t), t, 0.01))
    with pytest.raises(FglocError, match=r"model3 broke down .* use a larger alpha"):
        Model3(Model3Settings(alpha=1e-12)).estimate(drive)


@pytest.mark.parametrize(
    "settings",
    [
        {"yaw_variance": 0.0},
        {"x_variance": -1e-6},
        {"alpha": 0.0},
        {"track_floor": 0.0},
        {"kappa": -4.0},
        {"track_sigma": math.nan},
        {"start_sigma": (1e-3, 1e-3)},
    ],
)
def test_impossible_settings_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(FglocError, match="model3"):
        Model3Settings(**settings)  # type: ignore[arg-type]


def test_it_starts_at_the_truth_with_its_sigma() -> None:
    t = np.arange(101) * 0.1
    poses = np.column_stack([np.full(101, 2.0), np.full(101, 3.0), 0.5 + t])
    reference = Reference(Trajectory(stamps(t), poses), sigma=(0.01, 0.02, 0.03))
    drive = replace(turning(Yaw("yaw", stamps(t), t, 0.01)), truth=reference)
    found = Model3().history(drive)
    np.testing.assert_allclose(found.states[0, :3], [2.0, 3.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(np.diag(found.covariances[0])[:3], [1e-4, 4e-4, 9e-4])
