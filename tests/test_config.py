"""The robot file: what it changes, what it keeps, and where it is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fgloc.config import apply_robot, dump_robot, load_robot
from fgloc.core import bases
from fgloc.core.robot import Robot, WheelNoise
from fgloc.errors import FglocError


def jaguar() -> Robot:
    base = bases.skid_steer(("fl", "rl"), ("fr", "rr"), 0.135, 0.48, icr_prior=0.01)
    return Robot('a "quoted" \\ name\nσ', base, WheelNoise(rolling=0.0123))


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "robot.toml"
    path.write_text(text)
    return path


def parameters(robot: Robot) -> dict[str, tuple[float, float]]:
    return {p.name: (p.nominal, p.prior_sigma) for p in robot.base.parameters}


def test_empty_file_changes_nothing(tmp_path: Path) -> None:
    assert apply_robot(jaguar(), written(tmp_path, "")) == jaguar()


def test_value_sigma_name_and_noise(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        """
        [robot]
        name = "new"
        [parameters.effective_track]
        value = 0.96
        [parameters."wheel_radius.left"]
        value = 0.14
        sigma = 0
        [parameters.icr_x]
        sigma = 0.05
        [noise]
        rolling = 0.5
        """,
    )
    before, after = parameters(jaguar()), parameters(apply_robot(jaguar(), path))
    # A log parameter keeps its relative prior: twice the track, twice the sigma.
    assert after["effective_track"] == (0.96, 2.0 * before["effective_track"][1])
    assert after["wheel_radius.left"] == (0.14, 0.0)
    assert after["icr_x"] == (0.0, 0.05)
    assert after["wheel_radius.right"] == before["wheel_radius.right"]
    robot = apply_robot(jaguar(), path)
    assert robot.name == "new"
    assert robot.noise == replace(jaguar().noise, rolling=0.5)
    # With a track of 0.96 m, 0.1 m more on the right turns the robot by 0.1 / 0.96 rad.
    turned = robot.base.displacements(np.array([[0.0, 0.0, 0.1 / 0.135, 0.1 / 0.135]]))
    assert turned[0, 2] == pytest.approx(0.1 / 0.96, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_round_trip_loses_nothing(tmp_path: Path, seed: int) -> None:
    generator = np.random.default_rng(seed)
    values = {n: v * generator.uniform(0.5, 2.0) for n, (v, _) in parameters(jaguar()).items()}
    base = jaguar().base.with_values(values)
    shaken = [replace(p, prior_sigma=generator.exponential(1e-9)) for p in base.parameters]
    noise = WheelNoise(*generator.exponential(1e-3, 4))
    robot = replace(jaguar(), base=replace(base, parameters=tuple(shaken)), noise=noise)
    dump_robot(robot, tmp_path / "robot.toml")
    again = apply_robot(jaguar(), tmp_path / "robot.toml")
    assert parameters(again) == parameters(robot)
    assert (again.name, again.noise) == (robot.name, robot.noise)
    assert np.array_equal(again.base.primitives(), robot.base.primitives())


TRACK = '[parameters."effective_track"]\n'


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("bad = \n", ":1", "is not TOML: Invalid value"),
        ("[robto]\n", ":1", "unknown key 'robto'; known are robot, parameters, noise and sensors"),
        (f"\n{TRACK}# x\nvaleu = 1\n", ":4", "unknown key 'valeu' in parameters.effective_track"),
        (
            f"{TRACK}value = 'a'\n",
            ":2",
            "parameters.effective_track.value: expected float, got str",
        ),
        (f"{TRACK}sigma = 1\nvalue = nan\n", ":3", "effective_track.value must be a finite number"),
        (f"{TRACK}sigma = -0.1\n", ":2", "effective_track.sigma must be finite and not negative"),
        (f"{TRACK}sigma = inf\n", ":2", "effective_track.sigma must be finite and not negative"),
        (f"{TRACK}value = -3\n", ":2", "effective_track.value must be positive, got -3.0"),
        (f"{TRACK}value = 0\n", ":2", "effective_track.value must be positive, got 0.0"),
        ("[parameters.wheel_radius.left]\nvalue = 1\n", ":1", 'parameters."wheel_radius.left"'),
        ("[parameters.nope]\n", ":1", "no parameter 'nope'; it has wheel_radius.left, "),
        ("parameters = 3\n", ":1", "parameters must be a table"),
        ("[parameters]\nicr_x = 3\n", ":2", "parameters.icr_x: expected a table, got int"),
        ("[robot]\nname = 3\n", ":2", "robot.name: expected str, got int"),
        ("[noise]\nrolling = -1\n", ":2", "noise.rolling must be finite and not negative, got -1"),
        ("[noise]\nstanding = 0\n", ":2", "noise.standing must be finite and positive, got 0.0"),
        ("[noise]\nrollng = 1\n", ":2", "unknown key 'rollng' in noise; known are rolling, "),
        ("[noise]\nrolling = '1'\n", ":2", "noise.rolling: expected float, got str"),
    ],
)
def test_error_names_file_line_and_key(tmp_path: Path, text: str, place: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(FglocError) as caught:
        apply_robot(jaguar(), path)
    assert str(caught.value).startswith(f"{path}{place}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value).replace(jaguar().name, "")


def test_missing_folder_and_binary_file(tmp_path: Path) -> None:
    with pytest.raises(FglocError, match=r"none\.toml: no such robot file"):
        load_robot(tmp_path / "none.toml")
    with pytest.raises(FglocError, match="cannot be read"):
        load_robot(tmp_path)
    (tmp_path / "b").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FglocError, match="is not UTF-8"):
        load_robot(tmp_path / "b")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("value = 48", r"robot\.toml:2: .*track\.value is 48, more than 10 m.*write it in m"),
        ("sigma = 50", r"robot\.toml:2: .*track\.sigma is 50"),
    ],
)
def test_a_size_in_another_unit_is_named(tmp_path: Path, line: str, message: str) -> None:
    file = tmp_path / "robot.toml"
    file.write_text(f"[parameters.effective_track]\n{line}\n")
    base = bases.differential(0.1, 0.1, 0.5)
    with pytest.raises(FglocError, match=message):
        apply_robot(Robot("test", base), file)


def test_kind_chooses_the_full_linear_model(tmp_path: Path) -> None:
    text = '[robot]\nkind = "full-linear"\n[parameters."linear_y.left"]\nvalue = 0.002\n'
    robot = apply_robot(jaguar(), written(tmp_path, text))
    assert robot.base.kind == "full-linear"
    assert parameters(robot)["linear_y.left"][0] == 0.002
    assert robot.noise == jaguar().noise
    # 1 rad of all wheels is 0.135 m forward, and now a little to the left.
    moved = robot.base.displacements(np.ones((1, 4)))
    np.testing.assert_allclose(moved, [[0.135, 0.002, 0.0]], atol=1e-15)
    dump_robot(robot, tmp_path / "again.toml")
    assert apply_robot(jaguar(), tmp_path / "again.toml") == robot
    own = written(tmp_path, '[robot]\nkind = "skid-steer"\n')
    assert apply_robot(jaguar(), own) == jaguar()
    with pytest.raises(FglocError, match=r'robot.toml:2: robot.kind must be "skid-steer" or "full'):
        apply_robot(jaguar(), written(tmp_path, '[robot]\nkind = "mecanum"\n'))
    steered = Robot("cart", bases.tricycle(0.1, 0.8))
    with pytest.raises(FglocError, match=r"robot.kind: tricycle: a steered base has no full"):
        apply_robot(steered, written(tmp_path, '[robot]\nkind = "full-linear"\n'))
