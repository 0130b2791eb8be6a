"""The JSON of `calibrate`; its keys are a contract (docs/json.md): additions only."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from fgloc import __version__
from fgloc.calibration.result import CalibrationReport, DriveError
from fgloc.core.consistency import correlations


def calibration_json(report: CalibrationReport) -> dict[str, Any]:
    """Return a calibration as plain dicts, lists, numbers, strings and None."""
    before, after = report.total_nominal, report.total_value
    total: dict[str, Any] = dict.fromkeys(("nominal", "value", "change_percent"))
    if before is not None and after is not None:
        total = {
            "nominal": before.sum,
            "value": after.sum,
            "change_percent": 100.0 * (after.sum / before.sum - 1.0) if before.sum > 0.0 else None,
            "nominal_axes": before.to_json(),
            "value_axes": after.to_json(),
        }
    return {
        "fgloc_version": __version__,
        "fit": list(report.fit),
        "reference": report.reference,
        "model": report.model,
        "parameters": {
            p.name: {
                "nominal": p.nominal,
                "value": p.value,
                "sigma": p.sigma,
                "prior_sigma": p.prior_sigma,
                "observed": p.observed,
                "unit": p.unit,
            }
            for p in report.parameters
        },
        "correlation": correlations(report.covariance).tolist(),
        "evaluation": [_evaluation(e, e.drive in report.fit) for e in report.evaluation],
        "total": total,
        "candidates": [asdict(c) for c in report.candidates],
        "residuals": [asdict(r) for r in report.residuals],
        "clocks": [asdict(c) for c in report.clocks],
        "closed_form": dict(report.closed_form),
        "condition": report.condition,
        "advice": list(report.advice),
        "notes": list(report.notes),
        "seconds": report.seconds,
    }


def _evaluation(e: DriveError, in_sample: bool) -> dict[str, Any]:
    """Return one entry of "evaluation"."""
    return {
        "drive": e.drive,
        "motion": e.motion,
        "in_sample": in_sample,
        "nominal_rmse_m": e.nominal.ate_rmse_m,
        "rmse_m": e.value.ate_rmse_m,
        "nominal_heading_rmse_deg": e.nominal.ate_heading_rmse_deg,
        "heading_rmse_deg": e.value.ate_heading_rmse_deg,
        "nominal_end_position_m": e.nominal.end_position_m,
        "end_position_m": e.value.end_position_m,
        "nominal_e_max": asdict(e.nominal.e_max),
        "e_max": asdict(e.value.e_max),
    }
