"""Finding and reading the metadata file of a radar scene, whichever format it has."""

from __future__ import annotations

from pathlib import Path

from geomosaic import whole_files
from geomosaic.errors import InputError, default_hint
from geomosaic.sensor.inputs import parse_xml
from geomosaic.stores.path import to_path
from geomosaic_sar.scene import RadarScene
from geomosaic_sar.sentinel1 import ROOT as SENTINEL1
from geomosaic_sar.sentinel1 import read_sentinel1
from geomosaic_sar.table import read_table
from geomosaic_sar.terrasar import ROOT as TERRASAR
from geomosaic_sar.terrasar import read_terrasar

TABLE = ".radar.json"


def find_beside(image: str | None) -> Path | None:
    """Metadata of an image by their names and places.

    NAME.radar.json beside NAME.tif; in Sentinel-1's folders annotation/NAME.xml of measurement/NAME.tiff, in those of
    TerraSAR-X the XML of the product's name above IMAGEDATA.

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
    names = [path.with_name(path.stem + TABLE), path.parent.parent / "annotation" / f"{path.stem}.xml"]
    if path.parent.name.upper() == "IMAGEDATA":
        names += sorted(path.parent.parent.glob("T[SD]X*_SAR__*.xml"))[:1]
    return next((file for file in names if file.is_file()), None)


def read_metadata(path: Path) -> RadarScene:
    """Radar scene of a file, whose format is recognised by its content.

    Parameters
    ----------
    path : Path
        Annotation of Sentinel-1, main annotation of TerraSAR-X, or JSON table.

    Raises
    ------
    InputError
        The file cannot be read, is damaged, or of a product that is not taken; says why.
    """
    return read_bytes(whole_files.read_bytes(path, "file of metadata"), str(path))


def read_bytes(data: bytes, where: str) -> RadarScene:
    """Radar scene of the bytes of a file; see `read_metadata`.

    Parameters
    ----------
    data : bytes
        Whole file.
    where : str
        Named in errors.
    """
    with default_hint("get the file again, or correct what was edited in it"):
        return _recognised(data, where)


def _recognised(data: bytes, where: str) -> RadarScene:
    if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<"):
        return read_table(data.decode("utf-8", "replace"), where)
    # Tables over every column, of no use here, make up nine tenths of an annotation of Sentinel-1.
    root = parse_xml(data, where, ("antennaPattern", "dopplerCentroid", "noiseList", "replicaInformationList"))
    if root.tag == SENTINEL1:
        return read_sentinel1(root, where)
    if root.tag == TERRASAR:
        return read_terrasar(root, where)
    raise InputError(
        f"this XML starts with <{root.tag[:40]}>, not <{SENTINEL1}> (Sentinel-1) or <{TERRASAR}> (TerraSAR-X)",
        where=where,
        hint="give the annotation of the image, or a JSON table",
    )
