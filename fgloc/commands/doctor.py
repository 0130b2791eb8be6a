"""`fgloc doctor`: is everything that is needed installed, and does it work on this machine?"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from fgloc import __version__
from fgloc.atomic import write_text

REQUIRED = {
    "gtsam": "gtsam",
    "numpy": "numpy",
    "scipy": "scipy",
    "open3d": "open3d",
    "matplotlib": "matplotlib",
    "numba": "numba",
    "msgspec": "msgspec",
    "rich": "rich",
    "ruamel.yaml": "ruamel.yaml",
} | ({"libusb-package": "libusb_package"} if sys.platform == "linux" else {})
"""Distribution -> module of every core dependency; a test compares it with pyproject.toml."""
OPTIONAL = {
    "rosbags": "rosbags",
    "rerun-sdk": "rerun",
    "pyserial": "serial",
    "jinja2": "jinja2",
    "dask": "dask",
    "pymoo": "pymoo",
}
"""The same for the extras that add a feature."""
TIMEOUT_S = 120
"""Time after which a check counts as hung."""

IMPORT = {
    "open3d": "from fgloc.lazy import import_open3d; import_open3d()",
    # What the distribution is there for: the library inside it.
    "libusb_package": "import libusb_package; assert libusb_package.get_library_path()",
}
"""How a module is imported where `import NAME` is not enough."""
GTSAM_SOLVE = """
import gtsam, numpy as np
graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), noise))
for k in range(3):
    start.insert(k, gtsam.Pose2(1.3 * k, 0.2, 0.1))
    if k:
        graph.add(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(1.0, 0.0, 0.0), noise))
end = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize().atPose2(2)
error = float(np.hypot(end.x() - 2.0, end.y()))
assert error < 1e-6, f"the chain ends {error} m from where it should"
print(f"three poses solved to {error:.0e} m")
"""
NUMBA_COMPILE = """
from fgloc.experiments.warm_up import compile_kernels
seconds = compile_kernels()
print(f"compiled now, in {seconds:.0f} s" if seconds > 0.5 else "found compiled")
"""


@dataclass(frozen=True)
class Check:
    """The outcome of one check."""

    name: str
    """What was checked."""
    ok: bool
    """Whether it is as it should be."""
    required: bool
    """Whether fgloc needs it; a failed check that is not required is a note."""
    detail: str
    """Version, place, or what is wrong."""


def run(args: argparse.Namespace) -> int:
    """Print the checks, write them with --json; return 0 if all that is needed works, else 1."""
    checks = examine(args.data)
    ok = all(c.ok for c in checks if c.required)
    if args.json is not None:
        report = {"version": __version__, "ok": ok, "checks": [asdict(c) for c in checks]}
        write_text(args.json, json.dumps(report, indent=2) + "\n")
    _print(checks, ok)
    return 0 if ok else 1


def examine(data: Path | None = None) -> list[Check]:
    """Return all checks (a few seconds); `data` is searched for recordings first."""
    # Other processes, since a broken binary library ends the process that loads it.
    probes: list[Callable[[], Check]] = [
        *(lambda d=d, m=m: _dependency(d, m, required=True) for d, m in REQUIRED.items()),
        *(lambda d=d, m=m: _dependency(d, m, required=False) for d, m in OPTIONAL.items()),
        lambda: _probe("gtsam solves", GTSAM_SOLVE),
        lambda: _probe("inner loops", NUMBA_COMPILE),
    ]
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        outcomes = [f.result() for f in [pool.submit(p) for p in probes]]
    return [
        Check("fgloc", True, True, __version__),
        Check("python", sys.version_info >= (3, 11), True, platform.python_version()),
        Check("platform", True, False, platform.platform()),
        *outcomes,
        *_data(data),
    ]


def _dependency(distribution: str, module: str, *, required: bool) -> Check:
    """Return whether a dependency is installed, in which version, and whether it imports."""
    try:
        version = importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        how = "pip install --force-reinstall fgloc" if required else "optional"
        return Check(distribution, False, required, f"not installed ({how})")
    code = IMPORT.get(module, f"import {module}")
    outcome = _probe(distribution, code, required=required)
    return outcome if not outcome.ok else Check(distribution, True, required, version)


def _probe(name: str, code: str, *, required: bool = True) -> Check:
    """Return the outcome of Python code in a process of its own: its last line of output."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=TIMEOUT_S
        )
    except subprocess.TimeoutExpired:
        return Check(name, False, required, f"no answer within {TIMEOUT_S} s")
    if done.returncode < 0:
        number = -done.returncode
        known = {s.value: s.name for s in signal.Signals}
        return Check(name, False, required, f"crashes with {known.get(number, number)}")
    said = (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()
    return Check(name, done.returncode == 0, required, said[-1] if said else "")


def _data(data: Path | None) -> list[Check]:
    """Return where recordings are looked for and which are there; none is needed."""
    try:
        from fgloc.datasets import registry
    except Exception as error:
        return [Check("datasets", False, True, f"{type(error).__name__}: {error}")]
    checks = []
    places = {"--data": data, "FGLOC_DATA": os.environ.get("FGLOC_DATA") or None}
    for name, place in places.items():
        if place is not None:
            is_there = Path(place).is_dir()
            detail = str(place) if is_there else f"{place}: no such folder"
            checks.append(Check(name, is_there, False, detail))
        elif name == "FGLOC_DATA":
            checks.append(Check(name, True, False, "not set; recordings come from the cache only"))
    cache = registry.cache_folder()
    nearest = next(p for p in (cache, *cache.parents) if p.exists())
    is_writable = nearest.is_dir() and os.access(nearest, os.W_OK)
    detail = str(cache) if is_writable else f"{cache}: cannot be written, use fetch --to DIR"
    checks.append(Check("cache", is_writable, False, detail))
    for name in registry.DATASETS:
        try:
            count = len(registry.list_drives(name, data))
        except Exception:
            checks.append(Check(name, False, False, f"not here; fgloc datasets fetch {name}"))
        else:
            checks.append(Check(name, True, False, f"{count} runs"))
    return checks


def _print(checks: list[Check], ok: bool) -> None:
    """Print the table and the verdict."""
    try:
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text
    except ImportError:
        # The command that says what is missing must work without it.
        for c in checks:
            print(f"{_mark(c):8} {c.name:16} {c.detail}")
    else:
        console = Console()
        table = Table("check", "", "detail", box=None, pad_edge=False)
        colours = {"ok": "green", "FAILED": "bold red", "-": "yellow"}
        for c in checks:
            mark = _mark(c)
            # Text, not str: a path with brackets is not markup.
            table.add_row(Text(c.name), Text(mark, colours[mark]), Text(c.detail))
        console.print(table)
    failed = [c.name for c in checks if c.required and not c.ok]
    print("Everything needed works." if ok else f"Does not work: {', '.join(failed)}.")


def _mark(check: Check) -> str:
    """Return ok, FAILED, or a dash for what is absent but not needed."""
    if check.ok:
        return "ok"
    return "FAILED" if check.required else "-"
