"""One estimate over time in the rerun viewer: in a window, or as a recording in a file."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fgloc.atomic import atomic_path
from fgloc.core.measurements import Floats, Stamps
from fgloc.errors import FglocError
from fgloc.lazy import import_rerun
from fgloc.report.ellipses import ellipse_outlines
from fgloc.report.map_points import PlacedScans, all_points
from fgloc.report.map_segments import PlacedSegments
from fgloc.report.map_thinning import thin
from fgloc.report.map_walls import wall_bands
from fgloc.report.scene import SHOWN_S, Scene, evenly, wall_colour

TIMELINE = "drive"
"""Seconds since the drive's begin."""
MOST_POSES = 5000
"""Poses shown over time; the path itself has them all."""
PATH, TRUTH, POINT, MARK = (213, 94, 0), (90, 90, 90), (150, 150, 150), (127, 79, 201)
SCAN = (0, 158, 115)


def save_recording(scene: Scene, path: Path) -> Path:
    """Write the scene as a recording (.rrd), atomically and without a window; return the path.

    Raises FglocError if rerun-sdk is not installed, or the file cannot be written.
    """
    rerun = import_rerun()
    stream = rerun.RecordingStream("fgloc")
    with atomic_path(path) as temporary:
        points = thin(all_points(scene.scans))
        stream.save(str(temporary), default_blueprint=_blueprint(rerun, scene, points))
        _log(rerun, stream, scene, points)
        stream.flush()
        # Closes the file; what is logged afterwards goes nowhere.
        stream.disconnect()
    return path


def show(scene: Scene) -> None:
    """Open a window of the rerun viewer with the scene; return when it is closed.

    Raises FglocError if rerun-sdk is not installed, or the window cannot be opened.
    """
    with TemporaryDirectory(prefix="fgloc-view-") as folder:
        path = save_recording(scene, Path(folder) / "scene.rrd")
        # Through the interpreter: the viewer's own program need not be on the PATH.
        done = subprocess.run(
            [sys.executable, "-m", "rerun", str(path)], stderr=subprocess.PIPE, text=True
        )
    if done.returncode != 0:
        said = [line for line in done.stderr.splitlines() if line.strip()]
        raise FglocError(
            f"the viewer's window cannot be opened: {said[-1] if said else done.returncode}; "
            "use --save FILE.rrd or --html FILE"
        )


def _blueprint(rerun: Any, scene: Scene, points: Floats) -> Any:
    """Return how the viewer is laid out: the map, below it what is a number over time."""
    views = rerun.blueprint
    low, high = scene.box(points)
    x, y = 0.5 * (low + high)
    # From above, x to the right; not quite, since straight down nothing would be up.
    height = 1.1 * max(float(high[1] - low[1]), 0.5 * float(high[0] - low[0]))
    eye = views.EyeControls3D(position=[x, y - 0.05 * height, height], look_target=[x, y, 0.0])
    series = [views.TimeSeriesView(origin="sigma", name="standard deviations")]
    if scene.slips:
        series.append(views.TimeSeriesView(origin="slip", name="wheel slip"))
    return views.Blueprint(
        views.Vertical(
            # In a plane view y would point down.
            views.Spatial3DView(
                origin="map", name=f"{scene.drive}: {scene.method}", eye_controls=eye
            ),
            views.Horizontal(*series),
            row_shares=[4, 1],
        ),
        views.TimePanel(timeline=TIMELINE),
        collapse_panels=True,
    )


def _log(rerun: Any, stream: Any, scene: Scene, points: Floats) -> None:
    """Log the scene, what does not change first."""
    stream.send_recording_name(f"{scene.drive}: {scene.method}")
    stream.log("map", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _still(rerun, stream, scene, points)
    for scans in scene.scans:
        _scans(rerun, stream, scene, scans)
    if scene.segments is not None:
        _segments(rerun, stream, scene, scene.scans[0], scene.segments)
    _poses(rerun, stream, scene)
    _slips(rerun, stream, scene)


def _still(rerun: Any, stream: Any, scene: Scene, points: Floats) -> None:
    """Log the paths, the thinned points of all scans, walls with their bands, and landmarks."""

    def lines(name: str, strips: Sequence[Floats], colours: Any, width: float, **more: Any) -> None:
        radius = rerun.Radius.ui_points(width)
        strips = [_flat(s) for s in strips]
        stream.log(
            f"map/{name}",
            rerun.LineStrips3D(strips, colors=colours, radii=radius, **more),
            static=True,
        )

    lines("path", [scene.trajectory.poses[:, :2]], PATH, 1.0)
    if scene.truth is not None:
        lines("truth", [scene.truth.poses[:, :2]], TRUTH, 1.0)
    if scene.true_walls.shape[0]:
        lines("true_walls", list(scene.true_walls), TRUTH, 0.6)
    if points.shape[0]:
        stream.log(
            "map/points",
            rerun.Points3D(_flat(points), colors=POINT, radii=rerun.Radius.ui_points(0.8)),
            static=True,
        )
    if scene.walls is not None and scene.walls.normal.size:
        walls = scene.walls
        colours = [wall_colour(k) for k in range(walls.normal.size)]
        names = [f"wall {k}, seen {n} times" for k, n in enumerate(walls.sightings.tolist())]
        lines("walls", list(walls.ends), colours, 2.0, labels=names, show_labels=False)
        known = np.flatnonzero(np.isfinite(walls.covariance).all(axis=(1, 2)))
        bands = wall_bands(walls)[known]
        closed = np.concatenate([bands, bands[:, :1]], axis=1)
        lines("walls/2_sigma", list(closed), [colours[k] for k in known.tolist()], 0.5)
    _landmarks(rerun, stream, scene, lines)


def _landmarks(rerun: Any, stream: Any, scene: Scene, lines: Any) -> None:
    """Log point landmarks with their ellipses, and where they were surveyed to be."""
    if scene.marks is not None and scene.marks.landmark.size:
        marks = scene.marks
        stream.log(
            "map/landmarks",
            rerun.Points3D(
                _flat(marks.positions),
                colors=MARK,
                radii=rerun.Radius.ui_points(4.0),
                labels=[str(name) for name in marks.landmark.tolist()],
            ),
            static=True,
        )
        known = np.isfinite(marks.covariance).all(axis=(1, 2))
        outlines = ellipse_outlines(marks.positions[known], marks.covariance[known])
        lines("landmarks/95_percent", list(outlines), MARK, 0.7)
    if scene.surveyed:
        places = np.array(list(scene.surveyed.values()))
        stream.log(
            "map/surveyed",
            rerun.Points3D(_flat(places), colors=TRUTH, radii=rerun.Radius.ui_points(3.0)),
            static=True,
        )


def _scans(rerun: Any, stream: Any, scene: Scene, scans: PlacedScans) -> None:
    """Log the points of each scan at its stamp, all in one message."""
    stream.send_columns(
        f"map/scan/{scans.sensor}",
        [_times(rerun, scene, scans.stamps_ns)],
        rerun.Points3D.columns(positions=_flat(scans.returned)).partition(scans.valid.sum(axis=1)),
    )
    stream.log(
        f"map/scan/{scans.sensor}",
        rerun.Points3D.from_fields(colors=SCAN, radii=rerun.Radius.ui_points(2.0)),
        static=True,
    )


def _segments(
    rerun: Any, stream: Any, scene: Scene, scans: PlacedScans, segments: PlacedSegments
) -> None:
    """Log the segments of each scan that has some, in the colours of their walls."""
    rows, begins = np.unique(segments.row, return_index=True)
    bounds = [*begins.tolist(), segments.row.size]
    stamps = [*scene.seconds(scans.stamps_ns[rows]).tolist(), np.inf]
    for k in range(rows.size):
        own = slice(bounds[k], bounds[k + 1])
        wall = segments.wall[own].tolist()
        stream.set_time(TIMELINE, duration=stamps[k])
        stream.log(
            "map/segments",
            rerun.LineStrips3D(
                [_flat(ends) for ends in segments.ends[own]],
                colors=[wall_colour(w) for w in wall],
                radii=rerun.Radius.ui_points(3.5),
                labels=[f"wall {w}" if w >= 0 else "no wall" for w in wall],
                show_labels=False,
            ),
        )
        if stamps[k + 1] > stamps[k] + SHOWN_S:
            stream.set_time(TIMELINE, duration=stamps[k] + SHOWN_S)
            stream.log("map/segments", rerun.Clear(recursive=False))


def _poses(rerun: Any, stream: Any, scene: Scene) -> None:
    """Log where the robot is at each pose, its ellipse, its standard deviations, and the truth."""
    chosen = evenly(len(scene.trajectory), MOST_POSES)
    stamps = scene.trajectory.stamps_ns[chosen]
    poses = scene.trajectory.poses[chosen]
    _arrows(rerun, stream, scene, "map/robot", PATH, stamps, poses)
    true, known = scene.truth_at(stamps)
    if known.any():
        _arrows(rerun, stream, scene, "map/true_robot", TRUTH, stamps[known], true[known])
    if scene.trajectory.covariances is None:
        return
    covariances = scene.trajectory.covariances[chosen]
    outlines = ellipse_outlines(poses[:, :2], covariances[:, :2, :2])
    times = [_times(rerun, scene, stamps)]
    stream.send_columns(
        "map/robot/95_percent",
        times,
        rerun.LineStrips3D.columns(strips=[_flat(o) for o in outlines]),
    )
    stream.log(
        "map/robot/95_percent",
        rerun.LineStrips3D.from_fields(colors=PATH, radii=rerun.Radius.ui_points(0.8)),
        static=True,
    )
    sigma = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    for name, values in zip(("x_m", "y_m", "heading_deg"), sigma.T, strict=True):
        shown = np.degrees(values) if name == "heading_deg" else values
        stream.send_columns(f"sigma/{name}", times, rerun.Scalars.columns(scalars=shown))


def _arrows(
    rerun: Any,
    stream: Any,
    scene: Scene,
    name: str,
    colour: tuple[int, int, int],
    stamps: Stamps,
    poses: Floats,
) -> None:
    """Log poses (N, 3) as arrows of half a metre along the heading."""
    ahead = 0.5 * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=-1)
    stream.send_columns(
        name,
        [_times(rerun, scene, stamps)],
        rerun.Arrows3D.columns(vectors=_flat(ahead), origins=_flat(poses[:, :2])),
    )
    stream.log(
        name,
        rerun.Arrows3D.from_fields(colors=colour, radii=rerun.Radius.ui_points(3.0)),
        static=True,
    )


def _slips(rerun: Any, stream: Any, scene: Scene) -> None:
    """Log each wheel's slip as a curve: zero outside of the stretches."""
    for slip in scene.slips:
        edges = np.array([slip.begin_ns - 1, slip.begin_ns, slip.end_ns, slip.end_ns + 1])
        stream.send_columns(
            f"slip/{slip.wheel}",
            [_times(rerun, scene, edges)],
            rerun.Scalars.columns(scalars=[0.0, slip.slip, slip.slip, 0.0]),
        )


def _times(rerun: Any, scene: Scene, stamps: Stamps) -> Any:
    """Return the column of times for stamps."""
    return rerun.TimeColumn(TIMELINE, duration=scene.seconds(stamps))


def _flat(points: Floats) -> Floats:
    """Return points (..., 2) with z = 0."""
    return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)
