"""Calculate scales, scanning, relief, swath, coverage, control.

Help group: Calculations and lists
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import click

from geomosaic.cli.options import debug_option, json_option
from geomosaic.cli.output import answer
from geomosaic.cli.values import Measure, Scale
from geomosaic.planning.relations import QUANTITIES, TOPICS, Quantity, Relation, shown

RADII = (35.0, 70.0, 140.0)
HEIGHT_ERRORS = (0.5, 1.0, 2.0, 3.0, 5.0, 10.0)


@click.command("tables")
@click.option(
    "--ortho-scale", "scales", type=Scale(), multiple=True, default=(2000.0, 5000.0, 10000.0), show_default=True,
    help="Scale of the photo map; any number of times.",
)  # fmt: skip
@click.option(
    "--camera-constant", "constants", type=Measure("mm"), multiple=True, default=(150.0, 300.0), show_default=True,
    metavar="MM", help="Camera constant; any number of times.",
)  # fmt: skip
@json_option
@debug_option
def tables_command(scales: tuple[float, ...], constants: tuple[float, ...], as_json: bool) -> None:
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
    facts = [_of_scale(scale, constants) for scale in scales]
    answer({"tables": facts}, "\n\n".join(_words(one) for one in facts), as_json)


def _of_scale(scale: float, constants: tuple[float, ...]) -> dict[str, Any]:
    from geomosaic.planning import k28

    row = k28.INTERVALS.get(round(scale))
    return {
        "ortho_scale": scale,
        "ratio": k28.RATIOS.get(round(scale)),
        "photo_scale": None if row is None else list(row.photo),
        "scan_pixel": {film: list(k28.SCAN_UM[film]) for film in ("grey", "colour")},
        "position_error": k28.position_error(scale),
        "ortho_pixel": {film: k28.ortho_pixel(scale, film) for film in ("grey", "colour")},
        "ortho_dpi": {film: k28.dpi_of(film) for film in ("grey", "colour")},
        "dem_interval": None if row is None else {"easy": list(row.easy), "difficult": list(row.difficult)},
        "dem_error": {f"{c:g}": {f"{r:g}": k28.height_error(scale, c, r) for r in RADII} for c in constants},
        "shift_mm": {f"{c:g}": {f"{z:g}": k28.radial_shift(z, scale, c) for z in HEIGHT_ERRORS} for c in constants},
    }


def _words(one: dict[str, Any]) -> str:
    interval = one["dem_interval"]
    lines = [
        f"1:{one['ortho_scale']:.0f}: error of position {one['position_error']:g} m"
        + (f", K = {one['ratio']:g}" if one["ratio"] else ""),
        "  scanning pixel "
        + ", ".join(f"{low:g}-{high:g} µm {film}" for film, (low, high) in one["scan_pixel"].items())
        + (", photos 1:{:g} to 1:{:g}".format(*one["photo_scale"]) if one["photo_scale"] else ""),
        "  pixel "
        + ", ".join(
            f"{v * 100:.3g} cm {film} ({int(one['ortho_dpi'][film])} dpi)" for film, v in one["ortho_pixel"].items()
        ),
        f"  grid of the DEM {interval['easy'][0]:g}-{interval['easy'][1]:g} m in easy, "
        f"{interval['difficult'][0]:g}-{interval['difficult'][1]:g} m in difficult terrain"
        if interval
        else "  grid of the DEM: K-2.8 has none for this scale",
    ]
    for c, by_radius in one["dem_error"].items():
        limits = ", ".join(f"{v:.1f} m at r = {float(r) / 10:g} cm" for r, v in by_radius.items())
        shifts = ", ".join(f"{z} m {v:.1f} mm" for z, v in one["shift_mm"][c].items())
        lines += [f"  c = {c} mm: heights to {limits}", f"    shift in the corner: {shifts}"]
    return "\n".join(lines)


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
      geomosaic plan photo --height 3000 --camera-constant 150 --ortho-scale 1:5000
      geomosaic plan swath --field 90 --height 6000
      geomosaic plan product --ortho-scale 1:10000 --camera-constant 150
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
        from geomosaic.planning.solve import bound, derive, limits

        known = {key: value for key, value in given.items() if value is not None}
        found = derive(relations, known)
        derived = {item.name: item.value for item in found}
        facts: dict[str, object] = {
            "given": known,
            "derived": derived,
            "formulas": {item.name: item.relation.formula for item in found},
        }
        used = [item.relation for item in found]
        kept = [item for item in limits(relations, known | derived) if item.relation not in used]
        if kept:
            facts["limits"] = {item.name: {"limit": item.limit, "kept": item.kept} for item in kept}
        width = max(len(QUANTITIES[name].text) for name in [*derived, *(item.name for item in kept)])
        lines = [
            f"{QUANTITIES[item.name].text:<{width}}  {shown(item.name, item.value):>12}   {item.relation.formula}"
            for item in found
        ]
        lines += [
            f"{QUANTITIES[item.name].text:<{width}}  {shown(item.name, (known | derived)[item.name]):>12}   "
            f"{'keeps' if item.kept else 'MISSES'} {bound(item.relation)} {shown(item.name, item.limit)}: "
            f"{item.relation.formula}"
            for item in kept
        ]
        answer(facts, "\n".join(lines), as_json)

    options: list[click.Parameter] = [_option(quantity, QUANTITIES[quantity]) for quantity in wanted]
    made = click.Command(
        name, params=options, callback=call, short_help=SUMMARIES[name],
        help=f"{SUMMARIES[name]}\n\nGive what is known; what follows is printed.\n\n\b\nFormulas:\n{formulas}",
    )  # fmt: skip
    return debug_option(json_option(made))


for _name, _relations in TOPICS.items():
    command.add_command(_topic(_name, _relations))
command.add_command(tables_command)


@command.command("area")
@click.option(
    "--area", nargs=2, type=Measure("m"), required=True, metavar="LENGTH WIDTH", help="Along and across, metres."
)
@click.option("--photo-scale", type=Scale(), required=True, help="Scale of the photo.")
@click.option(
    "--format-along", type=Measure("mm"), default=230.0, show_default=True, metavar="MM", help="Side along the strip."
)
@click.option(
    "--format-across", type=Measure("mm"), default=230.0, show_default=True, metavar="MM", help="Side across it."
)
@click.option("--overlap", type=Measure("%"), metavar="PERCENT", help="Along the strip.  [default: 60]")
@click.option("--sidelap", type=Measure("%"), metavar="PERCENT", help="Of the strips.  [default: 30]")
@click.option("--strips", type=click.IntRange(1), help="So many strips, instead of --sidelap, which follows.")
@click.option("--photos-in-strip", type=click.IntRange(1), help="So many photos, instead of --overlap, which follows.")
@click.option("--mono", is_flag=True, help="Each place on one photo is enough, instead of on two.")
@click.option("--ortho-pixel", type=Measure("m"), metavar="METRES", help="Tell the size of the raster too.")
@json_option
@debug_option
def area_command(area: tuple[float, float], ortho_pixel: float | None, mono: bool, as_json: bool, **flags: Any) -> None:
    """Number of strips and photos that cover a rectangle, or the overlaps that a number of them has.

    \b
    Formulas (geometry of the vertical photo):
      base = (1 - overlap/100) · format along · M_photo
      spacing = (1 - sidelap/100) · format across · M_photo
      strips = ⌈(width - format across · M_photo) / spacing⌉ + 1
      photos in a strip = ⌈length / base⌉ + 1, with --mono ⌈(length - side) / base⌉ + 1
    """
    from geomosaic.planning.coverage import coverage, raster_size

    for lap, number, usual in (("overlap", "photos_in_strip", 60.0), ("sidelap", "strips", 30.0)):
        if flags[lap] is not None and flags[number] is not None:
            raise click.UsageError(f"--{number.replace('_', '-')} says what the {lap} is: leave out --{lap}")
        flags[lap] = usual if flags[lap] is None else flags[lap]
    found = coverage(*area, stereo=not mono, **flags)
    facts: dict[str, Any] = {
        "photos": found.photos, "strips": found.strips, "photos_in_strip": found.photos_in_strip,
        "base": found.base, "spacing": found.spacing, "overlap": found.overlap, "sidelap": found.sidelap,
        "footprint": list(found.footprint),
    }  # fmt: skip
    lines = [
        f"{found.photos} photos: {found.strips} strips of {found.photos_in_strip}",
        f"exposures every {found.base:.6g} m, strips every {found.spacing:.6g} m, "
        f"{found.footprint[0]:.6g} x {found.footprint[1]:.6g} m on a photo",
        f"overlap {found.overlap:.4g} %, sidelap {found.sidelap:.4g} %",
    ]
    if ortho_pixel is not None:
        size = raster_size(*area, ortho_pixel)
        facts["raster"] = list(size)
        lines.append(f"raster of {size[0]} x {size[1]} pixels (columns across, rows along)")
    answer(facts, "\n".join(lines), as_json)


@command.command("control")
@click.option("--model", default="affine", show_default=True, help="Model of the image.")
@click.option(
    "--points", type=click.IntRange(4), help="Show where so many should lie, and for which models they are enough."
)
@click.option("--photos", type=click.IntRange(1), help="Photos adjusted together, for the balance of the block.")
@click.option("--ties", type=click.IntRange(0), default=0, help="Connections of two photos by a tie point.")
@click.option("--control", type=click.IntRange(0), default=0, help="Measurements of control points in photos.")
@json_option
@debug_option
def control_command(model: str, points: int | None, photos: int | None, ties: int, control: int, as_json: bool) -> None:
    """Number and layout of control points.

    \b
    Sources:
      Wolf, 9-3: roughly 8 to 15 per image, in the four corners and evenly between them
      Jensen: 20 to begin with, where the worst are left out until the RMS is below a threshold
      Wolf, 9-8: block: unknowns = photos · unknowns of the model; two equations for every
      measurement of control and every connection; a point on n photos makes n (n - 1) / 2 connections
    """
    from geomosaic.planning.coverage import FOR_FILTERING, block_balance, control_layout, control_number, models_of

    need = control_number(model)
    low, high = need.recommended
    facts: dict[str, Any] = {
        "model": model, "unknowns": need.unknowns, "least": need.least, "recommended": list(need.recommended),
        "for_filtering": FOR_FILTERING,
    }  # fmt: skip
    lines = [
        f"{model}: {need.unknowns} unknowns, {need.least} points determine them",
        f"{low} to {high} points per image are recommended, {max(FOR_FILTERING, high)} where bad ones are to be found",
    ]
    if points is not None:
        enough, twice = models_of(points)
        facts["determined"], facts["redundant"] = list(enough), list(twice)
        lines += [
            f"{points} points determine {', '.join(enough)}",
            f"and check each other (twice as many equations as unknowns) for {', '.join(twice) or 'none'}",
        ]
        places = control_layout(points)
        facts["layout"] = places.round(4).tolist()
        lines += ["shares of width and height, in the order in which to measure:"]
        lines += [f"  {k:3d}  {x:.3f}  {y:.3f}" for k, (x, y) in enumerate(places.tolist(), 1)]
    if photos is not None:
        block = block_balance(photos, model, ties, control)
        facts["block"] = {
            "unknowns": block.unknowns, "tie_equations": block.tie_equations,
            "control_equations": block.control_equations, "redundancy": block.redundancy,
        }  # fmt: skip
        lines.append(
            f"{photos} photos: {block.unknowns} unknowns, {block.tie_equations} equations of ties and "
            f"{block.control_equations} of control: redundancy {block.redundancy}"
        )
    answer(facts, "\n".join(lines), as_json)


@command.command("product")
@click.option("--ortho-scale", type=Scale(), required=True, help="Scale of the photo map.")
@click.option(
    "--camera-constant", type=Measure("mm"), required=True, metavar="MM", help="Camera constant of the photos."
)
@click.option(
    "--film", type=click.Choice(["grey", "colour"]), default="colour", show_default=True, help="Of the photos."
)
@click.option("--ratio", type=float, help="K = M_photo / M_ortho.  [default: that of K-2.8]")
@click.option("--position-error", type=Measure("m"), metavar="METRES", help="Target.  [default: 0.3 mm on the map]")
@click.option(
    "--other-error", "other_errors", type=Measure("m"), multiple=True, metavar="METRES",
    help="An error of position that does not come from heights: orientation, identification.",
)  # fmt: skip
@click.option(
    "--radius", type=Measure("mm"), default=140.0, show_default=True, metavar="MM", help="Largest r that is used."
)
@json_option
@debug_option
def product_command(as_json: bool, **flags: Any) -> None:
    """From the quality of a photo map to what its inputs must be.

    \b
    Sources: K-2.8 (guidelines on orthophoto maps, 2001)
      error of position 0.3 mm on the map; K by scale; scan >= 320 dpi · K
      error of heights <= m_O · (140 mm / r) · (c / 150 mm); grid intervals by terrain
      errors that are independent add as squares: m_O² = m_DTM² + other²
    With --json > plan.json, `geomosaic check --target plan.json` holds the finished map against it.
    """
    from geomosaic.planning.product_quality import requirements

    found = requirements(**flags)
    facts: Mapping[str, Any] = {
        "requirements": [
            {"name": r.name, "least": r.least, "most": r.most, "unit": r.unit, "source": r.source} for r in found
        ]
    }
    width = max(len(r.text) for r in found)
    lines = [f"{r.text:<{width}}  {_range(r.least, r.most, r.unit):<18}  {r.source}" for r in found]
    answer(facts, "\n".join(lines), as_json)


def _range(least: float | None, most: float | None, unit: str) -> str:
    def one(value: float) -> str:
        return f"1:{value:.0f}" if unit == "1:" else f"{value:.4g} {unit}"

    if least is None:
        return f"<= {one(most or 0.0)}"
    return f">= {one(least)}" if most is None else f"{least:.4g} to {one(most)}"
