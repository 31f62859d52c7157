"""Calculate scales, scanning, relief, swath, coverage, control, processing.

Help group: Calculations and lists
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import debug_option, json_option, options_of, running_options, stack
from geomosaic.cli.output import answer
from geomosaic.cli.values import Measure, Scale
from geomosaic.errors import counted
from geomosaic.options.planning import (
    ControlNeedOptions,
    CoverageOptions,
    FlightOptions,
    ProcessingOptions,
    ProductOptions,
    TableOptions,
)
from geomosaic.options.sheet import scale_text
from geomosaic.planning.relations import QUANTITIES, TOPICS, Quantity, Relation, shown

if TYPE_CHECKING:
    from geomosaic.planning.coverage import Coverage
    from geomosaic.planning.guidelines import ScaleTable

SUMMARIES = {
    "photo": "Photo scale, flying height, enlargement, scanning resolution and pixels.",
    "relief": "What errors of heights do to positions, and relief displacement.",
    "accuracy": "Accuracy of a map on paper and on the ground.",
    "swath": "Swath and ground cells of across-track scanners.",
    "overlap": "Distances of exposures and strips, and overlaps.",
}


@click.group()
def command() -> None:
    """Calculate a photo flight, its scans and its maps.

    Give what is known; everything that follows is printed with its formula, in whatever direction. Numbers may have a
    unit of their own: 6km, 20000ft, 12in, 3.5cm, 100gon, 40px/mm.

    \b
    Examples:
      geomosaic plan flight --ortho-scale 1:5000 --camera-constant 150 --area 10km 8km
      geomosaic plan photo --height 3000 --camera-constant 150 --ortho-scale 1:5000
      geomosaic plan swath --field 90 --height 6000
      geomosaic plan product --ortho-scale 1:10000 --camera-constant 150
      geomosaic plan run --photos 5000 --photo-size 6000 4000 --ground-pixel 0.1 --workers 8 --cores 4
    """


def _option(name: str, quantity: Quantity) -> click.Option:
    kind: Any = Scale() if quantity.unit == "1:" else Measure(quantity.unit)
    unit = {"1:": "1:N", "°": "DEGREES", "%": "PERCENT", "m": "METRES", "": "NUMBER", "µm": "MICRONS"}.get(
        quantity.unit, quantity.unit.upper()
    )
    text = quantity.text[:1].upper() + quantity.text[1:] + "."
    return click.Option([f"--{name.replace('_', '-')}", name], type=kind, metavar=unit, help=text)


def _topic(name: str, relations: Sequence[Relation]) -> click.Command:
    """Command of a group of formulas."""
    wanted = list(dict.fromkeys(quantity for relation in relations for quantity in relation.names))
    formulas = "\n".join(f"  {relation.formula}\n      {relation.source}" for relation in relations)

    def call(as_json: bool, **given: float | None) -> None:
        from geomosaic.planning.solve import Derived, Limit, bound, plan

        known = {key: value for key, value in given.items() if value is not None}
        found = plan(name, **known).values()
        derived = {item.name: item.value for item in found if isinstance(item, Derived)}
        limits = {item.name: item for item in found if isinstance(item, Limit)}
        facts: dict[str, object] = {
            "given": known,
            "derived": derived,
            "formulas": {item.name: item.relation.formula for item in found if isinstance(item, Derived)},
        }
        if limits:
            facts["limits"] = {key: {"limit": item.limit, "kept": item.kept} for key, item in limits.items()}
        width = max(len(QUANTITIES[item.name].text) for item in found)
        lines = []
        for item in found:
            value = shown(item.name, (known | derived)[item.name])
            if isinstance(item, Limit):
                verdict = "keeps" if item.kept else "MISSES"
                value += f"   {verdict} {bound(item.relation)} {shown(item.name, item.limit)}:"
            line = f"{QUANTITIES[item.name].text:<{width}}  {value:>12}"
            lines.append(f"{line}{' ' if isinstance(item, Limit) else '   '}{item.relation.formula}")
        answer(facts, "\n".join(lines), as_json)

    options: list[click.Parameter] = [_option(quantity, QUANTITIES[quantity]) for quantity in wanted]
    made = click.Command(
        name, params=options, callback=call, short_help=SUMMARIES[name],
        help=f"{SUMMARIES[name]}\n\nGive what is known; what follows is printed.\n\n\b\nFormulas:\n{formulas}",
    )  # fmt: skip
    return debug_option(json_option(made))


for _name, _relations in TOPICS.items():
    command.add_command(_topic(_name, _relations))


@command.command("flight")
@stack(options_of(FlightOptions), running_options)
def flight_command(as_json: bool, options: dict[str, Any]) -> None:
    """Flight for a map of a given scale: height, base, number of photos.

    \b
    Formulas (K-2.8; geometry of the vertical photo):
      M_photo = K · M_ortho, height = c · M_photo
      scan dpi >= 320 dpi · K, ground pixel = scan pixel · M_photo
      base = (1 - overlap/100) · format along · M_photo
      spacing = (1 - sidelap/100) · format across · M_photo
    Photos of a digital camera have its own sides and pixel:

    \b
      geomosaic plan flight --ortho-scale 1:2000 --ratio 8 --camera-constant 100 \\
        --format-along 68 --format-across 104 --scan-pixel 6 --area 4km 3km
    """
    from geomosaic.planning.solve import plan

    found = plan("flight", **options)
    covered = found.coverage
    facts = {key: value for key, value in asdict(found).items() if value is not None and key != "coverage"}
    lines = [
        f"map {scale_text(found.ortho_scale)}: photos {scale_text(found.photo_scale)} (K = {found.ratio:g}), "
        f"{found.height:.6g} m above the ground",
        f"pixel of the photo {found.scan_pixel:.4g} µm, {found.ground_pixel:.4g} m on the ground; of the map "
        f"{found.ortho_pixel:g} m",
        _steps(found.base, found.spacing, found.footprint),
        f"overlap {found.overlap:.4g} %, sidelap {found.sidelap:.4g} %",
    ]
    if covered is not None:
        facts |= {name: getattr(covered, name) for name in ("photos", "strips", "photos_in_strip", "raster")}
        lines += [_number_of_photos(covered), *_raster_lines(covered)]
    answer(facts, "\n".join(lines), as_json)


@command.command("area")
@stack(options_of(CoverageOptions), running_options)
def area_command(as_json: bool, options: dict[str, Any]) -> None:
    """Number of strips and photos that cover a rectangle, or the overlaps that a number of them has.

    \b
    Formulas (geometry of the vertical photo):
      base = (1 - overlap/100) · format along · M_photo
      spacing = (1 - sidelap/100) · format across · M_photo
      strips = ⌈(width - format across · M_photo) / spacing⌉ + 1
      photos in a strip = ⌈length / base⌉ + 1, with --monoscopic ⌈(length - side) / base⌉ + 1
    """
    from geomosaic.planning.solve import plan

    found = plan("area", **options)
    names = ("photos", "strips", "photos_in_strip", "base", "spacing", "overlap", "sidelap", "footprint", "raster")
    facts = {name: value for name in names if (value := getattr(found, name)) is not None}
    lines = [
        _number_of_photos(found),
        _steps(found.base, found.spacing, found.footprint),
        f"overlap {found.overlap:.4g} %, sidelap {found.sidelap:.4g} %",
        *_raster_lines(found),
    ]
    answer(facts, "\n".join(lines), as_json)


def _number_of_photos(found: Coverage) -> str:
    return f"{counted(found.photos, 'photo')}: {counted(found.strips, 'strip')} of {found.photos_in_strip}"


def _steps(base: float, spacing: float, footprint: tuple[float, float]) -> str:
    along, across = footprint
    return f"exposures every {base:.6g} m, strips every {spacing:.6g} m, {along:.6g} x {across:.6g} m on a photo"


def _raster_lines(found: Coverage) -> list[str]:
    if found.raster is None:
        return []
    return [f"raster of {found.raster[0]} x {found.raster[1]} pixels (columns across, rows along)"]


@command.command("control")
@stack(options_of(ControlNeedOptions), running_options)
def control_command(as_json: bool, options: dict[str, Any]) -> None:
    """Number and layout of control points.

    \b
    Sources:
      Wolf, 9-3: roughly 8 to 15 per image, in the four corners and evenly between them
      Jensen: 20 to begin with, where the worst are left out until the RMS is below a threshold
      Wolf, 9-8: block: unknowns = photos · unknowns of the model; two equations for every
      measurement of control and every connection; a point on n photos makes n (n - 1) / 2 connections
    """
    from geomosaic.planning.coverage import FOR_FILTERING
    from geomosaic.planning.solve import plan

    found = plan("control", **options)
    need, (low, high) = found.number, found.number.recommended
    facts: dict[str, Any] = {
        "model": found.model, "unknowns": need.unknowns, "least": need.least, "recommended": [low, high],
        "for_filtering": FOR_FILTERING,
    }  # fmt: skip
    lines = [
        f"{found.model}: {counted(need.unknowns, 'unknown')}, {need.least} points determine them",
        f"{low} to {high} points per image are recommended, {max(FOR_FILTERING, high)} where bad ones are to be found",
    ]
    if found.layout is not None:
        facts["determined"], facts["redundant"] = list(found.determined), list(found.redundant)
        facts["layout"] = found.layout.round(4).tolist()
        lines += [
            f"{len(found.layout)} points determine {', '.join(found.determined)}",
            f"and check each other (twice as many equations as unknowns) for {', '.join(found.redundant) or 'none'}",
            "shares of width and height, in the order in which to measure:",
            *(f"  {k:3d}  {x:.3f}  {y:.3f}" for k, (x, y) in enumerate(found.layout.tolist(), 1)),
        ]
    if (block := found.block) is not None:
        facts["block"] = {**asdict(block), "redundancy": block.redundancy}
        lines.append(
            f"{counted(options['photos'], 'photo')}: {counted(block.unknowns, 'unknown')}, "
            f"{block.tie_equations} equations of ties and "
            f"{block.control_equations} of control: redundancy {block.redundancy}"
        )
    answer(facts, "\n".join(lines), as_json)


@command.command("product")
@stack(options_of(ProductOptions), running_options)
def product_command(as_json: bool, options: dict[str, Any]) -> None:
    """From the quality of a photo map to what its inputs must be.

    \b
    Sources: K-2.8 (guidelines on orthophoto maps, 2001)
      error of position 0.3 mm on the map; K by scale; scan >= 320 dpi · K
      error of heights <= m_O · (140 mm / r) · (c / 150 mm); grid intervals by terrain
      errors that are independent add as squares: m_O² = m_DTM² + other²
    With --json > plan.json, `geomosaic check --target plan.json` holds the finished map against it.
    """
    from geomosaic.planning.solve import plan

    found = plan("product", **options)
    names = ("name", "least", "most", "unit", "source")
    facts = {"requirements": [{name: getattr(r, name) for name in names} for r in found]}
    width = max(len(r.text) for r in found)
    lines = [f"{r.text:<{width}}  {_range(r.least, r.most, r.unit):<18}  {r.source}" for r in found]
    answer(facts, "\n".join(lines), as_json)


@command.command("run")
@stack(options_of(ProcessingOptions), running_options)
def run_command(as_json: bool, options: dict[str, Any]) -> None:
    """Time, memory, bytes and cost of processing a block.

    \b
    Formulas, with rates that were measured (date and machine are printed):
      match    photos · megapixels · rate + pairs · rate       on all machines
      adjust   image positions · rate                          on one machine
      seams    photos · rate, with --seams graph-cut           on all machines
      mosaic   photos · megapixels · rate + output · rate      on all machines
    A stage takes the longest of its processors, its reading and its writing. Rates of your own machine are made by
    `python -m benchmarks.rates FOLDER --out rates.json` in the source tree.
    """
    from geomosaic.planning.solve import plan

    found = plan("run", **options)
    facts = {**asdict(found), "seconds": found.seconds, "processor_seconds": found.processor_seconds}
    lines = [
        f"{counted(found.photos, 'photo')}, {found.area / 1e6:.4g} km², mosaic of {found.pixels / 1e9:.4g} gigapixels"
        + (f", {found.positions} image positions in {found.pairs} pairs" if found.positions else ""),
        f"{'':8} {'time':>9} {'processor':>11} {'cores':>6} {'read':>9} {'written':>9} {'memory':>9}  limited by",
    ]
    for stage in found.stages:
        read, written, memory = (_size(size) for size in (stage.read_bytes, stage.written_bytes, stage.memory))
        lines.append(
            f"{stage.name:8} {_duration(stage.seconds):>9} {_duration(stage.processor_seconds):>11} {stage.cores:>6} "
            f"{read:>9} {written:>9} {memory:>9}  {stage.limited_by}"
        )
    price = "" if found.cost is None else f", cost {_number(found.cost)}"
    lines.append(f"{_duration(found.seconds)} in all, {_number(found.core_hours)} core hours{price}")
    machine = found.rates["machine"]
    lines.append(f"rates of {found.rates['date']}: {machine.get('processor', '?')}, {machine.get('cores', '?')} cores")
    answer(facts, "\n".join([*lines, *(f"does not fit: {text}" for text in found.misfits)]), as_json)


def _number(value: float) -> str:
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"


def _size(size: float) -> str:
    """Bytes in GB or TB."""
    return f"{size / 1e12:.3g} TB" if size >= 1e12 else f"{size / 1e9:.3g} GB"


def _duration(seconds: float) -> str:
    """Time in the unit that suits it."""
    for limit, unit in ((100.0, "s"), (6000.0, "min"), (48 * 3600.0, "h")):
        if seconds < limit:
            return f"{seconds / {'s': 1, 'min': 60, 'h': 3600}[unit]:.3g} {unit}"
    return f"{seconds / 86400:.3g} d"


def _range(least: float | None, most: float | None, unit: str) -> str:
    def one(value: float) -> str:
        return f"1:{value:.0f}" if unit == "1:" else f"{value:.4g} {unit}"

    if least is None:
        return f"<= {one(most or 0.0)}"
    return f">= {one(least)}" if most is None else f"{least:.4g} to {one(most)}"


@command.command("tables")
@stack(options_of(TableOptions), running_options)
def tables_command(as_json: bool, options: dict[str, Any]) -> None:
    """Tables of K-2.8 for any scale: heights, grid intervals, pixels, radial shifts, accuracy.

    \b
    Formulas (K-2.8, guidelines on orthophoto maps, 2001):
      error of position = 0.3 mm · M_ortho
      largest error of heights = m_O · (140 mm / r) · (c / 150 mm)
      radial shift on the map = dZ · r / (c · M_ortho), in the photo's corner (r = 140 mm)
      pixel = 0.08 mm (grey) or 0.10 mm (colour) · M_ortho
      scanning pixels are usual ones: 12-25 µm in grey, 20-30 µm in colour
      photo scales and grid intervals have no formula: they are given for 1:2000, 1:5000 and 1:10 000
    """
    from geomosaic.planning.solve import plan

    found = plan("tables", **options)
    answer({"tables": [asdict(one) for one in found]}, "\n\n".join(map(_table_text, found)), as_json)


def _table_text(one: ScaleTable) -> str:
    interval = one.dem_interval
    lines = [
        f"{scale_text(one.ortho_scale)}: error of position {one.position_error:g} m"
        + (f", K = {one.ratio:g}" if one.ratio else ""),
        "  scanning pixel "
        + ", ".join(f"{low:g}-{high:g} µm {film}" for film, (low, high) in one.scan_pixel.items())
        + (", photos {} to {}".format(*map(scale_text, one.photo_scale)) if one.photo_scale else ""),
        "  pixel "
        + ", ".join(
            f"{round(v * 100, 1):.10g} cm {film} ({int(one.ortho_dpi[film])} dpi)"
            for film, v in one.ortho_pixel.items()
        ),
        f"  grid of the DEM {interval['easy'][0]:g}-{interval['easy'][1]:g} m in easy, "
        f"{interval['difficult'][0]:g}-{interval['difficult'][1]:g} m in difficult terrain"
        if interval
        else "  grid of the DEM: K-2.8 has none for this scale",
    ]
    for c, by_radius in one.dem_error.items():
        limits = ", ".join(f"{v:.1f} m at r = {float(r) / 10:g} cm" for r, v in by_radius.items())
        shifts = ", ".join(f"{z} m {v:.1f} mm" for z, v in one.shift_mm[c].items())
        lines += [f"  c = {c} mm: heights to {limits}", f"    shift in the corner: {shifts}"]
    return "\n".join(lines)
