"""Georeference of a PDF: a viewport with a geospatial measure dictionary on its page.

The dictionary is that of ISO 32000-2:2020, 12.9 and 12.10 (first in Adobe Supplement to ISO 32000, extension level 3):
`GPTS` are the geographic positions of the neatline's corners, `LPTS` the same corners as parts of `BBox`. The viewport
of a map in a local frame has a rectilinear measure dictionary instead (12.9), by which readers measure metres. It is
added as an incremental update: what was written stays as it is, and the page is written once more behind it.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from pyproj.enums import WktVersion

from geomosaic.geo.crs import horizontal, is_local
from geomosaic.geo.projection_domain import Rim, longitude_latitude
from geomosaic.geo.units import linear_unit
from geomosaic.sheets.page import Box, Page

_CORNERS = ((0, 0), (0, 1), (1, 1), (1, 0))


def add_georeference(path: Path, page: Page) -> bool:
    """Viewport of a map appended to the PDF of its sheet, a file of one page with a plain cross-reference table.

    Returns
    -------
    bool
        Whether the map has one.

    Raises
    ------
    ValueError
        The PDF is not of that kind.
    """
    data = path.read_bytes()
    start = re.findall(rb"startxref\s+(\d+)\s+%%EOF\s*$", data)
    trailer = re.search(rb"trailer\s*<<(.*?)>>\s*startxref", data, re.DOTALL)
    pages = list(
        re.finditer(rb"(?:^|\n)(\d+) 0 obj\s*<<((?:(?!endobj).)*?/Type /Page\b(?!s).*?)>>\s*endobj", data, re.DOTALL)
    )
    if not start or trailer is None or len(pages) != 1:
        raise ValueError("not a plain PDF of one page")
    number, body = int(pages[0][1]), pages[0][2]
    view = viewport(page)
    more = boxes(page) + (f"/VP [ {view} ]" if view else "")
    update = b"%d 0 obj\n<<%s\n%s\n>>\nendobj\n" % (number, body.rstrip(), more.encode("ascii"))
    offset = len(data)
    table = b"xref\n%d 1\n%010d 00000 n \n" % (number, offset)
    kept = re.sub(rb"/Prev\s+\d+", b"", trailer[1]).strip()
    end = b"trailer\n<< %s /Prev %s >>\nstartxref\n%d\n%%%%EOF\n" % (kept, start[0], offset + len(update))
    path.write_bytes(data + update + table + end)
    return bool(view)


def _points(page: Page, box: Box) -> list[float]:
    """Rectangle of the page in PDF units (1/72 inch) from the corner of the paper, bleed included."""
    left, bottom = page.paper[:2]
    return [(v - (left, bottom)[k % 2]) * 72.0 / 25.4 for k, v in enumerate(box)]


def boxes(page: Page) -> str:
    """Trim box and bleed box (ISO 32000-2, 14.11.2); '' without bleed."""
    if page.bleed <= 0:
        return ""
    bleed = page.bleed
    found = (
        ("TrimBox", (0.0, 0.0, page.width, page.height)),
        ("BleedBox", (-bleed, -bleed, page.width + bleed, page.height + bleed)),
    )
    return "".join(f"/{name} [ {' '.join(f'{v:.6f}' for v in _points(page, box))} ]\n" for name, box in found)


def viewport(page: Page) -> str:
    """Viewport dictionary of a map, in PDF notation; '' where its corners are not on the Earth (map of the globe)."""
    points = _points(page, page.neatline)
    head = f"<< /Type /Viewport /Name (Map) /BBox [ {' '.join(f'{v:.6f}' for v in points)} ] "
    if is_local(page.crs):
        return f"{head}/Measure {_rectilinear(page)} >>"
    left, bottom, right, top = page.bounds
    xy = np.array([(left + u * (right - left), bottom + v * (top - bottom)) for u, v in _CORNERS])
    places = longitude_latitude(xy, page.crs)
    if not np.isfinite(places).all() or Rim.of(page.crs).beyond(xy).any():
        return ""
    gpts = " ".join(f"{lat:.10f} {lon:.10f}" for lon, lat in places)
    lpts = " ".join(f"{u} {v}" for u, v in _CORNERS)
    flat = horizontal(page.crs)
    code = flat.to_epsg(min_confidence=100)
    wkt = flat.to_wkt(WktVersion.WKT1_ESRI)
    system = f"/Type /PROJCS /WKT ({_string(wkt)})" + (f" /EPSG {code}" if code else "")
    return (
        f"{head}/Measure << /Type /Measure /Subtype /GEO /Bounds [ {lpts} ] /GPTS [ {gpts} ] /LPTS [ {lpts} ] "
        f"/PDU [ /M /SQM /DEG ] /GCS << {system} >> >> >>"
    )


def _rectilinear(page: Page) -> str:
    """Measure dictionary in metres; its origin is that of the map's coordinates."""
    metres = 25.4 / 72.0 / page.mm_per_unit * linear_unit(page.crs)
    origin = page.to_page(np.zeros((1, 2)))[0].tolist()
    x, y = _points(page, (*origin, *origin))[:2]
    square = "<< /Type /NumberFormat /U (sq m) /C 1 /D 1000 >>"
    return (
        f"<< /Type /Measure /Subtype /RL /R ({_string(f'1 : {page.scale:g}')}) "
        f"/X [ << /Type /NumberFormat /U (m) /C {metres:.12g} /D 1000 >> ] "
        f"/D [ << /Type /NumberFormat /U (m) /C 1 /D 1000 >> ] /A [ {square} ] /O [ {x:.6f} {y:.6f} ] >>"
    )


def _string(text: str) -> str:
    """Literal string of PDF, escaped; characters outside ASCII become '?'."""
    plain = text.encode("ascii", "replace").decode()
    return re.sub(r"([\\()])", r"\\\1", plain)
