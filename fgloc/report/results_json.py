"""The JSON of `compare` and `smooth`; its keys are a contract (docs/json.md): additions only."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields
from typing import Any

from fgloc import __version__
from fgloc.core.evaluation import Evaluation
from fgloc.estimator import Live, Spread, TurningHistory
from fgloc.report.map_json import map_json
from fgloc.report.outcomes import Comparison, DriveOutcome, MethodOutcome

MOST_TURNING = 500
"""Times at which the effective track is told."""
START = "every method starts from the recorded truth's first pose (the origin without truth)"
ALIGNMENT = "none; ate_aligned_rmse_m after the best planar rotation and shift"


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as plain dicts, lists, numbers, strings and None."""
    settings = comparison.settings
    fixes = None
    if settings.fixes is not None:
        every_s, sigma_m = settings.fixes
        fixes = {"every_s": every_s, "sigma_m": sigma_m, "seed": settings.seed}
    nothing = dict.fromkeys(("x", "y", "theta", "sum"))
    document = {
        "fgloc_version": __version__,
        "methods": list(comparison.methods),
        "integrator": settings.integrator,
        "fixes": fixes,
        "robot_file": settings.robot_file,
        "topics_file": settings.topics_file,
        "ekf_file": settings.ekf_file,
        "encoder_selection": settings.encoder_selection,
        "start": START,
        "alignment": ALIGNMENT,
        "drives": [_drive(outcome) for outcome in comparison.drives],
        "total": {
            method: comparison.total[method].to_json() if method in comparison.total else nothing
            for method in comparison.methods
        },
        "total_is": comparison.total_is,
        "total_drives": {m: comparison.evaluated(m) for m in comparison.methods},
    }
    finite: dict[str, Any] = _finite(document)
    return finite


def dumps(document: dict[str, Any]) -> str:
    """Return JSON text with a line end; numbers keep all digits, NaN and infinity become null."""
    return json.dumps(_finite(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _drive(outcome: DriveOutcome) -> dict[str, Any]:
    """Return one entry of "drives"."""
    drive = outcome.drive
    return {
        "drive": drive.name,
        "duration_s": drive.duration_s,
        "robot": drive.robot.name,
        "base": drive.robot.base.kind,
        "motion": drive.motion,
        "truth": None if drive.truth is None else drive.truth.sensor,
        "sensors": [drive.wheels.sensor, *(s.sensor for s in drive.sensors)],
        "methods": {method: _method(found) for method, found in outcome.methods.items()},
        "skipped": dict(outcome.skipped),
        "rejected": dict(drive.rejected),
        "notes": list(drive.notes),
    }


def _method(outcome: MethodOutcome) -> dict[str, Any]:
    """Return one entry of a drive's "methods"; scores are None where there is no truth."""
    result = outcome.result
    scores: dict[str, Any] = {f.name: None for f in fields(Evaluation)}
    scores["e_max"] = dict.fromkeys(("x", "y", "theta"))
    if outcome.evaluation is not None:
        scores = outcome.evaluation.to_json()
    return {
        **scores,
        "seconds": result.seconds,
        "sensors_used": list(result.sensors_used),
        "calibration": {
            c.name: {
                "nominal": c.nominal,
                "value": c.value,
                "sigma": c.sigma,
                "prior_sigma": c.prior_sigma,
                "observed": c.observed,
                "unit": c.unit,
            }
            for c in result.calibration
        },
        "counts": {sensor: asdict(count) for sensor, count in result.counts.items()},
        "poses": len(result.trajectory),
        "slips": [{**asdict(slip), "probability": slip.probability} for slip in result.slips],
        "convergence": result.convergence,
        "notes": list(result.notes),
        "online": None if result.live is None else _live(result.live),
        "turning": None if result.turning is None else _turning(result.turning),
        "map": None if result.map is None else map_json(result.map),
    }


def _turning(history: TurningHistory) -> dict[str, Any]:
    """Return the effective track over time, at most `MOST_TURNING` times."""
    step = max(1, -(-history.stamps_ns.size // MOST_TURNING))
    return {
        "name": history.name,
        "nominal": history.nominal,
        "stamps_ns": history.stamps_ns[::step].tolist(),
        "values": history.values[::step].tolist(),
        "sigmas": history.sigmas[::step].tolist(),
    }


def _live(live: Live) -> dict[str, Any]:
    """Return how an online method kept up; times in milliseconds."""

    def spread(of: Spread | None) -> dict[str, float] | None:
        if of is None:
            return None
        return {"median": 1e3 * of.median, "p99": 1e3 * of.p99, "max": 1e3 * of.maximum}

    return {
        "updates": live.updates,
        "update_ms": spread(live.update),
        "late_ms": spread(live.late),
        "checkpoint_ms": spread(live.save),
        "resumed_poses": live.resumed_poses,
    }


def _finite(value: Any) -> Any:
    """Return the value with every NaN or infinity replaced by None, numpy scalars by Python's."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    if isinstance(value, bool) or value is None or isinstance(value, str | int):
        return value
    if hasattr(value, "item"):
        return _finite(value.item())
    return value if math.isfinite(value) else None
