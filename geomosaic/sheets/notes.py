"""Marginal notes of a sheet: grids, CRS and datum, accuracy, photography, sources."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from geomosaic.errors import counted
from geomosaic.geo.crs import crs_label, crs_name
from geomosaic.geo.local_frames import MapPlace
from geomosaic.numbers import angle_text, decimals, grouped
from geomosaic.sheets.grid_lines import MapGrid
from geomosaic.sheets.layout import Layout
from geomosaic.sheets.page import Page

# Plottable error: tolerance of an accurate point on a sheet, mm on paper.
_PLOTTABLE_MM = 0.3


def _crs_lines(page: Page, place: MapPlace | None, heights: str | None) -> list[str]:
    """Lines of the block on CRS and datum; `place` is None in a local frame."""
    flat = page.crs
    unit = flat.axis_info[0].unit_name if flat.axis_info else "unit"
    lines = [crs_label(flat)]
    if place is None:
        lines.append(f"Local frame, {unit}: not tied to the Earth")
        return lines + ([f"Heights: {heights}"] if heights else [])
    operation = flat.coordinate_operation
    method = operation.method_name if operation is not None else ""
    lines.append(f"{method}, {unit}" if method else unit)
    if flat.datum is not None:
        lines.append(f"Datum: {flat.datum.name}")
    if flat.ellipsoid is not None:
        lines.append(f"Ellipsoid: {flat.ellipsoid.name}")
    least, most = place.scales
    if not most - least >= 1e-4:  # or where they are no numbers
        lines.append(f"Point scale factor at the centre: {place.scale:.6f}")
    else:
        lines.append(f"Scale factors at the centre: {least:.4f} to {most:.4f} by direction")
    if heights:
        lines.append(f"Heights: {heights}")
    return lines


def grid_line(grid: MapGrid) -> str:
    """Line of the legend on a grid.

    Parameters
    ----------
    grid : MapGrid
    """
    name = crs_name(grid.crs)
    if grid.degrees:
        meridians, parallels = (_short(angle_text(step, step)) for step in grid.intervals)
        more = "" if meridians == parallels else f", meridians every {meridians}"
        return f"{name}, every {parallels}{more}"
    unit = grid.crs.axis_info[0].unit_name if grid.crs.axis_info else "units"
    unit = "m" if unit == "metre" else unit
    across, up = (f"{grouped(step, decimals(step, 3))}\u00a0{unit}" for step in grid.intervals)
    return f"{name}, every {up}" + ("" if across == up else f", from west to east every {across}")


def _short(step: str) -> str:
    """Angle without leading zero parts: 0°00′10″ is 10″."""
    for zero in ("0°", "00′"):
        step = step.removeprefix(zero) if len(step) > len(zero) else step
    return re.sub(r"^0(?=\d)", "", step)


def accuracy_statement(report: Mapping[str, Any], scale: float) -> str:
    """Accuracy statement from a project's report.

    Parameters
    ----------
    report : mapping, what stands in the report's JSON
    scale : float, denominator of the sheet

    Returns
    -------
    str, measured values only; '' where the report has none
    """
    orient, check = report.get("orient") or {}, report.get("check") or {}
    points = [p for p in orient.get("control", ()) if p.get("role") == "check"]
    parts = []
    value = orient.get("rms_check_px")
    if value is not None and points:
        parts.append(f"check points {value:.2f} px RMS in the images ({counted(len(points), 'measurement')})")
    reference = check.get("reference")
    grid = (report.get("mosaic") or {}).get("grid") or {}
    resolution = grid.get("resolution")
    if reference and reference.get("registration_rms_px") is not None:
        off = float(reference["registration_rms_px"])
        metres = str(grid.get("crs", "")).endswith("metre")
        ground = f" = {off * resolution[0]:.2g} m" if resolution and metres else ""
        parts.append(f"registration on the reference {off:.2g} px{ground} RMS ({reference.get('matched')} places)")
    if not parts:
        return ""
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}. {_PLOTTABLE_MM:g} mm on the sheet are {_PLOTTABLE_MM * scale / 1000:g} m."


def _photography_dates(records: Mapping[str, Any]) -> str:
    """Dates of photography from the STAC item: one day, or the first and the last; '' if unknown."""
    known = [str(image.get("acquired") or "")[:10] for image in _images(records)]
    days = sorted(day for day in known if day)
    if not days:
        return ""
    text = days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"
    return text if len(days) == len(known) else f"{text} ({len(days)} of {len(known)} images say when)"


def _source_statement(records: Mapping[str, Any]) -> str:
    """Sources of the raster from the STAC item and the report; '' if unknown."""
    images = _images(records)
    if not images:
        return ""
    names = [str(image.get("image")) for image in images]
    text = names[0] if len(names) == 1 else f"{len(names)} images, {names[0]} to {names[-1]}"
    sensor = (records.get("orient") or {}).get("sensor")
    text += f", sensor {sensor}" if sensor else ""
    sizes = [float(image["gsd_metres"]) for image in images if _number(image.get("gsd_metres"))]
    if sizes:
        low, high = (f"{value:.2g}" for value in (min(sizes), max(sizes)))
        text += f", ground pixels of {low if low == high else f'{low} to {high}'} m"
    software = (_item(records).get("processing:software") or {}).get("geomosaic")
    return f"{text}. Mosaic by geomosaic {software}." if software else f"{text}."


def _item(records: Mapping[str, Any]) -> Mapping[str, Any]:
    found: Mapping[str, Any] = (records.get("stac") or {}).get("properties") or {}
    return found


def _images(records: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [image for image in _item(records).get("geomosaic:sources") or () if isinstance(image, Mapping)]


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def blocks(
    layout: Layout, page: Page, place: MapPlace | None, heights: str | None, records: Mapping[str, Any]
) -> list[tuple[str, list[str]]]:
    """Headed blocks of text for the margin, in their order; empty ones are left out.

    Parameters
    ----------
    layout : Layout
    page : Page
    place : MapPlace or None, middle of the sheet; None in a local frame
    heights : str or None, vertical datum
    records : mapping, report of the project and STAC item
    """
    notes = layout.notes
    photography = notes.photography or _photography_dates(records)
    found = [
        ("Coordinate reference system", _crs_lines(page, place, heights)),
        ("Accuracy", [notes.accuracy or accuracy_statement(records, page.scale)]),
        (
            "Sources",
            [
                notes.sources or _source_statement(records),
                f"Date of photography: {photography}" if photography else "",
            ],
        ),
        ("", [notes.publisher, notes.edition, notes.credits]),
    ]
    kept = [(head, [line for text in lines for line in text.splitlines() if line.strip()]) for head, lines in found]
    return [(head, lines) for head, lines in kept if lines]
