"""Images of a block before its adjustment: models as they were declared, their cameras, and the ground's CRS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedBlock, OrientedImage
from geomosaic.block_adjustment.measurements import Measurements
from geomosaic.errors import InputError, counted, listed, warn
from geomosaic.geo.crs import geographic, has_heights, horizontal, in_degrees, is_local, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import build_block, join_blocks
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import RECONSTRUCTIONS, ExteriorRow
from geomosaic.inputs.ground import build_surface
from geomosaic.inputs.images import photos_of
from geomosaic.inputs.recorded_cameras import check_recorded_cameras
from geomosaic.inputs.recorded_places import check_recorded_places
from geomosaic.inputs.vertical_datums import positions_crs
from geomosaic.render.extent import utm_zone
from geomosaic.sensor.plugin import ControlUse, HasInterior, HasPose, SensorModel
from geomosaic.sensor.registry import capabilities
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray, IntArray

# Metres above the control points at which photos without any orientation wait for their first values.
WAITING = 1000.0
# Parameter of an interior orientation that one image of a camera may tell.
FOCAL = "focal_length"
# Metres within which positions of a flight cannot all lie, and from their middle beyond which one is in another land:
# the latter also in median distances, as blocks may be countries wide.
ONE_PLACE = 1e-3
ABROAD, ABROAD_TIMES = 1e5, 20.0


@dataclass(frozen=True, eq=False)
class StartBlock:
    """Images of a block as they were declared.

    Attributes
    ----------
    scenes : tuple of OrientedImage (M,)
    oriented : bool array (M,)
        Whether the model's orientation is one to start from.
    placed : bool array (M,)
        Whether its position is; of photos with positions alone it is, and the orientation is not.
    rows : tuple of ExteriorRow or None (M,)
        Rows of the orientation tables.
    frames : tuple of CRS or None (M,)
        3-D CRS of these.
    camera : int array (M,)
        Camera of each image; images of one camera share what an adjustment finds of it.
    blocks : tuple of OrientedBlock
        Images of each part.
    surface : Surface or None
    ground : CRS
        3-D CRS of the results, in metres.
    from_tie_points : bool
        Whether the ground is to be made of the tie points.
    """

    scenes: tuple[OrientedImage, ...]
    oriented: BoolArray
    placed: BoolArray
    rows: tuple[ExteriorRow | None, ...]
    frames: tuple[CRS | None, ...]
    camera: IntArray
    blocks: tuple[OrientedBlock, ...]
    surface: Surface | None
    ground: CRS
    from_tie_points: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the images."""
        return tuple(scene.name for scene in self.scenes)

    @property
    def models(self) -> tuple[SensorModel, ...]:
        """Models as declared."""
        return tuple(scene.model for scene in self.scenes)

    def for_matching(self) -> StartBlock:
        """Block without what its adjustment alone asks for."""
        return replace(self, blocks=(), rows=(), frames=())

    def select(self, kept: BoolArray) -> StartBlock:
        """Block of some of its images (M,); its parts stay, without the others."""
        numbers = np.flatnonzero(kept).tolist()
        scenes = tuple(self.scenes[k] for k in numbers)
        names = {scene.name for scene in scenes}
        return replace(
            self,
            scenes=scenes,
            oriented=self.oriented[kept],
            placed=self.placed[kept],
            rows=tuple(self.rows[k] for k in numbers),
            frames=tuple(self.frames[k] for k in numbers),
            camera=self.camera[kept],
            blocks=tuple(
                replace(block, scenes=tuple(scene for scene in block.scenes if scene.name in names))
                for block in self.blocks
            ),
        )


def heightless_points(start: StartBlock, measured: Measurements) -> list[str]:
    """Note on points that nothing gives a height, as only maps show them (models with a horizontal CRS).

    Parameters
    ----------
    start : StartBlock
    measured : Measurements
    """
    flat = np.array([not has_heights(model.crs) for model in start.models])
    there = np.zeros(len(measured.ids), dtype=np.bool_)
    there[measured.point[~flat[measured.image]]] = True
    there |= np.isfinite(measured.sigma_given[:, 2])
    names = [name for name, known in zip(measured.ids, there.tolist(), strict=True) if not known]
    if not names:
        return []
    some = counted(len(names), "point")
    return [
        f"{some} without a height, which only plane images show, left out: {listed(names, 6)}; `dem_sigma` uses them"
    ]


def start_block(parts: Sequence[Block]) -> StartBlock:
    """Block of declared images, not adjusted by any control point.

    Parameters
    ----------
    parts : sequence of Block

    Raises
    ------
    InputError
        An input is missing or wrong; two images have one name.
    """
    for part in parts:
        if part.planar is not None:
            what = "photos that `kind` places together are adjusted in the plane"
            raise InputError(
                what, where="`kind`", hint="name the sensor that took them; 'planar' for a map or an ortho"
            )
    ground = _ground(parts)
    built, oriented, placed, rows, frames, cameras = [], [], [], [], [], list[tuple[Any, ...]]()
    for number, part in enumerate(parts):
        block, given = _built(part, ground)
        built.append(block)
        photos, crs = photos_of(part)
        check_recorded_places(part, photos, crs)
        rows += [photo.exterior for photo in photos]
        frames += [crs] * len(photos)
        oriented += [given and not _gaps(photo.exterior) for photo in photos]
        placed += [given and (photo.exterior is None or photo.exterior.placed) for photo in photos]
        cameras += [(number, str(part.image_options.get(photo.name, {}).get("camera", ""))) for photo in photos]
    joined = join_blocks([replace(part, control=None) for part in parts], built)
    numbers = {key: index for index, key in enumerate(dict.fromkeys(cameras))}
    start = StartBlock(
        joined.scenes, np.array(oriented, dtype=bool), np.array(placed, dtype=bool), tuple(rows), tuple(frames),
        np.array([numbers[key] for key in cameras]), tuple(built), joined.surface, ground,
        any(part.dem_from_tie_points for part in parts),
    )  # fmt: skip
    return _without_foreign_positions(start, any(part.control is not None for part in parts))


def _built(part: Block, ground: CRS) -> tuple[OrientedBlock, bool]:
    """Block of one part, and whether its images have an orientation, or as much of one as their table says."""
    plain = _plain(part)
    over = part.dem is not None or part.height is not None
    if _oriented(part):
        partial = [photo.name for photo in photos_of(part)[0] if _gaps(photo.exterior)]
        plain = _waiting_at(plain, partial, ground)
        try:
            return build_block(plain, ground=over), True
        except InputError:
            power = capabilities(part.sensor)
            if part.control is None or not (power.planar or power.control is ControlUse.ADJUSTMENT):
                raise
            # Of a scene without metadata its control points alone tell the flight. They are observed once more in the
            # block, where soft a-priori values then lie at those of this start: it is exact where all are free.
            return build_block(replace(part, trusted=True), ground=over), True
    block = build_block(_waiting_at(plain, [image.name for image in part.images], ground), ground=False)
    if not over:
        return block, False
    surface = build_surface(part, block.crs)
    if is_local(ground) and surface is not None and not is_local(surface.crs):
        raise InputError(
            "a DEM cannot serve a block in a local frame, whose place on the Earth is not known",
            where="`dem`",
            hint="leave it out: tie points give the ground; or give camera positions (`exterior`), or control points",
        )
    return replace(block, surface=surface), False


def _gaps(row: ExteriorRow | None) -> bool:
    """Whether a row of an orientation table leaves position or angles open."""
    return row is not None and not (row.placed and row.turned)


def _waiting_at(part: Block, names: Sequence[str], ground: CRS) -> Block:
    """Part with some orientation for images until the tie points give one: the sensor wants it for its camera's sake.

    What a table knows of them comes before it.
    """
    if not names:
        return part
    waiting = _waiting(part, ground)
    own = {name: {**part.image_options.get(name, {}), **waiting} for name in names}
    return replace(part, image_options={**part.image_options, **own})


def _plain(part: Block) -> Block:
    """Part as it was declared, not adjusted by its control."""
    return replace(part, control=None, trusted=True)


def _oriented(part: Block) -> bool:
    """Whether the images of a part have an orientation to start from."""
    given = part.exterior is not None or "orientation" in part.options or part.angles in RECONSTRUCTIONS
    return given or "orientation" not in capabilities(part.sensor).exterior


def _waiting(part: Block, ground: CRS) -> dict[str, Any]:
    crs = positions_crs(part.crs, part.heights) if part.crs else ground
    longitude, latitude, *_ = crs.area_of_use.bounds if crs.area_of_use else (0.0, 0.0)
    x, y = (0.0, 0.0)
    if not is_local(crs):
        flat = horizontal(crs)
        x, y = Transform(horizontal(geographic(flat)), flat)(np.array([[longitude + 1.0, latitude + 1.0]]))[0].tolist()
    return {
        "position": [x, y, WAITING],
        "orientation": {"system": "opk", "omega": 0.0, "phi": 0.0, "kappa": 0.0},
    }


def _ground(parts: Sequence[Block]) -> CRS:
    """CRS of the results: the first that is declared with heights; for one in degrees, or none, the UTM zone."""
    for part in parts:
        if not part.crs:
            continue
        crs = positions_crs(part.crs, part.heights)
        if not has_heights(crs):
            continue
        return _in_metres(crs, part) if in_degrees(crs) and not is_local(crs) else crs
    if not any(part.crs for part in parts):
        # Scenes with RPCs or an orbit, and reconstructions with a reference, say where on the Earth they are
        models = (build_block(_plain(part), ground=False).scenes[0].model for part in parts if _oriented(part))
        for model in models:
            if not is_local(model.crs):
                place = Transform(model.crs, CRS.from_epsg(4979))(_place(model)[None])[0]
                return with_heights(utm_zone(*place[:2].tolist()), "ellipsoidal")
    raise InputError(
        "nothing says in which CRS, above which vertical datum, the block lies",
        where="`crs`",
        hint="name `crs` and `heights` of the camera positions and the control points; where there are none, the `crs` "
        "'local' is a local frame, without a place on the Earth",
    )


def _in_metres(crs: CRS, part: Block) -> CRS:
    """UTM zone of the first camera position, with the heights of a CRS in degrees."""
    rows = [photo.exterior for photo in photos_of(part)[0] if photo.exterior is not None and photo.exterior.placed]
    heights = part.heights or (None if crs.is_compound else "ellipsoidal")
    if not rows or heights is None:
        raise InputError(
            f"a block is adjusted in metres, and '{crs.name}' is in degrees",
            where="`crs`",
            hint="name a projected CRS, such as the UTM zone, and its `heights`, and give coordinates in it",
        )
    # One position may be in another country; the first is the reference where a block lies on the antimeridian.
    places = Transform(horizontal(crs), CRS.from_epsg(4326))(np.array([row.position[:2] for row in rows]))
    east = (places[:, 0] - places[0, 0] + 180.0) % 360.0 - 180.0
    longitude = (float(np.median(east)) + places[0, 0] + 180.0) % 360.0 - 180.0
    return with_heights(utm_zone(float(longitude), float(np.median(places[:, 1]))), heights)


def single_images(start: StartBlock, controlled: IntArray) -> BoolArray:
    """Images (M,) without control that are the only one of their camera, in a block with a camera of several.

    Such an image is resected on the points of the others, which tells no lens from its pose.

    Parameters
    ----------
    start : StartBlock
    controlled : int array (C,)
        Images that show a control point.
    """
    count: IntArray = np.bincount(start.camera)[start.camera]
    found: BoolArray = (count == 1) & (count.max() > 1)
    found &= np.array([isinstance(model, HasInterior) for model in start.models])
    found[controlled] = False
    return found


def with_interior(
    start: StartBlock, wanted: Mapping[str, float], single: BoolArray
) -> tuple[tuple[SensorModel, ...], IntArray]:
    """Models with parameters of their interior orientation set free, and the camera (M,) of each; -1 for none.

    Parameters
    ----------
    start : StartBlock
    wanted : mapping of str to float
        A-priori standard deviations by name, or by the name of several together; inf for free. NAME:IMAGE is for the
        camera of that image alone.
    single : bool array (M,)
        Images of which a focal length with an a-priori standard deviation alone is found (`single_images`).

    Raises
    ------
    InputError
        No camera has such a parameter, no image such a name, or the images of one camera differ in size.
    """
    models, camera = list(start.models), np.full(len(start.scenes), -1)
    if not wanted:
        return tuple(models), camera
    wanted, of_cameras = _by_camera(start, wanted)
    known: dict[str, None] = {}
    for index, model in enumerate(models):
        if not isinstance(model, HasInterior):
            continue
        own = model.interior
        known |= dict.fromkeys((*own.names, *own.groups))
        known |= dict.fromkeys(name for names in own.groups.values() for name in names)
        free: dict[str, float] = {}
        for name, sigma in {**wanted, **of_cameras.get(int(start.camera[index]), {})}.items():
            free |= dict.fromkeys(own.groups.get(name, (name,)), sigma)
        if single[index]:
            free = {name: sigma for name, sigma in free.items() if name == FOCAL and np.isfinite(sigma)}
        given = [name for names in own.groups.values() for name in names if name in free]
        own = own.including(tuple(dict.fromkeys(given)))
        sigmas = np.array([free.get(name, 0.0) for name in own.names])
        if sigmas.any():
            models[index] = model.with_interior(replace(own, sigmas=sigmas))
            camera[index] = start.camera[index]
    for name in (*wanted, *(name for own in of_cameras.values() for name in own)):
        if name not in known:
            have = f"the cameras here have {listed(known, 20)}" if known else "no sensor of this block has any"
            raise InputError(f"no camera has the parameter '{name}'", where="`interior`", hint=have)
    numbers = {old: new for new, old in enumerate(np.unique(camera[camera >= 0]).tolist())}
    camera = np.array([numbers.get(old, -1) for old in camera.tolist()])
    for number in numbers.values():
        mine = np.flatnonzero(camera == number)
        _same(mine, start, models)
    return tuple(models), camera


def _by_camera(
    start: StartBlock, wanted: Mapping[str, float]
) -> tuple[Mapping[str, float], Mapping[int, Mapping[str, float]]]:
    """Standard deviations of all cameras, and of single ones by their number."""
    of_all, own = dict[str, float](), dict[int, dict[str, float]]()
    for key, sigma in wanted.items():
        name, colon, image = key.partition(":")
        if not colon:
            of_all[name] = sigma
        elif image in start.names:
            own.setdefault(int(start.camera[start.names.index(image)]), {})[name] = sigma
    return of_all, own


def unknown_images(start: StartBlock, wanted: Mapping[str, float]) -> list[str]:
    """Note on parameters of cameras by images that the block does not have, such as those that were set aside.

    Parameters
    ----------
    start : StartBlock
    wanted : mapping of str to float
        As `with_interior` takes it.
    """
    names = [key for key in wanted if ":" in key and key.partition(":")[2] not in start.names]
    return [f"`interior` of images that are not in the block, not used: {listed(names, 6)}"] if names else []


def check_cameras(start: StartBlock, parts: Sequence[Block]) -> None:
    """Check that images declared with one camera, whose interior orientation is to be found, record no other.

    Parameters
    ----------
    start : StartBlock
    parts : sequence of Block
        As declared; those that are trusted pass.

    Raises
    ------
    InputError
        Names two images, and what they record.
    """
    trusted = {image.name for part in parts if part.trusted for image in part.images}
    for number in np.unique(start.camera).tolist():
        own = [start.scenes[index] for index in np.flatnonzero(start.camera == number).tolist()]
        check_recorded_cameras(
            [scene for scene in own if scene.name not in trusted and hasattr(scene.model, "interior")]
        )


def _same(images: IntArray, start: StartBlock, models: Sequence[SensorModel]) -> None:
    """Check that images of one camera have one interior orientation."""
    own = [(start.names[index], models[index].size, _interior(models[index])) for index in images.tolist()]
    one, size, interior = own[0]
    for other, mine, values in own[1:]:
        if mine != size or values.shape != interior.shape or not np.allclose(values, interior, rtol=1e-12, atol=0.0):
            raise InputError(
                f"{one} and {other} are declared with one camera, and differ in size or calibration: "
                f"{size[0]} x {size[1]} and {mine[0]} x {mine[1]} px",
                where="`interior`",
                hint="declare two cameras, with a table [[images]] and a camera of its own for some of the images",
            )


def _interior(model: SensorModel) -> FloatArray:
    return model.interior.values if isinstance(model, HasInterior) else np.zeros(0)


def places_of(start: StartBlock) -> FloatArray:
    """Some place (M, 3) of each placed image, in the CRS of the ground: projection centre, or what it sees.

    Parameters
    ----------
    start : StartBlock
    """
    found = []
    for model, placed in zip(start.models, start.placed, strict=True):
        if placed:
            found.append(Transform(model.crs, start.ground)(_place(model)[None])[0])
    return np.array(found).reshape(-1, 3)


def _place(model: SensorModel) -> FloatArray:
    """Projection centre (3,), or some point that the image shows, in the model's CRS."""
    return np.asarray(model.pose[0] if isinstance(model, HasPose) else model.seed, dtype=np.float64)


def refuse_positions(start: StartBlock, controlled: bool) -> None:
    """Check that camera positions without angles are not all one.

    Parameters
    ----------
    start : StartBlock
    controlled : bool
        Whether control points tell the place of photos that are all from one.

    Raises
    ------
    InputError
        Names the images.
    """
    alone = start.placed & ~start.oriented & np.array([isinstance(model, HasPose) for model in start.models])
    names = [name for name, wanted in zip(start.names, alone.tolist(), strict=True) if wanted]
    if len(names) < 3:
        return
    places = places_of(start)[alone[start.placed]]
    if not controlled and (np.ptp(places, axis=0) < ONE_PLACE).all():
        raise InputError(
            f"the positions of all {len(names)} photos are the same",
            where="`exterior`",
            hint="a receiver without reception repeats its last position: leave the positions out, and give control "
            "points, or the local frame 'local' as `crs`",
        )


def _without_foreign_positions(start: StartBlock, controlled: bool) -> StartBlock:
    """Block in which photos do not stand by positions in another country than the rest; they are named in a warning.

    Parameters
    ----------
    start : StartBlock
    controlled : bool
        Whether control points tell the place of oriented photos, wherever it is.
    """
    posed = start.placed & np.array([isinstance(model, HasPose) for model in start.models])
    if controlled:
        posed &= ~start.oriented
    which = np.flatnonzero(posed)
    if len(which) < 3:
        return start
    places = places_of(start)[posed[start.placed]]
    off = np.linalg.norm(places - np.nanmedian(places, axis=0), axis=1)
    far = ~(off <= max(ABROAD, ABROAD_TIMES * float(np.nanmedian(off))))
    if not 0 < 2 * far.sum() < len(which):
        return start
    some = [
        f"{start.names[k]} ({d / 1e3:.0f} km)" if np.isfinite(d) else f"{start.names[k]} (beyond the map)"
        for k, d in zip(which[far].tolist(), off[far].tolist(), strict=True)
    ]
    text = (
        f"{counted(len(some), 'camera position')} far from all others, not used: {listed(some, 6)}; tie "
        "points place these photos, or they are set aside. Correct them, or leave their fields empty"
    )
    warn(text)
    oriented, placed = start.oriented.copy(), start.placed.copy()
    oriented[which[far]] = placed[which[far]] = False
    return replace(start, oriented=oriented, placed=placed)


def described(start: StartBlock) -> str:
    """Images of a block in words: how many, of which sensors, and which have no orientation yet.

    Parameters
    ----------
    start : StartBlock
    """
    sensors = [scene.sensor for scene in start.scenes]
    kinds = listed((f"{sensors.count(name)} {name}" for name in dict.fromkeys(sensors)), 6)
    waiting = int((~start.oriented).sum())
    alone = int((start.placed & ~start.oriented).sum())
    of_these = f", {alone} of these with a position" if alone else ""
    rest = f", {waiting} without an orientation{of_these}" if waiting else ""
    return f"{counted(len(sensors), 'image')} ({kinds}){rest}"
