"""From a sensor's description to what takes its readings: streams and tables by sensor kind."""

from __future__ import annotations

import numpy as np

from fgloc.core.measurements import (
    CameraPoses,
    LandmarkSightings,
    PoseFixes,
    PositionFixes,
    Scans,
    Sensor,
    Yaw,
    YawRate,
)
from fgloc.factors.robust import PLAIN, Loss
from fgloc.factors.tables import Kind
from fgloc.online.fixes import FixTable
from fgloc.online.layout import Place
from fgloc.online.scans import ScanTable
from fgloc.online.settings import OnlineSettings
from fgloc.online.sightings import MarkTable
from fgloc.online.spots import MapHost, SpotTable
from fgloc.online.streams import CameraStream, GyroStream, Stream, YawStream
from fgloc.online.window import Window
from fgloc.smoothing.sensors import FREE_HEADING, bias_sigma


def loss_of(settings: OnlineSettings, loss: Loss) -> Loss:
    """Return a sensor's loss, or none where nothing is to be robust."""
    return loss if settings.robust else PLAIN


def open_stream(
    sensor: Sensor, place: Place, host: MapHost, settings: OnlineSettings, stamp_ns: int
) -> Stream | None:
    """Return what takes the readings of a continuous sensor, None for other kinds.

    `stamp_ns` is when the drive begins.
    """
    window = host.window
    if isinstance(sensor, Yaw):
        loss = loss_of(settings, settings.yaw_loss)
        return YawStream(sensor, place, loss, window, host.touch, stamp_ns)
    if isinstance(sensor, YawRate):
        loss = loss_of(settings, settings.yaw_loss)
        return GyroStream(sensor, place, loss, window, host.touch)
    if isinstance(sensor, CameraPoses):
        loss = loss_of(settings, settings.camera_loss)
        return CameraStream(sensor, place, loss, window, host.touch)
    return None


def open_zero(sensor: Sensor, place: Place, window: Window) -> float | None:
    """Give a drifting zero its prior; return its random walk, None for a sensor without one."""
    if place.slot < 0:
        return None
    if isinstance(sensor, Yaw):
        sigma, walk = FREE_HEADING, sensor.drift_sigma
    elif isinstance(sensor, YawRate):
        sigma, walk = bias_sigma(sensor), sensor.bias_walk
    else:
        return None
    empty = slice(0, 0)
    prior = window.table(Kind.ZERO_PRIOR, sensor.sensor, (1, 1), empty, PLAIN, place.slot)
    prior.add(0, np.zeros(1), np.array([[1.0 / sigma]]), weight=1.0)
    window.table(Kind.ZERO_WALK, sensor.sensor, (1, 1), empty, PLAIN, place.slot)
    return walk


def open_table(
    sensor: Sensor, place: Place, host: MapHost, settings: OnlineSettings, mapping: bool
) -> SpotTable | None:
    """Return what takes the readings of a sensor whose readings have keyframes, None for others.

    `mapping`: the solver can keep landmarks.
    """
    if isinstance(sensor, PositionFixes | PoseFixes):
        return FixTable(sensor, place, loss_of(settings, settings.fix_loss), host)
    if not mapping:
        return None
    if isinstance(sensor, LandmarkSightings):
        return MarkTable(sensor, place, loss_of(settings, settings.landmark_loss), host)
    if isinstance(sensor, Scans):
        return ScanTable(sensor, place, loss_of(settings, settings.landmark_loss), host)
    return None
