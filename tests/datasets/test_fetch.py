"""Fetching, from a server on this machine that can misbehave."""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from fgloc.datasets import registry
from fgloc.datasets.fetch import Manifest, PinnedFile, fetch, manifest, manifests, parse_manifest
from fgloc.errors import FglocError

CONTENT = bytes(range(256)) * 1000
OTHER = b"second file\n"


@dataclass
class Origin:
    """What the server has and how it behaves."""

    url: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    ranges: bool = True
    cut_after: list[int] = field(default_factory=list)
    errors: list[int] = field(default_factory=list)
    asked: list[tuple[str, str | None]] = field(default_factory=list)


@pytest.fixture
def origin() -> Iterator[Origin]:
    """Serve files on 127.0.0.1."""
    state = Origin(files={"/c1/data/a.bin": CONTENT, "/c1/b.txt": OTHER})

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            wanted = self.headers.get("Range")
            state.asked.append((self.path, wanted))
            if state.errors:
                self.send_error(state.errors.pop(0))
                return
            if self.path not in state.files:
                self.send_error(404)
                return
            data, begin = state.files[self.path], 0
            if wanted and state.ranges:
                begin = int(wanted.removeprefix("bytes=").removesuffix("-"))
                if begin >= len(data):
                    self.send_error(416)
                    return
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {begin}-{len(data) - 1}/{len(data)}")
            else:
                self.send_response(200)
            self.send_header("Content-Length", str(len(data) - begin))
            self.end_headers()
            stop = state.cut_after.pop(0) if state.cut_after else len(data)
            self.wfile.write(data[begin : begin + stop])

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    state.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield state
    server.shutdown()
    thread.join()
    server.server_close()


def pin(path: str, data: bytes, *at: str) -> PinnedFile:
    return PinnedFile(path, len(data), hashlib.sha256(data).hexdigest(), at)


PINNED = Manifest(
    "small",
    "somewhere",
    "MIT",
    "http://127.0.0.1:9/",
    (pin("data/a.bin", CONTENT, "c1/data/a.bin"), pin("b.txt", OTHER, "c0/b.txt", "c1/b.txt")),
)


def get(origin: Origin, to: Path, pinned: Manifest = PINNED) -> Path:
    return fetch(pinned, to, origin.url, pause_s=0.0)


def names(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def test_all_files_arrive_and_are_not_fetched_again(origin: Origin, tmp_path: Path) -> None:
    seen: list[tuple[str, int, int]] = []
    folder = fetch(PINNED, tmp_path, origin.url, lambda *a: seen.append(a), pause_s=0.0)
    assert names(folder) == {"data/a.bin", "b.txt"}
    assert (folder / "data/a.bin").read_bytes() == CONTENT
    total = len(CONTENT) + len(OTHER)
    assert seen[-1] == ("b.txt", total, total)
    assert [s[1] for s in seen] == sorted(s[1] for s in seen)
    # The first address of b.txt is not there, the second is.
    assert [path for path, _ in origin.asked][-2:] == ["/c0/b.txt", "/c1/b.txt"]
    asked = len(origin.asked)
    get(origin, tmp_path)
    assert len(origin.asked) == asked
    # A changed file is replaced.
    (folder / "b.txt").write_bytes(b"changed")
    get(origin, tmp_path)
    assert (folder / "b.txt").read_bytes() == OTHER


def test_a_cut_transfer_goes_on_where_it_stopped(origin: Origin, tmp_path: Path) -> None:
    origin.cut_after = [100_000]
    folder = get(origin, tmp_path)
    assert (folder / "data/a.bin").read_bytes() == CONTENT
    assert origin.asked[:2] == [("/c1/data/a.bin", None), ("/c1/data/a.bin", "bytes=100000-")]


def test_another_run_resumes_after_failures(origin: Origin, tmp_path: Path) -> None:
    origin.cut_after = [1000, 1000, 1000]
    with pytest.raises(FglocError, match="after 3000 of 256000 bytes; check the network"):
        get(origin, tmp_path)
    assert names(tmp_path) == {"small/data/a.bin.part"}
    folder = get(origin, tmp_path)
    assert origin.asked[3] == ("/c1/data/a.bin", "bytes=3000-")
    assert (folder / "data/a.bin").read_bytes() == CONTENT
    assert names(folder) == {"data/a.bin", "b.txt"}


def test_a_server_without_ranges_starts_over(origin: Origin, tmp_path: Path) -> None:
    origin.ranges = False
    origin.cut_after = [5000]
    assert (get(origin, tmp_path) / "data/a.bin").read_bytes() == CONTENT


def test_a_wrong_beginning_is_thrown_away(origin: Origin, tmp_path: Path) -> None:
    part = tmp_path / "small" / "data" / "a.bin.part"
    part.parent.mkdir(parents=True)
    for rubbish in (b"x" * 1000, b"x" * len(CONTENT), b"x" * (len(CONTENT) + 5)):
        part.write_bytes(rubbish)
        folder = get(origin, tmp_path)
        assert (folder / "data/a.bin").read_bytes() == CONTENT
        assert not part.exists()
        (folder / "data/a.bin").unlink()


@pytest.mark.parametrize("wrong", [b"\1" + CONTENT[1:], CONTENT + b"more"])
def test_a_changed_origin_is_refused(origin: Origin, tmp_path: Path, wrong: bytes) -> None:
    # The same length with another byte, then a longer file.
    assert wrong != CONTENT
    origin.files["/c1/data/a.bin"] = wrong
    with pytest.raises(FglocError, match="it was deleted"):
        get(origin, tmp_path)
    assert names(tmp_path) == set()


def test_a_server_that_stumbles_is_asked_again(origin: Origin, tmp_path: Path) -> None:
    origin.errors = [503, 500]
    get(origin, tmp_path)
    assert len(origin.asked) == 5


@pytest.mark.parametrize(("error", "times"), [(403, 1), (503, 3)])
def test_an_origin_that_refuses_is_named(
    origin: Origin, tmp_path: Path, error: int, times: int
) -> None:
    origin.errors = [error] * 3
    with pytest.raises(FglocError, match=f"c1/data/a.bin: HTTP {error}"):
        get(origin, tmp_path)
    assert len(origin.asked) == times


def test_a_file_that_is_gone_and_a_dead_origin(origin: Origin, tmp_path: Path) -> None:
    origin.files.clear()
    with pytest.raises(FglocError, match="HTTP 404"):
        get(origin, tmp_path)
    with pytest.raises(FglocError, match="check the network"):
        fetch(PINNED, tmp_path, "http://127.0.0.1:1", pause_s=0.0)
    with pytest.raises(FglocError, match="not an http"):
        fetch(PINNED, tmp_path, "file:///etc", pause_s=0.0)


@pytest.mark.parametrize(
    "path", ["../x", "a/../../x", "/etc/x", "", ".", "..", "a\\..\\x", "C:/x", "a/..", "a\0b"]
)
def test_paths_that_leave_the_folder_are_refused(origin: Origin, tmp_path: Path, path: str) -> None:
    pinned = Manifest("small", "", "", "", (pin(path, OTHER, "c1/b.txt"),))
    with pytest.raises(FglocError, match="refused"):
        get(origin, tmp_path / "to", pinned)
    with pytest.raises(FglocError, match="refused"):
        get(origin, tmp_path / "to", Manifest(path, "", "", "", (pin("a", OTHER, "c1/b.txt"),)))
    assert names(tmp_path) == set()
    assert origin.asked == []


def test_links_that_leave_the_folder_are_refused(origin: Origin, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "victim").write_text("keep me")
    folder = tmp_path / "to" / "small"
    folder.mkdir(parents=True)
    os.symlink(outside, folder / "data")
    with pytest.raises(FglocError, match="symbolic link"):
        get(origin, tmp_path / "to")
    (folder / "data").unlink()
    (folder / "data").mkdir()
    for name in ("a.bin", "a.bin.part"):
        os.symlink(outside / "victim", folder / "data" / name)
        with pytest.raises(FglocError, match="in the way"):
            get(origin, tmp_path / "to")
        (folder / "data" / name).unlink()
    assert [p.name for p in outside.iterdir()] == ["victim"]
    assert (outside / "victim").read_text() == "keep me"


def test_every_readable_dataset_is_pinned_to_a_commit() -> None:
    assert set(manifests()) == set(registry.DATASETS)
    for name in manifests():
        pinned = manifest(name)
        assert pinned.dataset == name
        assert pinned.root.startswith("https://raw.githubusercontent.com/")
        assert len({f.path for f in pinned.files}) == len(pinned.files)
        for file in pinned.files:
            assert len(file.sha256) == 64
            assert all(len(at.split("/")[0]) >= 7 for at in file.at)
    with pytest.raises(FglocError, match="cannot be fetched"):
        manifest("../manifests/optiodom")
    with pytest.raises(FglocError, match="damaged"):
        parse_manifest('{"files": [["a", 1]]}')


def test_pinned_hashes_are_those_of_the_recordings(data_dir: Path) -> None:
    pinned = manifest("jackal-jackass")
    folder = registry.find_folder("jackal-jackass", data_dir)
    for file in pinned.files:
        data = (folder / file.path).read_bytes()
        assert (len(data), hashlib.sha256(data).hexdigest()) == (file.size, file.sha256)
