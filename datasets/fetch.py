"""Downloads recordings from their public origin: pinned commit, size and SHA-256 of every file.

What is pinned stands in `manifests/<dataset>.json`: `root`, a URL, and `files`, a list of
[path below the dataset's folder, bytes, SHA-256, [addresses below the root, first one first]].
A file appears under its name only when it is whole and its hash is right.
"""

from __future__ import annotations

import hashlib
import http.client
import json
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path, PurePosixPath

from fgloc.errors import FglocError

Progress = Callable[[str, int, int], None]
"""Called with a file's path, the bytes done in the whole dataset, and its total bytes."""

TIMEOUT_S = 30.0
"""How long the origin may be silent."""
ATTEMPTS = 3
"""How often a transfer is tried."""
CHUNK = 1 << 16


@dataclass(frozen=True)
class PinnedFile:
    """One file as it was published."""

    path: str
    """Where it goes, relative to the dataset's folder, with `/`."""
    size: int
    """Bytes."""
    sha256: str
    """Hexadecimal digest."""
    at: tuple[str, ...]
    """Addresses below the manifest's root; the next is tried when one is not found."""


@dataclass(frozen=True)
class Manifest:
    """All pinned files of a dataset."""

    dataset: str
    """Name of the dataset."""
    source: str
    """Page for people."""
    licence: str
    """Terms of the recordings."""
    root: str
    """URL that addresses are relative to."""
    files: tuple[PinnedFile, ...]
    """What is fetched."""

    @property
    def size(self) -> int:
        """Return the bytes of all files."""
        return sum(f.size for f in self.files)


def manifests() -> list[str]:
    """Return the names of the datasets that can be fetched."""
    folder = resources.files("fgloc.datasets") / "manifests"
    return sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".json"))


def manifest(name: str) -> Manifest:
    """Return a dataset's manifest; raises FglocError for a dataset that cannot be fetched."""
    if name not in manifests():
        raise FglocError(f"{name!r} cannot be fetched; known are {', '.join(manifests())}")
    text = (resources.files("fgloc.datasets") / "manifests" / f"{name}.json").read_text("utf-8")
    return parse_manifest(text)


def parse_manifest(text: str) -> Manifest:
    """Return the manifest written as JSON; raises FglocError if a part is missing."""
    try:
        document = json.loads(text)
        files = tuple(
            PinnedFile(path, int(size), str(digest), tuple(at))
            for path, size, digest, at in document["files"]
        )
        dataset, source, licence, root = (
            str(document[key]) for key in ("dataset", "source", "licence", "root")
        )
        return Manifest(dataset, source, licence, root, files)
    except (ValueError, KeyError, TypeError) as error:
        raise FglocError(f"the manifest is damaged: {error}") from None


def fetch(
    name: str | Manifest,
    to: Path,
    base_url: str | None = None,
    progress: Progress | None = None,
    *,
    pause_s: float = 1.0,
) -> Path:
    """Download a dataset into `to/<name>` and return that folder; whole files are kept.

    `base_url` replaces the manifest's root (a mirror). An interrupted transfer is resumed from its
    `.part` file. `pause_s` is the wait before the second attempt, doubled each time. Raises
    FglocError for a path that leaves the folder, a wrong hash or size (the file is deleted), or
    an origin that does not answer.
    """
    pinned = manifest(name) if isinstance(name, str) else name
    root = base_url if base_url is not None else pinned.root
    if urllib.parse.urlsplit(root).scheme not in ("http", "https"):
        raise FglocError(f"{root!r} is not an http or https address")
    folder = to / safe_path(pinned.dataset)
    done = 0
    for file in pinned.files:
        target = _target(folder, file.path)

        def report(part: int, path: str = file.path, before: int = done) -> None:
            if progress is not None:
                progress(path, before + part, pinned.size)

        if not (target.is_file() and _digest(target) == (file.size, file.sha256)):
            _fetch_file(file, target, root.rstrip("/") + "/", report, pause_s)
        done += file.size
        report(file.size)
    return folder


def safe_path(path: str) -> PurePosixPath:
    """Return a relative path that stays below its folder; FglocError for any other."""
    pure = PurePosixPath(path)
    odd = not path or "\\" in path or ":" in path or "\0" in path
    if odd or pure.is_absolute() or ".." in pure.parts or not pure.parts:
        raise FglocError(f"refused: the path {path!r} leads out of the dataset's folder")
    return pure


def _target(folder: Path, path: str) -> Path:
    """Return where a file goes, with its folder made; FglocError if links lead elsewhere."""
    target = folder / safe_path(path)
    inside = folder.resolve()
    # The check comes before the folders are made: a link could make them elsewhere.
    if not target.parent.resolve().is_relative_to(inside):
        raise FglocError("refused: a symbolic link leads out of the dataset's folder", file=target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FglocError(f"cannot be created: {error.strerror}", file=target.parent) from None
    for place in (target, _part(target)):
        if place.is_symlink() or place.is_dir():
            raise FglocError("refused: a link or folder is in the way; remove it", file=place)
    return target


def _part(target: Path) -> Path:
    """Return where a transfer is collected until it is whole."""
    return target.with_name(target.name + ".part")


def _digest(path: Path) -> tuple[int, str]:
    """Return the size and SHA-256 of a file."""
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return path.stat().st_size, digest


def _fetch_file(
    file: PinnedFile, target: Path, root: str, report: Callable[[int], None], pause_s: float
) -> None:
    """Download one file beside its place, check it, and only then give it its name."""
    part = _part(target)
    resumed = part.is_file() and part.stat().st_size > 0
    _download(file, part, root, report, pause_s)
    if _digest(part) != (file.size, file.sha256) and resumed:
        # The beginning may come from another version: once more, from the start.
        part.unlink()
        _download(file, part, root, report, pause_s)
    size, digest = _digest(part)
    if (size, digest) != (file.size, file.sha256):
        part.unlink()
        what = f"{size} bytes" if size != file.size else f"SHA-256 {digest[:12]}…"
        wanted = f"{file.size} bytes" if size != file.size else f"{file.sha256[:12]}…"
        raise FglocError(
            f"the download has {what}, pinned are {wanted}; it was deleted. "
            "Try again, and if it stays so, the origin has changed",
            file=target,
        )
    part.replace(target)


def _download(
    file: PinnedFile, part: Path, root: str, report: Callable[[int], None], pause_s: float
) -> None:
    """Bring `part` to its full size, over several attempts and addresses if need be."""
    reason = "no address is known"
    addresses = list(file.at)
    failures = 0
    while addresses and failures < ATTEMPTS:
        url = root + urllib.parse.quote(addresses[0])
        try:
            _transfer(url, part, file.size, report)
            return
        except urllib.error.HTTPError as error:
            reason = f"HTTP {error.code} {error.reason}"
            if error.code in (404, 410):
                addresses.pop(0)
                continue
            if error.code < 500 and error.code not in (408, 429):
                break
        except (OSError, http.client.HTTPException) as error:
            reason = str(getattr(error, "reason", error)) or type(error).__name__
        failures += 1
        if failures < ATTEMPTS:
            time.sleep(pause_s * 2 ** (failures - 1))
    raise FglocError(
        f"{root + file.at[-1] if file.at else root}: {reason}; check the network and run the "
        "same command again, which goes on where this one stopped"
    )


def _transfer(url: str, part: Path, size: int, report: Callable[[int], None]) -> None:
    """Append what is missing of `size` bytes to `part`; OSError or HTTPException on failure."""
    have = part.stat().st_size if part.is_file() else 0
    if have > size:
        part.unlink()
        have = 0
    if have == size and part.is_file():
        return
    request = urllib.request.Request(url, headers={"User-Agent": "fgloc"})
    if have:
        request.add_header("Range", f"bytes={have}-")
    try:
        answer = urllib.request.urlopen(request, timeout=TIMEOUT_S)
    except urllib.error.HTTPError as error:
        if error.code != 416:
            raise
        part.unlink(missing_ok=True)
        raise ConnectionError("the origin refuses to resume; starting over") from None
    with answer:
        # A server that knows no ranges sends the whole file from its beginning.
        begin = f"bytes {have}-"
        resumes = answer.status == 206 and answer.headers.get("Content-Range", "").startswith(begin)
        if answer.status == 206 and not resumes:
            part.unlink(missing_ok=True)
            raise ConnectionError("the origin resumed at another place; starting over")
        have = have if resumes else 0
        with part.open("ab" if resumes else "wb") as out:
            # One byte more than pinned is enough to see that the file is another one.
            while have <= size and (block := answer.read(min(CHUNK, size + 1 - have))):
                out.write(block)
                have += len(block)
                report(min(have, size))
    if have < size:
        raise ConnectionError(f"the transfer ended after {have} of {size} bytes")
