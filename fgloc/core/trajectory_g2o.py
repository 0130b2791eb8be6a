"""Trajectories as g2o pose graphs: VERTEX_SE2, EDGE_SE2 between neighbours, FIX of the first.

g2o has no stamps and no covariances; ours stand in comment lines that other programs skip:
`# STAMP_NS id ns` and `# COVARIANCE id p11 p12 p13 p22 p23 p33`, the upper triangle in map axes.
They stand at the end, because GTSAM's reader drops the edges that follow a line it does not know.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fgloc.atomic import atomic_path
from fgloc.core.geometry import between, rotate_covariance
from fgloc.core.measurements import Floats, Stamps
from fgloc.core.stamped_text import Table, continuous, format_rows, read_lines
from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError

_UPPER = [0, 1, 2, 4, 5, 8]
"""Upper triangle of a 3x3 matrix in a row of nine, in the order of the format."""
_TRIANGLE = ("11", "12", "13", "22", "23", "33")
_EDGE_COLUMNS = ("EDGE_SE2", "from", "to", "dx", "dy", "dtheta", *(f"i{k}" for k in _TRIANGLE))
_VERTEX_COLUMNS = ("VERTEX_SE2", "id", "x", "y", "theta")
_STAMP_COLUMNS = ("#", "STAMP_NS", "id", "nanoseconds")
_COVARIANCE_COLUMNS = ("#", "COVARIANCE", "id", *(f"p{k}" for k in _TRIANGLE))
_LEAST_SIGMA = 1e-6
"""Smallest standard deviation [m, rad] behind an edge's information, so that it stays finite."""


def relative_information(trajectory: Trajectory) -> Floats:
    """Return the (N-1, 3, 3) information of the steps between neighbouring poses.

    It is in the axes of the later pose, where g2o measures an edge's error. A trajectory keeps no
    correlation between neighbours, so they are taken as independent. Neighbours usually err
    together, which makes this a cautious weight: the step is better known than it says. Identity
    where the trajectory has no covariances.
    """
    n = len(trajectory) - 1
    if trajectory.covariances is None:
        return np.tile(np.eye(3), (n, 1, 1))
    moved = np.diff(trajectory.poses[:, :2], axis=0)
    # Turning the earlier pose by a small angle swings the later one across the line between them.
    lever = np.tile(np.eye(3), (n, 1, 1))
    lever[:, 0, 2] = -moved[:, 1]
    lever[:, 1, 2] = moved[:, 0]
    earlier, later = trajectory.covariances[:-1], trajectory.covariances[1:]
    spread = later + lever @ earlier @ lever.transpose(0, 2, 1)
    spread = rotate_covariance(spread, -trajectory.poses[1:, 2])
    return np.asarray(np.linalg.inv(spread + _LEAST_SIGMA**2 * np.eye(3)), dtype=np.float64)


def write_g2o(trajectory: Trajectory, path: Path) -> None:
    """Write the pose graph; stamps, headings and covariances survive our own round trip exactly."""
    n = len(trajectory)
    ids = list(range(n))
    parts = [format_rows("VERTEX_SE2 %d %r %r %r\n", (ids, *trajectory.poses.T.tolist()))]
    if n > 1:
        steps = between(trajectory.poses[:-1], trajectory.poses[1:])
        upper = relative_information(trajectory).reshape(n - 1, 9)[:, _UPPER]
        numbers = (*steps.T.tolist(), *upper.T.tolist())
        template = "EDGE_SE2 %d %d" + " %.17g" * 3 + " %.12g" * 6 + "\n"
        parts.append(format_rows(template, (ids[:-1], ids[1:], *numbers)))
    parts.append("FIX 0\n")
    parts.append(format_rows("# STAMP_NS %d %d\n", (ids, trajectory.stamps_ns.tolist())))
    if trajectory.covariances is not None:
        upper = trajectory.covariances.reshape(n, 9)[:, _UPPER]
        template = "# COVARIANCE %d" + " %.17g" * 6 + "\n"
        parts.append(format_rows(template, (ids, *upper.T.tolist())))
    with atomic_path(path) as target:
        target.write_text("".join(parts), encoding="utf-8")


def read_g2o(path: Path) -> Trajectory:
    """Read the VERTEX_SE2 of a g2o file in the order of their ids; other tags are skipped.

    A file without our stamps numbers the poses: the k-th gets k seconds, and headings are
    unwrapped. Raises FglocError naming file and line.
    """
    lines = read_lines(path)
    vertices = _tagged(path, lines, _VERTEX_COLUMNS)
    _tagged(path, lines, _EDGE_COLUMNS)  # not needed, but a truncated file shall not pass
    if not vertices.rows:
        raise FglocError("holds no VERTEX_SE2, so no planar poses", file=path)
    ids = vertices.integers(1)
    order = np.argsort(ids, kind="stable")
    repeated = np.flatnonzero(np.diff(ids[order]) == 0)
    if repeated.size:
        k = int(order[repeated[0] + 1])
        raise FglocError(f"vertex {ids[k]} stands twice", file=path, line=vertices.numbers[k])
    ids = ids[order]
    poses = vertices.floats(2, 5)[order]
    stamp_rows = _tagged(path, lines, _STAMP_COLUMNS)
    if stamp_rows.rows:
        stamp_rows = _ordered(stamp_rows, ids)
        stamps = stamp_rows.integers(3)
        stamp_rows.check_increasing(stamps)
    else:
        stamps = np.arange(ids.size, dtype=np.int64) * 1_000_000_000
        poses[:, 2] = continuous(poses[:, 2])
    covariance_rows = _tagged(path, lines, _COVARIANCE_COLUMNS)
    covariances = None
    if covariance_rows.rows:
        upper = _ordered(covariance_rows, ids).floats(3, 9)
        covariances = upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return Trajectory(stamps, poses, covariances)


def _tagged(path: Path, lines: list[str], columns: tuple[str, ...]) -> Table:
    """Return the rows that begin with a tag, checked for their columns.

    A comment's tag is its first two tokens ("#" and a word), any other's the first.
    """
    tag = " ".join(columns[:2] if columns[0] == "#" else columns[:1]) + " "
    keep = [k for k, line in enumerate(lines) if line.startswith(tag)]
    table = Table(path, [k + 1 for k in keep], [lines[k].split() for k in keep])
    table.require(columns)
    return table


def _ordered(table: Table, ids: Stamps) -> Table:
    """Return a comment table in the order of the vertex `ids`; FglocError unless each has one."""
    named = table.integers(2)
    order = np.argsort(named, kind="stable")
    if not np.array_equal(named[order], ids):
        what = table.rows[0][1]
        raise FglocError(f"the {what} lines do not name each vertex once", file=table.path)
    rows = order.tolist()
    return Table(table.path, [table.numbers[k] for k in rows], [table.rows[k] for k in rows])
