"""Accuracy, places and drawings in words, and as plain values for JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.cli.results import grid_facts
from geomosaic.errors import counted, listed
from geomosaic.whole_files import finite

if TYPE_CHECKING:
    from geomosaic.accuracy.check_points import MapCheck
    from geomosaic.georeferencing.drawing import GeoreferencedVectors
    from geomosaic.georeferencing.run import Georeferenced
    from geomosaic.georeferencing.vectors import CarriedVectors
    from geomosaic.monoplotting.run import DrawnVectors, Located


# Points that are listed; --json has them all.
MOST = 40


def check_facts(found: MapCheck) -> dict[str, Any]:
    """Accuracy at check points as plain values, with all points.

    Parameters
    ----------
    found : MapCheck

    Returns
    -------
    dict
        JSON values.
    """
    from geomosaic.georeferencing.report import diagnostic_facts, statistics_facts

    points = zip(found.ids, found.measured, found.true, found.pixel_errors, found.statistics.errors, strict=True)
    return {
        "raster": str(found.raster),
        "points_file": str(found.points),
        "grid": grid_facts(found.grid),
        **statistics_facts(found.statistics),
        "rms_px": list(found.pixel_rms),
        "rms_total_px": found.pixel_rms_total,
        "notes": list(found.notes),
        "diagnostics": diagnostic_facts(found.diagnostics),
        "points": [
            {
                "id": name,
                "col": float(at[0]),
                "row": float(at[1]),
                "x": float(xy[0]),
                "y": float(xy[1]),
                "error_px": [finite(v) for v in pixel],
                "error_map": [finite(v) for v in error],
            }
            for name, at, xy, pixel, error in points
        ],
    }


def check_text(found: MapCheck) -> str:
    """Accuracy at check points in words: the points of the largest errors, RMS, and statements by NSSDA and ASPRS.

    Parameters
    ----------
    found : MapCheck
    """
    import numpy as np

    s, unit = found.statistics, found.statistics.unit
    order = np.argsort(-np.hypot(*s.errors.T), kind="stable")[:MOST]
    wide = max([5, *(len(found.ids[i]) for i in order)])
    lines = [f"{'point':<{wide}} {'x, ' + unit:>10} {'y, ' + unit:>10} {'col, px':>9} {'row, px':>9}"]
    for i in order:
        (x, y), (col, row) = s.errors[i], found.pixel_errors[i]
        lines.append(f"{found.ids[i]:<{wide}} {x:>+10.4g} {y:>+10.4g} {col:>+9.3f} {row:>+9.3f}")
    if len(found.ids) > MOST:
        lines.append(f"... the {MOST} largest of {len(found.ids)}; --json has them all")
    (x, y), (col, row) = s.rms, found.pixel_rms
    count = counted(len(s), "check point")
    lines += [
        f"{count}: RMS x {x:.4g}, y {y:.4g}, total {s.rms_total:.4g} {unit}",
        f"in pixels: RMS col {col:.3f}, row {row:.3f}, total {found.pixel_rms_total:.3f}",
        f"about 95 % of points lie within {s.circular_error_95:.4g} {unit} (2.5 x RMS of one axis)",
        s.shift_statement,
        s.nssda_statement,
        s.asprs_statement,
    ]
    return "\n".join(lines)


def georeference_text(made: Georeferenced | GeoreferencedVectors) -> str:
    """Georeferencing in words: the fit, its errors, and what was drawn.

    Parameters
    ----------
    made : Georeferenced or GeoreferencedVectors
    """
    from geomosaic.cli.results import ortho_text
    from geomosaic.georeferencing.run import Georeferenced

    solution, accuracy = made.solution, made.facts["accuracy"]
    states = made.facts["control"]
    counts = [counted(accuracy["points"], "control point")]
    counts += [counted(states["check"], "check point")] * bool(states["check"])
    counts += [f"{states[state]} {word}" for state, word in STATES.items() if states[state]]
    out = [name for name, state in zip(solution.control.names, solution.states, strict=True) if state == "suspect"]
    counts += [f"left out as wrong: {listed(out, 12)}"] * bool(out)
    lines = [
        f"{solution.model}: {solution.why}",
        f"fitted in {made.facts['fit']['crs']}",
        f"{', '.join(counts)}; redundancy {accuracy['redundancy']}",
        *_errors(accuracy, made.facts["fit"]["length_unit"]),
    ]
    if solution.deletion is not None:
        lines.append(solution.deletion.summary)
    if solution.check is not None:
        check = made.facts["check"]
        lines.append(
            f"{counted(check['check_points'], 'check point')}: RMS {check['px']['rms_total']:.3f} px, "
            f"{check['rms_total']:.3g} {check['unit']}; {check['shift_statement']}"
        )
    carried = made.carried
    if isinstance(made, Georeferenced):
        lines.append(ortho_text(made.product))
    else:
        lines.append(f"{made.facts['control']['notes'][-1]}")
    if carried is not None:
        lines.append(_carried_text(carried))
    beside = [str(path) for path in (made.page, made.report, made.vectors) if path]
    return "\n".join(lines + ([f"control report: {', '.join(beside)}"] if beside else []))


def _carried_text(carried: CarriedVectors) -> str:
    """Vectors on the map, in words."""
    layers = ", ".join(f"{name}: {counted(count, 'feature')}" for name, count in carried.layers.items())
    lost = f"; left out, as the fit has no ground for them: {counted(carried.lost, 'feature')}" if carried.lost else ""
    put = f"vertices put in where the fit bends lines by more than {carried.tolerance_px:g} px: {carried.added}"
    return f"{carried.path}: {layers}{lost}; {put}; {carried.crs.name}"


STATES = {"deleted": "deleted", "disabled": "not enabled"}


def _errors(accuracy: dict[str, Any], unit: str) -> list[str]:
    """Lines of errors at control points and corners; zero residuals of a fit through its points are no news."""
    from geomosaic.estimation.expected_errors import FITS_EXACTLY, share_text

    left_out, expected = accuracy["leave_one_out"], accuracy["expected"]
    rms = f"leave-one-out: RMS {_both(left_out, 'rms_total', unit)}"
    if accuracy["headline"] == "leave_one_out":
        found = [f"{rms}; 95 % within {_both(left_out, 'circular_error_95', unit)}"] if left_out["points"] else []
        return [*found, f"residuals: none, the fit {FITS_EXACTLY}", expected["said"]]
    residuals = accuracy["residuals"]
    within = f"95 % within {_both(residuals, 'circular_error_95', unit)}{share_text(expected)}"
    return [f"residuals: RMS {_both(residuals, 'rms_total', unit)}; {within}", rms, expected["said"]]


def _both(part: dict[str, Any], key: str, unit: str) -> str:
    if part["px"][key] is None:
        return "not known (nothing checks the points)"
    return f"{part['px'][key]:.3f} px, {part['m'][key]:.3g} {unit}"


def located_facts(found: Located, output: Path | None) -> dict[str, Any]:
    """Places on the ground as plain values.

    Parameters
    ----------
    found : Located
    output : Path or None
        File that was written, if any.

    Returns
    -------
    dict
        JSON values.
    """
    from geomosaic.geo.crs import authority_code, height_name, horizontal
    from geomosaic.monoplotting.run import POINT

    crs = found.places.crs
    return {
        "crs": authority_code(horizontal(crs)) or horizontal(crs).to_wkt(),
        "heights": height_name(crs),
        "error_of": list(found.uncertainty.known),
        "notes": list(found.uncertainty.notes),
        "points": [dict(zip(POINT, row, strict=True)) for row in found.rows()],
        "features": found.features,
        "lost": found.lost,
        "outside": list(found.outside),
        "output": None if output is None else str(output),
    }


def located_text(found: Located, output: Path | None) -> str:
    """Places on the ground in words; listed only where no file holds them.

    Parameters
    ----------
    found : Located
    output : Path or None
        File that was written, if any.
    """
    from geomosaic.inputs.vertical_datums import frame_description

    places = found.places
    metres = not places.crs.is_geographic
    lines = [frame_description(places.crs)]
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
    if found.uncertainty.known:
        lines.append(f"errors (one standard deviation) of {', '.join(found.uncertainty.known)}")
    return "\n".join([*lines, *found.uncertainty.notes])


def drawn_facts(drawn: DrawnVectors, output: Path) -> dict[str, Any]:
    """Map vectors drawn into a photo, as plain values.

    Parameters
    ----------
    drawn : Drawn
    output : Path

    Returns
    -------
    dict
        JSON values.
    """
    return {
        "output": str(output),
        "features": drawn.features,
        "drawn": drawn.drawn,
        "pieces": drawn.pieces,
        "hidden": drawn.hidden,
    }


def drawn_text(drawn: DrawnVectors, output: Path) -> str:
    """Map vectors drawn into a photo, in words.

    Parameters
    ----------
    drawn : Drawn
    output : Path
    """
    hidden = f", {drawn.hidden} of them hidden" if drawn.hidden else ""
    return f"{output}: {drawn.drawn} of {drawn.features} features in the photo, {drawn.pieces} pieces{hidden}"
