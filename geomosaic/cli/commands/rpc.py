"""Fit RPCs to any sensor, refine them, and write them.

Help group: Orientation and accuracy
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomosaic.cli.options import FILE, block_of, image_options, options_of, running_options, stack
from geomosaic.cli.output import answer, notes
from geomosaic.errors import InputError
from geomosaic.options.control import RpcOptions, TieOptions
from geomosaic.options.inputs import QualityLimits

if TYPE_CHECKING:
    from geomosaic.rpc.refine import ImageRpc

rpc_options = stack(
    click.option("--refine", metavar="KIND", help="Correct RPCs: shift, drift (shift and drift) or affine."),
    options_of(TieOptions, "tied"),
    options_of(RpcOptions, "files"),
    options_of(QualityLimits, "limits", made=True, only=("max_corner_sigma_px",)),
)


@click.command()
@click.argument("images", type=FILE, nargs=-1, required=True, metavar="IMAGE...")
@stack(rpc_options, image_options, running_options)
def command(
    images: tuple[Path, ...],
    as_json: bool,
    inputs: dict[str, Any],
    files: dict[str, Any],
    tied: dict[str, Any],
    limits: QualityLimits,
    refine: str | None,
) -> int:
    """Fit RPCs to images of any sensor, or refine those they have, and write them.

    \b
    Examples:
      geomosaic rpc IMAGERY.TIF --sensor pushbroom --height-range 0 900 --text
      geomosaic rpc scene.tif --refine shift --gcps gcps.csv --crs EPSG:32635 \\
        --heights ellipsoidal --tags --overwrite
      geomosaic rpc left.tif right.tif --refine shift --ties ties.csv --text --folder refined
    """
    from geomosaic.cli.results import placement_failure, quality_facts, verdict
    from geomosaic.rpc.write import fit_rpc, refine_rpc
    from geomosaic.sensor.registry import rational_sensor

    if not {"sensor", "exterior", "camera"} & inputs.keys():
        inputs["sensor"] = rational_sensor()
    block = block_of(images, inputs)
    # The library has a function for either; what only the other takes would do nothing.
    if useless := next((name for name in (files.keys() & {"grid"} if refine else tied)), None):
        what = "belongs to RPCs that are fitted" if refine else "refines RPCs"
        raise InputError(
            f"`{useless}` {what}", hint="leave it out" if refine else "add `refine`: shift, drift or affine"
        )
    with notes():
        if refine:
            made = refine_rpc(block, refine, **tied, **files)
        else:
            made = fit_rpc(block, **files)
    facts = [
        {"image": one.name, "how": one.how, **one.facts, "written": [str(path) for path in one.written]} for one in made
    ]
    known = [one.facts["accuracy"] for one in made if "accuracy" in one.facts]
    worst = max(known, key=lambda one: one["largest_sigma_px"] or float("inf"), default=None)
    failure = placement_failure({"accuracy": worst}, None, limits)
    said = "\n".join(line for one in made for line in _summary_lines(one))
    answer({"images": facts, **quality_facts(failure)}, said, as_json)
    return verdict(failure, as_json)


def _summary_lines(one: ImageRpc) -> list[str]:
    """Lines on the RPC of one image: fit, correction, check points and files."""
    facts = one.facts
    lines = [f"{one.name}: RPC {one.how if one.how in ('fitted', 'as it came') else f'refined by {one.how}'}"]
    if "fit_worst_px" in facts:
        low, high = facts["heights_m"]
        lines.append(
            f"  fitted to ellipsoidal heights from {low:g} to {high:g} m: {facts['fit_rms_px']:.2g} px RMS, "
            f"{facts['fit_worst_px']:.2g} px at most at {facts['fit_checks']} points between those of the fit"
        )
    if "grid_worst_px" in facts:
        columns, rows = facts["grid_nodes"]
        lines.append(
            f"  with the grid ({columns} x {rows} nodes; --corrections, geomosaic only): {facts['grid_rms_px']:.2g} px "
            f"RMS, {facts['grid_worst_px']:.2g} px at most"
        )
    if "rms_before_px" in facts:
        lines.append(f"  residuals {facts['rms_before_px']:.3f} px RMS before, {facts['rms_after_px']:.3f} px after")
        sigmas = facts["sigmas_px"]
        lines += [
            f"  {name} {value:+.3f} px" + (f", sigma {sigmas[name]:.3f}" if sigmas[name] is not None else "")
            for name, value in facts["corrections_px"].items()
        ]
    lines += [f"  {line}" for line in facts.get("summary", ())]
    if facts.get("left_out"):
        left = facts["left_out"]
        lines.append(f"  left out: {', '.join(left)}" if isinstance(left, list) else f"  {left} tie points left out")
    if "checks" in facts:
        lines.append(
            f"  check points: {facts['check_rms_before_px']:.3f} px RMS before, {facts['check_rms_after_px']:.3f} px "
            f"after ({facts['checks']})"
        )
    if "rewritten_worst_px" in facts:
        lines.append(f"  corrections fitted into the coefficients within {facts['rewritten_worst_px']:.2g} px")
    return lines + [f"  written: {path}" for path in one.written]
