"""Raster formats that are read: each with the endings of its files, and those that are refused with their reason."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path


@dataclass(frozen=True)
class Format:
    """Raster format that is read.

    Attributes
    ----------
    driver : str
        GDAL's short name.
    name : str
    endings : tuple of str
        Endings of its files, in lower case, where they are tried by ending alone; none where the first bytes of a file
        tell the format.
    sequential : bool
        Decoded from the top, whatever window is asked for.
    grid : bool
        Of heights and other measured values: never a photo, where a folder is searched for photos.
    """

    driver: str
    name: str
    endings: tuple[str, ...] = ()
    sequential: bool = False
    grid: bool = False


# GDAL has many more, some of which run code or fetch addresses that a file names. Formats without a mark of their own
# are tried by their endings alone: any table of three numbers in a line would be an XYZ grid.
FORMATS = (
    Format("GTiff", "GeoTIFF, TIFF"),
    Format("JPEG", "JPEG", sequential=True),
    Format("PNG", "PNG", sequential=True),
    Format("JP2OpenJPEG", "JPEG 2000"),
    Format("VRT", "virtual raster of GDAL"),
    Format("HFA", "ERDAS Imagine (.img)"),
    Format("ENVI", "ENVI, with its .hdr"),
    Format("NITF", "NITF"),
    Format("DIMAP", "SPOT and Pléiades DIMAP"),
    Format("BMP", "BMP"),
    Format("GPKG", "GeoPackage"),
    Format("GIF", "GIF", sequential=True),
    Format("WEBP", "WebP", sequential=True),
    Format("PNM", "PGM, PPM"),
    Format("PCIDSK", "PCI Geomatics (.pix)"),
    Format("LAN", "ERDAS 7.x (.lan, .gis)"),
    Format("DTED", "DTED levels 0 to 2", grid=True),
    Format("netCDF", "netCDF", grid=True),
    Format("HDF5", "HDF5", grid=True),
    Format("SAGA", "SAGA GIS", (".sdat", ".sgrd"), grid=True),
    Format("GSBG", "Surfer 6, binary", (".grd",), grid=True),
    Format("GS7BG", "Surfer 7, binary", (".grd",), grid=True),
    Format("GSAG", "Surfer, text", (".grd",), sequential=True, grid=True),
    Format("SRTMHGT", "SRTM", (".hgt",), grid=True),
    Format("USGSDEM", "USGS DEM, CDED", (".dem",), grid=True),
    Format("EHdr", "BIL, BIP, BSQ and floating-point grids, with a .hdr", (".bil", ".bip", ".bsq", ".flt", ".dem")),
    Format("AAIGrid", "Arc/Info ASCII grid", (".asc", ".grd"), sequential=True, grid=True),
    Format("XYZ", "grid as lines of x, y, z", (".xyz",), sequential=True, grid=True),
)
READ_DRIVERS = tuple(each.driver for each in FORMATS)
SEQUENTIAL = tuple(each.driver for each in FORMATS if each.sequential)
# HDF5 files with one variable are told by the second driver of that format.
GRIDS = (*(each.driver for each in FORMATS if each.grid), "HDF5Image")
# Within virtual rasters, one variable of a file of many.
SUBDATASETS = ("netcdf", "hdf5")

_PROPRIETARY = "its library is proprietary, and no free wheel of GDAL has it"
# What people have, its first bytes and ending, with the reason why it is not read.
_REFUSED = (
    ("the format ECW", b"", ".ecw", _PROPRIETARY),
    ("the format MrSID", b"msid", ".sid", _PROPRIETARY),
    ("the format HDF4", b"\x0e\x03\x13\x01", ".hdf4", "GDAL's wheels are built without its library"),
    ("an Arc/Info binary grid", b"", ".adf", "it has its pixels in several files of a folder"),
    ("the format of ER Mapper", b"DatasetHeader Begin", ".ers", "its header may name any other file as its pixels"),
    ("a Zip archive", b"PK\x03\x04", ".zip", "its files are to be unpacked first"),
    ("a gzip archive", b"\x1f\x8b\x08", ".gz", "its files are to be unpacked first"),
)  # fmt: skip


def drivers_of(path: Path) -> tuple[str, ...]:
    """GDAL drivers that a file may be opened with, in the order in which they are tried.

    Parameters
    ----------
    path : Path
    """
    return _by_ending(path.suffix.lower())


@lru_cache(maxsize=256)
def _by_ending(ending: str) -> tuple[str, ...]:
    return tuple(each.driver for each in FORMATS if not each.endings or ending in each.endings)


def refusal(path: Path) -> str | None:
    """Reason why a file of a known format is not read; None where nothing is known of it.

    Parameters
    ----------
    path : Path
    """
    with path.open("rb") as file:
        head = file.read(32)
    ending = path.suffix.lower()
    for name, magic, usual, reason in _REFUSED:
        if ending == usual or (len(magic) > 2 and head.startswith(magic)):
            return f"{name} is not read: {reason}"
    return None
