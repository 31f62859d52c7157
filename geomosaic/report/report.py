"""Report of a mosaic as one HTML file: pictures, key figures, seams."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.report.figures import data_uri, mosaic_map, residual_length, residual_plot
from geomosaic.report.page import decimals, number, rendered, rms, share
from geomosaic.types import AnyArray, ByteArray

if TYPE_CHECKING:
    from geomosaic.mosaicking.seams.seamlines import SeamPlace, SeamQuality, Segment


# White pixels between the pictures of a place.
GAP = 6
# Admissible mismatch at seams in units of the RMSE (ASPRS Positional Accuracy Standards).
ASPRS = 2.0


def seam_facts(parts: Sequence[Segment], quality: Sequence[SeamQuality], names: Sequence[str]) -> dict[str, Any] | None:
    """Facts of all seam segments and of the whole, for JSON.

    Parameters
    ----------
    parts : sequence of Segment
    quality : sequence of SeamQuality
        Of the segments; empty where it was not measured.
    names : sequence of str
        Of the images.

    Returns
    -------
    dict or None
        Differences in grey values, mismatches in output pixels, lengths in map units; NaN where nothing was measured.
        None without any quality.
    """
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
    """Largest admissible mismatch at seams: `ASPRS` times the RMSE of check points.

    Parameters
    ----------
    orient : mapping
        Facts of the orientation; `rms_check_px` in image pixels.
    made : mapping
        Facts of the mosaic; `scale` in image pixels per output pixel.

    Returns
    -------
    float or None
        Output pixels; None without check points.
    """
    rms, scale = orient.get("rms_check_px"), made.get("scale")
    return ASPRS * rms / scale if rms and scale else None


def place_pictures(places: Sequence[SeamPlace], rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Worst seam places: figures and one picture each, of the first image, the second one and the mosaic.

    Parameters
    ----------
    places : sequence of SeamPlace
    rows : sequence of mapping
        Facts of all segments, from `seam_facts`.

    Returns
    -------
    list of dict
        The row of each place, with `picture` as a data URI.
    """
    from geomosaic.raster.pictures import png_bytes

    return [
        {**rows[place.segment], "picture": data_uri(png_bytes(strip([place.first, place.second, place.mosaic])))}
        for place in places
    ]


def strip(views: Sequence[AnyArray]) -> ByteArray:
    """Images side by side in one contrast stretch, so that their colours can be compared.

    Parameters
    ----------
    views : sequence of array (rows, cols, bands)
        Of equal size; 0 in all bands where not valid. The first three bands are shown, or the first one.

    Returns
    -------
    uint8 array (rows, cols, 3)
        White between the images.
    """
    from geomosaic.raster.pictures import stretch

    bands = 3 if views[0].shape[2] >= 3 else 1
    shown = [np.asarray(view[:, :, :bands], dtype=np.float64) for view in views]
    valid = [(view != 0).any(axis=2).astype(np.uint8) for view in views]
    grey = stretch(np.concatenate(shown, axis=1), np.concatenate(valid, axis=1))
    parts = np.split(np.broadcast_to(grey, (*grey.shape[:2], 3)), len(views), axis=1)
    gap = np.full((grey.shape[0], GAP, 3), 255, dtype=np.uint8)
    return np.ascontiguousarray(np.concatenate([parts[0], *(p for part in parts[1:] for p in (gap, part))], axis=1))


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else math.nan


# Rows of a table; the JSON twin has them all.
MOST_ROWS = 100


def render_html(
    data: Mapping[str, Any], mosaic: Path, vectors: Path, places: Sequence[Mapping[str, Any]] = (), ties: str = ""
) -> str:
    """HTML page of the report.

    Parameters
    ----------
    data : mapping
        Content of report.json: `name`, `geomosaic`, `versions`, `inputs`, `outputs`, `warnings`, and the facts
        `orient`, `mosaic`, `check`.
    mosaic, vectors : Path
        The raster and its GeoPackage, for the pictures.
    places : sequence of mapping
        The worst places on seams, from `place_pictures`.
    ties : str
        HTML of the section on tie points, from `render_tie_section`.

    Returns
    -------
    str
        HTML; text from files is escaped, and nothing is loaded from elsewhere.
    """
    orient, made = data["orient"], data["mosaic"]
    unit = made["grid"]["crs"].rpartition(", ")[2]
    points = sorted(orient["control"], key=lambda point: residual_length((point["col"], point["row"])), reverse=True)
    sizes = {(image["width"], image["height"]) for image in orient["images"]}
    plot = residual_plot(points, sizes.pop(), orient["measured"]) if points and len(sizes) == 1 else None
    return rendered(
        "template",
        **data,
        ground=decimals(made["grid"]["resolution"][0]),
        grey=decimals(rms(made["before"]) or rms((data["check"]["reference"] or {}).get("colour_rms", [])), 2),
        cards=_cards(data),
        unit="m" if unit == "metre" else unit,
        points=points,
        map=mosaic_map(mosaic, vectors, made["grid"]["bounds"], unit),
        plot=plot,
        seams=made.get("seam_quality"),
        seam_limit=seam_limit(orient, made),
        places=places,
        tie_section=ties,
        most=MOST_ROWS,
        total_pixels=made["grid"]["width"] * made["grid"]["height"],
    )


def _cards(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Key figures of a mosaic's report."""
    orient, made, check = data["orient"], data["mosaic"], data["check"]
    verdicts = {verdict["name"]: verdict for verdict in check["verdicts"]}

    def card(title: str, value: str, unit: str, text: str, threshold: str = "") -> dict[str, Any]:
        verdict = verdicts.get(threshold) or verdicts.get(f"{title.partition(' ')[0].lower()}_median_px")
        judged = {key: verdict[key] if verdict else None for key in ("passed", "limit")}
        return {"title": title, "value": value, "unit": unit, "text": text, **judged}

    found = []
    for role, key in (("control", "max_control_rms_px"), ("check", "max_check_rms_px")):
        count = sum(1 for point in orient["control"] if point["role"] == role)
        if count:
            text = f"RMS of {count} image measurements."
            found.append(card(f"{role.capitalize()} points", number(orient[f"rms_{role}_px"], 2), "px", text, key))
    accuracy = orient.get("accuracy")
    if accuracy:
        text = f"One standard deviation, largest of the outline and the middles of images: {accuracy['largest_in']}."
        value = number(accuracy["largest_sigma_px"], 2)
        found.append(card("Expected error", value, "px", text, "max_corner_sigma_px"))
    if made.get("accuracy"):
        accuracy, plan = made["accuracy"], made["accuracy"]["rms_plan_m"]
        text = f"One standard deviation in plan, RMS over the area, of {' and '.join(accuracy['errors_of'])}."
        found.append(card("Accuracy", number(plan, decimals(plan, 2)), "m", text, "accuracy_target"))
    if check["reference"]:
        reference = check["reference"]
        text = f"RMS of {reference['matched']} of {reference['tiles']} places against {check['reference_path']}."
        value = number(reference["registration_rms_px"], 3)
        found.append(card("Registration", value, "px", text, "max_registration_px"))
    text = f"Largest measured error of interpolating the exact geometry; tolerance {made['tolerance_px']:g} px."
    found.append(card("Lattice error", number(made["lattice_error_px"], 4), "px", text, "max_lattice_error_px"))
    if made["balanced"] and made["overlaps"]:
        digits = decimals(rms(made["before"]), 1)
        value = f"{number(rms(made['before']), digits)} → {number(rms(made['after']), digits)}"
        text = f"RMS difference of grey values in {made['overlaps']} overlaps, before and after balancing."
        found.append(card("Colour", value, "", text))
    if made.get("seam_quality"):
        seams = made["seam_quality"]
        text = f"Largest mismatch in {seams['matched']} places on seams; {number(seams['mismatch_rms_px'], 2)} RMS."
        found.append(card("Seams", number(seams["worst_mismatch_px"], 2), "px", text, "max_seam_mismatch_px"))
    used = sum(1 for image in made["images"] if image["pixels"])
    seen = share(made["valid_pixels"], made["grid"]["width"] * made["grid"]["height"])
    found.append(card("Images", f"{used} of {len(made['images'])}", "", f"Used; {seen} of the grid is filled."))
    return found
