"""From what a user types to a `Drive`: paths, `dataset:run` ids and patterns over runs.

A recording that is found is read as it is; checksums belong to `fgloc.datasets.fetch`.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from fgloc.core.drive import Drive
from fgloc.datasets import carmen, carmen_lines, cut, jaguar, jaguar_lines, own_csv, own_format
from fgloc.datasets.catalogue import DATASETS as DATASETS
from fgloc.datasets.catalogue import Dataset
from fgloc.datasets.plausible import check_plausible
from fgloc.datasets.text import read_bytes
from fgloc.errors import FglocError
from fgloc.io.bag_drive import BagDrive, read_bag
from fgloc.io.bags import MAGIC as BAG_MAGIC
from fgloc.io.bags import SUFFIXES as BAG_SUFFIXES
from fgloc.io.bags import is_bag
from fgloc.io.topics import TopicMap, load_topics

if TYPE_CHECKING:
    from fgloc.datasets.simulator.worlds import World

SIMULATED = "sim"
"""Prefix of drives that are made, not read: `sim:NAME?seed=1&key=value`."""
SEMI_REAL = "semi"
"""Prefix of recorded drives with a synthesised camera and gyro: `semi:DRIVE?seed=1`."""

OF_DRIVES = (SEMI_REAL, cut.PREFIX)
"""Prefixes that go before another drive's id."""


def cache_folder() -> Path:
    """Return where fetched datasets go: $XDG_CACHE_HOME/fgloc, else ~/.cache/fgloc."""
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "fgloc"


def search_path(data: Path | None = None) -> list[Path]:
    """Return the folders that are searched: `data`, $FGLOC_DATA, the user's cache."""
    environment = os.environ.get("FGLOC_DATA")
    return [
        *([data] if data is not None else []),
        *([Path(environment)] if environment else []),
        cache_folder(),
    ]


def dataset(name: str) -> Dataset:
    """Return a dataset by name; raises FglocError naming the known ones and the nearest."""
    if name in DATASETS:
        return DATASETS[name]
    if name == SIMULATED:
        raise FglocError("sim drives are made on the spot, there is nothing to fetch; use sim:NAME")
    if name == SEMI_REAL:
        raise FglocError("semi: goes before a drive's own id; fetch the data set that it is of")
    if name == cut.PREFIX:
        raise FglocError("cut: goes before a drive's own id; fetch the data set that it is of")
    known = [*DATASETS, SIMULATED, SEMI_REAL, cut.PREFIX]
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise FglocError(f"no dataset is called {name!r}; {hint}known are {', '.join(known)}")


def find_folder(name: str, data: Path | None = None) -> Path:
    """Return the folder of a dataset that holds runs.

    Raises FglocError if no such dataset exists, or it is not on this machine.
    """
    kind = dataset(name)
    if data is not None and not data.is_dir():
        raise FglocError("no such data folder; check the path given to --data", file=data)
    for root in search_path(data):
        for folder in (root / name, root):
            if folder.name == name and folder.is_dir() and kind.runs(folder):
                return folder
    places = ", ".join(str(p) for p in search_path(data))
    raise FglocError(
        f"dataset {name} is not on this machine (looked in {places}); "
        f"get it with: fgloc datasets fetch {name}"
    )


def list_drives(name: str, data: Path | None = None) -> list[str]:
    """Return the ids of all runs of a dataset that are on this machine, in its own order."""
    return [f"{name}:{run}" for run in dataset(name).runs(find_folder(name, data))]


def is_dataset_id(drive_id: str) -> bool:
    """Return True if this reads as `dataset:run` rather than as a path."""
    head, colon, _ = drive_id.partition(":")
    if head in DATASETS or head in (SIMULATED, *OF_DRIVES):
        return not (head == drive_id and Path(drive_id).exists())
    return bool(colon) and bool(re.fullmatch(r"\w[\w-]+", head)) and not Path(drive_id).exists()


def expand(drive_ids: Sequence[str], data: Path | None = None) -> list[str]:
    """Return the ids with `dataset:all` and patterns (`optiodom:diff/circular/*`) written out.

    Order is kept, doubles are dropped. Raises FglocError for a pattern that matches nothing.
    """
    found: list[str] = []
    for drive_id in drive_ids:
        outer = _prefixed(drive_id)
        if outer is not None:
            prefix, inner, query = outer
            found += [f"{prefix}:{one}{query and '?'}{query}" for one in expand([inner], data)]
            continue
        name, _, run = drive_id.partition(":")
        pattern = "*" if run == "all" else run
        if not is_dataset_id(drive_id) or name == SIMULATED or not re.search(r"[*?\[]", pattern):
            found.append(drive_id)
            continue
        drives = list_drives(name, data)
        matches = [d for d in drives if fnmatchcase(d, f"{name}:{pattern}")]
        if not matches:
            raise FglocError(f"no run matches {drive_id}; there are {_short(drives)}")
        found += matches
    return list(dict.fromkeys(found))


def load_drive(
    drive_id: str, data: Path | None = None, topics: Path | TopicMap | None = None
) -> Drive:
    """Return the drive a user named: a path, `dataset:run` or `sim:NAME?seed=1&key=value`.

    `semi:` before a recorded drive, and `?seed=1` behind it, adds a synthesised camera and gyro
    (`fgloc.datasets.simulator.semi_real`); `cut:` and `?begin=10&end=60` keep a part of it
    (`fgloc.datasets.cut`). `data` is searched before $FGLOC_DATA and the user's
    cache; `topics` is the topic map of a ROS bag, or the file it is in. Raises FglocError for an
    unknown dataset or run, a dataset that is not here, a missing file, content that cannot be read,
    a topic map for what is no bag, a semi-real drive without a truth, or measurements in an
    obviously wrong unit (see `fgloc.datasets.plausible`).
    """
    return load_with_topics(drive_id, data, topics)[0]


def load_with_topics(
    drive_id: str, data: Path | None = None, topics: Path | TopicMap | None = None
) -> tuple[Drive, TopicMap | None]:
    """Return what `load_drive` does, and the topic map as it was used; None for what is no bag."""
    given = load_topics(topics) if isinstance(topics, Path) else topics
    outer = _prefixed(drive_id)
    if outer is not None:
        prefix, inner, query = outer
        if prefix == cut.PREFIX:
            where = cut.parse(query)
            drive, used = load_with_topics(inner, data, given)
            return cut.cut(drive, where, drive_id), used
        from fgloc.datasets.simulator.semi_real import parse, with_semi_real

        spec = parse(query)
        drive, used = load_with_topics(inner, data, given)
        return with_semi_real(drive, spec, drive_id), used
    name, _, run = drive_id.partition(":")
    if is_dataset_id(drive_id) and name == SIMULATED:
        if given is not None:
            raise _no_bag(drive_id)
        from fgloc.datasets.simulator import load_sim

        return load_sim(run), None
    found = _recorded(drive_id, data, given)
    drive, used = (found.drive, found.topics) if isinstance(found, BagDrive) else (found, None)
    if used is None and given is not None:
        raise _no_bag(drive_id)
    check_plausible(drive)
    return drive, used


def world_of(drive_id: str) -> World | None:
    """Return the walls that a simulated drive's lidar saw, in the axes of its truth.

    None for a drive without a world. Raises FglocError for a simulated drive that does not exist.
    """
    name, _, run = drive_id.partition(":")
    if not is_dataset_id(drive_id) or name != SIMULATED:
        return None
    from fgloc.datasets.simulator.drives import load_sim_world

    return load_sim_world(run)


def _prefixed(drive_id: str) -> tuple[str, str, str] | None:
    """Return prefix, inner drive and query of `semi:DRIVE?query`; None for any other id."""
    head, _, rest = drive_id.partition(":")
    if head not in OF_DRIVES or not is_dataset_id(drive_id):
        return None
    # A question mark may also be part of a pattern over runs; a query has an equals sign.
    inner, mark, query = rest.rpartition("?")
    if not mark or "=" not in query:
        inner, query = rest, ""
    if not inner:
        example = {SEMI_REAL: "?seed=1", cut.PREFIX: "?begin=10&end=60"}[head]
        raise FglocError(f"{drive_id} lacks a drive; write it like {head}:vitko-swerve:1{example}")
    return head, inner, query


def _no_bag(drive_id: str) -> FglocError:
    """Return the error for a topic map where there are no topics."""
    return FglocError(f"{drive_id} is no ROS bag; leave out --topics")


def _recorded(drive_id: str, data: Path | None, given: TopicMap | None) -> Drive | BagDrive:
    """Return the drive in a file or of a dataset."""
    name, _, run = drive_id.partition(":")
    if not is_dataset_id(drive_id):
        return _load_path(Path(drive_id), drive_id, given)
    kind = dataset(name)
    if not run:
        raise FglocError(f"{drive_id} lacks a run; write it like {name}:{kind.example}")
    folder = find_folder(name, data)
    known = kind.runs(folder)
    if run not in known:
        near = difflib.get_close_matches(run, known, n=3, cutoff=0.85)
        there = f"near it: {', '.join(near)}" if near else f"there are {_short(known)}"
        raise FglocError(f"{name} has no run {run!r} here; {there}")
    if kind.load_bag is not None:
        return kind.load_bag(folder, run, drive_id, given or TopicMap())
    assert kind.load is not None
    return kind.load(folder, run, drive_id)


def _short(names: Sequence[str], most: int = 6) -> str:
    """Return the names as a short list for a message."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{', '.join(names[: most - 1])}, … {names[-1]} ({len(names)} in all)"


def _load_path(path: Path, name: str, given: TopicMap | None) -> Drive | BagDrive:
    """Return the drive in a file or folder, its format guessed from suffix and content."""
    path = _drive_in(path) if path.is_dir() else path
    if is_bag(path):
        return read_bag(path, name, given)
    data = read_bytes(path)
    if path.suffix == ".npz" or data.startswith(b"PK"):
        return own_format.read_npz(path, name)
    for magic, suffix in BAG_MAGIC.items():
        if data.startswith(magic):
            raise FglocError(f"this is a ROS bag; let its name end in {suffix}", file=path)
    head = data[:4096].decode("utf-8", errors="replace").lstrip("\ufeff").splitlines()
    if head and head[0].startswith(f"# {own_format.FORMAT}"):
        return own_csv.read_csv(path, name)
    if any(jaguar_lines.looks_like(line) for line in head):
        return jaguar.load(path, name)
    if any(carmen_lines.looks_like(line) for line in head):
        return carmen.load(path, name)
    if not data.strip():
        raise FglocError("the file is empty; record or download it again", file=path)
    raise FglocError(
        "the format is not known; readable are npz and CSV files of fgloc "
        f"(first line {own_csv.MAGIC!r}), ROS bags ({', '.join(BAG_SUFFIXES)}), Jaguar, CARMEN "
        "and gfs logs",
        file=path,
    )


def _drive_in(folder: Path) -> Path:
    """Return the drive's file in a folder, or the folder itself where that is a ROS 2 bag."""
    if is_bag(folder):
        return folder
    for name in ("drive.npz", "drive.csv", "drive.log"):
        if (folder / name).is_file():
            return folder / name
    bags = sorted(p for suffix in BAG_SUFFIXES for p in folder.glob(f"*{suffix}"))
    if len(bags) == 1:
        return bags[0]
    if bags:
        raise FglocError(
            f"this folder holds {len(bags)} bags and no metadata.yaml; give one of them",
            file=folder,
        )
    raise FglocError(
        "this folder holds no drive.npz, .csv or .log and no ROS bag; give a file, or dataset:run "
        "with --data for a folder of datasets",
        file=folder,
    )
