"""Inputs of a sheet from files and options: layout, styles of its layers, records of the raster."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from geomosaic.enhancement.picture import HILLSHADE, enhance_keys
from geomosaic.errors import InputError, warn
from geomosaic.options.check import build, check_idle
from geomosaic.options.declaration import compose
from geomosaic.options.sheet import SheetOptions, parse_scale
from geomosaic.sheets.drawing.save import check_format
from geomosaic.sheets.layout import Layout
from geomosaic.sheets.make import SheetInputs, SheetResult, make_sheet
from geomosaic.sheets.qml import read_qml
from geomosaic.sheets.sld import read_sld
from geomosaic.sheets.style import BUILT_IN, Remarks, Style, StyleChange, Symbol, built_in, located, parse_style
from geomosaic.sheets.vector_layers import VectorInput
from geomosaic.stores.path import given_path
from geomosaic.types import PathLike, Progress
from geomosaic.whole_files import read_text, read_toml

SUFFIXES = (".qml", ".sld")


def foreign_style(text: str, where: str) -> tuple[Style, list[str]]:
    """Read QML or SLD, whichever it is.

    Parameters
    ----------
    text : str
    where : str, named in errors

    Returns
    -------
    style : Style
    remarks : list of str, what was not understood, and what was done instead

    Raises
    ------
    InputError
        It is neither, or nothing of it could be understood.
    """
    if "<!ENTITY" in text:
        raise InputError("the style declares entities", where=where, hint="save it again without a document type")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"the style is no XML: {error}", where=where, hint="save it again as QML or SLD") from None
    kind, remarks = root.tag.rpartition("}")[2], Remarks()
    if kind not in ("qgis", "StyledLayerDescriptor"):
        raise InputError(f"'{kind}' is neither QML nor SLD", where=where, hint="save it again as QML or SLD")
    try:
        style = read_qml(root, remarks) if kind == "qgis" else read_sld(root, remarks)
        _check_numbers(style)
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"a number of the style cannot be read: {error}", where=where, hint="correct the file"
        ) from None
    if style.symbol == Symbol() and not style.rules and style.label is None:
        left = f" (not understood: {'; '.join(remarks.texts)})" if remarks.texts else ""
        raise InputError(
            f"the style draws nothing{left}", where=where, hint="use simple lines, fills, markers and labels"
        )
    return style, list(remarks.texts)


# Millimetres or points; the longest side of the largest sheet.
_LONGEST = 2000.0


def _check_numbers(part: Any) -> None:
    """Check of the lengths and opacities of a style and its parts, which another program wrote."""
    for item in fields(part):
        value = getattr(part, item.name)
        for one in value if isinstance(value, tuple) else (value,):
            if is_dataclass(one):
                _check_numbers(one)
            elif isinstance(one, float) and item.name not in ("least", "below"):
                most = 1.0 if item.name == "opacity" else _LONGEST
                if not 0.0 <= one <= most:
                    raise ValueError(f"{item.name} = {one:g} is not within 0 and {most:g}")


def _read_records(raster: Path, report: Path | None = None) -> dict[str, Any] | None:
    """Report of the project and STAC item beside the raster.

    A report is that of `report`, or `report.json` beside the raster where it lists the raster among its outputs. The
    item is `NAME.stac.json` beside `NAME.tif`. Records of a file of another size are left out, with a warning.
    """
    found: dict[str, Any] = {}
    read: list[str] = []
    if report is not None:
        found.update(_report(report))
        read.append(report.name)
    elif (facts := _json(near := raster.with_name("report.json"))) and _describes(
        raster, facts.get("outputs"), "path", "bytes", near
    ):
        found.update(facts)
        read.append(near.name)
    if facts := _json(item := raster.with_suffix(".stac.json")):
        assets = facts.get("assets")
        entries = list(assets.values()) if isinstance(assets, dict) else None
        if _describes(raster, entries, "href", "file:size", item):
            found["stac"] = facts
            read.append(item.name)
    return {**found, "read": read} if read else None


def _describes(raster: Path, entries: Any, name: str, size: str, where: Path) -> bool:
    """Whether a record states the size of this file; what is no list of tables states none."""
    tables = [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []
    sizes = [entry.get(size) for entry in tables if Path(str(entry.get(name))).name == raster.name]
    if not (sizes and raster.is_file()):
        return False
    if raster.stat().st_size in sizes:
        return True
    warn(f"{where} describes another {raster.name} (its size differs): not used")
    return False


def _json(path: Path) -> dict[str, Any] | None:
    """Contents of a JSON file; None where it is missing or no JSON object."""
    try:
        facts = json.loads(read_text(path, "record", 256 << 20)) if path.is_file() else None
    except (InputError, ValueError, RecursionError):
        return None
    return facts if isinstance(facts, dict) else None


def _report(path: Path) -> Mapping[str, Any]:
    try:
        facts = json.loads(read_text(path, "report", 256 << 20))
    except (ValueError, RecursionError) as error:
        raise InputError(f"the report is not JSON: {error}", where=str(path), hint="give report.json") from None
    if not isinstance(facts, dict) or not {"orient", "mosaic", "check"} & set(facts):
        raise InputError(
            "this is no report of a project", where=str(path), hint="give the report.json beside the mosaic"
        )
    return facts


def read_layout(path: Path) -> Layout:
    """Layout from a TOML file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        Names what is wrong, with its table and key.
    """
    return layout_of(read_toml(path, "layout"), str(path))


def layout_of(tables: Mapping[str, Any], where: str) -> Layout:
    """Layout from the tables of its file.

    Parameters
    ----------
    tables : mapping
    where : str
        File, named in errors.

    Raises
    ------
    InputError
        Names what is wrong, with its table and key.
    """
    values = dict(tables)
    table = values.get("map")
    if isinstance(table, dict) and isinstance(table.get("scale"), str):
        values["map"] = {**table, "scale": parse_scale(table["scale"], f"{where}, [map] scale")}
    if isinstance(values.get("layer"), dict):
        raise InputError("layers are a list", where=f"{where}, [layer]", hint="write [[layer]] in double brackets")
    return build(Layout, values, where)


def read_style(name: str, base: Path, where: str | None = None) -> Style:
    """Style: a built-in one by its name, or a .toml, .qml or .sld file relative to `base`.

    What of QML and SLD is not understood is named in warnings.

    Parameters
    ----------
    name : str
    base : Path, folder of the layout
    where : str, optional, named in errors
    """
    if name.lower().endswith(SUFFIXES):
        path = base / name
        style, remarks = foreign_style(read_text(path, "style", 32 << 20), str(path))
        for remark in remarks:
            warn(f"{path}: not understood: {remark}")
        return style
    if name.lower().endswith(".toml"):
        file = base / name
        return located(parse_style(read_toml(file, "style"), str(file)), file.parent, str(file))
    return built_in(name, where)


def vector_input(text: str, base: Path = Path()) -> VectorInput:
    """Vector input from FILE[#LAYER][:STYLE], an item of `vectors`.

    Parameters
    ----------
    text : str
    base : Path, folder that the file is relative to

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


def sheet_inputs(raster: Path, options: SheetOptions, suffix: str = ".pdf", *, title: str | None = None) -> SheetInputs:
    """Inputs of a sheet from files and options.

    Parameters
    ----------
    raster : Path
    options : SheetOptions, they win over the layout file
    suffix : str, ending of the sheet's file
    title : str, optional, that of a sheet without a layout file

    Raises
    ------
    InputError
        A file cannot be read, a style is not known, or an option would do nothing.
    """
    layout, base = Layout(), Path()
    if options.layout is not None:
        layout, base = read_layout(options.layout), options.layout.parent
    named: dict[str, Any] = {
        "logo": str(base / layout.sheet.logo) if layout.sheet.logo else "",
        "fonts": tuple(str(base / name) for name in layout.sheet.fonts),
    }
    dem = options.contours or (base / layout.contours.dem if layout.contours.dem else None)
    shade = options.look.hillshade or (base / layout.enhance.dem if layout.enhance.dem else None)
    # A raster GeoPDF has no page around the map.
    written = "a raster GeoPDF" if options.files.driver == "PDF" else suffix.lower().replace(".tiff", ".tif")
    check_idle(options, {"output": written, "panel": layout.sheet.panel, "contours": dem, "hillshade": shade})
    page = {
        "paper": options.paper,
        "orientation": options.orientation,
        "dpi": options.dpi,
        "title": options.title if options.title is not None or options.layout is not None else title,
    }
    shaded = options.look.hillshade is not None and not layout.enhance.hillshade
    enhance = {**enhance_keys(options.look), "hillshade": HILLSHADE if shaded else None}
    layout = replace(
        layout,
        sheet=replace(layout.sheet, **named, **_given(page)),
        map=replace(layout.map, **_given({"scale": options.scale, "bounds": options.bounds})),
        contours=replace(layout.contours, **_given({"interval": options.interval})),
        enhance=replace(layout.enhance, **_given(enhance)),
    )
    layers = [
        VectorInput(
            base / part.file,
            part.layer or None,
            read_style(part.style, base, f"{options.layout}, [[layer]]") if part.style else None,
            part.title,
            StyleChange(part.color, part.width, part.label),
        )
        for part in layout.layer
    ]
    wanted = layout.notes.records or options.report is not None
    return SheetInputs(
        raster,
        layout,
        (*layers, *map(vector_input, options.vectors)),
        dem,
        options.dem_heights or layout.contours.heights or None,
        shade,
        _read_records(raster, options.report) if wanted else None,
        options.files,
    )


def sheet(
    raster: PathLike, output: PathLike, *, overwrite: bool = False, progress: Progress | None = None, **options: Any
) -> SheetResult:
    """Map sheet of a raster at an exact scale; what is given here wins over the layout file.

    Parameters
    ----------
    raster : path
        Georeferenced.
    output : path
        Ends in .pdf or .png; the map alone in .tif, .mbtiles or .kmz.
    overwrite : bool
        Replace an existing file.
    progress : callable, optional
        Called with the number of stages done, their number and the name of the one that begins.
    **options
        Fields of `SheetOptions`, `StretchOptions` and `FileOptions`: `layout`, `scale`, `paper`, `vectors`,
        `contours`, `title` (the name of the raster unless given here or in the layout) ...

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    raster, output, chosen = given_path(raster), given_path(output), compose(SheetOptions, options)
    check_format(output, chosen.files)
    inputs = sheet_inputs(raster, chosen, output.suffix, title=raster.stem.replace("_", " "))
    return make_sheet(inputs, output, overwrite=overwrite, progress=progress)


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}
