"""Raster metadata: size, bands, sample type, georeference, found without reading a pixel."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio._err import CPLE_BaseError
from rasterio.enums import ColorInterp, MaskFlags
from rasterio.errors import RasterioError

from geomosaic.errors import InputError, RasterReadError
from geomosaic.options.render import SAMPLE_TYPES
from geomosaic.raster.environment import check_files, environment, opened, opening, source_files
from geomosaic.raster.formats import GRIDS, READ_DRIVERS, SEQUENTIAL, drivers_of, refusal
from geomosaic.stores.failures import raise_failure
from geomosaic.stores.path import StorePath, to_path
from geomosaic.types import PathLike
from geomosaic.whole_files import read_text

# A block larger than this costs more to decode again for a neighbour window than a whole copy costs.
_LARGE_BLOCK = 32 << 20
# Files behind a VRT that are decoded from the top, whatever window is asked for.
_SEQUENTIAL_SUFFIXES = (".jpg", ".jpeg", ".png")


@dataclass(frozen=True)
class SourceInfo:
    """Metadata of a raster file; those of bands are of the chosen ones, all but alpha unless given.

    Attributes
    ----------
    path : str, as given
    driver : str, GDAL's short name of the format
    width, height : int, pixels
    bands : int, number of bands
    alpha : int or None, band number (from 1) of the alpha band
    dtype : str, NumPy name of the sample type; where bands differ, a type that holds them all
    nodata : float or None, the value of the first band that marks a missing pixel
    nodatas : tuple, the same for every band
    crs : CRS or None, horizontal, or with a vertical part where the file declares one
    transform : Affine or None, corner-based pixel to map; None where the file has none
    tiled : bool, stored in blocks narrower than the image
    direct : bool, an uncompressed tiled TIFF (see `open_raster`)
    windowed : bool, A small window costs little; otherwise the format decodes the image from the top or in huge blocks
    masked : bool, the file marks missing pixels by nodata, alpha or a mask band
    mask_band : bool, it does so by a mask band
    descriptions, units, colors : tuple
        Per band: description, unit of the values, colour (red, green, blue, gray, palette ...).
    scales, offsets : tuple of float, per band: value = stored × scale + offset
    wavelengths : tuple of float or None, per band: central wavelength in nanometres, where the file tells it
    """

    path: str
    driver: str
    width: int
    height: int
    bands: int
    alpha: int | None
    dtype: str
    nodata: float | None
    nodatas: tuple[float | None, ...]
    crs: CRS | None
    transform: Affine | None
    tiled: bool
    direct: bool
    windowed: bool
    masked: bool
    mask_band: bool
    descriptions: tuple[str | None, ...]
    units: tuple[str | None, ...]
    colors: tuple[str, ...]
    scales: tuple[float, ...]
    offsets: tuple[float, ...]
    wavelengths: tuple[float | None, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Width, height."""
        return self.width, self.height

    @property
    def pixel_bytes(self) -> int:
        """Bytes of a pixel in all bands."""
        return self.bands * np.dtype(self.dtype).itemsize

    def calibrated(self, quantity: str, unit: str) -> SourceInfo:
        """Metadata of the same raster whose values have become a physical quantity.

        Parameters
        ----------
        quantity, unit : str
        """
        none, every = (None,) * self.bands, self.bands
        named = f"{quantity} ({unit})"
        names = tuple(f"{named}, {name}" if name else named for name in self.descriptions)
        return replace(
            self, dtype="float32", nodata=None, nodatas=none, descriptions=names, units=(unit,) * every,
            scales=(1.0,) * every, offsets=(0.0,) * every,
        )  # fmt: skip


def open_raster(path: PathLike, *, direct: bool = False, overview: int | None = None) -> Any:
    """Rasterio's dataset of a raster opened for reading, in a format of the allow-list.

    Parameters
    ----------
    path : path
    direct : bool, read tiled uncompressed TIFFs straight from the file, past GDAL's block cache
    overview : int, optional, level in place of the raster itself, counted from 0

    Raises
    ------
    RasterReadError
        The file is missing, a folder, no raster that can be read, or one that reads from elsewhere than this machine.
    """
    file = to_path(path)
    if not file.exists():
        raise RasterReadError("the file does not exist", where=str(path), hint="check the path")
    if file.is_dir():
        raise RasterReadError("this is a folder, not a raster", where=str(path), hint="name the file in it")
    sources = source_files(file)
    served = opened(file, sources) | ({} if overview is None else {"overview_level": overview})
    reason: Exception | None = None
    # Direct reads are 2 to 5 times as fast. Only for tiled files: with strips, GDAL would not notice a truncated one.
    with environment(GTIFF_DIRECT_IO="YES" if direct else "NO"), opening():
        for driver in drivers_of(file):
            try:
                dataset = rasterio.open(str(file), driver=driver, **served)
            except FAILURES as error:
                raise_failure()
                # The driver that knew the format says why; the others only that they do not know it.
                if reason is None or "not recognized" in str(reason):
                    reason = error
            else:
                with _metadata(str(path)):
                    check_files(dataset, str(file))
                return dataset
    if refused := refusal(file):
        raise RasterReadError(
            refused, where=str(path), hint="convert it to GeoTIFF with a program that reads it, or unpack it"
        )
    raise RasterReadError(
        f"this is not a raster that can be read ({_short(reason or OSError('empty'))})",
        where=str(path),
        hint=f"check that the file is whole and of a known format ({', '.join(READ_DRIVERS)}), or convert it to "
        "GeoTIFF with gdal_translate",
    ) from reason


_RASTERS = (".tif", ".tiff", ".jpg", ".jpeg", ".png", ".jp2", ".j2k", ".vrt", ".img", ".ntf", ".nitf", ".bmp")
_WORLD_FILES = (
    ".tfw", ".tifw", ".tiffw", ".jgw", ".jpw", ".jpgw", ".jpegw", ".pgw", ".pngw", ".bpw", ".j2w", ".jp2w", ".wld",
)  # fmt: skip
# What lies beside rasters: world files, metadata, masks, overviews, records, drawings.
_BESIDE = (
    *_WORLD_FILES,
    ".prj", ".aux", ".xml", ".hdr", ".dim", ".rpb", ".imd", ".att", ".eph", ".geom", ".kwl", ".tsai", ".xmp", ".msk",
    ".ovr", ".rrd", ".json", ".geojson", ".txt", ".gpkg-wal", ".gpkg-shm",
)  # fmt: skip


def rasters_among(files: Iterable[Path]) -> tuple[list[Path], list[Path]]:
    """Rasters among the files of a folder, and what neither is one nor lies beside one.

    Parameters
    ----------
    files : iterable of Path

    Returns
    -------
    rasters : list of Path
        By their endings, as a damaged photo still is one; of endings that tell nothing, by their content. Grids of
        heights are none.
    others : list of Path
        Without side-cars, such as world files, overviews, metadata and records, and GeoPackages of vectors.
    """
    rasters: list[Path] = []
    others: list[Path] = []
    for file in files:
        ending = file.suffix.lower()
        if ending in _RASTERS:
            rasters.append(file)
        elif ending not in _BESIDE:
            try:
                with open_raster(file) as dataset:
                    (others if dataset.driver in GRIDS else rasters).append(file)
            except RasterReadError:
                others += [file] * (ending != ".gpkg")
    return rasters, others


def without_side_cars(files: Sequence[Path]) -> tuple[Path, ...]:
    """Files but the side-cars of others among them, which a pattern of the shell takes with their images.

    Parameters
    ----------
    files : sequence of Path

    Returns
    -------
    tuple of Path
    """
    rasters = {file.stem for file in files if file.suffix.lower() in _RASTERS}
    return tuple(
        file
        for file in files
        if file.suffix.lower() not in (*_BESIDE, ".gpkg")
        or rasters.isdisjoint(file.name[: dot.start()] for dot in re.finditer(r"\.", file.name))
    )


# GDAL's errors, whose class has no public name, pass through rasterio in some of its properties; text it decodes as
# UTF-8, whatever a file holds.
FAILURES = (RasterioError, CPLE_BaseError, OSError, UnicodeError)

# Nothing in any unit on the Earth is larger; squares of larger coordinates overflow.
_LARGEST = 1e15


@contextmanager
def _metadata(path: str) -> Iterator[None]:
    """Context in which metadata of a raster are read: what is damaged in them is told with the file's name."""
    try:
        yield
    except FAILURES as error:
        raise RasterReadError(
            f"the metadata of the raster are damaged ({_short(error)})",
            where=path,
            hint="get the file again; correct or remove a damaged world file or .aux.xml beside it",
        ) from error


def _transform(dataset: Any, path: str) -> Affine | None:
    """Geotransform, None where the file has none."""
    transform: Affine = dataset.transform
    if not all(abs(value) <= _LARGEST for value in transform[:6]):
        raise RasterReadError(
            f"the georeference has numbers that are no place: {', '.join(f'{value:g}' for value in transform[:6])}",
            where=path,
            hint="correct the world file or the header, or remove the georeference",
        )
    if transform == Affine.identity():
        return _world_file(to_path(path))
    return transform


def _world_file(raster: Path) -> Affine | None:
    """Geotransform of a world file beside a raster in a store, where GDAL, through rasterio, reads no lines."""
    import affine

    if not isinstance(raster, StorePath):
        return None
    for file in raster.neighbours():
        if file.stem == raster.stem and file.suffix.lower() in _WORLD_FILES:
            try:
                placed: Affine = affine.loadsw(read_text(file, "world file", 4096))
                return placed
            except ValueError as error:
                raise RasterReadError(
                    f"the world file is damaged ({error})", where=str(file), hint="correct or remove it"
                ) from None
    return None


def inspect(path: PathLike, bands: Sequence[int] | None = None) -> SourceInfo:
    """Metadata of a raster file, or of some of its bands, found without reading pixels.

    Parameters
    ----------
    path : path
    bands : sequence of int, optional, from 1; all but alpha unless given

    Raises
    ------
    RasterReadError
        The file is missing, no raster, or of a sample type that is not supported (complex).
    InputError
        A band that the file does not have.
    """
    with environment(), open_raster(path) as dataset:
        return describe(dataset, str(path), bands)


def joined(infos: Sequence[SourceInfo]) -> SourceInfo:
    """Metadata of rasters of one place as of one with all their bands; unnamed single bands are called as their files.

    Parameters
    ----------
    infos : sequence of SourceInfo

    Raises
    ------
    InputError
        No sample type holds the values of all.
    """
    if len(infos) == 1:
        return infos[0]
    types = sorted({info.dtype for info in infos})
    dtype = np.result_type(*types).name
    if dtype not in SAMPLE_TYPES:
        raise InputError(
            f"no sample type holds the values of {' and '.join(types)}", where=infos[0].path,
            hint="convert some of the files to another type (gdal_translate -ot)",
        )  # fmt: skip
    names = [(Path(info.path).stem,) if info.descriptions == (None,) else info.descriptions for info in infos]

    def every(of: Callable[[SourceInfo], tuple[Any, ...]]) -> tuple[Any, ...]:
        return tuple(value for info in infos for value in of(info))

    return replace(
        infos[0],
        bands=sum(info.bands for info in infos),
        dtype=dtype,
        masked=any(info.masked for info in infos),
        nodatas=every(lambda info: info.nodatas),
        descriptions=tuple(itertools.chain(*names)),
        units=every(lambda info: info.units),
        colors=every(lambda info: info.colors),
        scales=every(lambda info: info.scales),
        offsets=every(lambda info: info.offsets),
        wavelengths=every(lambda info: info.wavelengths),
    )


def corner_in_scene(path: PathLike) -> tuple[int, int] | None:
    """Upper-left corner of an image in the raw scene that it was cut from, as its own geotransform tells it.

    Parameters
    ----------
    path : path

    Returns
    -------
    tuple of int or None
        Column and row; None where the geotransform counts anything but whole pixels from the corner of a scene.
    """
    try:
        info = inspect(path)
    except RasterReadError:  # what reads its pixels says so
        return None
    t = info.transform
    # Tools that cut raw scenes write a window's transform: pixels to pixels, rows downwards or, as in QGIS, negative.
    if info.crs is not None or t is None or (t.a, t.b, t.d, abs(t.e)) != (1.0, 0.0, 0.0, 1.0):
        return None
    col, row = t.c, t.f * t.e
    return (int(col), int(row)) if min(col, row) >= 0.0 and col.is_integer() and row.is_integer() else None


def describe(dataset: Any, path: str, bands: Sequence[int] | None = None) -> SourceInfo:
    """Metadata of an open dataset, or of some of its bands.

    Parameters
    ----------
    dataset : rasterio dataset
    path : str, name used in errors
    bands : sequence of int, optional, from 1; all but alpha unless given

    Raises
    ------
    RasterReadError
        It has no band, or a sample type that is not supported.
    InputError
        A band that it does not have.
    """
    with _metadata(path):
        return _described(dataset, path, bands)


def _described(dataset: Any, path: str, bands: Sequence[int] | None) -> SourceInfo:
    if dataset.count == 0:
        found = ", ".join(dataset.subdatasets[:4])
        raise RasterReadError(
            f"the file has no band of its own{f' but subdatasets: {found}' if found else ''}",
            where=path,
            hint="choose one by a virtual raster: gdal_translate -of VRT 'NAME:\"FILE\":VARIABLE' one.vrt",
        )
    colors = dataset.colorinterp
    numbers = [i for i, color in enumerate(colors) if color != ColorInterp.alpha] or [0]
    alpha = next((i + 1 for i, color in enumerate(colors) if color == ColorInterp.alpha and i not in numbers), None)
    if bands is not None:
        numbers = [band - 1 for band in _check_bands(bands, dataset.count, path)]
    types = {dataset.dtypes[i] for i in numbers}
    if not types <= set(SAMPLE_TYPES):
        raise RasterReadError(
            f"samples of type {', '.join(sorted(types - set(SAMPLE_TYPES)))} are not supported",
            where=path,
            hint="convert to uint8, uint16, int16 or float32 (for complex radar data: the amplitude)",
        )
    nodatas = tuple(dataset.nodatavals[i] for i in numbers)
    flags = dataset.mask_flag_enums[numbers[0]]
    mask_band = MaskFlags.per_dataset in flags and MaskFlags.alpha not in flags
    rows, cols = dataset.block_shapes[numbers[0]]
    return SourceInfo(
        path=path,
        driver=dataset.driver,
        width=dataset.width,
        height=dataset.height,
        bands=len(numbers),
        alpha=alpha,
        dtype=np.result_type(*types).name,
        nodata=nodatas[0],
        nodatas=nodatas,
        crs=_crs(dataset, path),
        transform=_transform(dataset, path),
        tiled=cols < dataset.width,
        direct=dataset.driver == "GTiff" and cols < dataset.width and _compression(dataset) is None,
        windowed=_windowed(dataset, rows, cols),
        masked=mask_band or alpha is not None or any(value is not None for value in nodatas),
        mask_band=mask_band,
        descriptions=tuple(dataset.descriptions[i] for i in numbers),
        units=tuple(dataset.units[i] or None for i in numbers),
        colors=tuple(_colour(dataset, i + 1, colors[i]) for i in numbers),
        scales=tuple(float(dataset.scales[i]) for i in numbers),
        offsets=tuple(float(dataset.offsets[i]) for i in numbers),
        wavelengths=tuple(_wavelength(dataset, i + 1) for i in numbers),
    )


def _check_bands(bands: Sequence[int], count: int, path: str) -> tuple[int, ...]:
    """Band numbers, checked against the bands that a file has."""
    absent = [band for band in bands if not 1 <= band <= count]
    if absent or not bands:
        shown = ", ".join(map(str, absent))
        raise InputError(
            f"there is no band {shown}: the file has {'one band' if count == 1 else f'bands 1 to {count}'}"
            if absent
            else "no band is chosen",
            where=path,
            hint="name bands of the file, counted from 1",
        )
    return tuple(bands)


def _crs(dataset: Any, path: str) -> CRS | None:
    """Carry the CRS over as text: rasterio and pyproj have PROJ databases of their own."""
    if dataset.crs is None:
        return None
    try:
        return CRS.from_wkt(dataset.crs.to_wkt(version="WKT2_2019"))
    except CRSError as error:
        raise RasterReadError(
            f"the CRS of the file cannot be understood ({_short(error)})",
            where=path,
            hint="assign one with gdal_edit -a_srs",
        ) from error


def _colour(dataset: Any, band: int, color: Any) -> str:
    """Name of a band's colour; a palette of greys in their order, as each BMP has, is none."""
    if color == ColorInterp.palette and all(
        number == red == green == blue for number, (red, green, blue, _) in dataset.colormap(band).items()
    ):
        return "gray"
    return str(color.name)


# Nanometres in a unit of wavelengths, as files write it.
_NANOMETRES = {"nanometers": 1.0, "nm": 1.0, "micrometers": 1e3, "um": 1e3, "µm": 1e3, "microns": 1e3}


def _wavelength(dataset: Any, band: int) -> float | None:
    """Central wavelength of a band, nanometres: GDAL's domain IMAGERY, else tags as those of ENVI and Sentinel-2."""
    central = dataset.tags(band, ns="IMAGERY").get("CENTRAL_WAVELENGTH_UM")
    tags = {name.lower(): text for name, text in dataset.tags(band).items()}
    text, unit = (central, "um") if central else (tags.get("wavelength"), "")
    unit = unit or (tags.get("wavelength_units") or tags.get("wavelength_unit") or "").strip().lower()
    try:
        value = float(text or "nan")
    except ValueError:
        return None
    # Without a unit: no optical band of 100 micrometres or of less than 100 nanometres.
    nanometres = value * _NANOMETRES.get(unit, 1.0 if value >= 100.0 else 1e3)
    return nanometres if 0.0 < nanometres < 1e6 else None


def _windowed(dataset: Any, rows: int, cols: int) -> bool:
    """Whether a window can be read without decoding much more than the window."""
    if dataset.driver in SEQUENTIAL:
        return False
    if dataset.driver == "VRT":
        return not any(name.lower().endswith(_SEQUENTIAL_SUFFIXES) for name in dataset.files)
    if dataset.driver == "GTiff" and _compression(dataset) is None:
        return True
    # Compressed strips: a window costs all the strips that it touches, over the whole width.
    if dataset.driver == "GTiff" and cols == dataset.width and rows < dataset.height:
        return False
    samples = rows * cols * (dataset.count if dataset.tags(ns="IMAGE_STRUCTURE").get("INTERLEAVE") == "PIXEL" else 1)
    return samples * int(np.dtype(dataset.dtypes[0]).itemsize) <= _LARGE_BLOCK


def _compression(dataset: Any) -> str | None:
    value = dataset.tags(ns="IMAGE_STRUCTURE").get("COMPRESSION")
    return None if value is None else str(value)


def _short(error: BaseException) -> str:
    """First line of what GDAL said."""
    cause = error.__cause__ or error
    return (str(cause).strip().splitlines() or [type(cause).__name__])[0][:200]


def control_point_count(path: PathLike) -> int:
    """Number of ground control points (GCPs) in a raster.

    Parameters
    ----------
    path : path

    Raises
    ------
    RasterReadError
        The file is missing or no raster.
    """
    with environment(), open_raster(path) as dataset:
        return len(dataset.gcps[0])


@dataclass(frozen=True)
class Companions:
    """Files and metadata that a raster depends on besides its own bytes.

    Attributes
    ----------
    files : tuple of Path, world files, mask files, headers, sources of a VRT: those that are there
    metadata : SourceInfo
        CRS, transform, nodata, colours and all else that is known without reading a pixel, whatever file says it; its
        path is left empty.
    """

    files: tuple[Path, ...]
    metadata: SourceInfo


def companions(path: Path, bands: Sequence[int] | None = None) -> Companions:
    """Files and metadata that a raster depends on; no pixel is read.

    Parameters
    ----------
    path : Path
    bands : sequence of int, optional, from 1; all unless given

    Raises
    ------
    RasterReadError
        The raster cannot be opened.
    """
    # Not .aux.xml: programs that only look at a raster keep statistics in it. Not .ovr of the raster itself: its
    # pixels are read.
    files, metadata = _opened(path, bands, (".aux.xml", ".ovr"))
    for source in source_files(path):
        # A VRT that scales its sources takes their overviews.
        files += [source, *_opened(source, None, (".aux.xml",))[0]]
    return Companions(tuple(dict.fromkeys(files)), metadata)


def _opened(path: Path, bands: Sequence[int] | None, without: tuple[str, ...]) -> tuple[list[Path], SourceInfo]:
    with environment(), open_raster(path) as dataset:
        names = [name for name in dataset.files if name != str(path) and not name.lower().endswith(without)]
        metadata = replace(describe(dataset, str(path), bands), path="")
    return [Path(name) for name in names if Path(name).is_file()], metadata
