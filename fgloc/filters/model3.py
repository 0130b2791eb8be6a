"""Model 3: an unscented Kalman filter of the pose and the effective track."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from fgloc.core.checks import check_noise
from fgloc.core.drive import Drive
from fgloc.core.kinematics import Parameter, WheeledBase
from fgloc.core.measurements import Floats, Stamps, Yaw
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.estimator import CalibrationEstimate, Result, SensorCount, TurningHistory
from fgloc.filters.heading import heading_source, nearest_readings, rate_note, silence_note
from fgloc.filters.model1 import trim_note
from fgloc.filters.model2 import rate_turn
from fgloc.filters.unscented import ANCHOR, NONE, UPDATE, unscented_filter

TRACK = "effective_track"
"""Name of the calibration parameter that the filter estimates."""
PACKET_NS = 200_000_000
"""The seed's wheel packet, for which its process noise is stated [ns]."""
ORIGIN_SIGMA = 1e-4
"""Sigma [m, rad] of a start that defines the map frame itself."""


@dataclass(frozen=True)
class Model3Settings:
    """What may be set about Model 3; the defaults are the seed's (equations 2.36 to 2.38).

    The initial covariance is diagonal. Pose: the start is given to every method, so its sigmas
    are those that the reference states. Track: the seed prints none. The filter gets the robot's
    own prior of the track, as every calibrating method does: for a skid-steer base a relative
    sigma of 0.35 (0.168 m on the Jaguar's 0.48 m), so that the seed's range of tracks in practice,
    L to 2 L, reaches to three sigmas from L.
    """

    x_variance: float = 1e-6
    """Process noise of x in 0.2 s [m²]; like the others it grows with the interval."""
    y_variance: float = 1e-6
    """Process noise of y in 0.2 s [m²]."""
    heading_variance: float = 1e-5
    """Process noise of the heading in 0.2 s [rad²]."""
    track_variance: float = 1e-7
    """Process noise of the effective track in 0.2 s [m²]: it is a random walk."""
    yaw_variance: float = 1e-3
    """Variance of one yaw reading [rad²]."""
    alpha: float = 0.1
    """Spread of the sigma points; 1e-3 would lose six digits."""
    beta: float = 2.0
    """Weight of the central sigma point in covariances; 2 suits a Gaussian."""
    kappa: float = 0.0
    """Secondary scaling of the sigma points."""
    track_sigma: float | None = None
    """Initial sigma of the track [m]; None: that of the robot's prior."""
    track_floor: float = 0.1
    """Least track, in parts of the nominal one. Slip that turns the robot against its wheels drives
    the estimate down, through zero if nothing stops it, and then every turn is mirrored; it is set
    to this value where it would fall below."""
    start_sigma: tuple[float, float, float] | None = None
    """Initial sigmas of x, y [m], heading [rad]; None: those the truth states, or 1e-4 where the
    start is the origin by definition."""

    def __post_init__(self) -> None:
        floors = {
            f.name.replace("_", " "): float(getattr(self, f.name))
            for f in fields(self)
            if f.name.endswith("_variance") and f.name != "yaw_variance"
        }
        floors["track sigma"] = self.track_sigma or 0.0
        if self.start_sigma is not None:
            if len(self.start_sigma) != 3:
                raise FglocError("model3: start sigma must be three numbers: x, y, heading")
            floors["smallest start sigma"] = min(self.start_sigma)
            floors["largest start sigma"] = max(self.start_sigma)
        positive = {
            "yaw variance": self.yaw_variance,
            "alpha": self.alpha,
            "track floor": self.track_floor,
            "4 + kappa": 4.0 + self.kappa,
        }
        check_noise("model3", positive, {**floors, "beta": self.beta})


@dataclass(frozen=True)
class History:
    """Everything the filter knew at every wheel stamp."""

    stamps_ns: Stamps
    """(N+1,) wheel stamps."""
    states: Floats
    """(N+1, 4) x, y [m] in the map, heading [rad] (continuous), effective track [m]."""
    covariances: Floats
    """(N+1, 4, 4) covariance of the state in map axes."""
    corrected: Stamps
    """Indices of the stamps at which a heading reading was used."""
    result: Result
    """The same as every estimator returns it."""

    @property
    def track(self) -> Floats:
        """Return the (N+1,) effective track over time [m]."""
        return self.states[:, 3]

    @property
    def track_sigma(self) -> Floats:
        """Return the (N+1,) standard deviation of the effective track over time [m]."""
        return np.asarray(np.sqrt(np.maximum(self.covariances[:, 3, 3], 0.0)))


@dataclass(frozen=True)
class Model3:
    """Pose and effective track by an unscented filter: wheels predict, the yaw sensor corrects.

    Each sigma point turns with its own track: ψ grows by (Δs_R - Δs_L) / L_ef, the step lies along
    the mean heading. The yaw reading nearest in time to a wheel stamp corrects, each reading once,
    and where the sensor is silent the filter only predicts. The first reading is set to the
    start's heading, so that the sensor's arbitrary zero drops out. Without a yaw stream a yaw-rate
    stream is integrated; after a silence its zero is set anew. Nothing is gated; the track is kept
    from falling to zero. Source: seed A, Model 3 (equations 2.29 to 2.38).
    """

    settings: Model3Settings = Model3Settings()
    """Noise, sigma points, initial covariance."""

    @property
    def method(self) -> str:
        """Return the method id."""
        return "model3"

    def estimate(self, drive: Drive) -> Result:
        """Return a pose with covariance at every wheel stamp, and the last track; see `history`."""
        return self.history(drive).result

    def history(self, drive: Drive) -> History:
        """Return the state with covariance at every wheel stamp. O(N log M), 160 bytes a stamp.

        Raises FglocError if the base has no effective track, if the drive has neither a yaw nor a
        yaw-rate stream, if wheels and truth do not overlap, or if alpha is so
        small that the filter breaks down.
        """
        base = drive.robot.base
        track = track_parameter(base, self.method)
        source = heading_source(drive, self.method)
        trimmed = trim_to_truth(drive)
        wheels = trimmed.wheels
        stamps = wheels.stamps_ns
        displacements = base.displacements(wheels.angles, wheels.steering)
        notes: list[str] = []
        if isinstance(source, Yaw):
            measured, kinds, silent = _yaw_readings(source, stamps)
        else:
            turned = np.concatenate([[0.0], np.cumsum(displacements[:, 2])])
            measured, silent = rate_turn(source, stamps, turned)
            kinds = np.concatenate([[ANCHOR], np.where(silent, ANCHOR, UPDATE)])
            notes.append(rate_note(source.sensor))
        notes += silence_note(source.sensor, silent, "are predicted only")
        settings = self.settings
        sigma = settings.track_sigma if settings.track_sigma is not None else track.prior_sigma
        start = np.append(start_pose(trimmed), track.nominal)
        first = np.diag(np.append(_start_sigma(settings, drive), sigma) ** 2)
        # A track that is known is no random walk either.
        walk = settings.track_variance if sigma > 0.0 else 0.0
        floor = settings.track_floor * track.nominal
        states, covariances = np.empty((stamps.size, 4)), np.empty((stamps.size, 4, 4))
        done = unscented_filter(
            np.ascontiguousarray(displacements[:, 0]),
            # What each side went is in the turn: (right - left) / nominal track.
            displacements[:, 2] * track.nominal,
            next((p.nominal for p in base.parameters if p.name == "icr_x"), 0.0),
            np.diff(stamps) / PACKET_NS,
            measured,
            kinds.astype(np.int64),
            start,
            first,
            np.array([settings.x_variance, settings.y_variance, settings.heading_variance, walk]),
            settings.yaw_variance,
            np.array([settings.alpha, settings.beta, settings.kappa]),
            floor,
            states,
            covariances,
        )
        if done < stamps.size:
            raise FglocError(
                f"{drive.name}: model3 broke down {(stamps[done] - stamps[0]) * 1e-9:.1f} s after "
                "the start: the covariance is no longer positive; use a larger alpha"
            )
        held = int((states[1:, 3] <= floor).sum())
        if held:
            notes.append(
                f"{held} of {silent.size} steps end with the effective track held at its least "
                f"value, {floor:.3g} m: slip, a jump of the yaw or a wrong nominal track"
            )
        left_out = drive.wheels.stamps_ns.size - stamps.size
        outside = (source.stamps_ns < stamps[0]) | (source.stamps_ns > stamps[-1])
        corrected = np.flatnonzero(kinds == UPDATE)
        estimate = CalibrationEstimate(
            TRACK,
            track.nominal,
            float(states[-1, 3]),
            float(np.sqrt(max(covariances[-1, 3, 3], 0.0))),
            float(sigma),
            track.unit,
        )
        result = Result(
            self.method,
            drive.name,
            Trajectory(stamps, states[:, :3].copy(), covariances[:, :3, :3].copy()),
            (wheels.sensor, source.sensor),
            calibration=(estimate,),
            counts={
                wheels.sensor: SensorCount(wheels.angles.shape[0], rejected=left_out),
                source.sensor: SensorCount(corrected.size, rejected=int(outside.sum())),
            },
            notes=(*notes, *trim_note(left_out)),
            calibration_covariance=covariances[-1:, 3, 3:].copy(),
            turning=TurningHistory(
                TRACK,
                track.unit,
                track.nominal,
                stamps,
                states[:, 3].copy(),
                np.sqrt(np.maximum(covariances[:, 3, 3], 0.0)),
            ),
        )
        return History(stamps, states, covariances, corrected, result)


def track_parameter(base: WheeledBase, method: str) -> Parameter:
    """Return the base's effective track; raises FglocError, naming the method, without one."""
    for parameter in base.parameters:
        if parameter.name == TRACK:
            return parameter
    raise FglocError(
        f"{method} needs a base with an effective track (differential, skid-steer); "
        f"this one is {base.kind}"
    )


def _start_sigma(settings: Model3Settings, drive: Drive) -> Floats:
    """Return the (3,) initial sigmas of x, y [m] and heading [rad]."""
    if settings.start_sigma is not None:
        return np.array(settings.start_sigma)
    return np.full(3, ORIGIN_SIGMA) if drive.truth is None else np.array(drive.truth.sigma)


def _yaw_readings(yaw: Yaw, stamps: Stamps) -> tuple[Floats, Stamps, npt.NDArray[np.bool_]]:
    """Return for (N+1,) stamps the reading [rad], what to do with it, and which steps are silent.

    A reading nearest to several stamps (a sensor slower than the wheels) is used at the nearest of
    them only: used twice, its noise would count as two independent ones. The first one sets the
    zero.
    """
    nearest, heard = nearest_readings(yaw, stamps)
    distance = np.abs(yaw.stamps_ns[nearest] - stamps)
    # For every reading, the first of its stamps in order of distance.
    order = np.lexsort((distance, nearest))
    owner = np.concatenate([[True], np.diff(nearest[order]) > 0])
    once = np.zeros(stamps.size, dtype=np.bool_)
    once[order[owner]] = True
    kinds = np.where(heard & once, UPDATE, NONE)
    used = np.flatnonzero(kinds == UPDATE)
    kinds[used[:1]] = ANCHOR
    return yaw.yaw[nearest], kinds, ~heard[1:]
