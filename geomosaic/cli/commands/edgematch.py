"""Join lines of neighbouring map sheets at their edges.

Help group: Maps
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from geomosaic.cli.options import FILE, file_options, options_of
from geomosaic.cli.options import command as grouped_command
from geomosaic.cli.output import answer, notes
from geomosaic.errors import counted
from geomosaic.options.vector_edges import VectorEdgeOptions


@grouped_command()
@click.argument("sheets", type=FILE, nargs=-1, required=True, metavar="SHEET SHEET...")
@options_of(VectorEdgeOptions)
@file_options("GeoPackage to write.")
def command(sheets: tuple[Path, ...], output: Path, overwrite: bool, as_json: bool, options: dict[str, Any]) -> None:
    """Join lines of neighbouring map sheets (vectors) at their edges.

    Ends within the tolerance meet; each sheet is bent to them by its weight. Attributes are compared, and ends that met
    none are listed: layers edge_joins, edge_differences and edge_unmatched of the output.

    \b
    Example:
      geomosaic edgematch north.gpkg south.gpkg --tolerance 2 --same kind -o joined.gpkg
    """
    from geomosaic.products.vector_edges import match_vector_edges

    with notes():
        made = match_vector_edges(sheets, output, overwrite=overwrite, **options)
    rms, largest = made.before
    facts = {**asdict(made), "path": str(made.path), "before": [rms, largest] if made.places else None}
    lines = [f"{made.path}: ends meet at {counted(made.places, 'place')}"]
    if made.places:
        moved = ", ".join(f"{name} {length:.3g}" for name, length in zip(made.sheets, made.moved, strict=True))
        lines.append(f"apart before: {rms:.3g} RMS, largest {largest:.3g}; after: {made.after:.1g} (map units)")
        lines.append(f"moved at most: {moved}")
    lines.append(f"ends beside a neighbour that met none: {made.unmatched}; attributes that differ: {made.differences}")
    answer(facts, "\n".join(lines), as_json)
