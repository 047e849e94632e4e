"""Where a product comes from, as sections of name and value for the report."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thermacq import __version__
from thermacq.evaluation.probes import ProbeRecord, probe_label

if TYPE_CHECKING:
    import xarray as xr

    from thermacq.evaluation.run_comparison import RunComparison
    from thermacq.reconstruction import Source
    from thermacq_calibration import StereoCalibration


def json_attribute(dataset: xr.Dataset, name: str, *, default: Any) -> Any:
    """Value of an attribute that was stored as JSON; the default when it is missing or is none."""
    try:
        return json.loads(dataset.attrs[name])
    except (KeyError, TypeError, ValueError):
        return default


def json_table(dataset: xr.Dataset, name: str) -> dict[str, Any]:
    """Table in an attribute that was stored as JSON; empty when it is missing or is none."""
    value = json_attribute(dataset, name, default={})
    return value if isinstance(value, dict) else {}


def provenance(
    path: Path, dataset: xr.Dataset, source: Source | None, compared: RunComparison | None
) -> dict[str, dict[str, str]]:
    """Sections of name and value: product, run, calibration, matcher, world frame, probes.

    Parameters
    ----------
    path, dataset
        The product.
    source
        Its run, as far as it could be opened.
    compared
        The probes.
    """
    attributes = dataset.attrs
    sections = {
        "Product": {
            "file": path.name,
            "SHA-256": _sha256(path),
            "frames": str(dataset.sizes["time"]),
            "grid": f"{dataset.sizes['y']} × {dataset.sizes['x']} cells of {_spacing_mm(dataset):.3g} mm",
            "minimum points in a cell": str(attributes.get("min_points_per_cell", "unknown")),
            "made by": f"thermacq {attributes.get('thermacq_version', 'unknown')}",
            "report by": f"thermacq {__version__}",
        },
        "Run": {
            "file": str(attributes.get("run", "unknown")),
            "id": str(attributes.get("run_id", "unknown")),
            "SHA-256": str(attributes.get("run_sha256", "unknown")),
            "simulated": "yes" if json_attribute(dataset, "simulated", default=False) else "no",
            "pairs left out": str(attributes.get("pairs_left_out", "unknown")),
        },
        "Calibration": {
            "SHA-256": str(attributes.get("calibration_sha256", "unknown")),
            "baseline": f"{1000 * _number(dataset, 'baseline_m'):.3f} mm",
            "focal length": f"{_number(dataset, 'focal_px'):.2f} px",
        },
        "Correction of the pictures": _correction(dataset),
        "Matcher": {
            "name": str(attributes.get("matcher", "unknown")),
            **{name: str(value) for name, value in json_table(dataset, "matcher_settings").items()},
        },
        "World frame": _world(dataset),
    }
    if source is not None:
        header = source.header
        sections["Run"] |= {
            "title": header.title,
            "start": header.start_time,
            "clock": header.clock,
            **{f"version of {name}": version for name, version in header.versions.items()},
        }
        sections["Calibration"] |= {
            "stereo reprojection error": _pixels(source.calibration.rms_px),
            "acceptance": _acceptance(source.calibration),
            "source": source.calibration.source,
            "made": source.calibration.created,
        }
    for probe in compared.probes if compared else ():
        label = probe_label(probe.name)
        sections[label[0].upper() + label[1:]] = _probe(probe)
    return sections


def _acceptance(calibration: StereoCalibration) -> str:
    """The verdict, and the measures that failed."""
    from thermacq_calibration.geometry.acceptance import Verdict, acceptance, verdict

    rows = acceptance(calibration)
    failed = ", ".join(row.measure for row in rows if row.verdict is Verdict.FAIL)
    return f"{verdict(rows)}: {failed}" if failed else str(verdict(rows))


def _all_tables(values: object) -> bool:
    return isinstance(values, Iterable) and all(isinstance(value, dict) for value in values)


def _correction(dataset: xr.Dataset) -> dict[str, str]:
    values = json_table(dataset, "correction")
    cameras, stages = values.get("cameras", {}), values.get("stages", [])
    if not isinstance(cameras, dict) or not _all_tables(cameras.values()) or not _all_tables(stages):
        return {"applied": "unknown"}
    if not cameras and not stages:
        return {"applied": "none" if values else "unknown"}
    told = (
        {"corrections from": "the run" if values.get("from") == "run" else "files given"} if cameras else {}
    )
    for name, facts in cameras.items():
        updated = f", offsets of {facts['offset_updated']}" if facts.get("offset_updated") else ""
        told[f"{name}: stages"] = ", ".join(facts.get("stages", ()))
        told[f"{name}: made"] = f"{facts.get('created', 'unknown')}{updated}"
        told[f"{name}: SHA-256"] = str(facts.get("sha256", "unknown"))
    for stage in stages:
        told[f"stage {stage.get('name')}"] = json.dumps(stage.get("settings", {}))
    return told


def _world(dataset: xr.Dataset) -> dict[str, str]:
    values = json_table(dataset, "world_frame")
    return {
        "definition": str(dataset.attrs.get("world", "unknown")),
        "from": str(dataset.attrs.get("world_frame_from", "unknown")),
        "camera height": f"{_number(dataset, 'camera_height_m'):.4f} m",
        "single-frame σ on still water": f"{1000 * _number(dataset, 'still_water_sigma_m'):.3f} mm",
        "rotation": json.dumps(values.get("rotation", "unknown")),
        "translation": json.dumps(values.get("translation_m", "unknown")),
    }


def _probe(probe: ProbeRecord) -> dict[str, str]:
    clock = probe.clock
    return {
        "place": f"x = {probe.x_m:.4f} m, y = {probe.y_m:.4f} m",
        "channel": f"{probe.channel} ({probe.unit})",
        "coefficient": f"{probe.coefficient_m_per_unit:.6g} m per {probe.unit or 'unit'}",
        "its uncertainty (k = 2)": f"{200 * probe.coefficient_u_rel:.2f} %",
        "zero": f"{probe.zero_raw:.6g} {probe.unit}, from: {probe.zero_source}",
        "clock": f"{clock.method}, drift {clock.drift_ppm:+.2f} ppm, residual {clock.residual_ns / 1000:.3g} µs",
        "lost samples": str(probe.lost_samples),
    }


def _pixels(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f} px"


def _number(dataset: xr.Dataset, name: str) -> float:
    """An attribute as a number; NaN when it is missing or is none."""
    try:
        return float(dataset.attrs[name])
    except (KeyError, TypeError, ValueError):
        return float("nan")


def _spacing_mm(dataset: xr.Dataset) -> float:
    x = dataset["x"].to_numpy()
    return 1000 * float(x[1] - x[0]) if x.size > 1 else float("nan")


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
