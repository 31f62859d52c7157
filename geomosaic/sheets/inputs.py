"""Styles of other programs, and what of them was not understood."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from geomosaic.enhancement.picture import stretch_keys
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.inputs.declarations import read_toml
from geomosaic.inputs.tables import read_text
from geomosaic.options.check import build
from geomosaic.sheets.drawing.save import FileOptions
from geomosaic.sheets.layout import Layout, parse_scale
from geomosaic.sheets.make import SheetResult, VectorInput, make_sheet
from geomosaic.sheets.qml import read_qml
from geomosaic.sheets.sld import read_sld
from geomosaic.sheets.style import BUILT_IN, Style, Symbol, Told, built_in, parse_style
from geomosaic.types import PathLike

SUFFIXES = (".qml", ".sld")


def foreign_style(text: str, where: str) -> tuple[Style, list[str]]:
    """Read QML or SLD, whichever it is.

    Returns
    -------
    style : Style
    remarks : list of str
        What was not understood, and what was done instead.

    Raises
    ------
    InputError
        It is neither, or nothing of it could be understood.
    """
    from xml.etree import ElementTree

    if "<!ENTITY" in text:
        raise InputError("the style declares entities", where=where, hint="save it again without a document type")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"the style is no XML: {error}", where=where, hint="save it again as QML or SLD") from None
    kind, told = root.tag.rpartition("}")[2], Told()
    if kind not in ("qgis", "StyledLayerDescriptor"):
        raise InputError(f"'{kind}' is neither QML nor SLD", where=where, hint="save it again as QML or SLD")
    try:
        style = read_qml(root, told) if kind == "qgis" else read_sld(root, told)
    except ValueError as error:
        raise InputError(
            f"a number of the style cannot be read: {error}", where=where, hint="correct the file"
        ) from None
    if style.symbol == Symbol() and not style.rules and style.label is None:
        left = f" (not understood: {'; '.join(told.remarks)})" if told.remarks else ""
        raise InputError(
            f"the style draws nothing{left}", where=where, hint="use simple lines, fills, markers and labels"
        )
    return style, list(told.remarks)


def _read_records(raster: Path, report: Path | None = None) -> dict[str, Any] | None:
    """Report of the project and STAC item beside the raster.

    A report is that of `report`, or `report.json` beside the raster where it lists the raster among its outputs. The
    item is `NAME.stac.json` beside `NAME.tif`. Records that tell of a file of another size are left out, with a note.
    """
    found: dict[str, Any] = {}
    read: list[str] = []
    if report is not None:
        found.update(_report(report))
        read.append(report.name)
    else:
        near = raster.parent / "report.json"
        facts = _json(near) if raster.is_file() else None
        sizes = [out.get("bytes") for out in (facts or {}).get("outputs", ()) if Path(out["path"]).name == raster.name]
        if facts is not None and _describes(raster, sizes, near):
            found.update(facts)
            read.append(near.name)
    item = raster.with_suffix(".stac.json")
    facts = _json(item) if raster.is_file() else None
    if facts is not None:
        assets = facts.get("assets", {}).values()
        sizes = [a.get("file:size") for a in assets if Path(str(a.get("href"))).name == raster.name]
        if _describes(raster, sizes, item):
            found["stac"] = facts
            read.append(item.name)
    return {**found, "read": read} if read else None


def _describes(raster: Path, sizes: list[Any], where: Path) -> bool:
    """Whether a record describes this file."""
    if not sizes:
        return False
    if raster.stat().st_size in sizes:
        return True
    warnings.warn(
        f"{where} tells of another {raster.name} (its size differs): not used", GeomosaicWarning, stacklevel=3
    )
    return False


def _json(path: Path) -> dict[str, Any] | None:
    """Contents of a JSON file; None where it is missing or no JSON object."""
    try:
        facts = json.loads(read_text(path, "record", 256 << 20)) if path.is_file() else None
    except (InputError, json.JSONDecodeError):
        return None
    return facts if isinstance(facts, dict) else None


def _report(path: Path) -> Mapping[str, Any]:
    try:
        facts = json.loads(read_text(path, "report", 256 << 20))
    except json.JSONDecodeError as error:
        raise InputError(f"the report is not JSON: {error}", where=str(path), hint="give report.json") from None
    if not isinstance(facts, dict) or not {"orient", "mosaic", "check"} & set(facts):
        raise InputError(
            "this is no report of a project", where=str(path), hint="give the report.json beside the mosaic"
        )
    return facts


def read_layout(path: Path) -> Layout:
    """Layout from a TOML file.

    Raises
    ------
    InputError
        Names what is wrong, with its table and key.
    """
    values = dict(read_toml(path, "layout"))
    table = values.get("map")
    if isinstance(table, dict) and isinstance(table.get("scale"), str):
        values["map"] = {**table, "scale": parse_scale(table["scale"], f"{path}, [map] scale")}
    for name in ("layer",):
        if isinstance(values.get(name), dict):
            raise InputError("layers are a list", where=f"{path}, [layer]", hint="write [[layer]] in double brackets")
    return build(Layout, values, str(path))


def read_style(name: str, base: Path, where: str | None = None) -> Style:
    """Style: a built-in one by its name, or a .toml, .qml or .sld file relative to `base`.

    What of QML and SLD is not understood is told in a warning.
    """
    if name.lower().endswith(SUFFIXES):
        path = base / name
        style, remarks = foreign_style(read_text(path, "style", 32 << 20), str(path))
        for remark in remarks:
            warnings.warn(f"{path}: not understood: {remark}", GeomosaicWarning, stacklevel=2)
        return style
    if name.lower().endswith(".toml"):
        file = base / name
        return parse_style(read_toml(file, "style"), str(file))
    return built_in(name, where)


def vector_input(text: str, base: Path = Path()) -> VectorInput:
    """Vector input from FILE[#LAYER][:STYLE], an item of `vectors`.

    Raises
    ------
    InputError
        The style does not exist.
    """
    file, style = text, ""
    head, mark, tail = text.rpartition(":")
    # A colon may belong to the path (a drive): what follows then has a separator in it, or the file exists.
    if mark and len(head) > 1 and not (base / text).exists():
        known = tail in BUILT_IN or tail.lower().endswith((".toml", *SUFFIXES))
        if known or not any(c in tail for c in "/\\"):
            file, style = head, tail
    path, layer = file, ""
    if not (base / file).exists() and "#" in file:
        path, _, layer = file.rpartition("#")
    return VectorInput(base / path, layer or None, read_style(style, base, text) if style else None)


@dataclass(frozen=True)
class SheetInputs:
    """Inputs of `make_sheet`, read from files and options."""

    layout: Layout
    layers: tuple[VectorInput, ...]
    dem: Path | None
    shade: Path | None
    dem_heights: str | None
    report: Mapping[str, Any] | None


def sheet_inputs(
    raster: Path,
    *,
    layout: Path | None = None,
    scale: str | None = None,
    paper: str | None = None,
    orientation: str | None = None,
    bounds: tuple[float, float, float, float] | None = None,
    dpi: int | None = None,
    title: str | None = None,
    vectors: tuple[str, ...] = (),
    contours: Path | None = None,
    interval: float | None = None,
    dem_heights: str | None = None,
    report: Path | None = None,
    bands: tuple[int, ...] | None = None,
    stretch: str | None = None,
    limits: tuple[float, float] | None = None,
    percentiles: tuple[float, float] | None = None,
    gamma: float | None = None,
    clahe: float | None = None,
    sharpen: float | None = None,
    hillshade: Path | None = None,
) -> SheetInputs:
    """Layout, styles and records of the raster; parameters given here override the layout file."""
    plan = read_layout(layout) if layout is not None else Layout()
    base = layout.parent if layout is not None else Path()
    if plan.sheet.logo:
        plan = replace(plan, sheet=replace(plan.sheet, logo=str(base / plan.sheet.logo)))
    plan = replace(plan, sheet=replace(plan.sheet, fonts=tuple(str(base / name) for name in plan.sheet.fonts)))
    sheet = {"paper": paper, "orientation": orientation, "dpi": dpi, "title": title}
    area = {"scale": parse_scale(scale, "`scale`") if scale else None, "bounds": bounds}
    looks: dict[str, Any] = {
        "bands": bands, **stretch_keys(stretch, limits, percentiles), "gamma": gamma, "clahe": clahe,
        "sharpen": sharpen,
        "hillshade": 0.6 if hillshade is not None and not plan.enhance.hillshade else None,
    }  # fmt: skip
    plan = replace(
        plan,
        sheet=replace(plan.sheet, **_declared(sheet)),
        map=replace(plan.map, **_declared(area)),
        contours=replace(plan.contours, **_declared({"interval": interval})),
        enhance=replace(plan.enhance, **_declared(looks)),
    )
    layers = [
        VectorInput(
            base / part.file,
            part.layer or None,
            read_style(part.style, base, f"{layout}, [[layer]]") if part.style else None,
            part.title,
        )
        for part in plan.layer
    ]
    layers += [vector_input(text) for text in vectors]
    dem = contours or (base / plan.contours.dem if plan.contours.dem else None)
    facts = _read_records(raster, report) if plan.notes.records or report is not None else None
    shade = hillshade or (base / plan.enhance.dem if plan.enhance.dem else None)
    return SheetInputs(plan, tuple(layers), dem, shade, dem_heights or plan.contours.heights or None, facts)


def sheet(
    raster: PathLike,
    output: PathLike,
    *,
    layout: PathLike | None = None,
    title: str | None = None,
    driver: str = "GTiff",
    collar: bool = False,
    world_file: bool = False,
    overwrite: bool = False,
    **options: Any,
) -> SheetResult:
    """Map sheet of a raster at an exact scale; what is given here wins over the layout file.

    Parameters
    ----------
    raster : path
        Georeferenced.
    output : path
        Ends in .pdf or .png; the map alone in .tif, .mbtiles or .kmz.
    layout : path, optional
        Layout of the sheet (TOML).
    title : str, optional
        The name of the raster unless given.
    driver : str
        'GTiff' or 'COG', for a .tif.
    collar : bool
        Draw the margin, too, where the output is the map alone.
    world_file : bool
        Write a world file beside a picture.
    overwrite : bool
        Replace an existing file.
    **options
        Scale, paper, vectors, contours and stretch: the parameters of `sheet_inputs`.

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    raster, output, layout = Path(raster), Path(output), None if layout is None else Path(layout)
    named = title if title is not None or layout is not None else raster.stem.replace("_", " ")
    found = sheet_inputs(raster, layout=layout, title=named, **options)
    return make_sheet(
        raster, output, found.layout, found.layers, dem=found.dem, dem_heights=found.dem_heights, shade=found.shade,
        report=found.report,
        files=FileOptions(driver, collar, world_file), overwrite=overwrite,
    )  # fmt: skip


def _declared(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}
