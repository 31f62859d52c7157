"""`geomosaic plan tables`."""

from __future__ import annotations

from typing import Any

import click

from geomosaic.cli.options import debug_option, json_option
from geomosaic.cli.talk import answer
from geomosaic.cli.values import Measure, Scale

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
