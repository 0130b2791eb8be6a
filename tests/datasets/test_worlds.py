"""Worlds: what a file may say, and what becomes of it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fgloc.datasets.registry import world_of
from fgloc.datasets.simulator.motions import Limits
from fgloc.datasets.simulator.tour import plan
from fgloc.datasets.simulator.worlds import NAMES, SAGITTA_M, World, load_world
from fgloc.errors import FglocError

COURSE = "[course]\nwaypoints = [[0, 0], [4, 0], [4, 4], [0, 4]]\n"
LIMITS = Limits(0.5, 0.8, 0.8, 1.5)


def made(folder: Path, text: str, course: str = COURSE) -> World:
    """Return the world of a file with this text and a course."""
    file = folder / "a.toml"
    file.write_text(text + course)
    return load_world(file)


def test_walls_by_hand(tmp_path: Path) -> None:
    world = made(
        tmp_path,
        "[[walls]]\npoints = [[0, 0], [2, 0], [2, 1]]\n"
        "[[walls]]\npoints = [[5, 5], [6, 5], [6, 6]]\nclosed = true\n",
    )
    assert world.walls.tolist() == [
        [0, 0, 2, 0],
        [2, 0, 2, 1],
        [5, 5, 6, 5],
        [6, 5, 6, 6],
        [6, 6, 5, 5],
    ]
    assert not world.curved.any()
    assert (world.closed, world.speed, world.laps) == (True, 0.5, ("along",))


def test_a_thick_wall_has_two_sides_and_ends(tmp_path: Path) -> None:
    world = made(tmp_path, "[[walls]]\npoints = [[1, 2], [4, 2]]\nthickness = 0.2\n")
    corners = {tuple(np.round(p, 12)) for p in world.walls.reshape(-1, 2)}
    assert corners == {(1, 2.1), (4, 2.1), (4, 1.9), (1, 1.9)}
    lengths = np.hypot(*(world.walls[:, 2:] - world.walls[:, :2]).T)
    np.testing.assert_allclose(np.sort(lengths), [0.2, 0.2, 3, 3])


def test_a_curved_wall_is_cut_finely_enough(tmp_path: Path) -> None:
    world = made(tmp_path, "[[arcs]]\ncentre = [1, 2]\nradius = 6\nstart_deg = 90\nend_deg = 270\n")
    assert world.curved.all()
    away = world.walls - [1, 2, 1, 2]
    np.testing.assert_allclose(np.hypot(away[:, 0], away[:, 1]), 6)
    middle = 0.5 * (away[:, :2] + away[:, 2:])
    off = 6 - np.hypot(middle[:, 0], middle[:, 1])
    # No coarser than it may be, and not three times as fine.
    assert SAGITTA_M / 3 < off.max() <= SAGITTA_M
    np.testing.assert_allclose(world.walls[0, :2], [1, 8], atol=1e-12)
    np.testing.assert_allclose(world.walls[-1, 2:], [1, -4], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "course", "what"),
    [
        ("[[wall]]\npoints = [[0, 0]]\n", COURSE, r"a\.toml:1: unknown key 'wall'"),
        ("[[walls]]\npoints = [[0, 0]]\n", COURSE, r"a\.toml:1: walls, table 1: at least two"),
        ("[[walls]]\npoints = [[0, 0], [0, 0]]\n", COURSE, "two points in a row"),
        ("[[walls]]\npoints = [[0, 0], [nan, 0]]\n", COURSE, "finite"),
        ("[[walls]]\npoints = [[0, 0, 1], [1, 0]]\n", COURSE, r"a\.toml:2: walls\.points"),
        ("[[walls]]\npoints = [[0, 0], [1, 0]]\nthickness = -1\n", COURSE, "thickness"),
        ("[[walls]]\npoints = [[0, 0], [1, 0]]\nheight = 1\n", COURSE, "unknown key 'height'"),
        ("walls = 3\n", COURSE, r"a\.toml:1: walls must be written as \[\[walls\]\]"),
        ("[[arcs]]\ncentre = [0, 0]\nradius = 0\nstart_deg = 0\nend_deg = 9\n", COURSE, "positive"),
        ("[[arcs]]\ncentre = [0, 0]\nradius = 1\nstart_deg = 0\nend_deg = 400\n", COURSE, "360"),
        ("[[arcs]]\ncentre = [0, 0]\nradius = 1e15\nstart_deg = 0\nend_deg = 9\n", COURSE, "large"),
        ("", "", r"no \[course\]"),
        ("", "[course]\nwaypoints = [[0, 0]]\n", "at least two waypoints"),
        ("", "[course]\nwaypoints = [[0, 0], [1, 0], [1, 0]]\n", "another than the one before"),
        ("", "[course]\nwaypoints = [[0, 0], [inf, 0]]\n", "within 10000 m"),
        ("", "[course]\nwaypoints = [[0, 0], [99, 0]]\nspeed = 0.005\n", "more than 36000 s"),
        ("", COURSE + "speed = 0\n", r"a\.toml:3: course\.speed must be"),
        ("", COURSE + "laps = ['back']\n", "along and sideways"),
        ("", COURSE + "laps = [", r"a\.toml.*is not TOML"),
    ],
)
def test_errors_name_the_file(tmp_path: Path, text: str, course: str, what: str) -> None:
    with pytest.raises(FglocError, match=what) as error:
        made(tmp_path, text, course)
    assert "a.toml" in str(error.value)


def test_worlds_are_found_by_name_path_and_drive(tmp_path: Path) -> None:
    for name in NAMES:
        assert load_world(name).walls.shape[0] > 4
        world = world_of(f"sim:{name}?seed=3")
        assert world is not None
        assert world.name == name
    made(tmp_path, "")
    other = world_of(f"sim:hall?world={tmp_path / 'a.toml'}")
    assert other is not None
    assert other.walls.shape == (0, 4)
    assert world_of("sim:demo") is None
    assert world_of("csail:0") is None
    with pytest.raises(FglocError, match="no world 'attic'; use one of seed-b-room"):
        load_world("attic")


def test_the_packaged_worlds_are_those_in_the_folder() -> None:
    folder = Path(__file__).parents[2] / "datasets" / "worlds"
    assert sorted(p.stem for p in folder.glob("*.toml")) == sorted(NAMES)


def test_the_world_in_the_documentation_can_be_toured(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "worlds.md").read_text()
    (tmp_path / "a.toml").write_text(text.partition("```toml\n")[2].partition("```")[0])
    world = load_world(tmp_path / "a.toml")
    assert (world.laps, int(world.curved.sum())) == (("along", "sideways"), 28)
    assert plan(world, LIMITS, None).profile.duration_s > 20
    for name in NAMES:
        assert f"| `{name}` |" in text


def test_a_tour_cuts_its_corners_and_closes(tmp_path: Path) -> None:
    tour = plan(made(tmp_path, ""), LIMITS, None)
    steps, start = tour.displacements(0.005, math.ceil(tour.profile.duration_s / 0.005))
    from fgloc.core.geometry import EXACT, integrate

    poses = integrate(steps, start, EXACT)
    # From (0, 0) to (0, 0), three corners taken smoothly, the last leg to its end.
    np.testing.assert_allclose(poses[-1, :2], [0, 0], atol=1e-6)
    assert poses[-1, 2] == pytest.approx(1.5 * math.pi)
    # Halfway along the legs it is on them.
    for x, y in ((2, 0), (4, 2), (2, 4), (0, 2)):
        assert np.hypot(poses[:, 0] - x, poses[:, 1] - y).min() < 2e-3
    # A quarter turn at 0.3 m/s and 0.8 rad/s has a radius of 0.375 m and ramps beside it.
    corner = np.hypot(poses[:, 0] - 4, poses[:, 1]).min()
    assert 0.375 * (math.sqrt(2) - 1) < corner < 0.3
    twist = steps / 0.005
    assert twist[:, 0].max() == pytest.approx(0.5, abs=1e-9)
    assert np.abs(twist[:, 2]).max() == pytest.approx(0.8, abs=1e-9)
    assert np.abs(np.diff(twist[:, 0])).max() < 1.01 * 0.8 * 0.005


def test_sharp_corners_are_turned_on_the_spot(tmp_path: Path) -> None:
    course = "[course]\nwaypoints = [[0, 0], [3, 0], [1, 0]]\nclosed = false\n"
    world = made(tmp_path, "", course)
    tour = plan(world, LIMITS, None)
    steps, _ = tour.displacements(0.005, math.ceil(tour.profile.duration_s / 0.005))
    turning = np.abs(steps[:, 2]) > 0
    assert np.abs(steps[turning, :2]).max() < 1e-12
    assert abs(steps[:, 2].sum()) == pytest.approx(math.pi)
    with pytest.raises(FglocError, match=r"cannot turn on the spot.*\(3, 0\)"):
        plan(world, Limits(0.5, 0.8, 0.8, 1.5, spins=False), None)


def test_waypoints_must_leave_room_for_the_turns(tmp_path: Path) -> None:
    world = made(tmp_path, "", "[course]\nwaypoints = [[0, 0], [4, 0], [4, 0.5], [0, 0.5]]\n")
    with pytest.raises(FglocError, match=r"from \(4, 0\) to \(4, 0\.5\) there is no room"):
        plan(world, LIMITS, None)


def test_a_given_duration_takes_as_many_laps_as_it_needs(tmp_path: Path) -> None:
    world = made(tmp_path, "", COURSE + 'laps = ["along", "sideways"]\n')
    one = plan(world, LIMITS, None)
    assert len(one.laps) == 2
    longer = plan(world, LIMITS, 150.0)
    assert len(longer.laps) == 5
    assert longer.profile.duration_s >= 150.0
    # This base cannot drive sideways; one that can does not turn in its second lap.
    assert not any(sideways for _, sideways in one.laps)
    able = plan(world, Limits(0.5, 0.8, 0.8, 1.5, holonomic=True), None)
    assert [sideways for _, sideways in able.laps] == [False, True]
    steps, _ = able.displacements(0.005, math.ceil(able.profile.duration_s / 0.005))
    second = math.ceil(able.laps[1][0] / 0.005) + 1
    assert np.abs(steps[second:, 2]).max() < 1e-12
    assert np.abs(steps[second:, 1]).max() > 0.5 * 0.005 * 0.99
    assert np.abs(steps[: second - 2, 1]).max() < 1e-5
