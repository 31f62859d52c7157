"""Declarations of inputs: `Scene` and `Block` of images, and `Camera`, the table that a sensor plugin reads."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from geomosaic.control.points import ControlPoints
from geomosaic.errors import InputError, did_you_mean, warn
from geomosaic.image_names import file_of_image
from geomosaic.inputs.exterior_orientation import Exterior, ExteriorTable, exterior_values
from geomosaic.options.inputs import CRS_FILES, GEOID_FILES, BlockInputs
from geomosaic.sensor.inputs import camera_file
from geomosaic.sensor.registry import check_camera, plane_sensor
from geomosaic.stores.path import expanded, to_path
from geomosaic.surface.dem import Dem
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of


class Camera(Mapping[str, Any]):
    """Camera description: the keys of a camera file as values.

    Which keys there are, and in which units, is the sensor's affair: `geomosaic sensors NAME` and the page on sensors
    list them. Nested tables are mappings.

    Parameters
    ----------
    **values
        Keys of the camera file.

    Raises
    ------
    InputError
        No installed sensor knows a key; names it, and the one that was probably meant.

    Examples
    --------
    >>> Camera(focal_length=153.2, pixel_size=14.0)["focal_length"]
    153.2
    """

    def __init__(self, **values: Any) -> None:
        check_camera(values, "Camera")
        self._values = dict(values)

    @classmethod
    def read(cls, path: PathLike) -> Camera:
        """Camera of a TOML file, or of orthority's YAML.

        Parameters
        ----------
        path : path-like

        Raises
        ------
        InputError
            The file cannot be read; names file and line.
        """
        return cls(**read_camera(path_of(path, "path")))

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return f"Camera({', '.join(f'{name}={value!r}' for name, value in self._values.items())})"


def read_camera(camera: PathLike | Camera) -> dict[str, Any]:
    """Camera description as a table; a single [camera] table at the top of a file is unwrapped.

    Parameters
    ----------
    camera : path-like or Camera
        TOML file, YAML file of another program, or values.

    Returns
    -------
    dict
        Keys as the sensor documents them.

    Raises
    ------
    InputError
        The file is neither TOML nor YAML by its ending, cannot be read, or is damaged.
    """
    return dict(camera) if isinstance(camera, Camera) else camera_file(camera)


# It has no field of its own: all methods but the frozen ones are those of its base, and are not made anew.
@dataclass(frozen=True, init=False, repr=False, eq=False)
class Block(BlockInputs):
    """Declaration of a block: images of one sensor with what is known of them; nothing is read before it is used.

    What a file can say can be given as a value, too: `Camera`, `Exterior`, `Dem`, `ControlPoints`.

    Attributes
    ----------
    images : tuple of Path
        One path, or several.
    sensor : str
        Name of the sensor plugin; unless given, images lie as their files say.
    options : mapping
        The plugin's own inputs, the same for all images.
    image_options : mapping of str to mapping
        Inputs of the plugin for single images by name, `camera` among them; they come before `options`.
    base : Path
        Folder that relative file names in `options` start from.
    camera : Path or Camera, optional
        Camera description (TOML, or orthority's YAML).
    corrections : str, optional
        File of a correction grid; '{image}' in it takes the name of each image, without it one serves all.
    fiducials : Path, optional
        Fiducial marks measured in the scans of films.
    exterior : Path, Exterior or mapping of str to Exterior, optional
        Orientation table; or orientations by image name, which bring `crs`, `heights` and `angles` with them.
    crs : str, optional
        CRS of positions and control points.
    heights : str, optional
        Vertical datum of positions and control points.
    angles : str
        Angle system of the orientation table.
    angle_unit : str, optional
        'deg', 'gon' or 'rad' as declared; degrees unless it is, and an error where they do not look like degrees.
    angle_frame : str, optional
        'grid' or 'local', where the angles refer to another north than their system says.
    matrix : str, optional
        Direction of rotation matrices: 'ground_to_image' or 'image_to_ground'.
    printed : ListingLayout, optional
        How a printed list of orientations is to be read, with angles 'printed'.
    trusted : bool
        Skip the plausibility check of the orientation.
    dem : Path or Dem, optional
        Digital elevation model.
    height : float, optional
        A constant height in metres, instead of a DEM.
    dem_from_tie_points : bool
        The ground is made of the adjusted tie points, see `gm.adjust`.
    dem_heights : str, optional
        Vertical datum of the DEM or of `height`; overrides what the DEM's file says.
    control : Path, ControlPoints or mapping of str to ControlPoints, optional
        Control and check points; as values by image name.
    src_nodata : float, optional
        Value of missing pixels of the images, in place of what the files say.
    bands : tuple of int, optional
        Bands of the images to use, counted from 1, in this order; all but alpha unless given.
    planar : PlanarInputs, optional
        Where the photos are placed together by plane transformations.
    margin : tuple of float, optional
        Pixels at the left, top, right and bottom of every image that are not to be used.
    usable : Path, optional
        Table of polygons in image coordinates, beyond which images are not to be used.
    band_names : tuple of str, optional
        Bands to use by name, colour or wavelength, in this order, wherever each file has them; in place of `bands`.
    declared_bands : tuple of str, optional
        Names or wavelengths of the bands of the files, in their order, in place of what the files say.
    acquired : str, optional
        Day of acquisition, in place of what the files say.
    cloud_cover : float, optional
        Percentage of the images that is cloud, in place of what the files say.
    clouds : str, optional
        Raster of the pixels that are cloud; '{image}' in it takes the name of each image.
    cloud_values : tuple of int, optional
        Its values that stand for clouds; all but 0 unless given.
    """

    def __post_init__(self) -> None:
        put = object.__setattr__  # the value is frozen from here on
        roles = {"`dem`": file_of(self.dem), "`heights`": _grid(self.heights), "`dem_heights`": _grid(self.dem_heights)}
        put(self, "images", leave_out(image_paths(self.images), roles))
        if isinstance(self.camera, Mapping) and not isinstance(self.camera, Camera):
            put(self, "camera", Camera(**self.camera))
        for name, kinds, example in _VALUES:
            given = getattr(self, name)
            if given is not None and not isinstance(given, str | Path | kinds):
                what = f"{type(given).__name__} is neither a path nor {example}"
                raise InputError(what, where=f"`{name}`", hint=f"give {example}, or the path of a file")
        super().__post_init__()
        if not self.sensor:
            put(self, "sensor", plane_sensor())
        elif self.planar is not None and self.sensor != plane_sensor():
            own, other = f"`kind={self.planar.kind}`", f"`sensor={self.sensor}`"
            what = f"{own} places photos without a rigorous model, and {other} names one"
            raise InputError(what, hint="leave one of them out")
        names = [image.name for image in self.images]
        for name in self.image_options.keys() - names:
            what = f"inputs are given for '{name}', which is no image of the block"
            raise InputError(what, where="`image_options`", hint=did_you_mean(name, names) or "check the name")
        if isinstance(self.control, ControlPoints):
            put(self, "control", {self._only("control"): self.control})
        if isinstance(self.exterior, Exterior):
            put(self, "exterior", {self._only("exterior"): self.exterior})
        if isinstance(self.exterior, Mapping):
            table, common = exterior_values(self.exterior)
            put(self, "exterior", table)
            for name, value in common.items():
                put(self, name, value)
        if isinstance(self.control, Mapping) and self.control and self.crs is None:
            put(self, "crs", next(iter(self.control.values())).crs.to_wkt())

    def __repr__(self) -> str:
        shown = [f"'{self.images[0].name}'" if len(self.images) == 1 else f"{len(self.images)} images"]
        for item in fields(self)[1:]:
            value = getattr(self, item.name)
            if value != (item.default_factory() if callable(item.default_factory) else item.default):
                short = repr(value) if isinstance(value, str | int | float | tuple) else type(value).__name__
                shown.append(f"{item.name}={repr(value.name) if isinstance(value, Path) else short}")
        return f"{type(self).__name__}({', '.join(shown)})"

    def _only(self, parameter: str) -> str:
        """Name of the one image that a single value can belong to."""
        if len(self.images) != 1:
            raise InputError(
                f"one value is given for {len(self.images)} images",
                where=f"`{parameter}`",
                hint="give one by image name",
            )
        return self.images[0].name

    @property
    def tables(self) -> tuple[Path, ...]:
        """Files that say how the images were taken."""
        ties = self.planar.ties if self.planar else None
        given = (self.camera, self.fiducials, self.exterior, self.control, ties)
        named = Path(self.crs) if self.crs and self.crs.lower().endswith(CRS_FILES) else None
        own = (*map(file_of, given), _grid(self.heights), named)
        grids = [file_of_image(self.corrections, image.name) for image in self.images] if self.corrections else []
        others = _beside(self.exterior, self.angles, self.images)
        return (
            *(path for path in own if isinstance(path, Path)),
            *others,
            *self.masks,
            *dict.fromkeys(grids),
            *dict.fromkeys((*_named_in(self.options, self.base), *_named_in(self.image_options, self.base))),
        )

    @property
    def masks(self) -> tuple[Path, ...]:
        """Files that say which parts of the images show nothing of the ground."""
        clouds = [file_of_image(self.clouds, image.name) for image in self.images] if self.clouds else []
        return tuple(dict.fromkeys((*([self.usable] if self.usable else []), *clouds)))

    @property
    def ground(self) -> tuple[Path, ...]:
        """Files that say how high the ground is."""
        return tuple(path for path in (file_of(self.dem), _grid(self.dem_heights), _grid(self.heights)) if path)

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that are read."""
        return (*self.images, *self.tables, *self.ground)


# Inputs that a file or a value gives: the types of the value, and an example of one.
_VALUES: tuple[tuple[str, Any, str], ...] = (
    ("camera", Camera, "`Camera(...)`"),
    ("exterior", Exterior | ExteriorTable | Mapping, "`Exterior(...)`"),
    ("dem", Dem, "`Dem.from_array(...)`"),
    ("control", ControlPoints | Mapping, "`ControlPoints(...)`"),
)


@dataclass(frozen=True, init=False, repr=False, eq=False)
class Scene(Block):
    """Declaration of one image: a block of one, with the parameters of `Block`.

    Parameters
    ----------
    image : path-like
    sensor : str
        Name of the sensor plugin; unless given, the image lies as its file says.
    **inputs
        As of `Block`: `camera`, `exterior`, `crs`, `heights`, `dem`, `height`, `control`, `bands`, `options`, ...

    Examples
    --------
    >>> camera = Camera(focal_length=50.0, pixel_size=5.0)
    >>> angles = {"omega": 0.1, "phi": -0.2, "kappa": 91.0}
    >>> exterior = Exterior(500000.0, 5400000.0, 1200.0, **angles, crs="EPSG:32633", heights="egm96")
    >>> Scene("0417.tif", "frame", camera=camera, exterior=exterior).name
    '0417.tif'
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self._only("images")

    @property
    def name(self) -> str:
        """Name of the image: that of its file, without folders."""
        return self.images[0].name


def image_paths(images: Any, parameter: str = "images") -> tuple[Path, ...]:
    """Paths of one or several images.

    Parameters
    ----------
    images : path or iterable of path
    parameter : str
        Its name, for the message.

    Raises
    ------
    InputError
        One of them is no path.
    """
    several = images if isinstance(images, Iterable) and not isinstance(images, str) else (images,)
    return tuple(path for image in several for path in expanded(path_of(image, parameter)))


def block_of(given: object, parameter: str) -> Block:
    """Block that a caller has given, where paths do not say how the images lie.

    Parameters
    ----------
    given : object
    parameter : str
        Its name, for the message.

    Raises
    ------
    InputError
        It is no block.
    """
    if not isinstance(given, Block):
        what = f"{type(given).__name__} does not describe images"
        raise InputError(
            what, where=f"`{parameter}`", hint="give Scene(FILE, SENSOR, ...) or Block(FILES, SENSOR, ...)"
        )
    return given


def as_block(images: Block | Sequence[PathLike] | PathLike) -> Block:
    """Block of images that are given as one, or by their paths.

    Parameters
    ----------
    images : Block, sequence of path or path
        Images given by paths lie as their files say.
    """
    return images if isinstance(images, Block) else Block(image_paths(images))


def as_blocks(images: Block | Sequence[Block | PathLike] | PathLike) -> tuple[Block, ...]:
    """Blocks of images that are given as one, by their paths, or one by one with sensors of their own.

    Parameters
    ----------
    images : Block, sequence of Block or path, or path

    Returns
    -------
    tuple of Block
        One of all images that are given by their paths.

    Raises
    ------
    InputError
        No image is given.
    """
    if isinstance(images, Block | str) or not isinstance(images, Iterable):
        return (as_block(images),)
    paths = tuple(image for image in images if not isinstance(image, Block))
    found = [image for image in images if isinstance(image, Block)]
    if not (paths or found):
        raise InputError("no image is given", where="`images`", hint="name one at least")
    return (*found, Block(image_paths(paths))) if paths else tuple(found)


def on_ground(block: Block, dem: PathLike | Dem | float | None, dem_heights: str | None) -> Block:
    """Block over another ground than its own, where one is given.

    Parameters
    ----------
    block : Block
    dem : path, Dem, float or None
        DEM, or one height in metres; the block's own ground unless given.
    dem_heights : str or None
        Vertical datum of the heights, where they do not say it.
    """
    if dem is None:
        return block if dem_heights is None else replace(block, dem_heights=dem_heights)
    # A block has one ground: the new one replaces a DEM and a constant height alike.
    if isinstance(dem, int | float) and not isinstance(dem, bool):
        return replace(block, dem=None, height=float(dem), dem_from_tie_points=False, dem_heights=dem_heights)
    return replace(block, dem=dem, height=None, dem_from_tie_points=False, dem_heights=dem_heights)


def file_of(given: object) -> Path | None:
    """File of an input.

    Parameters
    ----------
    given : object
        Path, `Dem`, another value or None.

    Returns
    -------
    Path or None
        None of an input that is given as a value, or not at all.
    """
    if isinstance(given, Dem):
        return to_path(given.path) if given.path else None
    return given if isinstance(given, Path) else None


def leave_out(images: Sequence[Path], roles: Mapping[str, Path | None]) -> tuple[Path, ...]:
    """Images without the files that have another role; a warning names each.

    Parameters
    ----------
    images : sequence of Path
        The only image is always kept.
    roles : mapping of str to Path
        Files by the input that names them; None where it is not given.
    """
    # Patterns such as `*.tif` match a DEM, a reference or an output in the folder of the images, too.
    if len(images) < 2:
        return tuple(images)
    others = {path.resolve(): role for role, path in roles.items() if path is not None}
    kept = tuple(image for image in images if image.resolve() not in others) if others else tuple(images)
    for image in images if len(kept) < len(images) else ():
        role = others.get(image.resolve())
        if role is not None:
            text = f"{image.name} is the file of {role}: it is left out of the images"
            warn(text)
    return kept


def _grid(heights: str | None) -> Path | None:
    """Path of a geoid grid, where a vertical datum is given as one."""
    return to_path(heights) if heights and heights.lower().endswith(GEOID_FILES) else None


def _beside(exterior: Path | ExteriorTable | None, angles: str, images: Sequence[Path]) -> tuple[Path, ...]:
    """Files of another program that are read with the one that is named."""
    if not isinstance(exterior, Path):
        return ()
    if angles == "colmap":
        return tuple(exterior.with_name(f"{name}{exterior.suffix}") for name in ("cameras", "images"))
    if angles == "ori":
        files = (exterior.with_name(f"{image.stem}.ori.xml") for image in images)
        return tuple(file for file in files if file.is_file() and file != exterior)
    if angles == "tsai":
        from geomosaic.interchange.files import pinhole_files

        return tuple(file for files in pinhole_files(exterior) for file in files if file != exterior.absolute())
    if angles != "pix4d":
        return ()
    from geomosaic.interchange.files import PIX4D

    for ending in PIX4D:
        if exterior.name.endswith(ending):
            offset = exterior.with_name(exterior.name.removesuffix(ending) + "_offset.xyz")
            return (offset,) if offset.is_file() else ()
    return ()


def _named_in(value: Any, base: Path) -> tuple[Path, ...]:
    """Files that the inputs of a sensor name, at any depth."""
    if isinstance(value, Mapping):
        return tuple(path for item in value.values() for path in _named_in(item, base))
    if isinstance(value, list):
        return tuple(path for item in value for path in _named_in(item, base))
    try:
        return (base / value,) if isinstance(value, str) and value and (base / value).is_file() else ()
    except (OSError, ValueError):  # too long, or not what a name can be
        return ()
