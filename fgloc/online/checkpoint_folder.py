"""A folder from which an interrupted replay goes on: the engine's state, and the poses so far."""

from __future__ import annotations

from pathlib import Path

from fgloc.core.drive import Drive
from fgloc.errors import FglocError
from fgloc.online.checkpoint import Labels, labels_of, mark, restore, save
from fgloc.online.engine import OnlineEngine
from fgloc.online.settings import OnlineSettings
from fgloc.online.track import Track

STATE = "state.npz"
"""The engine's state, replaced as a whole."""
POSES = "poses.bin"
"""Every pose emitted, only ever appended to (`fgloc.online.track.RECORD`)."""


class CheckpointFolder:
    """State and poses of one drive.

    The poses are on disk before the state that counts them: whenever the power goes, the state
    finds at least its poses, and cuts off what came after it.
    """

    def __init__(self, folder: Path, drive: Drive) -> None:
        self._state = folder / STATE
        self._poses = folder / POSES
        self._drive = drive
        self._mark = mark([drive.wheels, drive.sensors])
        self._written = 0

    @property
    def used(self) -> bool:
        """Return True if there is a state to go on from."""
        return self._state.exists()

    def clear(self) -> None:
        """Begin a new drive.

        Raises FglocError rather than throw away a drive that was not finished.
        """
        if self.used and not labels_of(self._state)["finished"]:
            raise FglocError(
                "holds a drive that was interrupted; add --resume to go on with it, or remove it",
                file=self._state,
            )
        try:
            # The state first: without its poses it would be of no use.
            self._state.unlink(missing_ok=True)
            self._poses.parent.mkdir(parents=True, exist_ok=True)
            self._poses.write_bytes(b"")
        except OSError as error:
            raise _failed(self._poses, error) from error

    def load(self, settings: OnlineSettings, track: Track) -> tuple[OnlineEngine, int]:
        """Return the engine and how many packets it has had; put its poses into `track`.

        Raises FglocError if the state belongs to another drive, robot, settings or version.
        """
        labels = labels_of(self._state)
        if labels["drive"] != self._mark:
            raise FglocError(
                "this checkpoint was written on another drive; go on with the same, or without it",
                file=self._state,
            )
        drive = self._drive
        engine = restore(
            self._state, drive.robot, drive.sensors, drive.truth, settings, drive.wheels.resolution
        )
        try:
            track.take_from(self._poses, labels["poses"])
        except OSError as error:
            raise _failed(self._poses, error) from error
        self._written = track.count
        return engine, labels["packets"]

    def save(self, engine: OnlineEngine, track: Track, packets: int, finished: bool) -> None:
        """Save everything after `packets` packets; raises FglocError if it cannot be written."""
        try:
            track.append_to(self._poses, self._written)
        except OSError as error:
            raise _failed(self._poses, error) from error
        self._written = track.count
        labels: Labels = {
            "drive": self._mark,
            "packets": packets,
            "poses": track.count,
            "finished": finished,
        }
        save(engine, self._state, labels)


def _failed(path: Path, error: OSError) -> FglocError:
    """Return the one-line error for a file that could not be written."""
    return FglocError(f"cannot be written: {error.strerror or error}", file=path)
