"""`fgloc datasets`: what recordings there are, what a drive holds, fetching and converting."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fgloc.atomic import write_text
from fgloc.errors import FglocError

if TYPE_CHECKING:
    from fgloc.core.drive import Drive
    from fgloc.datasets.fetch import Manifest


def run(args: argparse.Namespace) -> int:
    """Run `args.datasets_command` (list, info, fetch or convert) and return 0.

    Raises FglocError for an unknown dataset or drive, a recording that cannot be read, or a place
    that cannot be written.
    """
    handler = {"list": _list, "info": _info, "fetch": _fetch, "convert": _convert}
    handler[args.datasets_command](args)
    return 0


def catalogue(data: Path | None) -> list[dict[str, Any]]:
    """Return one entry a dataset: name, robot, runs and folder here, licence, origin, example."""
    from fgloc.datasets.registry import DATASETS, find_folder

    if data is not None and not data.is_dir():
        raise FglocError("no such data folder; check the path given to --data", file=data)
    entries = []
    for kind in DATASETS.values():
        try:
            folder = find_folder(kind.name, data)
        except FglocError:
            folder = None
        runs = kind.runs(folder) if folder is not None else []
        entries.append(
            {
                "dataset": kind.name,
                "robot": kind.robot,
                "runs": runs,
                "folder": str(folder) if folder is not None else None,
                "licence": kind.licence,
                "origin": kind.origin,
                "example": f"{kind.name}:{kind.example}",
            }
        )
    return entries


def describe(drive: Drive) -> dict[str, Any]:
    """Return what a drive holds, ready for JSON; path and turn are those of the nominal wheels."""
    import numpy as np

    wheels = drive.wheels
    moved = drive.robot.base.displacements(wheels.angles, wheels.steering)
    streams: list[dict[str, Any]] = [
        {"name": wheels.sensor, "kind": type(wheels).__name__, **_timing(wheels.stamps_ns)}
    ]
    streams += [
        {"name": s.sensor, "kind": type(s).__name__, **_timing(s.stamps_ns)} for s in drive.sensors
    ]
    truth = None
    if drive.truth is not None:
        stamps = drive.truth.trajectory.stamps_ns
        truth = {
            "name": drive.truth.sensor,
            "sigma": list(drive.truth.sigma),
            "mount": list(drive.truth.mount),
            "mount_sigma": list(drive.truth.mount_sigma),
            **_timing(stamps),
        }
    return {
        "drive": drive.name,
        "robot": {"name": drive.robot.name, "base": drive.robot.base.kind},
        "motion": drive.motion,
        "duration_s": drive.duration_s,
        "path_m": float(np.hypot(moved[:, 0], moved[:, 1]).sum()),
        "turned_rad": float(np.abs(moved[:, 2]).sum()),
        "wheels": list(wheels.wheels),
        "sensors": streams,
        "truth": truth,
        "parameters": {
            p.name: {"nominal": p.nominal, "prior_sigma": p.prior_sigma, "unit": p.unit}
            for p in drive.robot.base.parameters
        },
        "rejected": dict(drive.rejected),
        "notes": list(drive.notes),
    }


def _timing(stamps: Any) -> dict[str, Any]:
    """Return number of samples, mean rate and longest gap of a stream."""
    seconds = float(stamps[-1] - stamps[0]) * 1e-9 if stamps.size > 1 else 0.0
    gap = float((stamps[1:] - stamps[:-1]).max()) * 1e-9 if stamps.size > 1 else 0.0
    rate = (stamps.size - 1) / seconds if seconds > 0.0 else 0.0
    return {"samples": int(stamps.size), "rate_hz": rate, "longest_gap_s": gap}


def _list(args: argparse.Namespace) -> None:
    """Print the catalogue."""
    from fgloc.datasets.fetch import manifests
    from fgloc.datasets.registry import search_path

    entries = catalogue(args.data)
    _save_json(args.json, {"datasets": entries})
    table = _table("dataset", "robot", "runs here", "example", "licence")
    fetchable = manifests()
    for e in entries:
        missing = "not here; fetch it" if e["dataset"] in fetchable else "not here"
        runs = str(len(e["runs"])) if e["runs"] else missing
        table.add_row(e["dataset"], e["robot"], runs, e["example"], e["licence"])
    table.add_row("sim", "made on the spot", "any", "sim:demo?seed=1", "yours")
    _print(table)
    for e in entries:
        if e["folder"]:
            print(f"{e['dataset']}: {e['folder']}")
    print(f"looked in: {', '.join(str(p) for p in search_path(args.data))}")


def _info(args: argparse.Namespace) -> None:
    """Print what one drive holds."""
    from fgloc.datasets.registry import load_with_topics
    from fgloc.io.topics import as_dict, topics_toml

    drive, topics = load_with_topics(args.drive, args.data, args.topics)
    about = {**describe(drive), "topics": None if topics is None else as_dict(topics)}
    _save_json(args.json, about)
    print(f"{about['drive']}: {about['robot']['name']} ({about['robot']['base']})")
    motion = f", motion {about['motion']}" if about["motion"] else ""
    print(
        f"  {about['duration_s']:.2f} s, {about['path_m']:.2f} m and {about['turned_rad']:.1f} rad "
        f"by the nominal wheels{motion}"
    )
    table = _table("stream", "kind", "samples", "rate [Hz]", "longest gap [s]")
    truth = [{**about["truth"], "kind": "truth"}] if about["truth"] else []
    for s in about["sensors"] + truth:
        timing = (str(s["samples"]), f"{s['rate_hz']:.1f}", f"{s['longest_gap_s']:.3f}")
        table.add_row(s["name"], s["kind"], *timing)
    _print(table)
    table = _table("parameter", "nominal", "prior σ", "unit")
    for name, p in about["parameters"].items():
        table.add_row(name, f"{p['nominal']:.5g}", f"{p['prior_sigma']:.2g}", p["unit"])
    _print(table)
    if not about["truth"]:
        print("no truth was recorded")
    for reason, number in about["rejected"].items():
        print(f"rejected: {number} × {reason}")
    for note in about["notes"]:
        print(f"note: {note}")
    if topics is not None:
        print("\nThe topic map, to be changed and given as --topics FILE:\n")
        print(topics_toml(topics), end="")


def _fetch(args: argparse.Namespace) -> None:
    """Download a dataset."""
    from fgloc.datasets.fetch import manifest
    from fgloc.datasets.registry import cache_folder, dataset

    dataset(args.name)  # an unknown name gets the better message
    pinned = manifest(args.name)
    to = args.to if args.to is not None else cache_folder()
    print(
        f"{pinned.dataset}: {len(pinned.files)} files, {pinned.size / 1e6:.1f} MB from "
        f"{pinned.source} (licence: {pinned.licence})"
    )
    try:
        folder = _with_progress(pinned, to) if sys.stderr.isatty() else _plain(pinned, to)
    except KeyboardInterrupt:
        print(f"stopped; fgloc datasets fetch {args.name} goes on from here", file=sys.stderr)
        raise
    print(f"all files are there and their SHA-256 is right: {folder}")


def _with_progress(pinned: Manifest, to: Path) -> Path:
    """Download with a progress bar."""
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

    from fgloc.datasets.fetch import fetch

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn())
    with Progress(*columns, TransferSpeedColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(pinned.dataset, total=pinned.size)
        return fetch(
            pinned,
            to,
            progress=lambda path, done, _: bar.update(task, completed=done, description=path),
        )


def _plain(pinned: Manifest, to: Path) -> Path:
    """Download with a line a tenth of the way."""
    from fgloc.datasets.fetch import fetch

    shown = 0

    def report(path: str, done: int, total: int) -> None:
        nonlocal shown
        if done * 10 // max(total, 1) > shown:
            shown = done * 10 // total
            print(f"{shown * 10:3d} % {path}", file=sys.stderr)

    return fetch(pinned, to, progress=report)


def _convert(args: argparse.Namespace) -> None:
    """Write a drive as npz or CSV."""
    from fgloc.datasets.own_csv import write_csv
    from fgloc.datasets.own_format import write_npz
    from fgloc.datasets.registry import load_drive

    writers = {".npz": write_npz, ".csv": write_csv}
    if args.file.suffix not in writers:
        raise FglocError("the name must end in .npz or .csv", file=args.file)
    drive = load_drive(args.drive, args.data, args.topics)
    writers[args.file.suffix](drive, args.file)
    print(f"{drive.name}: written to {args.file}")


def _save_json(path: Path | None, document: dict[str, Any]) -> None:
    """Write a document as JSON if a path is given."""
    if path is not None:
        write_text(path, json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def _table(*columns: str) -> Any:
    """Return an empty table with these columns."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(Text(column), overflow="fold")  # a plain [s] would be markup
    return table


def _print(table: Any) -> None:
    """Print a table; in a pipe as wide as it needs, so that no cell is broken."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else 200, highlight=False)
    console.print(table)
