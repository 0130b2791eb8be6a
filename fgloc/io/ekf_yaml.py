"""Reads the `ekf.yaml` of robot_localization, as far as it makes sense in the plane.

Both styles are understood: flat keys (ROS 1), also below the name of a node, and
`ekf_filter_node: ros__parameters:` (ROS 2). Every key that is not honoured is named in a note of
the configuration, with what that means here; docs/ekf.md has the table.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from fgloc.errors import FglocError
from fgloc.io.ekf_config import (
    DEFAULT_PROCESS_NOISE,
    FLAGS,
    FREQUENCY_HZ,
    INITIAL_VARIANCE,
    KINDS,
    PLANAR,
    PLANAR_INDEX,
    EkfConfig,
    EkfInput,
    Matrix,
    covariance_problem,
    diagonal,
)
from fgloc.io.yaml_lines import Node, read_yaml

T = TypeVar("T")
INPUT = re.compile(rf"({'|'.join(KINDS)})(\d+)(?:_(\w+))?")
"""Keys of inputs: odom0, odom0_config, imu1_pose_rejection_threshold, …"""
WITHOUT_EFFECT = frozenset(
    {
        "acceleration_gains",
        "acceleration_limits",
        "base_link_frame",
        "base_link_frame_output",
        "control_config",
        "control_timeout",
        "debug",
        "debug_out_file",
        "deceleration_gains",
        "deceleration_limits",
        "history_length",
        "map_frame",
        "odom_frame",
        "permit_corrected_publication",
        "print_diagnostics",
        "publish_acceleration",
        "publish_tf",
        "reset_on_time_jump",
        "silent_tf_failure",
        "smooth_lagged_data",
        "stamped_control",
        "tf_prefix",
        "throttle_prediction",
        "transform_time_offset",
        "transform_timeout",
        "use_sim_time",
        "world_frame",
    }
)
"""Keys of robot_localization that change nothing where recorded data are filtered in order and in
one frame."""
INPUT_WITHOUT_EFFECT = (
    "queue_size",
    "nodelay",
    "pose_use_child_frame",
    "remove_gravitational_acceleration",
)
"""The same for endings of keys of inputs."""
THRESHOLDS: Mapping[str, Mapping[str, str]] = {
    "odom": {
        "pose_rejection_threshold": "pose_threshold",
        "twist_rejection_threshold": "twist_threshold",
    },
    "pose": {"rejection_threshold": "pose_threshold"},
    "twist": {"rejection_threshold": "twist_threshold"},
    "imu": {
        "pose_rejection_threshold": "pose_threshold",
        "twist_rejection_threshold": "twist_threshold",
        "linear_acceleration_rejection_threshold": "acceleration_threshold",
    },
}
"""Endings of threshold keys by kind of input, and the field each becomes."""
MEASURES = {
    "odom": ("x", "y", "yaw", "vx", "vy", "vyaw"),
    "pose": ("x", "y", "yaw"),
    "twist": ("vx", "vy", "vyaw"),
    "imu": ("yaw", "vyaw", "ax", "ay"),
}
"""What a message of each kind holds of the planar states."""


def load_ekf(path: str | Path) -> EkfConfig:
    """Return the configuration in an `ekf.yaml`; `FILE:NODE` picks one of several filters in it.

    Raises FglocError naming file and line: what cannot be read, a key of the wrong type, a vector
    or matrix of the wrong length, a threshold or rate that is not positive, no inputs at all.
    """
    file, node = _split(path)
    return _Reader(file, _parameters(file, read_yaml(file), node)).config()


def _split(path: str | Path) -> tuple[Path, str | None]:
    """Return file and node of FILE or FILE:NODE."""
    whole = Path(path)
    name, colon, node = str(path).rpartition(":")
    if colon and not whole.exists() and Path(name).exists():
        return Path(name), node
    return whole, None


def _parameters(file: Path, root: Node, wanted: str | None) -> Mapping[str, Node]:
    """Return the parameters of the filter in a file, whichever style it is written in."""
    if not isinstance(root.value, dict):
        raise FglocError("is not a mapping of keys to values; is it an ekf.yaml?", file=file)
    found: dict[str, dict[str, Node]] = {}

    def look(value: dict[str, Node], name: str, depth: int) -> None:
        if any(INPUT.fullmatch(key) for key in value):
            found[name] = value
        elif depth < 4:
            for key, child in value.items():
                if isinstance(child.value, dict):
                    inner = name if key == "ros__parameters" else key.strip("/")
                    look(child.value, inner, depth + 1)

    look(root.value, "", 0)
    names = ", ".join(sorted(found))
    if wanted is not None:
        if wanted.strip("/") not in found:
            raise FglocError(f"holds no filter {wanted!r}; it has {names or 'none'}", file=file)
        return found[wanted.strip("/")]
    if not found:
        raise FglocError(
            "names no input (odom0, pose0, twist0, imu0, …); is it an ekf.yaml?", file=file
        )
    if len(found) > 1:
        raise FglocError(f"holds several filters, {names}; write FILE:NAME", file=file)
    return next(iter(found.values()))


class _Reader:
    """Takes keys out of a file's parameters, and notes those that nobody took."""

    def __init__(self, file: Path, parameters: Mapping[str, Node]) -> None:
        self._file = file
        self._all = parameters
        self._left = dict(parameters)
        self._notes: list[str] = []

    def config(self) -> EkfConfig:
        """Return everything that is honoured."""
        inputs = self._inputs()
        frequency = self._positive("frequency", FREQUENCY_HZ)
        timeout = self._positive("sensor_timeout", 1.0 / frequency)
        if not self._take("two_d_mode", bool, False):
            self._notes.append(
                "two_d_mode is not true: this filter is planar all the same, z, roll and pitch "
                "are taken to be 0"
            )
        process = self._covariance("process_noise_covariance", DEFAULT_PROCESS_NOISE)
        first = self._covariance(
            "initial_estimate_covariance", diagonal((INITIAL_VARIANCE,) * len(PLANAR))
        )
        dynamic = self._take("dynamic_process_noise_covariance", bool, False)
        predict = self._take("predict_to_current_time", bool, False)
        self._unused()
        return EkfConfig(
            inputs,
            process,
            first,
            frequency,
            timeout,
            dynamic,
            predict,
            tuple(self._notes),
        )

    def _error(self, message: str, key: str) -> FglocError:
        """Return an error about a key."""
        return FglocError(f"{key} {message}", file=self._file, line=self._all[key].line)

    def _take(self, key: str, kind: type[T], default: T) -> T:
        """Return the value of a key as a type; `default` where the file does not have it."""
        node = self._left.pop(key, None)
        if node is None:
            return default
        try:
            return msgspec.convert(node.plain(), kind)
        except msgspec.ValidationError as error:
            text = str(error).partition(" - at ")[0].replace("`", "")
            raise self._error(f"{text[0].lower()}{text[1:]}", key) from error

    def _positive(self, key: str, default: float) -> float:
        """Return a positive, finite number."""
        value = self._take(key, float, default)
        if not 0.0 < value < math.inf:
            raise self._error(f"must be positive and finite, got {value!r}", key)
        return value

    def _inputs(self) -> tuple[EkfInput, ...]:
        """Return all inputs, by kind and number."""
        found = {
            (KINDS.index(match[1]), int(match[2])): match[1] + match[2]
            for key in self._all
            if (match := INPUT.fullmatch(key)) and match[3] is None
        }
        return tuple(self._input(name) for _, name in sorted(found.items()))

    def _input(self, name: str) -> EkfInput:
        """Return one input."""
        kind = name.rstrip("0123456789")
        topic = self._take(name, str, "")
        key = f"{name}_config"
        vector: list[bool] = self._take(key, list[bool], [])
        if key not in self._all:
            self._notes.append(f"{name} has no {key}: nothing of it is used")
        elif len(vector) != len(FLAGS):
            raise self._error(
                f"has {len(vector)} flags, needs {len(FLAGS)}: {', '.join(FLAGS)}", key
            )
        asked = {flag for flag, on in zip(FLAGS, vector, strict=False) if on}
        for reason, flags in (
            ("not planar", [f for f in FLAGS if f in asked and f not in PLANAR]),
            (
                f"{'an' if kind in ('imu', 'odom') else 'a'} {kind} input has none",
                [f for f in PLANAR if f in asked and f not in MEASURES[kind]],
            ),
        ):
            if flags:
                self._notes.append(f"{key}: {', '.join(flags)} not used: {reason}")
        differential = self._take(f"{name}_differential", bool, False)
        relative = self._take(f"{name}_relative", bool, False)
        if kind == "twist" and (differential or relative):
            self._notes.append(f"{name}: differential and relative have no meaning for a twist")
        if differential and relative:
            self._notes.append(f"{name} is differential and relative: differential is used")
        limits = {
            field: self._threshold(f"{name}_{ending}") for ending, field in THRESHOLDS[kind].items()
        }
        return EkfInput(
            name,
            topic,
            tuple(flag for flag in PLANAR if flag in asked and flag in MEASURES[kind]),
            differential,
            relative and not differential,
            **limits,
        )

    def _threshold(self, key: str) -> float:
        """Return a rejection threshold, infinite where there is none."""
        value = self._take(key, float, math.inf)
        if not value > 0.0:
            raise self._error(f"must be positive, got {value!r}; leave it out for none", key)
        return value

    def _covariance(self, key: str, default: Matrix) -> Matrix:
        """Return the planar part of a 15 by 15 matrix, given by rows or as its diagonal."""
        numbers: list[Any] = self._take(key, list[float | list[float]], [])
        if key not in self._all:
            return default
        rows = [n for n in numbers if isinstance(n, list)]
        if rows and len(rows) == len(numbers):
            numbers = [value for row in rows for value in row]
        n = len(FLAGS)
        if any(isinstance(value, list) for value in numbers) or len(numbers) not in (n, n * n):
            raise self._error(f"has {len(numbers)} numbers, needs {n * n} or {n}", key)
        full = np.array(numbers, dtype=np.float64)
        full = np.diag(full) if full.size == n else full.reshape(n, n)
        planar = full[np.ix_(PLANAR_INDEX, PLANAR_INDEX)]
        problem = covariance_problem(planar)
        if problem is not None:
            raise self._error(problem, key)
        return tuple(tuple(row) for row in planar.tolist())

    def _unused(self) -> None:
        """Note every key that nobody took."""
        if self._left.pop("use_control", Node(False, 0)).value is True:
            self._notes.append("use_control is not honoured: drives hold no commands")
        if "initial_state" in self._left:
            del self._left["initial_state"]
            self._notes.append("initial_state is not honoured: all methods start at the same pose")
        quiet: list[str] = []
        unknown: list[str] = []
        for key in self._left:
            match = INPUT.fullmatch(key)
            ending = match[3] if match else None
            known = key in WITHOUT_EFFECT or ending in INPUT_WITHOUT_EFFECT
            (quiet if known else unknown).append(key)
        if quiet:
            self._notes.append(f"without effect on recorded drives: {', '.join(sorted(quiet))}")
        if unknown:
            plural = "s are" if len(unknown) > 1 else " is"
            lines = ", ".join(f"{key} (line {self._left[key].line})" for key in unknown)
            self._notes.append(f"key{plural} not known and not honoured: {lines}")
