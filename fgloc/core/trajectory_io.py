"""Trajectories in and out of files: TUM, KITTI, g2o and npz.

What each format keeps of a `Trajectory`:

| suffix        | stamps              | headings            | covariances |
|---------------|---------------------|---------------------|-------------|
| `.tum` `.txt` | exact, 9 digits     | as a quaternion     | no          |
| `.kitti`      | side file `.times`  | as a matrix         | no          |
| `.g2o`        | in comment lines    | exact               | in comments |
| `.npz`        | exact               | exact               | exact       |

Numbers are written with as many digits as reading them back to the same double takes. Where a
format stores rotations, headings are unwrapped on reading; the whole turns of the first one are
kept in a comment `# turns: K`. Steps of more than half a turn between poses only survive in g2o
and npz. All of it is vectorised or one pass over the text: 100,000 poses take well under a second
in npz and about one in the text formats.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from fgloc.atomic import atomic_path
from fgloc.core.measurements import Floats
from fgloc.core.stamped_text import (
    Table,
    continuous,
    format_rows,
    format_stamps,
    read_table,
)
from fgloc.core.trajectory import Trajectory
from fgloc.core.trajectory_g2o import read_g2o, write_g2o
from fgloc.errors import FglocError

MAX_TILT_DEG = 10.0
"""A pose tilted more than this is not planar; below, it is projected: at 10° the heading is off by
at most 0.9° and lengths by 1.5 %, and no ground robot's motion capture reads more by mistake."""
NPZ_VERSION = 1
TUM_COLUMNS = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")
KITTI_COLUMNS = tuple(f"{name}{k}" for k in (1, 2, 3) for name in ("rx", "ry", "rz", "t"))


def save_trajectory(trajectory: Trajectory, path: str | Path) -> None:
    """Write a trajectory in the format of the path's suffix; nothing half-written is left behind.

    Raises FglocError for an unknown suffix, a trajectory without poses, or a place that
    cannot be written.
    """
    path = Path(path)
    if not len(trajectory):
        raise FglocError("a trajectory without poses cannot be written", file=path)
    suffix = _suffix(path)
    if suffix == ".npz":
        _write_npz(trajectory, path)
    elif suffix == ".g2o":
        write_g2o(trajectory, path)
    elif suffix == ".kitti":
        _write_kitti(trajectory, path)
    else:
        _write_tum(trajectory, path)


def load_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory in the format of the path's suffix (`.tum .txt .kitti .g2o .npz`).

    Raises FglocError naming file and line for whatever is not a planar trajectory with finite
    numbers and increasing stamps.
    """
    path = Path(path)
    suffix = _suffix(path)
    if suffix == ".npz":
        return _read_npz(path)
    if suffix == ".g2o":
        return read_g2o(path)
    return _read_kitti(path) if suffix == ".kitti" else _read_tum(path)


def _suffix(path: Path) -> str:
    """Return the known suffix of a path or raise FglocError."""
    suffix = path.suffix.lower()
    if suffix not in (".tum", ".txt", ".kitti", ".g2o", ".npz"):
        raise FglocError(
            "unknown trajectory format; name the file .tum, .txt, .kitti, .g2o or .npz", file=path
        )
    return suffix


def _turns_comment(heading: Floats) -> str:
    """Return the comment line that keeps the whole turns of the first heading; often empty."""
    first = float(heading[0])
    turns = round((first - float(np.arctan2(np.sin(first), np.cos(first)))) / (2.0 * np.pi))
    return f"# turns: {turns}\n" if turns else ""


def _turns(comments: list[str], path: Path) -> int:
    """Return the whole turns of the first heading that a comment line keeps, else 0."""
    for comment in comments:
        key, _, value = comment.lstrip("# ").partition(":")
        if key == "turns":
            try:
                return int(value)
            except ValueError:
                raise FglocError(f"'{comment}' is not a number of turns", file=path) from None
    return 0


def _check_planar(cosine: Floats, table: Table) -> None:
    """Raise FglocError naming the first pose whose vertical axis leans over MAX_TILT_DEG."""
    leaning = np.flatnonzero(cosine < np.cos(np.radians(MAX_TILT_DEG)))
    if leaning.size:
        k = int(leaning[0])
        tilt = float(np.degrees(np.arccos(np.clip(cosine[k], -1.0, 1.0))))
        raise FglocError(
            f"the pose is tilted by {tilt:.1f}°, more than the {MAX_TILT_DEG:.0f}° that can be "
            "taken for planar; turn the trajectory so that z points up",
            file=table.path,
            line=table.numbers[k],
        )


def _write_tum(trajectory: Trajectory, path: Path) -> None:
    """Write `time x y z qx qy qz qw` lines; z, qx, qy are 0 and qw is not negative."""
    half = 0.5 * trajectory.poses[:, 2]
    sign = np.where(np.cos(half) < 0.0, -1.0, 1.0)
    x, y, _ = trajectory.poses.T.tolist()
    columns = (
        format_stamps(trajectory.stamps_ns),
        x,
        y,
        (sign * np.sin(half)).tolist(),
        (sign * np.cos(half)).tolist(),
    )
    text = format_rows("%s %r %r 0.0 0.0 0.0 %r %r\n", columns)
    header = "# time[s] x[m] y[m] z[m] qx qy qz qw\n" + _turns_comment(trajectory.poses[:, 2])
    with atomic_path(path) as target:
        target.write_text(header + text, encoding="utf-8")


def _read_tum(path: Path) -> Trajectory:
    """Read a TUM file, projecting to the plane within MAX_TILT_DEG; z is dropped."""
    table, comments = read_table(path, TUM_COLUMNS)
    stamps = table.stamps(0)
    values = table.floats(1, 8)
    qx, qy, qz, qw = values[:, 3:].T
    squared = qx * qx + qy * qy + qz * qz + qw * qw
    if not bool(np.all(squared > 1e-12)):
        k = int(np.flatnonzero(~(squared > 1e-12))[0])
        raise FglocError("the quaternion has norm zero", file=path, line=table.numbers[k])
    _check_planar(1.0 - 2.0 * (qx * qx + qy * qy) / squared, table)
    # Direction of the body's x axis seen from above; homogeneous, so the norm does not matter.
    heading = np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    heading = continuous(heading) + 2.0 * np.pi * _turns(comments, path)
    return Trajectory(stamps, np.column_stack([values[:, 0], values[:, 1], heading]))


def times_path(path: Path) -> Path:
    """Return the side file that holds a KITTI file's stamps: `run.kitti` has `run.times`."""
    return path.with_suffix(".times")


def _write_kitti(trajectory: Trajectory, path: Path) -> None:
    """Write rows of the 3x4 matrix [R t] (body in map, z up), and the stamps to the side file."""
    x, y, _ = trajectory.poses.T.tolist()
    c = np.cos(trajectory.poses[:, 2])
    s = np.sin(trajectory.poses[:, 2])
    columns = (c.tolist(), (-s).tolist(), x, s.tolist(), c.tolist(), y)
    text = format_rows("%r %r 0.0 %r %r %r 0.0 %r 0.0 0.0 1.0 0.0\n", columns)
    times = _turns_comment(trajectory.poses[:, 2]) + "".join(
        f"{stamp}\n" for stamp in format_stamps(trajectory.stamps_ns)
    )
    with atomic_path(path) as target, atomic_path(times_path(path)) as side:
        target.write_text(text, encoding="utf-8")
        side.write_text(times, encoding="utf-8")


def _read_kitti(path: Path) -> Trajectory:
    """Read a KITTI file; without its `.times` file pose k gets the stamp k seconds."""
    table, _ = read_table(path, KITTI_COLUMNS)
    matrices = table.floats(0, 12).reshape(-1, 3, 4)
    rotation = matrices[:, :, :3]
    skew = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    wrong = np.flatnonzero((skew > 1e-3) | (np.linalg.det(rotation) < 0.0))
    if wrong.size:
        line = table.numbers[int(wrong[0])]
        raise FglocError("the 3x3 part of the matrix is not a rotation", file=path, line=line)
    _check_planar(rotation[:, 2, 2], table)
    heading = continuous(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    stamps = np.arange(len(table.rows), dtype=np.int64) * 1_000_000_000
    side = times_path(path)
    if side.exists():
        times, comments = read_table(side, ("time",))
        stamps = times.stamps(0)
        if stamps.size != heading.size:
            raise FglocError(
                f"{stamps.size} stamps for the {heading.size} poses of {path.name}", file=side
            )
        heading = heading + 2.0 * np.pi * _turns(comments, side)
    return Trajectory(stamps, np.column_stack([matrices[:, 0, 3], matrices[:, 1, 3], heading]))


def _write_npz(trajectory: Trajectory, path: Path) -> None:
    """Write stamps_ns, poses, covariances (where known) and the version; nothing is lost."""
    arrays = {"stamps_ns": trajectory.stamps_ns, "poses": trajectory.poses}
    if trajectory.covariances is not None:
        arrays["covariances"] = trajectory.covariances
    # An open file, because numpy would add a second suffix to a temporary name.
    with atomic_path(path) as target, target.open("wb") as file:
        np.savez(file, version=np.int64(NPZ_VERSION), **arrays)  # type: ignore[arg-type]


def _read_npz(path: Path) -> Trajectory:
    """Read our own npz; pickled content is refused."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise FglocError("no such file; check the path", file=path) from None
    except (OSError, ValueError, EOFError, AttributeError, TypeError, zipfile.BadZipFile):
        raise FglocError("is not an npz file of plain arrays", file=path) from None
    missing = [name for name in ("version", "stamps_ns", "poses") if name not in arrays]
    if missing:
        raise FglocError(f"is no trajectory: {', '.join(missing)} missing", file=path)
    if arrays["version"].shape != () or arrays["version"] != NPZ_VERSION:
        raise FglocError(
            f"has version {arrays['version']}, this program reads {NPZ_VERSION}", file=path
        )
    covariances = arrays.get("covariances")
    for name, values in arrays.items():
        if name in ("poses", "covariances") and values.dtype != np.float64:
            raise FglocError(f"{name} must be float64, not {values.dtype}", file=path)
    try:
        return Trajectory(arrays["stamps_ns"], arrays["poses"], covariances)
    except FglocError as error:
        raise FglocError(str(error), file=path) from None
