"""What the report says of seams: figures of all, and pictures of the worst places."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.product.report.figures import data_uri
from geomosaic.types import AnyArray, ByteArray

if TYPE_CHECKING:
    from geomosaic.product.seams.quality import SeamPlace, SeamQuality
    from geomosaic.seam.lines import Segment

GAP = 6
"""White pixels between the pictures of a place."""
ASPRS = 2.0
"""Admissible mismatch at seams in units of the RMSE (ASPRS Positional Accuracy Standards)."""


def seam_facts(parts: Sequence[Segment], quality: Sequence[SeamQuality], names: Sequence[str]) -> dict[str, Any] | None:
    """Plain values of all pieces and of the whole; None where they were not judged."""
    if not quality:
        return None
    rows = [
        {
            "id": f"{names[part.first]}|{names[part.second]}|{part.number}",
            "first": names[part.first],
            "second": names[part.second],
            "length": part.line.length,
            "step_before": one.step_before,
            "step_after": one.step_after,
            "difference": one.difference,
            "mismatch_px": one.mismatch,
        }
        for part, one in zip(parts, quality, strict=True)
    ]
    known = [row for row in rows if math.isfinite(row["difference"])]
    matched = [row["mismatch_px"] for row in rows if math.isfinite(row["mismatch_px"])]
    return {
        "segments": len(rows),
        "judged": len(known),
        "matched": len(matched),
        "step_before": _rms([row["step_before"] for row in known]),
        "step_after": _rms([row["step_after"] for row in known]),
        "worst_step_after": max((row["step_after"] for row in known), default=math.nan),
        "mismatch_rms_px": _rms(matched),
        "worst_mismatch_px": max(matched, default=math.nan),
        "rows": rows,
    }


def seam_limit(orient: Mapping[str, Any], made: Mapping[str, Any]) -> float | None:
    """Largest admissible mismatch in output pixels, from the check points; None where there are none."""
    rms, scale = orient.get("rms_check_px"), made.get("scale")
    return ASPRS * rms / scale if rms and scale else None


def place_pictures(places: Sequence[SeamPlace], rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The worst places: figures and one picture each, of the first image, the second one and the mosaic."""
    from geomosaic.raster.preview import png_bytes

    return [
        {**rows[place.segment], "picture": data_uri(png_bytes(strip([place.first, place.second, place.mosaic])))}
        for place in places
    ]


def strip(views: Sequence[AnyArray]) -> ByteArray:
    """Pictures (rows, cols, bands) side by side in one stretch, so that their colours can be compared."""
    from geomosaic.raster.preview import stretch

    bands = 3 if views[0].shape[2] >= 3 else 1
    shown = [np.asarray(view[:, :, :bands], dtype=np.float64) for view in views]
    valid = [(view != 0).any(axis=2).astype(np.uint8) for view in views]
    grey = stretch(np.concatenate(shown, axis=1), np.concatenate(valid, axis=1))
    parts = np.split(np.broadcast_to(grey, (*grey.shape[:2], 3)), len(views), axis=1)
    gap = np.full((grey.shape[0], GAP, 3), 255, dtype=np.uint8)
    return np.ascontiguousarray(np.concatenate([parts[0], *(p for part in parts[1:] for p in (gap, part))], axis=1))


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else math.nan
