"""What the viewers show: the scene, a recording read back, the page and its script."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgloc.core.geometry import compose
from fgloc.errors import FglocError
from fgloc.estimator import WheelSlip
from fgloc.lazy import import_rerun
from fgloc.report import view_html, viewer
from fgloc.report.scene import Scene, evenly, make_scene, wall_colour
from tests.report.mapped import (
    MOUNT,
    drive,
    poses_at,
    result,
    room_map,
    room_scans,
    room_segments,
    sightings,
)

SLIP = WheelSlip("left", 1_000_000_000, 2_000_000_000, 0.25, 0.02)


def scene() -> Scene:
    """The room with everything that can be shown."""
    found = replace(result(room_map()), slips=(SLIP,))
    return make_scene(found, drive(room_scans(), sightings()))


def test_segments_lie_where_the_lidar_saw_them() -> None:
    segments = scene().segments
    assert segments is not None
    # 2 m ahead of the lidar, half a metre to both sides; right end first.
    lidar = compose(poses_at(np.array(0.0)), np.array(MOUNT))
    c, s = np.cos(lidar[2]), np.sin(lidar[2])
    middle = lidar[:2] + 2.0 * np.array([c, s])
    side = 0.5 * np.array([-s, c])
    # The normal points back to the lidar, so its left is the lidar's right.
    np.testing.assert_allclose(segments.ends[0], [middle + side, middle - side], atol=1e-12)
    assert segments.wall.tolist() == [1]
    assert segments.row.tolist() == [0]


def test_segments_of_scans_left_out_are_left_out() -> None:
    late = replace(room_segments(), scan=np.array([25]))
    found = result(replace(room_map(), segments=late))
    segments = make_scene(found, drive(room_scans(30))).segments
    assert segments is not None
    assert segments.row.size == 0


def test_a_drive_without_lidar_has_a_scene() -> None:
    bare = make_scene(result(), drive())
    assert bare.scans == ()
    assert bare.segments is None
    assert bare.truth is not None


def test_colours_differ_and_grey_is_for_none() -> None:
    colours = {wall_colour(k) for k in range(-1, 60)}
    assert len(colours) == 61
    assert len(set(wall_colour(-1))) == 1
    assert evenly(10, 4).tolist() == [0, 3, 6, 9]
    assert evenly(3, 10).tolist() == [0, 1, 2]
    assert evenly(0, 10).tolist() == []


# --- the recording ------------------------------------------------------------------------------


def columns(path: Path) -> dict[str, dict[str, Any]]:
    """Read a recording back: for each entity the values of its components that change in time."""
    rerun = pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    reader = pytest.importorskip("rerun.chunk", reason="this rerun cannot read back").RrdReader
    found: dict[str, dict[str, Any]] = {}
    for chunk in reader(str(path)).stream():
        own = found.setdefault(chunk.entity_path, {})
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            own.setdefault(name, []).extend(batch.column(name).to_pylist())
    assert rerun
    return found


def test_recording_read_back(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    path = viewer.save_recording(scene(), tmp_path / "room.rrd")
    found = columns(path)
    assert {
        "/map/path",
        "/map/truth",
        "/map/points",
        "/map/walls",
        "/map/walls/2_sigma",
        "/map/landmarks",
        "/map/landmarks/95_percent",
        "/map/surveyed",
        "/map/scan/lidar",
        "/map/segments",
        "/map/robot",
        "/map/robot/95_percent",
        "/map/true_robot",
        "/sigma/x_m",
        "/sigma/heading_deg",
        "/slip/left",
    } <= found.keys()
    scans = found["/map/scan/lidar"]
    positions = [p for p in scans["Points3D:positions"] if p]
    assert [len(p) for p in positions] == [360] * 20
    assert np.abs(np.abs(np.array(positions)[..., :2]).max(axis=-1) - 3.0).max() < 1e-5
    stamps = [t.total_seconds() for t in scans["drive"] if t is not None]
    np.testing.assert_allclose(stamps, 0.2 * np.arange(20))
    # One segment in the first scan, none in the others: a second later it is gone.
    assert [len(s) for s in found["/map/segments"]["LineStrips3D:strips"] if s] == [1]
    assert sorted(t.total_seconds() for t in found["/map/segments"]["drive"]) == [0.0, 1.0]
    assert [c for c in found["/map/segments"]["Clear:is_recursive"] if c] == [[False]]
    slip = found["/slip/left"]["Scalars:scalars"]
    assert slip == [[0.0], [0.25], [0.25], [0.0]]
    sigma = found["/sigma/heading_deg"]["Scalars:scalars"]
    np.testing.assert_allclose(np.ravel(sigma), np.degrees(0.01))


def test_recording_without_lidar_truth_and_covariance(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    found = result()
    plain = replace(found, trajectory=replace(found.trajectory, covariances=None))
    bare = make_scene(plain, drive(truth=False))
    entities = columns(viewer.save_recording(bare, tmp_path / "bare.rrd")).keys()
    assert {e for e in entities if not e.startswith("/__")} == {"/map", "/map/path", "/map/robot"}


def test_missing_viewer_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(FglocError, match=r"pip install 'fgloc\[viz\]'.*--html FILE"):
        import_rerun()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window opens without DISPLAY")
def test_no_display_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(FglocError, match=r"cannot be opened: .*; use --save FILE.rrd or --html"):
        viewer.show(make_scene(result(), drive()))


def test_viewer_is_started_with_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    fake, seen = tmp_path / "python", tmp_path / "seen"
    fake.write_text(f'#!/bin/sh\necho "$1 $2" > {seen}\nhead -c 3 "$3" >> {seen}\n')
    fake.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(fake))
    viewer.show(make_scene(result(), drive()))
    assert seen.read_bytes() == b"-m rerun\nRRF"


# --- the page -----------------------------------------------------------------------------------


def embedded(path: Path) -> dict[str, Any]:
    """What the page holds for its script."""
    found = re.search(
        r'<script id="scene" type="application/json">(.*?)</script>', path.read_text(), re.DOTALL
    )
    assert found is not None
    document: dict[str, Any] = json.loads(found.group(1))
    return document


def test_page_holds_the_scene(tmp_path: Path) -> None:
    document = embedded(view_html.save_page(scene(), tmp_path / "room.html"))
    assert document["has"] == [
        "points",
        "scan",
        "walls",
        "bands",
        "segments",
        "marks",
        "path",
        "ellipse",
        "truth",
    ]
    # Millimetres from the first pose, (1, 0) m: the wall x = 3 is 2 m away.
    assert document["origin_m"] == [1.0, 0.0]
    assert document["walls"][0]["ends"] == [2000, 3000, 2000, -3000]
    assert len(document["walls"][0]["band"]) == 36
    lidar = document["lidars"][0]
    assert lidar["t"] == [round(0.2 * k, 3) for k in range(20)]
    first = np.array(lidar["scans"][0]).reshape(-1, 2) + np.array([1000, 0])
    assert np.abs(np.abs(first).max(axis=1) - 3000).max() <= 1
    # Wall 1's colour, in both.
    assert [[s["colour"] for s in seen] for seen in lidar["segments"]["seen"]] == [
        [document["walls"][1]["colour"]]
    ]
    assert lidar["segments"]["t"] == [0.0]
    assert document["marks"][0] | {"axes": None} == {"name": "6", "x": 0, "y": 2000, "axes": None}
    np.testing.assert_allclose(document["marks"][0]["axes"][:2], [489.54, 244.77])
    assert document["marks"][1]["axes"] is None
    assert document["surveyed"] == [{"x": 100, "y": 2000}]
    assert document["slips"] == [{"wheel": "left", "begin": 1.0, "end": 2.0, "slip": 0.25}]
    assert (document["begin"], document["end"]) == (0.0, 4.0)


def test_page_needs_nothing_from_elsewhere(tmp_path: Path) -> None:
    text = view_html.save_page(scene(), tmp_path / "room.html").read_text()
    assert not re.search(r"https?:|src=|@import|url\(|fetch\(|XMLHttp", text)
    assert "@SCENE@" not in text


def test_names_cannot_break_the_page(tmp_path: Path) -> None:
    evil = replace(scene(), drive="</script><script>alert(1)</script>")
    path = view_html.save_page(evil, tmp_path / "room.html")
    assert path.read_text().count("</script>") == 2
    assert embedded(path)["drive"] == evil.drive


def test_long_drives_are_thinned_and_say_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view_html, "MOST_SCANS", 5)
    monkeypatch.setattr(view_html, "MOST_POSES", 9)
    document = embedded(view_html.save_page(scene(), tmp_path / "room.html"))
    assert document["note"] == "5 of 20 scans of lidar are shown."
    assert len(document["lidars"][0]["scans"]) == len(document["lidars"][0]["t"]) == 5
    assert document["path"]["t"] == [0.5 * k for k in range(9)]


DOM = """
const calls = [];
const paper = new Proxy({}, {
  get: (of, name) => name in of ? of[name] : (...a) => { calls.push([name, ...a]); },
  set: (of, name, value) => { of[name] = value; calls.push(["set", name, value]); return true; },
});
const elements = {};
function element(id) {
  return elements[id] ??= { id, dataset: {}, style: {}, value: "", children: [], listeners: {},
    textContent: "", clientWidth: 800, clientHeight: 600, getContext: () => paper,
    append(...c) { this.children.push(...c); },
    addEventListener(name, f) { this.listeners[name] = f; }, setPointerCapture() {} };
}
let made = 0;
globalThis.document = { getElementById: element, title: "",
  createElement: () => element("made" + made++) };
globalThis.window = { devicePixelRatio: 1, location: { hash: "#t=1.5" }, addEventListener() {} };
globalThis.requestAnimationFrame = () => {};
element("speed").value = "20";
element("scene").textContent = require("fs").readFileSync(process.argv[2], "utf8");
"""
"""As much of a browser as the script touches; what it draws is recorded."""


@pytest.mark.skipif(shutil.which("node") is None, reason="node runs the page's script")
def test_script_draws_and_answers(tmp_path: Path) -> None:
    page = view_html.save_page(scene(), tmp_path / "room.html")
    script = page.read_text().rsplit("<script>", 1)[1].split("</script>")[0]
    (tmp_path / "scene.json").write_text(json.dumps(embedded(page)))
    asked = """
    const out = { title: document.title, clock: elements.clock.textContent,
      rectangles: calls.filter((c) => c[0] === "fillRect").length, drawn: calls.length };
    calls.length = 0;
    elements.time.value = "3.0";
    elements.time.listeners.input();
    out.later = elements.clock.textContent;
    const thick = () => calls.filter((c) => c[0] === "set" && c[1] === "lineWidth" && c[2] === 4);
    out.segments = [3.0, 0.9, 1.1].map((t) => {
      calls.length = 0;
      elements.time.value = String(t);
      elements.time.listeners.input();
      return thick().length;
    });
    elements.map.listeners.wheel({ preventDefault() {}, offsetX: 0, offsetY: 0, deltaY: -500 });
    elements.map.listeners.dblclick();
    elements.play.listeners.click();
    out.play = elements.play.textContent;
    out.pose = poseAt(scene.path, 2.025);
    out.finite = calls.every((c) => c.slice(1).every((v) => typeof v !== "number" || isFinite(v)));
    console.log(JSON.stringify(out));
    """
    (tmp_path / "run.js").write_text(DOM + script.replace('"use strict";', "") + asked)
    done = subprocess.run(
        ["node", str(tmp_path / "run.js"), str(tmp_path / "scene.json")],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    out = json.loads(done.stdout)
    assert out["title"] == "a/room:1: batch"
    assert out["clock"] == "1.50 s of 4.00 s, left slips 25 %"
    assert out["later"] == "3.00 s of 4.00 s"
    # The one segment is seen at 0 s, and shown for a second.
    assert out["segments"] == [0, 1, 0]
    assert out["play"] == "stop"
    assert out["finite"]
    # The points of the scan at 1.4 s and of the map, each a small square.
    assert out["rectangles"] > 500
    # Between two poses of 50 ms, on the circle: within the rounding to millimetres.
    x, y, h = poses_at(np.array(2.025))
    np.testing.assert_allclose(
        [out["pose"]["x"], out["pose"]["y"]], [1e3 * (x - 1.0), 1e3 * y], atol=1.0
    )
    np.testing.assert_allclose(out["pose"]["h"], h, atol=1e-3)
