"""Placement of a photo: position and rotation in any frame brought to the frame of the model.

A position in a map CRS with a vertical datum goes to geocentric coordinates through the geoid and the projection, so
both the curvature of the Earth and the distortion of the map are in the transform, not in the camera. A rotation that
refers to grid north is turned by the meridian convergence. What the map does to heights is a convention of some
producers (linear alteration) and undone on request.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicError, HeightDatumError, InputError, default_where
from geomosaic.geo.crs import geocentric, geographic, has_heights, horizontal, with_heights
from geomosaic.geo.local_frames import LocalFrame, map_place, r3
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray
from geomosaic_frame.orientation import Attitude


@dataclass(frozen=True, eq=False)
class Place:
    """Frame of a photo and its rotation there.

    Attributes
    ----------
    frame : LocalFrame
        East, north, up at the projection centre, or the map's axes (planar treatment).
    rotation : array (3, 3)
        Frame → image, x right, y up.
    height : float
        Of the projection centre, in the vertical datum and unit of its CRS.
    """

    frame: LocalFrame
    rotation: FloatArray
    height: float


def convergence(crs: CRS, position: FloatArray) -> float:
    """Meridian convergence: azimuth of grid north from true north.

    Parameters
    ----------
    crs : CRS
    position : array (2,) or (3,)
        In `crs`.

    Returns
    -------
    float
        Radians, clockwise; 0 for coordinates that are no map.
    """
    if not horizontal(crs).is_projected:
        return 0.0
    return float(np.radians(map_place(crs, position[0], position[1]).convergence))


def rigorous(crs: CRS, position: FloatArray, attitude: Attitude, where: str) -> Place:
    """Place on the curved Earth.

    Parameters
    ----------
    crs : CRS
        3-D.
    position : array (3,)
        In `crs`.
    attitude : Attitude
        In 'grid' or 'local'.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The position lies outside the CRS or its geoid.
    """
    # With γ the azimuth of grid north, a vector has grid components R3(−γ)·(east, north, up), so M = M_grid·R3(−γ).
    frame = local_frame(crs, position, where)
    rotation = attitude.rotation
    if attitude.frame == "grid":
        # Angles from grid north, but the frame has true north: the two differ by the convergence.
        rotation = rotation @ r3(-convergence(crs, position))
    return Place(frame, rotation, float(position[2]))


def planar(crs: CRS, position: FloatArray, attitude: Attitude, where: str) -> Place:
    """Place on a map taken for a flat Earth: the textbook treatment, wrong by the map's and the Earth's curvature.

    Parameters
    ----------
    crs : CRS
        Map, with one unit for all axes.
    position, attitude, where
        As for `rigorous`.

    Raises
    ------
    InputError
        The CRS is not a map, or measures heights in another unit.
    """
    rotation = attitude.rotation
    if attitude.frame == "local":
        rotation = rotation @ r3(convergence(crs, position))
    return Place(LocalFrame.of_map(crs, position, where), rotation, float(position[2]))


def local_frame(crs: CRS, position: FloatArray, where: str) -> LocalFrame:
    """Local frame east, north, up at a position.

    Parameters
    ----------
    crs, position, where
        As for `rigorous`.

    Raises
    ------
    InputError
        The position lies outside the CRS or its geoid; names the image.
    """
    with default_where(where):
        frame = LocalFrame.at(crs, position)
    if not np.isfinite(frame.origin).all():
        raise InputError(
            f"position {position.tolist()} has no place in '{crs.name}'",
            where=where,
            hint="check the order (x or longitude first), the unit and the CRS of the positions, and the extent of "
            "its geoid",
        )
    return frame


def _position(attitude: Attitude, where: str) -> FloatArray:
    """Position that the orientation must have."""
    if attitude.position is None:
        raise InputError("the orientation has no position", where=where, hint="give x, y, z of the projection centre")
    return attitude.position


def from_topocentric(crs: CRS, reference: FloatArray, attitude: Attitude, where: str) -> tuple[FloatArray, Attitude]:
    """Position in `crs` and attitude in 'local' of a photo oriented in a topocentric frame.

    Parameters
    ----------
    crs : CRS
        3-D.
    reference : array (3,)
        Origin of that frame, in `crs`.
    attitude : Attitude
        With its position.
    where : str
        Named in errors.

    Returns
    -------
    position : array (3,)
        In `crs`.
    attitude : Attitude
        In 'local'.

    Raises
    ------
    InputError
        There is no position, or the reference lies outside the CRS or its geoid.
    """
    place = _position(attitude, where)
    base = local_frame(crs, reference, where)
    earth = base.to_geocentric(place[None])
    position = Transform(base.crs, crs)(earth)[0]
    here = local_frame(crs, position, where)
    return position, Attitude(attitude.rotation @ base.axes @ here.axes.T, "local")


def from_geocentric(crs: CRS, attitude: Attitude, where: str) -> tuple[FloatArray, Attitude]:
    """Position and attitude of a photo oriented in geocentric axes.

    Parameters
    ----------
    crs : CRS
        3-D, of the result.
    attitude : Attitude
        With its position in geocentric metres.
    where : str
        Named in errors.

    Returns
    -------
    position : array (3,)
        In `crs`.
    attitude : Attitude
        In 'local'.

    Raises
    ------
    InputError
        There is no position, or it is far from the Earth's surface.
    """
    place = _position(attitude, where)
    earth = attitude.crs or geocentric(crs)
    position = Transform(earth, crs)(place[None])[0]
    # Wide about the surface (6.36e6 m and more) and low orbits: what lies outside is another kind of coordinates.
    distance = float(np.linalg.norm(place))
    if not 6.0e6 < distance < 8.0e6:
        raise InputError(
            f"the camera is {distance / 1000:.0f} km from the centre of the Earth",
            where=where,
            hint="the coordinates are not geocentric: say what they are, world = 'map' or 'local'",
        )
    here = local_frame(crs, position, where)
    return position, Attitude(attitude.rotation @ here.axes.T, "local")


def from_offset(crs: CRS, reference: FloatArray, attitude: Attitude, where: str) -> tuple[FloatArray, Attitude]:
    """Position and attitude of a photo oriented in map axes about a reference point.

    Parameters
    ----------
    crs : CRS
        Map.
    reference : array (3,)
        In `crs`.
    attitude : Attitude
        With its position relative to the reference.
    where : str
        Named in errors.

    Returns
    -------
    position : array (3,)
        In `crs`.
    attitude : Attitude
        In 'grid'.

    Raises
    ------
    InputError
        There is no position, or the CRS is no map.
    """
    place = _position(attitude, where)
    if not horizontal(crs).is_projected:
        raise InputError(
            f"orientations of OpenDroneMap are in map axes, but '{crs.name}' is no map",
            where=where,
            hint="name the UTM zone of the project, for example EPSG:32651, or use system = 'opensfm'",
        )
    return reference + place, Attitude(attitude.rotation, "grid")


def of_longitude_latitude(crs: CRS, lla: FloatArray) -> FloatArray:
    """Point of a CRS from longitude, latitude and altitude.

    Parameters
    ----------
    crs : CRS
    lla : array (3,)
        Longitude, latitude in degrees on the datum of `crs`, altitude in its vertical datum.

    Returns
    -------
    array (3,)
        In `crs`.
    """
    if crs.is_geocentric:
        point: FloatArray = Transform(geographic(crs), crs)(lla[None])[0]
        return point
    point = lla.copy()
    if not horizontal(crs).is_geographic:
        flat = horizontal(crs)
        point[:2] = Transform(horizontal(geographic(flat)), flat)(lla[None, :2])[0]
    return point


def undo_linear_alteration(crs: CRS, position: FloatArray, ground_height: float, where: str) -> FloatArray:
    """True height of a projection centre whose height above ground was multiplied by the grid scale k.

    Z = (Z' − h)/k + h, with h the mean height of the ground under the photo. Producers that adjust in map coordinates
    stretch flying heights like this, so that planimetric and vertical scale agree.

    Parameters
    ----------
    crs : CRS
        Map.
    position : array (3,)
        Projection centre, in `crs`.
    ground_height : float
        h, in the vertical datum of `crs`.
    where : str
        Named in errors.

    Returns
    -------
    array (3,)
        Position with its true height.

    Raises
    ------
    InputError
        The CRS is no map.
    """
    if not horizontal(crs).is_projected:
        raise InputError(
            "scale_correction is about maps, but the positions are in no map CRS",
            where=where,
            hint="leave scale_correction out, or give positions in a map CRS",
        )
    scale = map_place(crs, position[0], position[1]).scale
    out = position.copy()
    # The ground itself was not stretched, so the scale acts on the height above it only.
    out[2] = (position[2] - ground_height) / scale + ground_height
    return out


def need_heights(crs: CRS, position: FloatArray, reach: float, where: str) -> None:
    """Check that the heights of a CRS have a vertical datum.

    Parameters
    ----------
    crs : CRS
        Of the position.
    position : array (3,)
        In `crs`.
    reach : float
        Pixels from the image's centre to its corner.
    where : str
        Named in the error, with what a wrong guess would cost in metres and pixels.

    Raises
    ------
    HeightDatumError
        They have none.
    """
    if has_heights(crs):
        return
    risk = ""
    try:
        to_ellipsoid = Transform(with_heights(crs, "egm96"), geocentric(crs))
        heights = Transform(geocentric(crs), geographic(crs))
        shift = abs(float(heights(to_ellipsoid(np.array([[position[0], position[1], 0.0]])))[0, 2]))
        if np.isfinite(shift):
            # A photo that looks down moves its corner by reach / height per metre; the height above sea stands for it.
            pixels = f" and up to {reach * shift / position[2]:.0f} px in the image" if position[2] > shift else ""
            risk = f": ellipsoidal and geoid heights differ by {shift:.1f} m there{pixels}"
    except GeomosaicError:
        pass
    raise HeightDatumError(
        f"the height of the camera has no vertical datum{risk}",
        where=where,
        hint="declare the heights of the positions: 'ellipsoidal', 'egm96', a vertical EPSG code or a geoid grid",
    )
