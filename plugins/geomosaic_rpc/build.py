"""RPC models of an image: the coefficients found for it, refined by control points."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError, default_hint, default_where, warn
from geomosaic.geo.transform import Transform
from geomosaic.raster.image_metadata import pam_has_rpc, read_rpc_tags
from geomosaic.raster.info import corner_in_scene
from geomosaic.sensor.inputs import check_scene_offset, choice, number, numbers, point_rows, undeclared_offset
from geomosaic.sensor.plausibility import require_vertical_datum
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.stores.path import to_path
from geomosaic.types import FloatArray
from geomosaic.whole_files import read_bytes
from geomosaic_rpc.coefficients import Rpc
from geomosaic_rpc.formats import POLYNOMIALS, SCALARS, RpcFields, ossim, rpb, rpc_number, rpc_txt, rpc_xml
from geomosaic_rpc.model import KINDS, WGS84, RpcModel
from geomosaic_rpc.refinement import refine

# Bytes; DigitalGlobe's XML with all attitudes is below one megabyte.
LARGEST = 16 << 20

FORMATS = (
    "_RPC.TXT, RPB, DIMAP XML (RPC_....XML, or that of a Pléiades scene), DigitalGlobe XML, OSSIM keyword list (.geom, "
    ".kwl)"
)


def read_rpc(path: Path) -> RpcFields:
    """RPC of a file of any known format.

    Parameters
    ----------
    path : Path
        At most `LARGEST` bytes.

    Raises
    ------
    InputError
        The file cannot be read, is of no known format, or its RPC is damaged.
    """
    return read_rpc_bytes(read_bytes(path, "RPC file", LARGEST), str(path))


def read_rpc_bytes(data: bytes, where: str) -> RpcFields:
    """RPC from the bytes of a file, whose format is recognised by its content.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        As `read_rpc`.
    """
    with default_hint("get the file again, or correct what was edited in it"):
        return _recognised(data, where)


def _recognised(data: bytes, where: str) -> RpcFields:
    start = data[:256].lstrip(b"\xef\xbb\xbf \t\r\n\0")
    if start.startswith((b"<", b"\xff\xfe", b"\xfe\xff")):
        return rpc_xml(data.lstrip(b" \t\r\n"), where)
    text = data.decode("latin-1")
    if re.search(r"(?m)^[ \t]*LINE_NUM_COEFF_1[ \t]*:", text):
        return rpc_txt(text, where)
    if re.search(r"(?m)^[ \t]*(projection\.)?line_num_coeff_00[ \t]*:", text):
        return ossim(text, where)
    if re.search(r"(?m)^[ \t]*lineNumCoef[ \t]*=", text):
        return rpb(text, where)
    kind = re.search(r"(?m)^type:\s*(ossim\w+)", text)
    raise InputError(
        f"this keyword list is of {kind[1]} and has no RPC" if kind else "this is no RPC file that is known",
        where=where,
        hint="use the sensor 'pushbroom': SPOT 5 by this list (metadata = FILE), other by METADATA.DIM, Formosat-2 by "
        "control points alone: metadata = 'none', flying_height = 891000, and a table of points in `control`"
        if kind
        else f"known are: {FORMATS}",
    )


def _rpc_tags(tags: Mapping[str, str], where: str) -> RpcFields | None:
    """RPC of GDAL's metadata domain 'RPC'."""
    # GDAL may add a unit to a number ('+000.12 degrees'); it has then turned everything into pixels, degrees and
    # metres.
    if "LINE_NUM_COEFF" not in tags and "LINE_OFF" not in tags:
        return None
    numbers = {
        name: rpc_number(tags[name].strip().partition(" ")[0], name, where)
        for name in (*SCALARS, "ERR_BIAS", "ERR_RAND")
        if tags.get(name, "").strip()
    }
    polynomials = {
        name: [rpc_number(item, name, where) for item in tags[name].split()] for name in POLYNOMIALS if name in tags
    }
    return RpcFields("GDAL", numbers, polynomials)


# Word for the RPC that the image itself carries.
OWN = "image"

_BESIDE = ("_RPC.TXT", "_RPC.txt", "_rpc.txt", ".RPB", ".rpb", ".geom", ".GEOM", ".kwl", ".KWL")
# A file of the image's name may be anything; it counts only where it is an RPC.
_MAYBE = (".XML", ".xml")
_BEYOND = 0.05  # share of its extent by which the box of an RPC may begin or end elsewhere than its scene
_SAME = 1e-3  # pixels: formats print offsets and coefficients with different numbers of digits


@dataclass(frozen=True)
class FoundRpc:
    """RPC and its source.

    Attributes
    ----------
    source : str
        File name, or `OWN` for the image itself.
    fields : RpcFields
    """

    source: str
    fields: RpcFields


def _own_rpc(path: str) -> FoundRpc | None:
    """RPC that GDAL reports for an image, from its tags or from what it finds beside it."""
    fields = _rpc_tags(read_rpc_tags(path), path)
    return None if fields is None else FoundRpc(OWN, fields)


def _rpc_beside(path: Path) -> list[FoundRpc]:
    """RPC files that by their names belong to an image."""
    # 'scene.tif' has scene_RPC.TXT, scene.RPB, scene.geom, scene.kwl or scene.XML; 'IMG_x_R1C1.TIF' of a DIMAP product
    # RPC_x.XML. Tiles of a scene other than the first have an RPC that counts from the corner of the scene, so a DIMAP
    # file is taken for R1C1 only.
    sure, maybe = _named(path)
    found = [FoundRpc(file.name, read_rpc(file)) for file in sure]
    for file in maybe:
        with suppress(InputError):
            found.append(FoundRpc(file.name, read_rpc(file)))
    return found


def files_beside(path: Path) -> tuple[Path, ...]:
    """Files beside an image that its RPC may come from, GDAL's .aux.xml among them where it holds one.

    Parameters
    ----------
    path : Path
        Image file.
    """
    sure, maybe = _named(path)
    if pam_has_rpc(path):
        maybe = [*maybe, path.with_name(f"{path.name}.aux.xml")]
    return (*sure, *maybe)


def _named(path: Path) -> tuple[list[Path], list[Path]]:
    """Files beside an image that by their names are an RPC, and that may be one."""
    files = [path.with_name(path.stem + suffix) for suffix in _BESIDE]
    dimap = re.fullmatch(r"IMG_(.+?)(?:_R1C1)?", path.stem)
    if dimap and not re.search(r"_R\d+C\d+$", dimap[1]):
        files += [path.with_name(f"RPC_{dimap[1]}{suffix}") for suffix in _MAYBE]
    maybe = [path.with_name(path.stem + suffix) for suffix in _MAYBE]
    return _distinct(files), [file for file in _distinct(maybe) if not file.samefile(path)]


def _find_rpc(path: str, where: str) -> FoundRpc:
    """RPC of an image, that it carries or that lies beside it: the first of several that agree within 0.001 px."""
    every = [one for one in (*_rpc_beside(to_path(path)), _own_rpc(path)) if one is not None]
    if not every:
        raise InputError(
            "the image carries no RPC, and none lies beside it",
            where=where,
            hint=f"name its file: rpc = FILE ({FORMATS}), or use another sensor",
        )
    first = every[0]
    for other in every[1:]:
        off = _difference(first.fields.rpc(where), other.fields.rpc(where))
        if not off <= _SAME:
            raise InputError(
                f"the RPC of {first.source} and of {other.source} differ, by up to {off:.3g} pixels",
                where=where,
                hint=f"say which one holds: rpc = '{first.source}' or rpc = '{other.source}', with its path; "
                f"'{OWN}' is what the image itself carries",
            )
    return first


def _difference(one: Rpc, other: Rpc) -> float:
    """Largest distance in pixels between two maps over the scene of the first; infinite where one of them fails."""
    # Not to ±1: at the edges of the box one of two equal maps may already leave its range.
    levels = np.linspace(-0.9, 0.9, 5)
    lph = np.stack(np.meshgrid(levels, levels, levels), axis=-1).reshape(-1, 3)
    ground = one.ground_offset + lph * np.abs(one.ground_scale)
    off = np.hypot(*(one.image(ground) - other.image(ground)).T)
    # Corners of the box may lie far outside the image, where one map may end.
    return float(np.nanmax(off)) if np.isfinite(off).mean() > 0.5 else float("inf")


def _distinct(files: list[Path]) -> list[Path]:
    """Files that are there, each once where the file system does not tell capitals apart."""
    there: list[Path] = []
    for file in files:
        if file.is_file() and not any(file.samefile(other) for other in there):
            there.append(file)
    return there


POINT = ("x", "y", "z", "col", "row")


def build_model(request: SensorRequest) -> RpcModel:
    """RPC model of one image, refined by its control points.

    Parameters
    ----------
    request : SensorRequest
        Image with its file, size in pixels, options of the sensor; the CRS is that of the control points.

    Returns
    -------
    RpcModel
        Ground in WGS 84 longitude, latitude (degrees) and ellipsoidal height (metres).

    Raises
    ------
    InputError
        There is no RPC, there are several, or an input is unknown or out of range.
    SolveError
        The control points do not determine the refinement.
    """
    where, options = request.image, request.options
    kind = choice(options.get("refine", "shift"), KINDS, "refine", where)
    found = _chosen(request)
    first = number(options["first_pixel"], "first_pixel", where) if "first_pixel" in options else None
    rpc = found.fields.rpc(f"{where} ({found.source})", first)
    corner = numbers(options.get("offset", (0.0, 0.0)), 2, "offset", where)
    in_scene = corner_in_scene(request.path) if request.path is not None else None
    if "offset" in options:
        check_scene_offset(corner, in_scene, where)
    else:
        _check_extent(rpc, request, in_scene)
    notes = (f"RPC of {found.source}, format {found.fields.format}",)
    model = RpcModel.of(rpc.moved(-corner[0], -corner[1]), request.size, kind, where=where, notes=notes)
    return _refined(model, request, kind) if options.get("points") else model


def _chosen(request: SensorRequest) -> FoundRpc:
    """RPC that the inputs name, or the one of the image."""
    named = request.options.get("rpc")
    if named is not None and (not isinstance(named, str) or not named.strip()):
        raise InputError(
            f"input 'rpc' is {named!r}, not the name of a file",
            where=request.image,
            hint="give rpc = FILE, or leave it out where the file lies beside the image",
        )
    if named is not None and named != OWN:
        file = Path(request.base) / named
        if not file.is_file():
            raise InputError(f"there is no RPC file '{named}'", where=request.image, hint="check the path")
        return FoundRpc(file.name, read_rpc(file))
    if request.path is None:
        raise InputError(
            "nothing says where the RPC is: neither a file of the image nor one of the RPC is known",
            where=request.image,
            hint="give rpc = FILE",
        )
    if named is None:
        return _find_rpc(request.path, request.image)
    own = _own_rpc(request.path)
    if own is None:
        raise InputError("the image carries no RPC", where=request.image, hint="name its file: rpc = FILE")
    return own


def _check_extent(rpc: Rpc, request: SensorRequest, in_scene: tuple[int, int] | None) -> None:
    """Error or warning about an image that is a part of the scene from whose corner its RPC counts."""
    where, size = request.image, np.array(request.size)
    whole = 2.0 * np.abs(rpc.image_scale)
    corner = rpc.image_offset - np.abs(rpc.image_scale)
    # An RPC's box reaches beyond its scene (by 2 % in Pléiades scenes), and one that was cut with its image counts from
    # the image's own corner: its box begins far outside.
    if (np.abs(corner) >= _BEYOND * whole).any():
        return
    if in_scene is not None and any(in_scene) and (np.array(in_scene) + size < (1.0 + _BEYOND) * whole).all():
        raise undeclared_offset(in_scene, where)
    if (size < 0.5 * whole).any():  # an image of less than half of the box is a cut, or was reduced
        warn(
            f"{where}: the image has {size[0]} x {size[1]} pixels, its RPC is made for about {whole[0]:.0f} x "
            f"{whole[1]:.0f}; it is taken for the upper-left part. If it is another part, give offset = [col, row] of "
            "its corner in the scene; if it was reduced, its RPC does not fit"
        )


def _refined(model: RpcModel, request: SensorRequest, kind: str) -> RpcModel:
    """Model corrected by the control points of the inputs; wrong ones are named."""
    where = request.image
    if kind == "none":
        raise InputError("there are control points, but refine is 'none'", where=where, hint="leave one of them out")
    if request.crs is None:
        raise InputError("the control points have no CRS", where=where, hint="name it, e.g. EPSG:32633")
    require_vertical_datum(request.crs, "the control points", where, lambda _: model)
    names, ground, image, sigmas = _points(request.options["points"], where)
    with default_where(where):
        found = refine(model, Transform(request.crs, WGS84)(ground), image, kind, sigmas, names)
    found.search.warn(where)
    return found.model


def _points(points: Any, where: str) -> tuple[list[str], FloatArray, FloatArray, FloatArray | None]:
    """Names, ground (N, 3), image (N, 2) and sigmas (N,) of control points; no sigmas where none is given."""
    names, rows = point_rows(points, POINT, where)
    table = np.array(rows)
    known = all("sigma" in point for point in points)
    return names, table[:, :3], table[:, 3:5], table[:, 5] if known else None
