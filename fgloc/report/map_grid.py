"""Occupancy grid by tracing every beam, and its files for ROS's map_server.

Sources: Hornung et al., "OctoMap" (2013), for the log-odds of a hit and a miss and for updating a
cell once a scan, a hit before a miss; Amanatides and Woo, "A fast voxel traversal algorithm"
(1987); ROS's map_server for the meaning of pixels and thresholds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fgloc.atomic import write_bytes, write_text
from fgloc.core.compiled import compiled
from fgloc.core.measurements import Floats
from fgloc.errors import FglocError
from fgloc.report.map_points import PlacedScans

RESOLUTION_M = 0.05
"""Side of a cell [m] unless another is asked for; what map_server's own maps have."""
HIT, MISS = 0.85, -0.4
"""Log-odds that a beam adds to the cell where it ends, and to each one it passes."""
MARGIN_M = 0.5
"""Unknown border around everything seen [m]."""
MOST_CELLS = 64_000_000
"""Largest grid: 400 m × 400 m at 5 cm, 64 MB as an image and eight times that while it is made."""
FREE, OCCUPIED, UNKNOWN = 254, 0, 205
"""Pixels of map_server's files."""
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
"""Thresholds of (255 - pixel) / 255 in the YAML file. A pixel of 205 gives 0.19608: with the 0.25
of some later files it would be read as free."""

Pixels = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class OccupancyGrid:
    """How likely each cell is occupied."""

    log_odds: npt.NDArray[np.float32]
    """(H, W) log-odds; row 0 is the one of the lowest y. 0 where nothing was seen."""
    resolution: float
    """Side of a cell [m]."""
    origin: tuple[float, float]
    """Map coordinates of the outer corner of cell (0, 0): lowest x and y [m]."""

    def pixels(self) -> Pixels:
        """Return the (H, W) image, its first row at the TOP (highest y).

        A cell is occupied (0) where that is more likely than not, free (254) where less likely,
        unknown (205) where no beam told or they cancel.
        """
        image = np.full(self.log_odds.shape, UNKNOWN, np.uint8)
        image[self.log_odds > 0.0] = OCCUPIED
        image[self.log_odds < 0.0] = FREE
        return np.ascontiguousarray(image[::-1])


def occupancy_grid(
    placed: Sequence[PlacedScans], resolution: float = RESOLUTION_M
) -> OccupancyGrid:
    """Return the grid of all beams that returned.

    Beams without return say nothing: glass and dark walls give none either. Raises FglocError if
    no beam returned, or the grid would have more than MOST_CELLS cells. O(beams · range /
    resolution), 8 bytes a cell.
    """
    if not 0.0 < resolution < np.inf:
        raise FglocError(f"a cell's side must be positive and finite, got {resolution}")
    ends = [p.returned for p in placed] + [p.origins[p.valid] for p in placed]
    everything = np.concatenate([np.zeros((0, 2)), *ends])
    if everything.shape[0] == 0:
        raise FglocError("no beam of any scan returned, so there is no occupancy grid to make")
    low = np.floor((everything.min(axis=0) - MARGIN_M) / resolution) * resolution
    cells = np.ceil((everything.max(axis=0) + MARGIN_M - low) / resolution)
    if not float(cells.prod()) <= MOST_CELLS:
        raise FglocError(_too_large(cells, resolution))
    width, height = int(cells[0]), int(cells[1])
    log_odds = np.zeros((height, width), np.float32)
    seen = np.zeros((height, width), np.int32)
    scans = 0
    for p in placed:
        _trace(log_odds, seen, p.origins, p.points, p.valid, low, resolution, scans)
        scans += p.scan.size
    return OccupancyGrid(log_odds, resolution, (float(low[0]), float(low[1])))


def write_grid(grid: OccupancyGrid, image: Path, description: Path) -> None:
    """Write the grid as PGM and the YAML that map_server is started with, each atomically.

    The YAML names the image by its file name, so both belong into one folder.
    """
    pixels = grid.pixels()
    height, width = pixels.shape
    head = f"P5\n# CREATOR: fgloc {grid.resolution:.3f} m/pix\n{width} {height}\n255\n"
    write_bytes(image, head.encode("ascii") + pixels.tobytes())
    x, y = grid.origin
    write_text(
        description,
        f"image: {image.name}\n"
        f"resolution: {grid.resolution:.9g}\n"
        f"origin: [{x:.6f}, {y:.6f}, 0.000000]\n"
        "negate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\n"
        f"free_thresh: {FREE_THRESH}\n",
    )


def _too_large(cells: Floats, resolution: float) -> str:
    """Return the error for a grid of `cells` (2,) cells, with a cell's side that would do."""
    sides = cells * resolution
    least = resolution * float(np.sqrt(cells.prod() / MOST_CELLS))
    # Two digits, rounded up.
    step = 10.0 ** (np.floor(np.log10(least)) - 1.0)
    enough = float(np.ceil(1.02 * least / step) * step)
    return (
        f"an occupancy grid of {sides[0]:.0f} m × {sides[1]:.0f} m would have {cells.prod():.2g} "
        f"cells of {resolution:g} m, and at most {MOST_CELLS:.2g} are made; ask for cells of "
        f"{enough:.3g} m, or see whether the estimate has diverged"
    )


@compiled
def _trace(
    log_odds: npt.NDArray[np.float32],
    seen: npt.NDArray[np.int32],
    origins: Floats,
    points: Floats,
    valid: npt.NDArray[np.bool_],
    low: Floats,
    resolution: float,
    before: int,
) -> None:
    """Add (S, B) beams to the grid; `before` scans were added already.

    `seen` holds the last scan that told of a cell and what: 2·number + 1 that it was passed,
    2·number + 2 that a beam ended there. A scan tells of a cell once, and hits go first: a beam
    that grazes a wall passes cells in which others end.
    """
    scale = 1.0 / resolution
    for s in range(points.shape[0]):
        passed, ended = 2 * (before + s) + 1, 2 * (before + s) + 2
        for b in range(points.shape[1]):
            if valid[s, b]:
                column = int((points[s, b, 0] - low[0]) * scale)
                row = int((points[s, b, 1] - low[1]) * scale)
                if seen[row, column] != ended:
                    seen[row, column] = ended
                    log_odds[row, column] += HIT
        for b in range(points.shape[1]):
            if not valid[s, b]:
                continue
            x = (origins[s, b, 0] - low[0]) * scale
            y = (origins[s, b, 1] - low[1]) * scale
            u = (points[s, b, 0] - low[0]) * scale
            v = (points[s, b, 1] - low[1]) * scale
            dx, dy = u - x, v - y
            column, row = int(x), int(y)
            # Borders still to be crossed in each direction, and where along the beam the next is.
            columns = abs(int(u) - column)
            rows = abs(int(v) - row)
            step_x = 1 if dx > 0.0 else -1
            step_y = 1 if dy > 0.0 else -1
            each_x = abs(1.0 / dx) if dx != 0.0 else np.inf
            each_y = abs(1.0 / dy) if dy != 0.0 else np.inf
            next_x = (column + 1 - x if dx > 0.0 else x - column) * each_x if columns else np.inf
            next_y = (row + 1 - y if dy > 0.0 else y - row) * each_y if rows else np.inf
            while columns or rows:
                if seen[row, column] < passed:
                    seen[row, column] = passed
                    log_odds[row, column] += MISS
                if columns and (next_x < next_y or not rows):
                    column += step_x
                    next_x += each_x
                    columns -= 1
                else:
                    row += step_y
                    next_y += each_y
                    rows -= 1
