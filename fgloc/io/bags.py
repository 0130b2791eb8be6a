"""ROS 1 and ROS 2 bags: opening them, what topics they have, decoding those that are wanted.

The library rosbags does the reading (extra `bags`). What it raises for damaged files are the
errors of its many parts (struct, lz4, sqlite), so every call into it is watched for any of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from fgloc.errors import FglocError
from fgloc.io.messages import EXTRACTORS, Messages

SUFFIXES = (".bag", ".db3", ".mcap")
"""Suffixes of bag files."""
METADATA = "metadata.yaml"
"""The file that makes a folder a ROS 2 bag."""
MAGIC = {b"#ROSBAG V": ".bag", b"SQLite format 3\0": ".db3", b"\x89MCAP": ".mcap"}
"""First bytes of a bag file, and the suffix that goes with them."""


@dataclass(frozen=True)
class Topic:
    """One topic of a bag."""

    name: str
    """Its name."""
    kind: str
    """Type of its messages, e.g. "sensor_msgs/msg/Imu"."""
    count: int
    """How many messages there are."""


def is_bag(path: Path) -> bool:
    """Return True for a file with a bag's suffix and for the folder of a ROS 2 bag."""
    if path.is_dir():
        return (path / METADATA).is_file()
    return path.suffix in SUFFIXES


class Bag:
    """An open bag, for use in a `with` statement."""

    def __init__(self, path: Path) -> None:
        """Open the bag at `path`, a file or the folder of a ROS 2 bag.

        Raises FglocError where rosbags is not installed or the bag is missing, empty, cut off or
        in a format that is not known.
        """
        self.path = path
        if not path.exists():
            raise FglocError("no such file; check the path", file=path)
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError as error:
            raise FglocError(
                f"reading ROS bags needs the library rosbags ({error}); install it with: "
                "pip install 'fgloc[bags]'",
                file=path,
            ) from None
        # Bags of ROS 2 before Iron do not say what their messages look like.
        self._store: Any = get_typestore(Stores.LATEST)
        try:
            self._reader: Any = AnyReader([path], default_typestore=self._store)
            self._reader.open()
        except Exception as error:
            raise self._unreadable(error) from error
        self.cut_off: str | None = None
        """Why reading ended before the end of the bag; None where it did not."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._reader.close()

    def topics(self) -> dict[str, Topic]:
        """Return the topics by name, the types of which this package can read or not."""
        found: dict[str, Topic] = {}
        for c in self._reader.connections:
            before = found.get(c.topic)
            if before is not None and before.kind != c.msgtype and before.kind in EXTRACTORS:
                continue  # two types under one name: the one that can be read
            count = 0 if before is None or before.kind != c.msgtype else before.count
            found[c.topic] = Topic(c.topic, c.msgtype, count + c.msgcount)
        return dict(sorted(found.items()))

    def read(self, topics: Mapping[str, Topic]) -> dict[str, Messages]:
        """Return the messages of topics by name, in one pass over the bag; O(messages).

        Where the bag is damaged, reading ends there and `cut_off` says why. A single message that
        cannot be decoded is counted.
        """
        found = {t.name: Messages(t.name, t.kind) for t in topics.values()}
        wanted = [
            c
            for c in self._reader.connections
            if c.topic in found and c.msgtype == found[c.topic].kind
        ]
        decode = {t.kind: self._decoder(t.kind) for t in topics.values()}
        for topic, received, raw in self._raw(wanted):
            into = found[topic]
            try:
                message = decode[into.kind](raw, into.kind)
                row = EXTRACTORS[into.kind](message)
            except Exception:
                into.broken += 1
                continue
            header = getattr(message, "header", None)
            stamp = header.stamp if header is not None else None
            into.received.append(received)
            into.stamped.append(0 if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec)
            into.rows.append(row)
        return found

    def _raw(self, connections: list[Any]) -> Iterator[tuple[str, int, bytes]]:
        """Yield topic, time of recording and bytes of every message, as far as there are any."""
        if not connections:
            return  # rosbags would take that for all of them
        messages = self._reader.messages(connections=connections)
        while True:
            try:
                connection, received, raw = next(messages)
            except StopIteration:
                return
            except Exception as error:
                self.cut_off = _first_line(error)
                return
            yield connection.topic, received, raw

    def _decoder(self, kind: str) -> Any:
        """Return what decodes messages of a type; that which the bag says, where it does."""
        if kind in self._reader.typestore.fielddefs:
            return self._reader.deserialize
        return self._store.deserialize_cdr if self._reader.is2 else self._store.deserialize_ros1

    def _unreadable(self, error: Exception) -> FglocError:
        """Return the one-line error for a bag that cannot be opened."""
        if self.path.is_file() and self.path.stat().st_size == 0:
            return FglocError("the file is empty; record or download it again", file=self.path)
        mend = {
            ".bag": "mend it with `rosbag reindex`",
            ".mcap": "mend it with `mcap recover`",
        }.get(self.path.suffix, "mend it with `ros2 bag reindex`")
        return FglocError(
            f"this bag cannot be read ({_first_line(error)}): if it was cut off, {mend}, "
            "or record it again",
            file=self.path,
        )


def _first_line(error: Exception) -> str:
    """Return the first line of what an error says, or its type."""
    lines = str(error).strip().splitlines()
    return lines[0].rstrip(".") if lines else type(error).__name__
