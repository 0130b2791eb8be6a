"""The occupancy grid, read back from its files the way ROS's map_server reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from ruamel.yaml import YAML

from fgloc.core.trajectory import Trajectory
from fgloc.errors import FglocError
from fgloc.report.map_grid import HIT, MISS, OccupancyGrid, occupancy_grid, write_grid
from fgloc.report.map_points import PlacedScans, place_scans
from tests.report.mapped import HALF, MOUNT, room_scans, trajectory


def beams(*ends: tuple[float, float, float, float]) -> PlacedScans:
    """One scan of beams that start at (x, y) and end at (x, y)."""
    table = np.array([ends])
    n = len(ends)
    return PlacedScans(
        "lidar",
        np.zeros(1, np.int64),
        np.zeros(1, np.int64),
        np.zeros((1, 3)),
        table[:, :, :2].copy(),
        table[:, :, 2:].copy(),
        np.ones((1, n), dtype=bool),
        0,
    )


def served(description: Path) -> tuple[np.ndarray, float, tuple[float, float]]:
    """Occupancy (H, W), row 0 lowest, as map_server publishes it: 100, 0 or -1.

    Rules of its image loader in trinary mode, without negation: p = (255 - pixel) / 255, occupied
    above occupied_thresh, else free below free_thresh, else unknown; the image's last row is the
    map's first.
    """
    yaml = YAML(typ="safe").load(description.read_text())
    assert set(yaml) == {
        "image",
        "resolution",
        "origin",
        "negate",
        "occupied_thresh",
        "free_thresh",
    }
    assert yaml["negate"] == 0
    assert yaml["origin"][2] == 0.0
    with Image.open(description.parent / yaml["image"]) as image:
        assert image.mode == "L"
        p = (255.0 - np.asarray(image, dtype=float)) / 255.0
    data = np.full(p.shape, -1)
    data[p < yaml["free_thresh"]] = 0
    data[p > yaml["occupied_thresh"]] = 100
    return data[::-1], yaml["resolution"], tuple(yaml["origin"][:2])


def test_one_beam_by_hand() -> None:
    # Cells of 1 m. From (0.5, 0.5) to (3.5, 1.5) the beam crosses x = 1 at y = 0.67, x = 2 at
    # y = 1 (the corner's upper side), x = 3 at y = 1.33: cells (0,0) (1,0) (2,1), ends in (3,1).
    grid = occupancy_grid([beams((0.5, 0.5, 3.5, 1.55))], 1.0)
    assert grid.origin == (0.0, 0.0)
    x, y = np.nonzero(grid.log_odds.T < 0.0)
    assert sorted(zip(x.tolist(), y.tolist(), strict=True)) == [(0, 0), (1, 0), (1, 1), (2, 1)]
    assert grid.log_odds[1, 3] == np.float32(HIT)
    assert grid.log_odds[0, 1] == np.float32(MISS)
    assert np.count_nonzero(grid.log_odds) == 5


def test_traced_cells_against_dense_sampling() -> None:
    # Every cell that a finely sampled beam passes is free, and no other.
    rng = np.random.default_rng(5)
    for _ in range(200):
        x, y, u, v = rng.uniform(-4.0, 4.0, 4)
        grid = occupancy_grid([beams((x, y, u, v))], 0.5)
        share = np.linspace(0.0, 1.0, 20_001)[:, None]
        line = (1.0 - share) * np.array([x, y]) + share * np.array([u, v])
        cells = np.floor((line - grid.origin) / 0.5).astype(int)
        expected = np.zeros(grid.log_odds.shape)
        expected[cells[:, 1], cells[:, 0]] = MISS
        expected[cells[-1, 1], cells[-1, 0]] = HIT
        wrong = np.abs(grid.log_odds - expected) > 1e-6
        # A corner cut by less than a sample may be missed by the sampling, not by the tracing.
        assert np.count_nonzero(wrong) <= 1
        assert not np.any(wrong & (expected != 0.0))


def test_a_grazing_beam_does_not_erase_the_wall_of_its_own_scan() -> None:
    # The second beam passes the cell where the first one ends, and passes cell (0, 0) again.
    grid = occupancy_grid([beams((0.5, 0.5, 2.5, 0.5), (0.5, 0.5, 4.5, 0.5))], 1.0)
    assert grid.log_odds[0, 0] == np.float32(MISS)
    assert grid.log_odds[0, 2] == np.float32(HIT)
    # In two scans it is told both ways.
    grid = occupancy_grid([beams((0.5, 0.5, 2.5, 0.5)), beams((0.5, 0.5, 4.5, 0.5))], 1.0)
    np.testing.assert_allclose(grid.log_odds[0, 2], HIT + MISS, rtol=1e-6)
    np.testing.assert_allclose(grid.log_odds[0, 0], 2.0 * MISS, rtol=1e-6)


def test_room_as_map_server_sees_it(tmp_path: Path) -> None:
    placed = place_scans(room_scans(), trajectory(), MOUNT)
    write_grid(occupancy_grid([placed]), tmp_path / "map.pgm", tmp_path / "map.yaml")
    data, resolution, origin = served(tmp_path / "map.yaml")
    assert resolution == 0.05
    centres_x = origin[0] + resolution * (np.arange(data.shape[1]) + 0.5)
    centres_y = origin[1] + resolution * (np.arange(data.shape[0]) + 0.5)
    x, y = np.meshgrid(centres_x, centres_y)
    reach = np.maximum(np.abs(x), np.abs(y))
    assert np.all(data[reach < HALF - 0.05] == 0)
    assert np.all(data[reach > HALF + 0.05] == -1)
    # The walls are closed: each column has an occupied cell at the top and at the bottom.
    inside = np.abs(centres_x) < HALF - 0.1
    for edge in (HALF, -HALF):
        near = np.abs(centres_y - edge) < 0.05
        assert np.all((data[near][:, inside] == 100).any(axis=0))


def test_rows_are_top_down(tmp_path: Path) -> None:
    # One beam up: free below, occupied above; in the file the occupied row comes first.
    grid = occupancy_grid([beams((0.5, 0.5, 0.5, 2.5))], 1.0)
    write_grid(grid, tmp_path / "up.pgm", tmp_path / "up.yaml")
    content = (tmp_path / "up.pgm").read_bytes()
    head, pixels = content[:-3], content[-3:]
    assert head == b"P5\n# CREATOR: fgloc 1.000 m/pix\n1 3\n255\n"
    assert pixels == bytes([0, 254, 254])


def test_cells_that_cancel_are_unknown() -> None:
    grid = OccupancyGrid(np.array([[0.0, 0.1, -0.1]], np.float32), 1.0, (0.0, 0.0))
    assert grid.pixels().tolist() == [[205, 0, 254]]


def test_refusals() -> None:
    far = beams((0.0, 0.0, 50_000.0, 40_000.0))
    with pytest.raises(FglocError, match=r"50001 m × 40001 m .* ask for cells of 5\.\d m"):
        occupancy_grid([far])
    # What the message proposes does.
    assert occupancy_grid([far], 5.8).log_odds.size <= 64_000_000
    with pytest.raises(FglocError, match="no beam of any scan returned"):
        occupancy_grid([])
    with pytest.raises(FglocError, match="must be positive"):
        occupancy_grid([beams((0.0, 0.0, 1.0, 1.0))], float("nan"))


def test_standing_robot_and_huge_coordinates() -> None:
    # A map far from its origin, as with coordinates of a survey.
    here = np.array([4.5e5, 5.4e6, 0.0])
    scans = room_scans(1, period=0.0)
    placed = place_scans(scans, Trajectory(np.zeros(1, np.int64), here[None]), (0.0, 0.0, 0.0))
    grid = occupancy_grid([placed])
    assert grid.log_odds.size < 200 * 200
    assert np.count_nonzero(grid.log_odds > 0.0) > 200
