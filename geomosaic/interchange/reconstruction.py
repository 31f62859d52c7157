"""Reconstruction: cameras, images with their poses, object points and their measurements, as any program leaves them.

A pose takes the world to the camera, X_c = R·(X − C), with camera axes x right, y down, z forward. (0.5, 0.5) is the
centre of the upper-left pixel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, counted, listed
from geomosaic.geo.crs import has_heights, horizontal, parse_crs, with_heights
from geomosaic.geo.local_frames import LocalFrame, map_place, r3
from geomosaic.geo.transform import Transform
from geomosaic.sensor.inputs import numbers, pair
from geomosaic.types import BoolArray, ByteArray, FloatArray, IntArray

# Camera table, as in `camera.toml`, where a file has one, and orientation row with `rotation` and `position`.
Tables = Mapping[str, tuple[Mapping[str, Any] | None, Mapping[str, Any]]]


@dataclass(frozen=True, eq=False)
class ImagePose:
    """Image with its camera and pose.

    Attributes
    ----------
    name : str
        File name, as the program wrote it.
    camera : str, optional
        Key of `Reconstruction.cameras`.
    rotation : array (3, 3), optional
        World → camera; None where the image is not oriented.
    centre : array (3,), optional
        Projection centre in the world.
    """

    name: str
    camera: str | None = None
    rotation: FloatArray | None = None
    centre: FloatArray | None = None

    @property
    def oriented(self) -> bool:
        """Whether the pose is known."""
        return self.rotation is not None and self.centre is not None

    @property
    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Rotation (3, 3) and projection centre (3,); an error where the image is not oriented."""
        if self.rotation is None or self.centre is None:
            raise InputError("the image is not oriented", where=self.name, hint="leave it out, or orient it")
        return self.rotation, self.centre


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """Points in space.

    Attributes
    ----------
    ids : tuple of str
    xyz : array (S, 3)
        In the world; NaN where a coordinate is not known.
    colour : array (S, 3), optional
        Red, green, blue, 0 to 255.
    """

    ids: tuple[str, ...]
    xyz: FloatArray
    colour: ByteArray | None = None

    @property
    def known(self) -> BoolArray:
        """Whether all three coordinates are known (S,)."""
        out: BoolArray = np.asarray(np.isfinite(self.xyz).all(axis=1))
        return out

    @property
    def colours(self) -> ByteArray:
        """Colours (S, 3), black where there are none."""
        return np.zeros((len(self.ids), 3), np.uint8) if self.colour is None else self.colour

    @classmethod
    def unknown(cls, ids: Sequence[str]) -> ObjectPoints:
        """Points whose coordinates are not known."""
        return cls(tuple(ids), np.full((len(ids), 3), np.nan))


@dataclass(frozen=True, eq=False)
class ImagePoints:
    """Measurements of points in images.

    Attributes
    ----------
    image, point : array (N,)
        Index of the image, and of the point.
    colrow : array (N, 2)
        Pixels.
    sigma : array (N,), optional
        Standard deviation of a coordinate, pixels; NaN where not told.
    scale : array (N,), optional
        Size of the feature, pixels: how well it was measured it does not say; NaN where not told.
    """

    image: IntArray
    point: IntArray
    colrow: FloatArray
    sigma: FloatArray | None = None
    scale: FloatArray | None = None

    @classmethod
    def none(cls) -> ImagePoints:
        """No measurements."""
        return cls(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class SurveyedPoints:
    """Control points with their measurements.

    Attributes
    ----------
    points : ObjectPoints
        In `crs`, x east.
    observations : ImagePoints
    crs : str, optional
        Such as 'EPSG:4979'; None where the file does not say.
    """

    points: ObjectPoints
    observations: ImagePoints
    crs: str | None = None


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Cameras, images, object points and their measurements.

    Attributes
    ----------
    cameras : mapping of str to mapping
        Camera tables, as in `camera.toml`; without `size` where the program does not tell it, and then pixels count
        from the middle of the image (`with_sizes`).
    images : tuple of ImagePose
    points : ObjectPoints
    observations : ImagePoints
    crs : str, optional
        CRS of the world, where the file names it; with a `reference` the geographic CRS of that, EPSG:4979 if None.
    reference : tuple of float, optional
        Longitude, latitude, altitude of the origin of a world that is east, north, up there.
    control : SurveyedPoints, optional
    notes : tuple of str
        What the file leaves open.
    before : tuple of ImagePose
        Images as they were before an adjustment, in the same world, for programs that keep the difference; those whose
        pose was not known then are not among them.
    """

    cameras: Mapping[str, Mapping[str, Any]]
    images: tuple[ImagePose, ...]
    points: ObjectPoints = field(default_factory=lambda: ObjectPoints((), np.zeros((0, 3))))
    observations: ImagePoints = field(default_factory=ImagePoints.none)
    crs: str | None = None
    reference: tuple[float, float, float] | None = None
    control: SurveyedPoints | None = None
    notes: tuple[str, ...] = ()
    before: tuple[ImagePose, ...] = ()

    def __repr__(self) -> str:
        counts = (
            (len(self.images), "image"),
            (len(self.cameras), "camera"),
            (len(self.points.ids), "point"),
            (len(self.observations.point), "measurement"),
        )
        return f"Reconstruction({', '.join(counted(count, noun) for count, noun in counts)})"

    def camera_of(self, image: ImagePose) -> Mapping[str, Any]:
        """Camera table of an image; an error where it has none.

        Parameters
        ----------
        image : ImagePose
        """
        if image.camera is None or image.camera not in self.cameras:
            raise InputError("the image has no camera", where=image.name, hint="give its camera's table")
        return self.cameras[image.camera]

    @property
    def on_earth(self) -> LocalFrame | None:
        """Axes of the world on the Earth, where `crs` or `reference` tell them."""
        crs = CRS.from_user_input(self.crs) if self.crs else None
        if self.reference is not None:
            return LocalFrame.at(crs or CRS.from_epsg(4979), np.array(self.reference))
        return LocalFrame(crs, np.zeros(3), np.eye(3)) if crs is not None and crs.is_geocentric else None

    def require_map(self, program: str) -> None:
        """An error where the world is known to be no map, for programs that count in one.

        Parameters
        ----------
        program : str
            Named in errors.
        """
        if self.on_earth is not None:
            world = "geocentric" if self.reference is None else "east, north, up at a reference"
            raise InputError(
                f"{program} counts in the axes of a map, this reconstruction is {world}",
                where="reconstruction",
                hint="bring it to a map, `in_map('EPSG:32633', 'egm96')` for example, or write it as 'metashape', "
                "'opensfm' or 'colmap'",
            )

    def in_map(self, crs: CRS | str, heights: str | None = None) -> Reconstruction:
        """The same in the axes of a map: places are transformed, rotations counted from grid north.

        Read again with that CRS, photos are where they were; a program that takes the map for a flat Earth misses its
        curvature, s²/(2·R) in height at a distance s.

        Parameters
        ----------
        crs : CRS or str
            Projected, with a vertical datum.
        heights : str, optional
            Vertical datum, where `crs` has none: 'ellipsoidal', 'egm96', an EPSG code, or a geoid grid.

        Raises
        ------
        InputError
            The CRS is no map, or nothing says where on the Earth the reconstruction is.
        """
        ground = parse_crs(crs, "`crs`") if heights is None else with_heights(parse_crs(crs, "`crs`"), heights)
        if not horizontal(ground).is_projected or not has_heights(ground):
            what = "has no vertical datum" if horizontal(ground).is_projected else "is no map"
            hint = "name a projected CRS and its heights, 'EPSG:32633' and 'egm96' for example"
            raise InputError(f"'{ground.name}' {what}", where="`crs`", hint=hint)
        frame = self.on_earth
        if frame is None:
            hint = "name its CRS: dataclasses.replace(block, crs='EPSG:4978'), or its `reference`"
            raise InputError("nothing says where on the Earth the reconstruction is", where="reconstruction", hint=hint)
        to_map = Transform(frame.crs, ground)

        def mapped(image: ImagePose) -> ImagePose:
            if not image.oriented:
                return image
            rotation, centre = image.pose
            place = to_map(frame.to_geocentric(centre[None]))[0]
            turn = r3(np.radians(map_place(ground, place[0], place[1]).convergence))
            return replace(
                image, rotation=rotation @ frame.axes @ LocalFrame.at(ground, place).axes.T @ turn, centre=place
            )

        images, before = tuple(map(mapped, self.images)), tuple(map(mapped, self.before))
        known = self.points.known
        xyz = np.full_like(self.points.xyz, np.nan)
        xyz[known] = to_map(frame.to_geocentric(self.points.xyz[known]))
        points = replace(self.points, xyz=xyz)
        return replace(self, images=images, points=points, crs=ground.to_wkt(), reference=None, before=before)

    def with_sizes(self, sizes: Mapping[str, tuple[int, int]]) -> Reconstruction:
        """The same with the sizes of images that their file did not tell: their pixels count from the corner then.

        Parameters
        ----------
        sizes : mapping
            Width and height by image name.

        Raises
        ------
        InputError
            Images of one camera differ in size, or one that needs its size is not named.
        """
        cameras = {name: dict(table) for name, table in self.cameras.items()}
        shift = np.zeros((len(self.images), 2))
        for index, image in enumerate(self.images):
            if image.camera is None or "size" in self.cameras[image.camera]:
                continue
            if image.name not in sizes:
                raise InputError("the size of the image is missing", where=image.name, hint="give width and height")
            size, table = list(sizes[image.name]), cameras[image.camera]
            if table.setdefault("size", size) != size:
                raise InputError(
                    f"{image.name} has {size} pixels, another image of its camera {table['size']}",
                    where=f"camera {image.camera}",
                    hint="give each size its own camera",
                )
            shift[index] = np.array(size) / 2
            table["principal_point_px"] = (
                np.array(numbers(self.cameras[image.camera]["principal_point_px"], 2, "principal_point_px", image.name))
                + shift[index]
            ).tolist()
        seen = replace(self.observations, colrow=self.observations.colrow + shift[self.observations.image])
        return replace(self, cameras=cameras, observations=seen)


def of_tables(tables: Tables, notes: tuple[str, ...] = ()) -> Reconstruction:
    """Reconstruction without points of tables of each image; cameras that are the same are one.

    Parameters
    ----------
    tables : mapping
        Camera table and orientation row by image name.
    notes : tuple of str
    """
    names: dict[str, str] = {}
    cameras: dict[str, Mapping[str, Any]] = {}
    images = []
    for image, (camera, row) in tables.items():
        name = None
        if camera is not None:
            name = names.setdefault(repr(camera), str(len(names) + 1))
            cameras.setdefault(name, camera)
        images.append(
            ImagePose(
                image,
                name,
                np.array(row["rotation"], dtype=np.float64).reshape(3, 3),
                np.array(row["position"], dtype=np.float64),
            )
        )
    return Reconstruction(cameras, tuple(images), notes=notes)


@dataclass(frozen=True)
class PixelCamera:
    """Camera table in pixels, as writers need it.

    Attributes
    ----------
    size : tuple of int, optional
        Width and height.
    focal, principal : tuple of float
        Along columns and rows; the principal point from the outer corner, without a size from the middle.
    model : str
        'none', 'brown', 'opencv' or 'fisheye'.
    lens : dict of float
        Coefficients that the table has.
    shear : float
    one_focal : bool
        Whether the table has one focal length for both directions.
    """

    size: tuple[int, int] | None
    focal: tuple[float, float]
    principal: tuple[float, float]
    model: str
    lens: dict[str, float]
    shear: float
    one_focal: bool

    def known_size(self, where: str) -> tuple[int, int]:
        """Width and height; an error where they are not known."""
        if self.size is None:
            raise InputError("the size of its images is not known", where=where, hint="give it with `with_sizes`")
        return self.size

    def known_only(self, program: str, where: str, **models: Sequence[str]) -> None:
        """An error where a lens that is not zero has no place in a program's file; models with their coefficients."""
        given = {name for name, value in self.lens.items() if value != 0.0}
        given |= {"shear"} if self.shear else set()
        more = given - set(models.get(self.model, ()))
        if self.model not in models and given:
            more = {self.model}
        if more:
            raise InputError(
                f"{program} has no place for a lens with {listed(sorted(more))}",
                where=where,
                hint="adjust the camera without it, or write another format",
            )

    @property
    def from_middle(self) -> tuple[float, float]:
        """Principal point, counted from the middle of the image."""
        width, height = self.size or (0, 0)
        return self.principal[0] - width / 2, self.principal[1] - height / 2

    @property
    def middle(self) -> FloatArray:
        """Column and row (2,) of the middle of the image."""
        return np.array(self.size or (0, 0)) / 2


def pixel_camera(table: Mapping[str, Any], where: str) -> PixelCamera:
    """Camera of a table in pixels.

    Parameters
    ----------
    table : mapping
        As in `camera.toml`, with `focal_length_px`.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The table is in millimetres, of film, or has a lens that no other program knows.
    """
    if "fiducials" in table or "focal_length_px" not in table:
        raise InputError(
            "the camera is not in pixels: other programs take no millimetres and no fiducial marks",
            where=where,
            hint="give focal_length_px and principal_point_px, for film those of a scan without its deformations",
        )
    lens = dict(table.get("distortion", {"model": "none"}))
    model, shear = str(lens.pop("model", "none")), float(lens.pop("shear", 0.0))
    usual = (None, [0.0, 0.0], "ideal", "opencv")
    odd = {key for key in ("centre", "corrects", "convention") if lens.pop(key, None) not in usual}
    for key, what in (("additional", "additional parameters of Ebner or Grün"), ("rolling_shutter", "rolling shutter")):
        if key in table:
            hint = "adjust with a lens alone, such as `interior` = brown, to hand the block on"
            raise InputError(f"other programs have no {what}", where=where, hint=hint)
    if odd:
        raise InputError(
            f"other programs have no lens with {listed(sorted(odd))}",
            where=where,
            hint="describe the lens about the principal point, from ideal to distorted",
        )
    focal = table["focal_length_px"]
    size = None
    if table.get("size") is not None:
        width, height = numbers(table["size"], 2, "size", where)
        size = (int(width), int(height))
    default = [0.0, 0.0] if size is None else [size[0] / 2, size[1] / 2]
    x, y = numbers(table.get("principal_point_px", default), 2, "principal_point_px", where)
    if model not in ("none", "brown", "opencv", "fisheye"):
        hint = "describe it by coefficients of one of none, brown, opencv, fisheye"
        raise InputError(f"no other program has the lens '{model}'", where=where, hint=hint)
    coefficients = {key: float(value) for key, value in lens.items()}
    return PixelCamera(
        size, pair(focal, "focal_length_px", where), (x, y), model, coefficients, shear, isinstance(focal, float | int)
    )
