"""What tables say of points and images together: distances, lakes, planes, lines and rigs, as observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from geomosaic.block_adjustment.measurements import Measurements, image_numbers
from geomosaic.errors import InputError, counted, did_you_mean, listed, warn
from geomosaic.estimation.solver import Unknowns
from geomosaic.geo.local_frames import omega_phi_kappa
from geomosaic.image_names import file_name, stem
from geomosaic.inputs.tables import Row, read_table
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.object_constraints import CommonHeights, Distances, OnSurfaces
from geomosaic.orientation.block.observations import Group
from geomosaic.orientation.block.poses import Pose, RelativeAttitudes, RelativePositions
from geomosaic.types import FloatArray, IntArray

# Standard deviation (metres) of points on lakes, planes and lines whose table says none.
SIGMA = 0.05
# Points that determine a lake's height, a plane and a line: with no more, nothing is said of any of them.
NEEDED = {"lake": 1, "plane": 3, "line": 2}
# Width of the points of a plane over their length, below which they are on one line.
NARROW = 0.02
# Variation of a rig from exposure to exposure, metres and degrees, where its table says none.
SPREADS = (0.001, 0.005)
# Changes of a height or place (m) and of a rotation (degrees) that move an image by about a pixel.
STEPS = (0.1, 0.01)
BASE, ANGLES = ("dx", "dy", "dz"), ("omega", "phi", "kappa")


def of_points(
    measured: Measurements, frame: BlockFrame, points: FloatArray, options: AdjustmentOptions, further: list[Unknowns]
) -> list[Group]:
    """Distances, lakes, planes and lines.

    Parameters
    ----------
    measured : Measurements
    frame : BlockFrame
    points : array (S, 3)
        First coordinates in the frame; NaN of points without a place.
    options : AdjustmentOptions
    further : list of Unknowns
        Heights of lakes, places of planes and lines are added to it.

    Raises
    ------
    InputError
        Names file and line, or the lake, plane or line that its points do not determine.
    """
    number = {identity: index for index, identity in enumerate(measured.ids)}
    groups: list[Group] = []
    if options.distances is not None:
        groups.append(_distances(options.distances, number))
    tables = {"lake": options.lakes, "plane": options.planes, "line": options.lines}
    for kind, path in tables.items():
        if path is None:
            continue
        members = _members(path, kind, number)
        body, first = np.zeros(len(members.point), dtype=np.int64), len(further)
        axes, origins = np.zeros((len(body), 3, 3)), np.zeros((len(body), 3))
        for name in dict.fromkeys(members.name):
            mine = np.array([each == name for each in members.name])
            places = points[members.point[mine]]
            places = places[np.isfinite(places).all(axis=1)]
            body[mine] = len(further)
            if kind == "lake":
                height = float(np.median(frame.to_ground(places)[:, 2])) if len(places) else 0.0
                further.append(_free((f"lake {name}: height",), np.array([height]), STEPS[:1]))
            else:
                axes[mine], origins[mine], length = _fitted(places, f"{kind} {name}", path)
                labels = ("turn 1", "turn 2", "shift 1", "shift 2")[: 3 if kind == "plane" else 4]
                tilt = float(np.degrees(STEPS[0] / length))
                steps = (tilt, tilt, *STEPS[:1] * 2)[: len(labels)]
                names = tuple(f"{kind} {name}: {each}" for each in labels)
                further.append(_free(names, np.zeros(len(labels)), steps))
        if len(further) > first:
            groups.append(
                CommonHeights(members.point, body, members.sigma)
                if kind == "lake"
                else OnSurfaces(members.point, body, axes, origins, members.sigma, kind == "line")
            )
    return groups


def _free(names: tuple[str, ...], start: FloatArray, steps: Sequence[float]) -> Unknowns:
    return Unknowns(names, start, np.array(steps), np.full(len(names), np.inf))


def _distances(path: Path, number: dict[str, int]) -> Distances:
    table = read_table(path, "table of distances", "from,to,length,sigma")
    table.require("from", "to", "length", "sigma", what="distances")
    ends, values = [], []
    for row in table:
        pair = _point(row, "from", number), _point(row, "to", number)
        if pair[0] == pair[1]:
            what = f"a distance from point '{row.text('from')}' to itself"
            raise InputError(what, where=row.where, hint="name its two ends")
        length, sigma = row.number("length"), row.number("sigma")
        if not (length > 0.0 and sigma > 0.0):
            hint = "give both above 0"
            raise InputError(
                f"the length is {length:g} m, its standard deviation {sigma:g} m", where=row.where, hint=hint
            )
        ends.append(pair)
        values.append((length, sigma))
    pairs, lengths = np.array(ends), np.array(values)
    return Distances(pairs[:, 0], pairs[:, 1], lengths[:, 0], lengths[:, 1])


def _point(row: Row, column: str, number: dict[str, int]) -> int:
    """Number of a point that a table names."""
    name = row.text(column)
    if name not in number:
        similar = did_you_mean(name, number)
        what = f"point '{name}' is not measured in two images"
        raise InputError(what, where=row.where, hint=f"{similar} measure it, or leave the line out".strip())
    return number[name]


@dataclass(frozen=True, eq=False)
class _Members:
    """Points (N,) that belong to lakes, planes or lines, the names of these, and standard deviations (N,)."""

    point: IntArray
    name: list[str]
    sigma: FloatArray


def _members(path: Path, kind: str, number: dict[str, int]) -> _Members:
    """Points of a table, those of lakes, planes or lines left out that say nothing."""
    table = read_table(path, f"table of {kind}s", f"id,{kind},sigma")
    # Elsewhere a column 'line' is that of an image's row, and it is read by this name.
    column = "row" if kind == "line" and "row" in table.columns else kind
    table.require("id", column, what=f"points on {kind}s")
    rows: dict[str, dict[int, tuple[float, str]]] = {}
    lakes: dict[int, tuple[str, str]] = {}
    for row in table:
        point, name = _point(row, "id", number), row.text(column)
        sigma = row.number("sigma", SIGMA)
        if not sigma > 0.0:
            raise InputError(f"the standard deviation is {sigma:g} m", where=row.where, hint="give metres above 0")
        own = rows.setdefault(name, {})
        other, where = lakes.setdefault(point, (name, row.where)) if kind == "lake" else (name, "")
        if point in own or other != name:
            at = own[point][1] if point in own else where
            what = f"point '{row.text('id')}' is on {kind} '{other}' already ({at})"
            raise InputError(what, where=row.where, hint="keep one of the two lines")
        own[point] = (sigma, row.where)
    idle = [name for name, own in rows.items() if len(own) <= NEEDED[kind]]
    more = f"a {kind} needs {counted(NEEDED[kind] + 1, 'point')} that are measured"
    if len(idle) == len(rows):
        raise InputError(f"no {kind} has enough points", where=str(path), hint=f"{more}: add some")
    if idle:
        text = f"{path}: {counted(len(idle), kind)} with too few points, left out: {listed(idle, 6)}; {more}"
        warn(text)
    kept = [(point, name, sigma) for name, own in rows.items() if name not in idle for point, (sigma, _) in own.items()]
    return _Members(
        np.array([point for point, *_ in kept]), [name for _, name, _ in kept], np.array([sigma for *_, sigma in kept])
    )


def _fitted(places: FloatArray, name: str, path: Path) -> tuple[FloatArray, FloatArray, float]:
    """Axes (3, 3) and origin (3,) of a plane or a line through places (N, 3), and how long it is, RMS."""
    needed = NEEDED[name.partition(" ")[0]]
    if len(places) < needed:
        # Too few have a place: their rays do not meet, and its observations wait with them.
        return np.eye(3), np.zeros(3), 1.0
    origin = places.mean(axis=0)
    sizes, axes = np.linalg.svd(places - origin)[1:]
    length = max(float(sizes[0]) / np.sqrt(len(places)), 1e-3)
    if name.startswith("plane"):
        if sizes[1] < NARROW * sizes[0]:
            what = f"the points of {name} lie on one line, about which it turns freely"
            raise InputError(what, where=str(path), hint="add points beside them, or give them as a line (`lines`)")
    else:
        axes = axes[[1, 2, 0]]
    return axes * np.linalg.det(axes), origin, length


@dataclass(frozen=True, eq=False)
class _Rig:
    """Exposures of a rig: the images of each, what is known of its base and rotation, and the spreads of each."""

    name: str
    pairs: list[tuple[int, int]]
    spreads: list[tuple[float, float]]
    base: tuple[FloatArray, float] | None
    angles: tuple[FloatArray, float] | None


def of_rigs(names: Sequence[str], poses: Sequence[Pose | None], path: Path, further: list[Unknowns]) -> list[Group]:
    """Relative positions and attitudes of the cameras of rigs.

    Parameters
    ----------
    names : sequence of str (M,)
        Of the images.
    poses : sequence of Pose or None (M,)
        First poses in the block's frame; None where the sensor has none.
    path : Path
        Table: from, to, rig, dx, dy, dz, omega, phi, kappa, sigma_base, sigma_angle, spread_base, spread_angle.
    further : list of Unknowns
        Bases and rotations are added to it.

    Raises
    ------
    InputError
        Names file and line.
    """
    pairs, spreads, turns, of_base = (
        list[tuple[int, int]](),
        list[tuple[float, float]](),
        list[FloatArray](),
        list[int](),
    )
    axes = ("right", "down", "forward")
    for rig in _rigs(path, names, poses):
        both = [(poses[a], poses[b]) for a, b in rig.pairs]
        seen = [(a.rotation @ (b.centre - a.centre), b.rotation @ a.rotation.T) for a, b in both if a and b]
        base, sigma = rig.base or (np.median([each for each, _ in seen], axis=0), np.inf)
        labels = tuple(f"rig {rig.name}, base: {axis}" for axis in axes)
        turn = Rotation.from_matrix([each for _, each in seen]).mean().as_matrix()
        if rig.angles is not None:
            turn = omega_phi_kappa(*np.radians(rig.angles[0]))
        pairs += rig.pairs
        spreads += rig.spreads
        turns += [turn] * len(rig.pairs)
        of_base += [len(further)] * len(rig.pairs)
        further.append(Unknowns(labels, base, np.full(3, STEPS[0]), np.full(3, sigma)))
        labels = tuple(f"rig {rig.name}, rotation: correction about {axis}" for axis in axes)
        sigma = np.inf if rig.angles is None else rig.angles[1]
        further.append(Unknowns(labels, np.zeros(3), np.full(3, STEPS[1]), np.full(3, sigma)))
    root, own = np.eye(3) / np.array(spreads)[:, :, None, None], np.array(of_base)
    first, second = np.array(pairs).T
    return [
        RelativePositions(first, second, root[:, 0], np.zeros((len(own), 3)), rig=own),
        RelativeAttitudes(first, second, root[:, 1], np.array(turns), rig=own + 1),
    ]


def _rigs(path: Path, names: Sequence[str], poses: Sequence[Pose | None]) -> list[_Rig]:
    table = read_table(path, "table of rigs", "from,to,rig,dx,dy,dz,omega,phi,kappa,sigma_base,sigma_angle")
    table.require("from", "to", what="rigs")
    number, rows = image_numbers(names), dict[str, list[tuple[Row, tuple[int, int]]]]()
    second: dict[int, str] = {}
    for row in table:
        pair = _image(row, "from", number, names, poses), _image(row, "to", number, names, poses)
        if pair[0] == pair[1]:
            raise InputError(f"{names[pair[0]]} is both images", where=row.where, hint="name the two of one exposure")
        if pair[1] in second:
            what = f"{names[pair[1]]} hangs on another image already ({second[pair[1]]})"
            raise InputError(what, where=row.where, hint="keep one of the two lines")
        second[pair[1]] = row.where
        rows.setdefault(row.values.get("rig", "").strip() or "1", []).append((row, pair))
    found = []
    for name, own in rows.items():
        base = _calibrated(own, BASE, "sigma_base")
        angles = _calibrated(own, ANGLES, "sigma_angle")
        if len(own) == 1 and (base is None or angles is None):
            what = f"rig '{name}' has one exposure, and its base or its rotation is not given"
            hint = "give dx, dy, dz (metres) and omega, phi, kappa (degrees), or leave the line out: it says nothing"
            raise InputError(what, where=own[0][0].where, hint=hint)
        spreads = [
            (_spread(row, "spread_base", SPREADS[0]), _spread(row, "spread_angle", SPREADS[1])) for row, _ in own
        ]
        found.append(_Rig(name, [pair for _, pair in own], spreads, base, angles))
    return found


def _image(row: Row, column: str, number: dict[str, int], names: Sequence[str], poses: Sequence[Pose | None]) -> int:
    """Number of an image that a table names."""
    name = row.text(column)
    found = number.get(file_name(name), number.get(stem(file_name(name))))
    if found is None:
        hint = did_you_mean(stem(file_name(name)), number) or f"the images are {listed(names, 4)}"
        raise InputError(f"no image of the block is named '{name}'", where=row.where, hint=hint)
    if poses[found] is None:
        what = f"{names[found]} has no camera position and attitude, as a scanner or RPC has none"
        raise InputError(what, where=row.where, hint="leave the line out: rigs are of frame cameras")
    return found


def _calibrated(
    rows: Sequence[tuple[Row, tuple[int, int]]], columns: tuple[str, ...], sigma: str
) -> tuple[FloatArray, float] | None:
    """Values (3,) that the lines of a rig give, and their standard deviation; None where they give none."""
    found: tuple[FloatArray, float] | None = None
    where = ""
    for row, _ in rows:
        given = [bool(row.values.get(column, "").strip()) for column in columns]
        if not any(given):
            continue
        if not all(given):
            hint = f"give {', '.join(columns)}, or none of them"
            raise InputError(f"only some of {', '.join(columns)} are given", where=row.where, hint=hint)
        value = np.array([row.number(column) for column in columns]), row.number(sigma, 0.0)
        if value[1] < 0.0:
            raise InputError(f"{sigma} is {value[1]:g}", where=row.where, hint="give 0 or more; 0 is exact")
        if found is not None and not (np.array_equal(found[0], value[0]) and found[1] == value[1]):
            what = f"{', '.join(columns)} differ from those in {where}"
            hint = "a rig is the same in all exposures: give its values once, or name two rigs in the column 'rig'"
            raise InputError(what, where=row.where, hint=hint)
        found, where = value, row.where
    return found


def _spread(row: Row, column: str, default: float) -> float:
    spread = row.number(column, default)
    if not spread > 0.0:
        hint = "give how much the rig varies from exposure to exposure, above 0"
        raise InputError(f"{column} is {spread:g}", where=row.where, hint=hint)
    return spread
