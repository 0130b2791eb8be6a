"""The online engine as an estimator: a drive replayed as it would have come live."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fgloc.core.drive import Drive
from fgloc.core.geometry import compose
from fgloc.core.measurements import CameraPoses, PoseFixes, PositionFixes
from fgloc.core.start import start_pose, trim_to_truth
from fgloc.estimator import Result, WheelSlip, calibration_of
from fgloc.online.alarm import pause_notes
from fgloc.online.engine import OnlineEngine, Start
from fgloc.online.session import ReplayOptions, Session
from fgloc.online.settings import OnlineSettings
from fgloc.online.surroundings import map_notes, map_of
from fgloc.smoothing.slip_report import slip_notes, wheel_slips

SURPRISING = 4.0
"""Mean normalised innovation squared a component beyond which a sensor's noise is misjudged."""


class OnlineSmoother:
    """Replays a drive through the online engine; every pose is kept as it was emitted."""

    def __init__(
        self, settings: OnlineSettings | None = None, options: ReplayOptions | None = None
    ) -> None:
        self.settings = settings if settings is not None else OnlineSettings()
        self.options = options if options is not None else ReplayOptions()

    @property
    def method(self) -> str:
        """Return "online"."""
        return "online"

    def estimate(self, drive: Drive) -> Result:
        """Return the poses emitted at every wheel packet, with the last calibration."""
        drive = trim_to_truth(drive)
        session = Session(drive, start_of(drive), self.settings, self.options)
        session.run()
        engine = session.engine
        engine.finish()
        known, b, g = engine.smoother.posterior, engine.layout.width, len(engine.layout.parameters)
        calibration, covariance = calibration_of(
            engine.layout.parameters, known.border[:g], known.covariance[b : b + g, b : b + g]
        )
        slips = slips_of(engine)
        start_ns = int(drive.wheels.stamps_ns[0])
        return Result(
            method=self.method,
            drive=drive.name,
            trajectory=session.track.trajectory(),
            sensors_used=tuple(name for name, t in engine.tally.items() if t.used),
            calibration=calibration,
            counts={name: t.count() for name, t in engine.tally.items()},
            notes=(
                *notes(engine),
                *slip_notes(slips, start_ns, seen_by_others(engine)),
                *map_notes(engine),
                *session.notes,
            ),
            live=session.live,
            slips=slips,
            calibration_covariance=covariance,
            turning=session.track.history(),
            map=map_of(engine),
        )


def slips_of(engine: OnlineEngine) -> tuple[WheelSlip, ...]:
    """Return when which wheel slipped, as it was known when that time left the window."""
    window = engine.window
    history = window.slip_history + window.slips_until(len(window.stamps_ns) - 1)
    if not history:
        return ()
    bounds = np.array([[begin, end] for begin, end, _, _ in history], np.int64)
    slips, sigmas = (np.array([row[k] for row in history]) for k in (2, 3))
    names = engine.layout.robot.base.driven_names
    # Intervals that follow each other belong together; others are kept apart.
    apart = np.flatnonzero(bounds[1:, 0] != bounds[:-1, 1]) + 1
    return tuple(
        slip
        for k in np.split(np.arange(len(history)), apart)
        for slip in wheel_slips(
            names, np.append(bounds[k, 0], bounds[k[-1], 1]), slips[k], sigmas[k], slips[k] != 0.0
        )
    )


def seen_by_others(engine: OnlineEngine) -> bool:
    """Return True if camera or fixes saw the motion as well."""
    kinds = CameraPoses | PositionFixes | PoseFixes
    return any(engine.tally[s.sensor].used for s in engine.sensors if isinstance(s, kinds))


def notes(engine: OnlineEngine) -> Iterator[str]:
    """Yield what a user should know about what the engine met."""
    yield from engine.left_out.values()
    yield from engine.remarks
    yield from pause_notes(engine.pauses, engine.began_ns)
    for name, tally in engine.tally.items():
        for reason, count in tally.rejected.items():
            what = "1 measurement" if count == 1 else f"{count} measurements"
            yield f"{what} of {name} rejected: {reason}"
        if tally.components and tally.nis > SURPRISING * tally.components:
            yield (
                f"{name} surprises the estimate: normalised innovations squared are "
                f"{tally.nis / tally.components:.3g} on average (1 is right)"
            )
    if engine.clock.shifts:
        back = ", ".join(f"{shift * 1e-9:.3f} s" for shift in engine.clock.shifts[:3])
        more = len(engine.clock.shifts) - 3
        back += f" and {more} more times" if more > 0 else ""
        yield f"the clock was set back by {back}; stamps go on as if it had not been"
    if engine.rebuilds:
        times = "once" if engine.rebuilds == 1 else f"{engine.rebuilds} times"
        yield f"the window was rebuilt {times} because its solution failed"
    if engine.spots.aligner is not None and engine.spots.aligner.fixes:
        yield "the fixes do not tell where the drive started; poses are relative to its start"


def start_of(drive: Drive) -> Start | None:
    """Return where a drive starts: its truth's first pose; None where that is not known."""
    if drive.truth is None:
        return None
    base = start_pose(drive)
    mount = np.array(drive.truth.mount, dtype=np.float64)
    return Start(compose(base, mount), np.array(drive.truth.sigma), base, mount)
