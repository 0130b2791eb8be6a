"""`fgloc simulate`: make a drive with known truth and write it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fgloc.atomic import write_text
from fgloc.errors import FglocError

if TYPE_CHECKING:
    from fgloc.core.drive import Drive

SUFFIXES = {"npz": ".npz", "csv": ".csv", "jaguar": ".log"}
"""Suffix of the drive's file by format."""
TRUTH = "truth.tum"
"""Suffix (or name, in a run folder) of the truth beside a drive."""


def run(args: argparse.Namespace) -> int:
    """Simulate `args.name`, write it in `args.format` and say where; return 0.

    `args.out` is a folder that gets a run folder (drive, truth and description) or, if it ends
    like a file of the format, that file. Without it the file is written to the working folder,
    named like the drive. A Jaguar log cannot hold the truth: that is written beside it as TUM.
    `args.json` gets the description. Raises FglocError for an unknown drive, key or value, or a
    place that cannot be written.
    """
    from fgloc.datasets.simulator import load_sim
    from fgloc.report.rundir import RunDir

    text = args.name.removeprefix("sim:")
    if args.format == "jaguar":
        text = _with_imu(text)
    suffix = SUFFIXES[args.format]
    if args.out is not None and args.out.suffix and args.out.suffix != suffix:
        raise FglocError(f"a drive as {args.format} ends in {suffix}; rename it", file=args.out)
    drive = load_sim(text)
    if args.out is not None and not args.out.suffix:
        with RunDir.create(args.out) as folder:
            name = "drive" + suffix
            _write(drive, text, folder.file(name), args.format)
            _write_truth(drive, folder.file(TRUTH))
            about = json.dumps(_about(drive, args.format, Path(name)), indent=2)
            write_text(folder.file("drive.json"), about + "\n")
        place = folder.path / name
    else:
        place = args.out or Path(text.partition("?")[0] + suffix)
        _write(drive, text, place, args.format)
        if args.format == "jaguar":
            _write_truth(drive, place.with_suffix("." + TRUTH))
    report = _about(drive, args.format, place)
    if args.json is not None:
        write_text(args.json, json.dumps(report, indent=2) + "\n")
    _print(report)
    return 0


def _with_imu(text: str) -> str:
    """Return the spec with gyro and accelerometer, which every Jaguar log has, switched on."""
    name, _, query = text.partition("?")
    items = query.split("&") if query else []
    given = {item.partition("=")[0] for item in items}
    items += [f"{sensor}=on" for sensor in ("gyro", "acc") if sensor not in given]
    return f"{name}?{'&'.join(items)}"


def _write(drive: Drive, text: str, path: Path, kind: str) -> None:
    """Write the drive to `path`, complete or not at all."""
    if kind == "npz":
        from fgloc.datasets.own_format import write_npz

        write_npz(drive, path)
    elif kind == "csv":
        from fgloc.datasets.own_csv import write_csv

        write_csv(drive, path)
    else:
        from fgloc.datasets.simulator.drives import NAMED
        from fgloc.datasets.simulator.jaguar_log import LogSettings, write_log
        from fgloc.datasets.simulator.spec import parse
        from fgloc.datasets.simulator.streams import generator

        write_log(drive, path, LogSettings(), generator(parse(text, NAMED).seed, "log"))


def _write_truth(drive: Drive, path: Path) -> None:
    """Write the truth's trajectory as TUM."""
    from fgloc.core.trajectory_io import save_trajectory

    if drive.truth is not None:
        save_trajectory(drive.truth.trajectory, path)


def _about(drive: Drive, kind: str, path: Path) -> dict[str, Any]:
    """Return what a user wants to know of the drive, ready for JSON."""
    streams = {drive.wheels.sensor: int(drive.wheels.angles.shape[0])}
    streams |= {s.sensor: int(s.stamps_ns.size) for s in drive.sensors}
    return {
        "drive": drive.name,
        "file": str(path),
        "format": kind,
        "robot": drive.robot.name,
        "duration_s": drive.duration_s,
        "sensors": streams,
        "nominal_calibration": {p.name: p.nominal for p in drive.robot.base.parameters},
        "true_calibration": dict(drive.true_calibration or {}),
        "notes": list(drive.notes),
    }


def _print(about: dict[str, Any]) -> None:
    """Print the description for a person."""
    print(f"{about['drive']}: {about['robot']}, {about['duration_s']:.1f} s")
    counts = ", ".join(f"{name} {count}" for name, count in about["sensors"].items())
    print(f"  measurements  {counts}")
    for name, value in about["true_calibration"].items():
        nominal = about["nominal_calibration"].get(name)
        beside = "" if nominal is None else f"  (nominal {nominal:.4f})"
        print(f"  true {name:<20} {value:.4f}{beside}")
    for note in about["notes"]:
        print(f"  {note}")
    print(f"written to {about['file']}")
