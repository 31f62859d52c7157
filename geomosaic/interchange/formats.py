"""Reconstructions read from and written to the files of other programs, whichever the program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from geomosaic.errors import InputError, default_hint, did_you_mean
from geomosaic.interchange.colmap import SparseModel
from geomosaic.interchange.files import PIX4D, decoded, pinhole_files, program_of, read_bytes, read_text
from geomosaic.interchange.reconstruction import Reconstruction, of_tables
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of, under_construction


def colmap_model(path: Path, where: str | None = None, with_points: bool = False) -> SparseModel:
    """Sparse model of COLMAP, binary or text.

    Parameters
    ----------
    path : Path
        Its folder, or one of its files.
    where : str, optional
        Named where a file cannot be read; the file itself unless given.
    with_points : bool
        Whether measurements and points are wanted, where points3D is there.

    Raises
    ------
    InputError
        A file is missing or damaged.
    """
    folder = path if path.is_dir() else path.parent
    binary = path.suffix == ".bin" or (path.is_dir() and (folder / "images.bin").is_file())
    cameras, images, points = (folder / f"{name}{'.bin' if binary else '.txt'}" for name in _COLMAP)
    data = tuple(read_bytes(file, where or str(file)) for file in (cameras, images))
    listed = read_bytes(points, where or str(points)) if with_points and points.is_file() else None
    return _sparse_model(*data, listed, (str(cameras), str(images), str(points)), binary)


_COLMAP = ("cameras", "images", "points3D")


@lru_cache(maxsize=2)
def _sparse_model(
    cameras: bytes, images: bytes, points: bytes | None, paths: tuple[str, str, str], binary: bool
) -> SparseModel:
    """Model of the bytes of its files; kept, since all images of a block ask for it."""
    from geomosaic.interchange import colmap, colmap_binary

    whole = points is not None
    if binary:
        return SparseModel(
            colmap_binary.parse_cameras(cameras, paths[0]),
            colmap_binary.parse_images(images, paths[1], whole),
            None if points is None else colmap_binary.parse_points(points, paths[2]),
        )
    return SparseModel(
        colmap.parse_cameras(decoded(cameras, paths[0], paths[0]), paths[0]),
        colmap.parse_images(decoded(images, paths[1], paths[1]), paths[1], whole),
        None if points is None else colmap.parse_points(decoded(points, paths[2], paths[2]), paths[2]),
    )


def _colmap(path: Path) -> Reconstruction:
    from geomosaic.interchange.colmap import from_records

    return from_records(colmap_model(path, with_points=True), str(path))


def _opensfm(path: Path) -> Reconstruction:
    from geomosaic.interchange.opensfm import read

    file = path / "reconstruction.json" if path.is_dir() else path
    tracks = _tracks_of(file)
    surveyed = file.with_name("ground_control_points.json")
    return read(
        read_bytes(file, str(file)),
        str(file),
        read_text(tracks, str(tracks)) if tracks.is_file() else None,
        read_bytes(surveyed, str(surveyed)) if surveyed.is_file() else None,
    )


def _tracks_of(file: Path) -> Path:
    """Measurements beside a reconstruction; OpenSfM's example calls both by names of their own, ..._example."""
    own = file.with_name(f"tracks{file.stem.removeprefix('reconstruction')}.csv")
    return own if own.is_file() else file.with_name("tracks.csv")


def _bundler(path: Path) -> Reconstruction:
    from geomosaic.interchange.bundler import read_bundler

    file = path / "bundle.out" if path.is_dir() else path
    # Beside the file, or a folder up, where Bundler itself writes it.
    lists = (file.with_suffix(".list.txt"), file.with_name("list.txt"), file.absolute().parent.parent / "list.txt")
    listed = next((item for item in lists if item.is_file()), None)
    names = None
    if listed is not None:
        names = [line.split()[0] for line in read_text(listed, str(listed)).splitlines() if line.strip()]
    return read_bundler(read_text(file, str(file)), str(file), names)


def _bal(path: Path) -> Reconstruction:
    from geomosaic.interchange.bundler import read_bal

    return read_bal(read_bytes(path, str(path)), str(path))


def _metashape(path: Path) -> Reconstruction:
    from geomosaic.interchange.metashape import read_metashape, read_metashape_text, world_of

    if path.suffix.lower() == ".xml":
        tables = read_metashape(read_bytes(path, str(path)), str(path))
        found = of_tables(tables, ("Metashape's XML has no tie points",))
        return world_of(found, tables)
    rows = read_metashape_text(read_text(path, str(path)), str(path))
    return of_tables({name: (None, row) for name, row in rows.items()}, ("the list has no cameras and no points",))


def _pix4d(path: Path) -> Reconstruction:
    from geomosaic.interchange.pix4d import OFFSET, PMATRIX, offset_file, read_offset, read_pix4d, read_pmatrix

    offset = offset_file(path, OFFSET)
    shift = read_offset(read_text(offset, str(offset)), str(offset)) if offset else None
    read = read_pmatrix if path.name.endswith(PMATRIX) else read_pix4d
    return of_tables(
        read(read_text(path, str(path)), shift, str(path)), ("positions are in the map of the project: not told",)
    )


def _ori(path: Path) -> Reconstruction:
    from geomosaic.interchange.photo_files import read_ori

    files = sorted(path.glob("*.ori.xml")) if path.is_dir() else [path]
    photos = [read_ori(read_bytes(file, str(file)), str(file)) for file in files]
    return of_tables({name: (camera, row) for name, camera, row in photos})


def _tsai(path: Path) -> Reconstruction:
    return _pinholes(tuple(sorted(path.glob("*.tsai"))) if path.is_dir() else (path,))


def _pinholes(files: Sequence[Path]) -> Reconstruction:
    from geomosaic.interchange.photo_files import read_tsai

    found = of_tables({file.stem: read_tsai(read_text(file, str(file)), str(file)) for file in files})
    return replace(found, crs="EPSG:4978")


def _adjusted(path: Path) -> Reconstruction:
    from geomosaic.interchange.asp import with_adjustments

    cameras, adjustments = pinhole_files(path)
    files = adjustments if path.is_dir() else (path,)
    if not cameras or not files:
        hint = "keep the IMAGE.tsai that were adjusted beside the .adjust, or a folder up"
        raise InputError(f"{len(files)} .adjust and {len(cameras)} .tsai are here", where=str(path), hint=hint)
    return with_adjustments(_pinholes(cameras), {str(file): read_text(file, str(file)) for file in files})


def _match(path: Path) -> Reconstruction:
    from geomosaic.interchange.asp import read_matches

    files = sorted(path.glob("*.match")) if path.is_dir() else [path]
    return read_matches({file.name: read_bytes(file, str(file)) for file in files})


# Reader of each format, and what it reads.
READERS: Mapping[str, tuple[Callable[[Path], Reconstruction], str]] = {
    "colmap": (_colmap, "COLMAP: folder with cameras, images and points3D, .bin or .txt"),
    "opensfm": (_opensfm, "OpenSfM and OpenDroneMap: reconstruction.json with tracks.csv beside it"),
    "bundler": (_bundler, "Bundler v0.3: bundle.out with list.txt"),
    "bal": (_bal, "Bundle Adjustment in the Large: .txt, .bz2 or .gz"),
    "metashape": (_metashape, "Metashape: cameras as .xml, or as text of omega, phi, kappa"),
    "pix4d": (_pix4d, "Pix4D: PROJECT_calibrated_camera_parameters.txt with its offset, or PROJECT_pmatrix.txt"),
    "ori": (_ori, "IGN: folder of .ori.xml, or one of them"),
    "tsai": (_tsai, "Ames Stereo Pipeline: folder of pinhole cameras .tsai, or one of them"),
    "adjust": (
        _adjusted,
        "Ames Stereo Pipeline: folder of .adjust, or one of them, with the .tsai beside or a folder up",
    ),
    "match": (_match, "Ames Stereo Pipeline: folder of .match, or one of them"),
}

# What a folder of each format holds.
_FOLDERS = (
    ("colmap", "images.bin"),
    ("colmap", "images.txt"),
    ("opensfm", "reconstruction.json"),
    ("bundler", "bundle.out"),
    ("ori", "*.ori.xml"),
    ("adjust", "*.adjust"),
    ("tsai", "*.tsai"),
    ("match", "*.match"),
)


def format_of(path: Path) -> str | None:
    """Format of a file or folder, recognised by names and first bytes; one of `READERS`, or None.

    Parameters
    ----------
    path : Path
        File or folder.
    """
    if path.is_dir():
        return next((name for name, pattern in _FOLDERS if any(path.glob(pattern))), None)
    if path.name in ("cameras.bin", "points3D.bin", "cameras.txt", "points3D.txt", "images.txt"):
        return "colmap"
    if path.suffix.lower() in (".match", ".adjust"):
        return path.suffix.lower()[1:]
    if path.suffix.lower() == ".json":
        return "opensfm"
    try:
        with path.open("rb") as file:
            start = file.read(200)
    except OSError:
        return None
    if start.lstrip(b"\xef\xbb\xbf").startswith(b"# Bundle file"):
        return "bundler"
    words = start.partition(b"\n")[0].split()
    if path.suffix.lower() in (".bz2", ".gz") or (len(words) == 3 and all(word.isdigit() for word in words)):
        return "bal"
    return program_of(path)


def files_read(path: Path) -> tuple[Path, ...]:
    """Files whose change changes what is read from a path: those of a folder, or the file and what belongs to it.

    Parameters
    ----------
    path : Path
    """
    if path.is_dir():
        return tuple(sorted(each for each in path.iterdir() if each.is_file()))
    beside: tuple[Path, ...] = ()
    if path.stem in _COLMAP:
        beside = tuple(path.with_name(f"{name}{path.suffix}") for name in _COLMAP)
    elif path.suffix.lower() == ".json":
        beside = (_tracks_of(path),)
    elif path.suffix.lower() == ".adjust":
        beside = pinhole_files(path)[0]
    return (path, *(each for each in beside if each != path and each.is_file()))


def read_reconstruction(path: PathLike, format: str | None = None) -> Reconstruction:
    """Cameras, poses, object points and image measurements from files of another program.

    Parameters
    ----------
    path : path-like
        File, or folder of files that belong together.
    format : str, optional
        One of `READERS`; recognised unless given.

    Returns
    -------
    Reconstruction
        Its `notes` say what the files leave open.

    Raises
    ------
    InputError
        The format is not known, or a file is damaged; names file and place.

    Examples
    --------
    >>> block = read_reconstruction("odm/opensfm/reconstruction.json")  # doctest: +SKIP
    >>> len(block.images), block.observations.colrow.shape  # doctest: +SKIP
    (3, (4160, 2))
    """
    file = path_of(path, "path")
    if not file.exists():
        raise InputError("there is no such file or folder", where=str(file), hint="check the path")
    name = _known(format, READERS) if format else format_of(file)
    if name is None:
        raise InputError(
            "this is the file of no program that is known",
            where=str(file),
            hint=f"say which it is with `format`: {', '.join(READERS)}",
        )
    with default_hint(f"write {file.name} again with the program it comes from, or correct what was edited in it"):
        return READERS[name][0](file)


def _known(name: str, formats: Mapping[str, object]) -> str:
    if name not in formats:
        hint = f"{did_you_mean(name, formats)} known are: {', '.join(formats)}".strip()
        raise InputError(f"no format is named '{name}'", where="`format`", hint=hint)
    return name


def _contents(format: str, found: Reconstruction, name: str) -> Mapping[str, str | bytes]:
    """Contents of the files of a format by name, of a reconstruction and the last part of the given path."""
    match format:
        case "colmap" | "colmap-text":
            from geomosaic.interchange.colmap import text_of, to_records
            from geomosaic.interchange.colmap_binary import bytes_of

            model = to_records(found)
            return bytes_of(model) if format == "colmap" else text_of(model)
        case "opensfm":
            from geomosaic.interchange.opensfm import texts_of

            return texts_of(found)
        case "bundler":
            from geomosaic.interchange.bundler import bundler_texts

            return bundler_texts(found)
        case "bal":
            from geomosaic.interchange.bundler import bal_bytes

            return {name: bal_bytes(found, Path(name).suffix.lower())}
        case "metashape":
            from geomosaic.interchange.metashape import metashape_xml

            return {name: metashape_xml(found)}
        case "pix4d":
            from geomosaic.interchange.pix4d import pix4d_texts

            return pix4d_texts(found, name)
        case "ori":
            from geomosaic.interchange.photo_files import ori_texts

            return ori_texts(found)
        case _:
            from geomosaic.interchange.asp import adjustment_files, match_files

            return match_files(found) if format == "match" else adjustment_files(found)


@dataclass(frozen=True)
class Writer:
    """How a format is written.

    Attributes
    ----------
    ending : str, optional
        Of the file's name; None where the format is a folder.
    in_map : bool
        Whether it counts in the axes of a map.
    """

    ending: str | None = None
    in_map: bool = False


WRITERS: Mapping[str, Writer] = {
    "colmap": Writer(),
    "colmap-text": Writer(),
    "opensfm": Writer(),
    "bundler": Writer(),
    "bal": Writer(".txt"),
    "metashape": Writer(".xml"),
    "pix4d": Writer(PIX4D[0], in_map=True),
    "ori": Writer(in_map=True),
    "match": Writer(),
    "adjust": Writer(),
}


def write_reconstruction(
    reconstruction: Reconstruction, path: PathLike, format: str, *, overwrite: bool = False
) -> tuple[Path, ...]:
    """Files of another program, of a reconstruction.

    Parameters
    ----------
    reconstruction : Reconstruction
    path : path-like
        Folder, which is made where it is missing; of 'bal', 'metashape' and 'pix4d' a file.
    format : str
        One of `WRITERS`.
    overwrite : bool
        Whether files of the same names may be replaced.

    Returns
    -------
    tuple of Path
        Written, each whole.

    Raises
    ------
    InputError
        The format is not known, or has no place for a lens or a missing pose: nothing is written.
    OutputExistsError
        A file is there already.
    """
    from geomosaic.raster.files import check_output

    if not isinstance(reconstruction, Reconstruction):
        hint = "give what `read_reconstruction` returns, or `reconstruction()` of an adjusted block"
        raise InputError(f"{type(reconstruction).__name__} is no reconstruction", where="`reconstruction`", hint=hint)
    target = path_of(path, "path")
    writer = WRITERS[_known(format, WRITERS)]
    folder = writer.ending is None
    files = _contents(format, reconstruction, target.name)
    home = target if folder else target.parent
    if folder and target.is_file():
        raise InputError("the output is a file", where=str(target), hint=f"'{format}' is written to a folder")
    if home.parent.is_dir():
        home.mkdir(exist_ok=True)
    for name in files:
        check_output(home / name, overwrite=overwrite)
    for name, data in files.items():
        with under_construction(home / name) as unfinished:
            unfinished.write_bytes(data if isinstance(data, bytes) else data.encode())
    return tuple(home / name for name in files)
