"""Files of a sheet: PDF with a georeference, PNG, GeoTIFF, raster GeoPDF, tiles for the web."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import shapely
from affine import Affine
from pyproj.enums import WktVersion

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal, is_local
from geomosaic.geo.grid import Grid
from geomosaic.geo.projection_domain import DomainBoundary, longitude_latitude
from geomosaic.geo.units import linear_unit
from geomosaic.options.sheet import FileOptions
from geomosaic.raster.cog.codec import Samples
from geomosaic.raster.export_formats import write_raster_pdf, write_web
from geomosaic.raster.files import write_text
from geomosaic.raster.sink import RasterSink
from geomosaic.raster.validity import rasterized
from geomosaic.sheets.drawing.canvas import Canvas
from geomosaic.sheets.drawing.contents import SheetParts
from geomosaic.sheets.drawing.sheet import Pixels, draw_map, draw_sheet
from geomosaic.sheets.page import Box, Page
from geomosaic.types import ByteArray
from geomosaic.whole_files import under_construction

# The georeference of a PDF is a viewport with a geospatial measure dictionary on its page, as in ISO 32000-2:2020, 12.9
# and 12.10 (first in Adobe Supplement to ISO 32000, extension level 3): `GPTS` are the geographic positions of the
# neatline's corners, `LPTS` the same corners as parts of `BBox`. The viewport of a map in a local frame has a
# rectilinear measure dictionary instead (12.9), by which readers measure metres. It is added as an incremental update:
# what was written stays as it is, and the page is written once more behind it.
_CORNERS = ((0, 0), (0, 1), (1, 1), (1, 0))


def _add_georeference(path: Path, page: Page) -> bool:
    """Viewport of a map appended to the PDF of its sheet, a file of one page with a plain cross-reference table."""
    # Matplotlib writes objects, a table of offsets and a trailer; the update has the page object once more, a table of
    # this one object, and a trailer that names the former table (/Prev), as ISO 32000-2, 7.5.6 has it.
    data = path.read_bytes()
    start = re.findall(rb"startxref\s+(\d+)\s+%%EOF\s*$", data)
    trailer = re.search(rb"trailer\s*<<(.*?)>>\s*startxref", data, re.DOTALL)
    pages = list(
        re.finditer(rb"(?:^|\n)(\d+) 0 obj\s*<<((?:(?!endobj).)*?/Type /Page\b(?!s).*?)>>\s*endobj", data, re.DOTALL)
    )
    if not start or trailer is None or len(pages) != 1:
        raise ValueError("not a plain PDF of one page")
    number, body = int(pages[0][1]), pages[0][2]
    view = _viewport(page)
    more = _boxes(page) + (f"/VP [ {view} ]" if view else "")
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


def _boxes(page: Page) -> str:
    """Trim box and bleed box (ISO 32000-2, 14.11.2); '' without bleed."""
    if page.bleed <= 0:
        return ""
    bleed = page.bleed
    found = (
        ("TrimBox", (0.0, 0.0, page.width, page.height)),
        ("BleedBox", (-bleed, -bleed, page.width + bleed, page.height + bleed)),
    )
    return "".join(f"/{name} [ {' '.join(f'{v:.6f}' for v in _points(page, box))} ]\n" for name, box in found)


def _viewport(page: Page) -> str:
    """Viewport dictionary of a map, in PDF notation; '' where its corners are not on the Earth (map of the globe)."""
    points = _points(page, page.neatline)
    head = f"<< /Type /Viewport /Name (Map) /BBox [ {' '.join(f'{v:.6f}' for v in points)} ] "
    if is_local(page.crs):
        return f"{head}/Measure {_rectilinear(page)} >>"
    left, bottom, right, top = page.bounds
    xy = np.array([(left + u * (right - left), bottom + v * (top - bottom)) for u, v in _CORNERS])
    places = longitude_latitude(xy, page.crs)
    if not np.isfinite(places).all() or DomainBoundary.of(page.crs).beyond(xy).any():
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
        f"<< /Type /Measure /Subtype /RL /R ({_string(f'1 : {page.scale:.10g}')}) "
        f"/X [ << /Type /NumberFormat /U (m) /C {metres:.12g} /D 1000 >> ] "
        f"/D [ << /Type /NumberFormat /U (m) /C 1 /D 1000 >> ] /A [ {square} ] /O [ {x:.6f} {y:.6f} ] >>"
    )


def _string(text: str) -> str:
    """Literal string of PDF, escaped; characters outside ASCII become '?'."""
    plain = text.encode("ascii", "replace").decode()
    return re.sub(r"([\\()])", r"\\\1", plain)


_WEB = (".mbtiles", ".kmz")
FORMATS = (".pdf", ".png", ".tif", ".tiff", *_WEB)
# Endings that a driver which is not the default one writes.
_DRIVERS = {"COG": (".tif", ".tiff"), "PDF": (".pdf",)}
# Pixels of a picture that is drawn at once: an A0 sheet at 580 dpi, whose canvas takes 2 GB.
MOST_PIXELS = 1 << 29


def check_format(path: Path, files: FileOptions) -> None:
    """Refuse names that say no format, and drivers that do not write it.

    Parameters
    ----------
    path : Path
    files : FileOptions

    Raises
    ------
    InputError
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise InputError(
            f"sheets are not written as '{path.suffix}'",
            where=str(path),
            hint=f"end the name in {', '.join(FORMATS)}",
        )
    endings = _DRIVERS.get(files.driver, FORMATS)
    if suffix not in endings:
        raise InputError(
            f"`driver={files.driver}` does not write '{suffix}'",
            where=str(path),
            hint=f"leave out `driver`, or end the name in {' or '.join(endings)}",
        )


def write_sheet(
    path: Path, parts: SheetParts, pixels: Pixels, dpi: int, files: FileOptions, *, overwrite: bool
) -> tuple[dict[str, Box], list[str]]:
    """Draw and write; returns the boxes of the elements around the map, and what had no room, in words.

    Parameters
    ----------
    path : Path
    parts : SheetParts
    pixels : callable, see `Pixels`
    dpi : int, pixels of the picture per inch of paper
    files : FileOptions
    overwrite : bool, replace an existing file

    Raises
    ------
    InputError, OutputExistsError, OutputError
        Too many pixels, or a map that has no place on the Earth in a format that needs one; writing failed.
    """
    suffix, flat = path.suffix.lower(), files.driver == "PDF"
    page = parts.page
    if (flat or suffix in _WEB) and is_local(page.crs):
        raise InputError(
            f"'{page.crs.name}' is not tied to the Earth, so its map has no place "
            + ("in a raster GeoPDF" if flat else "on the web"),
            where=str(path),
            hint="leave out `driver=PDF`" if flat else "write .pdf, .png or .tif",
        )
    vectors = suffix == ".pdf" and not flat
    left, bottom, right, top = page.neatline if vectors else page.paper
    if (right - left) * (top - bottom) * (dpi / 25.4) ** 2 > MOST_PIXELS:
        raise InputError(
            f"{'the map' if vectors else 'a sheet'} of {right - left:.0f} x {top - bottom:.0f} mm at {dpi} dpi has too "
            "many pixels",
            where=str(path),
            hint="lower `dpi`" if vectors else "lower `dpi`, or write a PDF of vectors",
        )
    if flat or suffix in _WEB:
        return _by_gdal(path, parts, pixels, dpi, files, overwrite=overwrite)
    if suffix.startswith(".tif"):
        return _geotiff(path, parts, pixels, dpi, files, overwrite=overwrite)
    drawn = draw_sheet(parts, pixels)
    canvas, remarks = drawn.canvas, list(drawn.remarks)
    if suffix == ".pdf":
        with under_construction(path) as file:
            canvas.save_pdf(file, parts.layout.sheet.title or "Map sheet")
            if not _add_georeference(file, page):
                remarks.append("the PDF has no georeference: a corner of the map lies beyond the globe")
    else:
        with under_construction(path) as file:
            _png(file, canvas, dpi)
        if files.world_file:
            _world_file(path, _page_grid(page, dpi))
    return drawn.elements, remarks


def _png(path: Path, canvas: Canvas, dpi: int) -> None:
    from PIL import Image

    with path.open("wb") as file:
        Image.fromarray(canvas.pixels(dpi)).save(file, format="PNG", dpi=(dpi, dpi))


def _sheet_grid(page: Page, dpi: float) -> Grid:
    """Pixels of the map at a print resolution: they start at the upper left corner of the neatline and cover it."""
    step = 25.4 / dpi
    left, bottom, right, top = page.neatline
    width, height = (max(1, int(np.ceil(v / step - 1e-6))) for v in (right - left, top - bottom))
    size = step / page.mm_per_unit
    return Grid(page.crs, Affine(size, 0.0, page.bounds[0], 0.0, -size, page.bounds[3]), width, height)


def _page_grid(page: Page, dpi: float) -> Grid:
    """Pixels of the whole page at a print resolution, in the map's CRS: they start at its upper left corner."""
    size = 25.4 / dpi / page.mm_per_unit
    box = page.paper
    width, height = (max(1, round((box[k + 2] - box[k]) * dpi / 25.4)) for k in (0, 1))
    left, top = page.to_map(np.array([[box[0], box[3]]]))[0].tolist()
    return Grid(page.crs, Affine(size, 0.0, left, 0.0, -size, top), width, height)


def _world_file(path: Path, grid: Grid) -> None:
    """Write the affine of pixel centres: x size, two turns, y size, centre of the upper left pixel."""
    t = grid.transform
    values = (t.a, t.d, t.b, t.e, t.c + t.a / 2, t.f + t.e / 2)
    suffix = ".tfw" if path.suffix.lower().startswith(".tif") else ".pgw"
    text = "".join(f"{value + 0.0:.12g}\n" for value in values)
    write_text(path.with_suffix(suffix), text, overwrite=True, encoding="ascii")


def _geotiff(
    path: Path, parts: SheetParts, pixels: Pixels, dpi: int, files: FileOptions, *, overwrite: bool
) -> tuple[dict[str, Box], list[str]]:
    """Draw the map alone on pixels that fit the neatline, its vectors burned in; or the whole page with its collar."""
    grid, drawn, valid, drawing = _drawn(parts, pixels, dpi, collar=files.collar)
    driver, masked = files.driver, valid is not None
    with RasterSink(path, grid, Samples(3, "uint8", mask=masked), driver=driver, overwrite=overwrite) as sink:
        # Whole tiles row by row, as the sink takes them.
        for window in grid.window.split(2048, 512):
            rows, cols = slice(window.row, window.stop_row), slice(window.col, window.stop_col)
            part = None if valid is None else np.ascontiguousarray(valid[rows, cols])
            sink.write(window, np.ascontiguousarray(drawn[rows, cols]), part)
        sink.finish()
    if files.world_file:
        _world_file(path, grid)
    return drawing


def _by_gdal(
    path: Path, parts: SheetParts, pixels: Pixels, dpi: int, files: FileOptions, *, overwrite: bool
) -> tuple[dict[str, Box], list[str]]:
    """Draw a raster GeoPDF, or the map alone for the web."""
    flat = files.driver == "PDF"
    grid, drawn, valid, drawing = _drawn(parts, pixels, dpi, collar=flat and files.collar)
    title = parts.layout.sheet.title or "Map"
    alpha = np.ones(grid.shape, dtype=np.uint8) if valid is None else valid
    if not flat:
        write_web(path, grid, np.dstack([drawn, 255 * alpha]), title=title, overwrite=overwrite)
    else:
        shown = drawn if valid is None else np.dstack([drawn, 255 * alpha])
        write_raster_pdf(path, grid, shown, dpi=dpi, title=title, overwrite=overwrite)
    return drawing


def _drawn(
    parts: SheetParts, pixels: Pixels, dpi: int, *, collar: bool
) -> tuple[Grid, ByteArray, ByteArray | None, tuple[dict[str, Box], list[str]]]:
    """Draw: grid, pixels (rows, cols, 3), which of them are map (None where all are), boxes and what had no room."""
    page = parts.page
    valid: ByteArray | None = None
    if collar:
        grid = _page_grid(page, dpi)
        sheet = draw_sheet(parts, pixels)
        canvas, drawing = sheet.canvas, (sheet.elements, list(sheet.remarks))
    else:
        grid = _sheet_grid(page, dpi)
        left, top = page.neatline[0], page.neatline[3]
        area = (left, top - grid.height * 25.4 / dpi, left + grid.width * 25.4 / dpi, top)
        canvas = Canvas(area)
        drawing = {}, draw_map(canvas, parts, pixels, area)
        if page.outline is not None:
            valid = rasterized([(shapely.Polygon(page.outline), 1)], grid, fill=0, dtype="uint8")
    drawn = canvas.pixels(dpi)
    if drawn.shape[:2] != grid.shape:
        raise RuntimeError(f"{drawn.shape[:2]} pixels were drawn where {grid.shape} belong")
    return grid, drawn, valid, drawing
