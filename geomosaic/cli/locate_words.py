"""Places found in an image, and what was drawn into it, in words and as plain values."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.errors import counted

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
        "outside": list(found.outside),
        "output": None if output is None else str(output),
    }


def located_words(found: Located, output: Path | None) -> str:
    """Say where the pixels lie."""
    from geomosaic.project.frames import describe

    places = found.places
    metres = not places.crs.is_geographic
    lines = [describe(places.crs)]
    for number, row in enumerate(found.rows() if output is None else []):
        name, col, line, x, y, z, *error = row
        if x is None:
            why = "lies outside the image" if number in found.outside else "sees no known ground"
            lines.append(f"{name}: {col:g} {line:g} {why}")
            continue
        place = f"{x:.3f} {y:.3f}" if metres else f"{x:.9f} {y:.9f}"
        text = f"{name}: {col:g} {line:g} -> {place} {z:.3f}"
        if error[0] is not None:
            text += f"  ellipse {error[0]:.3g} x {error[1]:.3g} m at {error[2]:.0f} deg, height {error[3]:.3g} m"
        lines.append(text)
    if output is not None:
        kept = len(found.names) if output.suffix.lower() == ".csv" else len(found.names) - found.lost
        what = counted(kept, "point") if found.names else counted(found.features, "feature")
        lines.append(f"{output}: {what}")
    if found.lost:
        noun, end = ("point", "no place") if found.names else ("feature", "no place and left out")
        beyond = f"; {len(found.outside)} outside the image" if found.outside else ""
        lines.append(f"{counted(found.lost, noun)} with {end}: the sky, or ground that is not known{beyond}")
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
