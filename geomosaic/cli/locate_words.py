"""Places found in an image, and what was drawn into it, in words and as plain values."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geomosaic.project.mono.draw import Drawn
    from geomosaic.project.mono.plot import Located


def located_facts(found: Located, output: Path | None) -> dict[str, Any]:
    """Plain values of places."""
    from geomosaic.geo.crs import height_name, horizontal
    from geomosaic.project.mono.plot import POINT

    crs = found.places.crs
    code = horizontal(crs).to_authority(min_confidence=100)
    return {
        "crs": f"{code[0]}:{code[1]}" if code else horizontal(crs).to_wkt(),
        "heights": height_name(crs),
        "error_of": list(found.certainty.known),
        "notes": list(found.certainty.notes),
        "points": [dict(zip(POINT, row, strict=True)) for row in found.rows()],
        "features": found.features,
        "lost": found.lost,
        "output": None if output is None else str(output),
    }


def located_words(found: Located, output: Path | None) -> str:
    """Say where the pixels lie."""
    from geomosaic.project.frames import describe

    places = found.places
    metres = not places.crs.is_geographic
    lines = [describe(places.crs)]
    for row in found.rows() if output is None else []:
        name, col, line, x, y, z, *error = row
        if x is None:
            lines.append(f"{name}: {col:g} {line:g} sees no known ground")
            continue
        place = f"{x:.3f} {y:.3f}" if metres else f"{x:.9f} {y:.9f}"
        text = f"{name}: {col:g} {line:g} -> {place} {z:.3f}"
        if error[0] is not None:
            text += f"  ellipse {error[0]:.3g} x {error[1]:.3g} m at {error[2]:.0f} deg, height {error[3]:.3g} m"
        lines.append(text)
    if output is not None:
        what = f"{found.features} features" if not found.names else f"{len(found.names)} points"
        lines.append(f"{output}: {what}")
    if found.lost:
        noun, end = ("points", "") if found.names else ("features", ": left out")
        lines.append(f"{found.lost} {noun} see ground that is not known, or none{end}")
    if found.certainty.known:
        lines.append(f"errors (one standard deviation) of {', '.join(found.certainty.known)}")
    return "\n".join([*lines, *found.certainty.notes])


def drawn_facts(drawn: Drawn, output: Path) -> dict[str, Any]:
    """Plain values of a drawing."""
    return {
        "output": str(output),
        "features": drawn.features,
        "drawn": drawn.drawn,
        "pieces": drawn.pieces,
        "hidden": drawn.hidden,
    }


def drawn_words(drawn: Drawn, output: Path) -> str:
    """Say what was drawn."""
    hidden = f", {drawn.hidden} of them hidden" if drawn.hidden else ""
    return f"{output}: {drawn.drawn} of {drawn.features} features in the photo, {drawn.pieces} pieces{hidden}"
