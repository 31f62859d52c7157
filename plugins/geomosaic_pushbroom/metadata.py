"""Finding and reading the metadata file of a scene, whichever format it has."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

from geomosaic import whole_files
from geomosaic.errors import InputError, default_hint
from geomosaic.stores.path import to_path
from geomosaic.whole_files import LARGEST_FILE
from geomosaic_pushbroom.dimap2 import CHARACTERISTICS, REFINED, read_pleiades, read_refined
from geomosaic_pushbroom.scene_metadata import SceneMetadata, parse_dimap
from geomosaic_pushbroom.spot import read_ossim, read_spot
from geomosaic_pushbroom.worldview import ROOT, read_worldview

BESIDE = ("METADATA.DIM", "metadata.dim")
_PHYSICAL = (b"<Refined_Model", b"<Sensor_Model_Characteristics", b"<Ephemeris", b"<EPHEMLIST")
_PRODUCTS = (b"Dimap_Document", f"<{ROOT}>".encode())
_SIZES = ((rb"<NCOLS>\s*(\d+)", rb"<NROWS>\s*(\d+)"), (rb"<NUMCOLUMNS>\s*(\d+)", rb"<NUMROWS>\s*(\d+)"))
# Files of a folder that are looked at; products have some ten of them.
_MOST = 50


def find_beside(image: str | None) -> Path | None:
    """Metadata beside an image: METADATA.DIM, a .DIM of its name, or DIM_x.XML of IMG_x.TIF or IMG_x_R1C1.TIF.

    Parameters
    ----------
    image : str, optional
        Image file.

    Returns
    -------
    Path or None
        The first that is there.
    """
    if image is None:
        return None
    path = to_path(image)
    names = [path.with_suffix(suffix) for suffix in (".DIM", ".dim")] + [path.with_name(name) for name in BESIDE]
    dimap = re.fullmatch(r"IMG_(.+?)(?:_R\d+C\d+)?", path.stem)
    if dimap:
        names += [path.with_name(f"DIM_{dimap[1]}{suffix}") for suffix in (".XML", ".xml")]
    return next((file for file in names if file.is_file()), None)


def metadata_in_folder(image: str | None) -> dict[Path, tuple[int, int] | None]:
    """Metadata of products beside an image, whatever their names, with the size of their scenes.

    Parameters
    ----------
    image : str, optional
        Image file.

    Returns
    -------
    dict
        Width and height in pixels by file; None of one without orbit and attitude.
    """
    folder = to_path(image).parent if image is not None else None
    files = sorted(folder.glob("*.[xXdD][mMiI][lLmM]"))[:_MOST] if folder is not None else []
    found: dict[Path, tuple[int, int] | None] = {}
    for file in files:
        with suppress(OSError):
            data = file.read_bytes() if file.stat().st_size <= LARGEST_FILE // 8 else b""
            sizes = [[re.search(name, data) for name in names] for names in _SIZES]
            known = next(((int(w[1]), int(h[1])) for w, h in sizes if w and h), None)
            if any(mark in data[:4096] for mark in _PRODUCTS):
                found[file] = known if any(mark in data for mark in _PHYSICAL) else None
    return found


def read_metadata(path: Path, band: str | None = None) -> SceneMetadata:
    """Metadata of a scene: DIMAP of SPOT 1 to 7 or Pléiades, DigitalGlobe XML, or an OSSIM keyword list of SPOT 5.

    Parameters
    ----------
    path : Path
    band : str, optional
        Band whose look angles are taken, where the metadata have those of several.

    Raises
    ------
    InputError
        The file cannot be read, is damaged, or holds no physical model.
    """
    return read_bytes(whole_files.read_bytes(path, "file of metadata"), str(path), band)


def read_bytes(data: bytes, where: str, band: str | None = None) -> SceneMetadata:
    """Metadata of a scene from the bytes of a file, whose format is recognised by its content.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.
    band : str, optional
        As for `read_metadata`.

    Raises
    ------
    InputError
        As `read_metadata`.
    """
    with default_hint("get the file again, or correct what was edited in it"):
        return _recognised(data, where, band)


def _recognised(data: bytes, where: str, band: str | None) -> SceneMetadata:
    if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return read_ossim(data, where)
    root = parse_dimap(data, where)
    if root.tag == ROOT:
        return read_worldview(root, where, band)
    if root.tag.rpartition("}")[2] not in ("Dimap_Document", "PHR_Dimap_Document"):
        raise InputError(
            f"this XML starts with <{root.tag[:40]}>, not <Dimap_Document> or <{ROOT}>",
            where=where,
            hint="give the metadata of the product",
        )
    if root.find(CHARACTERISTICS) is not None:
        return read_pleiades(root, where)
    if root.find(REFINED) is not None:
        return read_refined(root, where, band)
    if root.find(".//Rational_Sensor_Model") is not None or root.find(".//Rational_Function_Model") is not None:
        raise InputError(
            "this DIMAP has an RPC, but no physical model",
            where=where,
            hint="give the product's own metadata, or use the sensor 'rpc' with this file",
        )
    return read_spot(root, where, band)
