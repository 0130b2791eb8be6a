"""The robot_localization-like EKF: constant acceleration in the plane, inputs of an ekf.yaml."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.evaluation import interpolate_trajectory
from fgloc.core.geometry import compose, inverse, rotate_covariance
from fgloc.core.measurements import (
    Acceleration,
    CameraPoses,
    Floats,
    PoseFixes,
    PositionFixes,
    Yaw,
    YawRate,
)
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import Result, SensorCount, SensorResiduals
from fgloc.filters.model1 import trim_note
from fgloc.filters.pose_ekf import FARTHEST, ORIGIN_SIGMA
from fgloc.filters.rl_inputs import POSE, Messages, bind, messages_of
from fgloc.filters.rl_kernel import STATES, X, Y, run_filter
from fgloc.io.ekf_config import PLANAR, EkfConfig, EkfInput
from fgloc.smoothing.initial import align, telling

UNITS = ("m", "m", "rad", "m/s", "m/s", "rad/s", "m/s²", "m/s²")
"""Units of the states."""


def default_config(drive: Drive) -> EkfConfig:
    """Return a sensible configuration for a drive's sensors.

    The wheels' twist, every camera and pose fix, position fixes, and an IMU's yaw, yaw rate and
    forward acceleration. Noise is that which robot_localization has unless told otherwise: in a
    search over 60 others on simulated and recorded drives none was better by 1 %.
    """
    inputs = [EkfInput("odom0", drive.wheels.sensor, ("vx", "vy", "vyaw"))]
    poses = [s for s in drive.sensors if isinstance(s, CameraPoses | PoseFixes | PositionFixes)]
    for k, s in enumerate(poses):
        flags = ("x", "y") if isinstance(s, PositionFixes) else ("x", "y", "yaw")
        inputs.append(EkfInput(f"pose{k}", s.sensor, flags))
    asked = (
        (bool(drive.each(Yaw)), "yaw"),
        (bool(drive.each(YawRate)), "vyaw"),
        (bool(drive.each(Acceleration)), "ax"),
    )
    imu = tuple(flag for there, flag in asked if there)
    if imu:
        inputs.append(EkfInput("imu0", "", imu, relative=True))
    return EkfConfig(tuple(inputs))


class RlEkf:
    """Extended Kalman filter of pose, velocity and acceleration in the plane.

    It does what `ekf_localization_node` of robot_localization does with two_d_mode (Moore and
    Stouch, A Generalized Extended Kalman Filter Implementation for the Robot Operating System,
    2014), written anew; what differs is said in docs/ekf.md.
    """

    def __init__(self, settings: EkfConfig | None = None) -> None:
        """Without `settings`, `default_config` makes them from every drive's sensors."""
        self.settings = settings

    @property
    def method(self) -> str:
        """Return the method id."""
        return "rl-ekf"

    def estimate(self, drive: Drive) -> Result:
        """Return the poses as they were put out, with covariances.

        The residuals of the result are innovations. Raises FglocError if wheels and truth do not
        overlap, the configuration uses nothing that the drive has, the wheels do not determine
        the motion, or numbers are so large that nothing can be computed from them.
        """
        trimmed = trim_to_truth(drive)
        config = self.settings if self.settings is not None else default_config(trimmed)
        start, placed = start_pose(trimmed), ""
        bindings = bind(config, trimmed)
        messages = [m for b in bindings for m in messages_of(b, trimmed, start)]
        if drive.truth is None and any(m.absolute for m in messages):
            found, placed = place(config, trimmed, messages)
            if found is not None:
                start = found
                messages = [m for b in bindings for m in messages_of(b, trimmed, start)]
            else:
                messages = [m for m in messages if not m.absolute]
        if not any(m.stamps_ns.size for m in messages):
            said = "; ".join(str(b) for b in bindings)
            raise FglocError(f"rl-ekf: nothing that the configuration uses is there: {said}")
        run = _Run(config, trimmed, messages, start)
        left_out = drive.wheels.stamps_ns.size - trimmed.wheels.stamps_ns.size
        counts = run.counts(trimmed)
        notes = [] if self.settings is None else [*(str(b) for b in bindings), *config.notes]
        return Result(
            self.method,
            drive.name,
            run.trajectory(drive.name),
            tuple(name for name, count in counts.items() if count.accepted > 0),
            residuals=run.innovations(),
            counts=counts,
            notes=(*notes, *filter(None, [placed]), *trim_note(left_out)),
        )


def place(
    config: EkfConfig, drive: Drive, messages: Sequence[Messages]
) -> tuple[Floats | None, str]:
    """Return the start in the map (3,) that the first fixes tell, None if they do not; and a note.

    A node is given this from outside: the datum and heading of its transform of GPS. Here the path
    without fixes is aligned with the first of them.
    """
    others = [m for m in messages if not m.absolute]
    fixes = [m for m in messages if m.absolute and m.states[:2] == (X, Y)]
    if others and fixes:
        path = _Run(config, drive, others, np.zeros(3)).trajectory(drive.name)
        for m in fixes:
            poses, known = interpolate_trajectory(path, m.stamps_ns)
            if m.states == POSE and known.any():
                k = int(np.flatnonzero(known)[0])
                start = compose(m.values[k], inverse(poses[k]))
                return start, "no truth to start from: a fix told where the start is"
        stamps = np.concatenate([m.stamps_ns for m in fixes])
        order = np.argsort(stamps, kind="stable")
        poses, known = interpolate_trajectory(path, stamps[order])
        chosen = order[known]
        read = np.concatenate([m.values[:, :2] for m in fixes])[chosen]
        sigma = np.sqrt(np.concatenate([m.noises[:, 0, 0] for m in fixes]))[chosen]
        arms = np.zeros((stamps.size, 3))
        arms[:, :2] = np.concatenate([np.tile(m.lever, (m.stamps_ns.size, 1)) for m in fixes])
        enough = telling(read, sigma) if chosen.size > 1 else 0
        if enough:
            points = compose(poses[known], arms[chosen])[:enough, :2]
            start, _ = align(points, read[:enough])
            return start, f"no truth to start from: {enough} fixes told where the start is"
    return None, (
        "no truth to start from, and the fixes do not tell the heading: they are not used, poses "
        "are relative to the start"
    )


class _Run:
    """One pass of the filter over a drive's messages."""

    def __init__(
        self, config: EkfConfig, drive: Drive, messages: Sequence[Messages], start: Floats
    ) -> None:
        self._messages = messages
        self._start = start
        sizes = [m.stamps_ns.size for m in messages]
        of = np.repeat(np.arange(len(messages)), sizes)
        times = np.concatenate([m.stamps_ns for m in messages])
        order = np.argsort(times, kind="stable")
        self._of, self._times = of[order], times[order]
        e = times.size
        states = np.zeros((e, 3), dtype=np.int64)
        values, noises = np.zeros((e, 3)), np.zeros((e, 3, 3))
        at = np.concatenate([[0], np.cumsum(sizes)])
        for k, m in enumerate(messages):
            d, rows = len(m.states), slice(at[k], at[k + 1])
            states[rows, :d] = m.states
            values[rows, :d] = m.values
            noises[rows, :d, :d] = m.noises
        wheels = drive.wheels.stamps_ns
        outputs, timeout = wheels, 0
        if config.frequency is not None:
            period = round(1e9 / config.frequency)
            outputs = np.arange(wheels[0], wheels[-1], max(period, 1), dtype=np.int64)
            # The drive ends with an output, whatever is left of a period.
            outputs = np.append(outputs, wheels[-1])
            wait = config.sensor_timeout
            timeout = period if wait is None else round(wait * 1e9)
        predicting = config.predict_to_current_time or config.frequency is None
        x, p = np.zeros(STATES), _first_covariance(config, drive, start)
        k = outputs.size
        stamps = np.zeros(k, dtype=np.int64)
        poses, covariances = np.zeros((k, 3)), np.zeros((k, 3, 3))
        self._accepted = np.zeros(e, dtype=np.int64)
        self._innovations, self._whitened = np.zeros((e, 3)), np.zeros((e, 3))
        written = run_filter(
            self._times,
            np.array([len(m.states) for m in messages], dtype=np.int64)[self._of],
            states[order],
            values[order],
            noises[order],
            np.array([m.lever for m in messages])[self._of],
            np.array([m.threshold for m in messages], dtype=np.float64)[self._of],
            outputs,
            predicting,
            timeout,
            int(wheels[0]),
            np.array(config.process_noise),
            config.dynamic_process_noise,
            x,
            p,
            stamps,
            poses,
            covariances,
            self._accepted,
            self._innovations,
            self._whitened,
        )
        self._stamps = stamps[:written]
        self._poses, self._covariances = poses[:written], covariances[:written]

    def trajectory(self, name: str) -> Trajectory:
        """Return the poses in the map; FglocError where nothing could be computed."""
        fine = bool((np.abs(self._poses) < FARTHEST).all())
        if not fine or not np.isfinite(self._covariances).all():
            raise FglocError(
                f"{name} cannot be filtered: a measurement or a covariance is off by orders of "
                "magnitude; look for leaps in the data and at the configuration"
            )
        turned = rotate_covariance(self._covariances, np.full(self._stamps.size, self._start[2]))
        symmetric = 0.5 * (turned + turned.swapaxes(1, 2))
        return Trajectory(self._stamps, compose(self._start, self._poses), symmetric)

    def counts(self, drive: Drive) -> dict[str, SensorCount]:
        """Return accepted and rejected measurements of every stream, in the drive's order.

        A message whose pose and twist are both used counts twice.
        """
        found: dict[str, SensorCount] = {}
        for k, m in enumerate(self._messages):
            accepted = int(self._accepted[self._of == k].sum())
            before = found.get(m.sensor, SensorCount(0))
            found[m.sensor] = SensorCount(
                before.accepted + accepted,
                rejected=before.rejected + m.stamps_ns.size - accepted,
            )
        names = [drive.wheels.sensor, *(s.sensor for s in drive.sensors)]
        return {name: found[name] for name in names if name in found}

    def innovations(self) -> tuple[SensorResiduals, ...]:
        """Return the innovations of every kind of message of every stream."""
        out = []
        for k, m in enumerate(self._messages):
            mine = self._of == k
            d = len(m.states)
            out.append(
                SensorResiduals(
                    m.sensor,
                    tuple(f"{PLANAR[s]} [{UNITS[s]}]" for s in m.states),
                    self._times[mine],
                    self._innovations[mine, :d],
                    self._whitened[mine, :d],
                    self._accepted[mine].astype(np.float64),
                )
            )
        return tuple(r for r in out if r.stamps_ns.size)


def _first_covariance(config: EkfConfig, drive: Drive, start: Floats) -> Floats:
    """Return the covariance of the state at the start, in the frame of the start."""
    if config.initial_covariance is not None:
        return np.array(config.initial_covariance)
    p = np.eye(STATES)
    sigma = np.full(3, ORIGIN_SIGMA) if drive.truth is None else np.array(drive.truth.sigma)
    p[:3, :3] = rotate_covariance(np.diag(sigma**2), np.asarray(-start[2]))
    return p
