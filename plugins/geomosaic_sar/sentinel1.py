"""Annotation of Sentinel-1 level-1 products: stripmap (SLC and GRD), and ground range detected (GRD) of all modes.

Elements and units are those of the Sentinel-1 Product Specification (S1-RS-MDA-52-7441), section 6.3. Ground range in
metres is Σ c_k (R − sr0)^k with the srgrCoefficients of a record of coordinateConversion, R the slant range in metres;
columns are rangePixelSpacing apart from ground range 0 on. Between two records polynomials are interpolated linearly in
azimuth time, as those of the ASAR products from which the format descends (ENVISAT ASAR Product Handbook, 6.6.17).
"""

from __future__ import annotations

from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray
from geomosaic_sar.annotation import AGAIN, above_zero, coefficients, number, pixels, state_vectors, text
from geomosaic_sar.geometry import LIGHT, GroundRange, SlantRange
from geomosaic_sar.model import ECEF, SarModel
from geomosaic_sar.scene import Epoch, RadarScene, checked_geometry, growing, orbit_note
from geomosaic_sar.table import ground_range

ROOT = "product"
_IMAGE = "imageAnnotation/imageInformation"
# Pixels by which the tie points of the annotation may miss the model: they are rounded, and some are interpolated.
_FARTHEST = 5.0


def read_sentinel1(root: Element, where: str) -> RadarScene:
    """Radar scene of an annotation.

    Parameters
    ----------
    root : Element
        Of the XML of one polarisation, folder `annotation` of the product.
    where : str
        File, named in errors.

    Raises
    ------
    InputError
        A product in bursts (SLC of IW or EW), or an element is missing or damaged; names it.
    """
    mission, kind, mode, polarisation = (
        text(root, f"adsHeader/{name}", where) for name in ("missionId", "productType", "mode", "polarisation")
    )
    bursts = root.find("swathTiming/burstList")
    if kind == "SLC" and (mode in ("IW", "EW") or (bursts is not None and len(bursts) > 0)):
        raise InputError(
            f"this is a single look complex (SLC) image of mode {mode}: its rows are bursts that overlap in time, and "
            "bursts are not read",
            where=where,
            hint="take the ground range detected product (GRD) of the same scene, or merge the bursts (deburst) and "
            "describe the result in a JSON table",
        )
    size = pixels(root, f"{_IMAGE}/numberOfSamples", f"{_IMAGE}/numberOfLines", where)
    started = text(root, f"{_IMAGE}/productFirstLineUtcTime", where)
    epoch = Epoch.of(started, where)
    timing = epoch.seconds(started, where), above_zero(root, f"{_IMAGE}/azimuthTimeInterval", where)
    states = state_vectors(
        root.findall("generalAnnotation/orbitList/orbit"),
        "time",
        ("position/x", "position/y", "position/z"),
        ("velocity/x", "velocity/y", "velocity/z"),
        epoch,
        where,
    )
    title = f"{mission[:20]} {mode[:20]} {kind[:20]} {polarisation[:20]}, {started[:19]}"
    axis: SlantRange | GroundRange
    notes = list[str]()
    if text(root, "generalAnnotation/productInformation/projection", where) == "Slant Range":
        near = 0.5 * LIGHT * above_zero(root, f"{_IMAGE}/slantRangeTime", where)
        rate = above_zero(root, "generalAnnotation/productInformation/rangeSamplingRate", where)
        axis = SlantRange(near, 0.5 * LIGHT / rate)
    else:
        axis, note = _ground_range(root, size[0], epoch, where)
        notes.append(note)
    # All satellites of the mission look to the right of their flight.
    geometry = checked_geometry(states, size, timing, 1, axis, where)
    ties = _tie_points(root, where)
    height = float(np.median(ties[:, 4])) if len(ties) else 0.0
    scene = RadarScene(title, size, geometry, (orbit_note(geometry.orbit), *notes), height, polarisation)
    return _checked(scene, ties, where) if len(ties) else scene


def _ground_range(root: Element, width: int, epoch: Epoch, where: str) -> tuple[GroundRange, str]:
    """Columns over ground range, and how well they agree with the inverse polynomials of the annotation."""
    records = root.findall("coordinateConversion/coordinateConversionList/coordinateConversion")
    if not records:
        raise InputError("<coordinateConversion> has no record", where=where, hint=AGAIN)
    times = growing(
        [epoch.seconds(text(r, "azimuthTime", where), where) for r in records], "coordinateConversion", where
    )
    origins = [number(record, "sr0", where) for record in records]
    polynomials = [coefficients(record, "srgrCoefficients", where) for record in records]
    spacing = above_zero(root, f"{_IMAGE}/rangePixelSpacing", where)
    axis = ground_range(times, origins, [tuple(p.tolist()) for p in polynomials], (0.0, spacing), width, where)
    worst = 0.0
    ground = np.linspace(0.0, (width - 1) * spacing, 50)
    for record, time in zip(records, times, strict=True):
        inverse = np.polynomial.Polynomial(coefficients(record, "grsrCoefficients", where))
        ranges = inverse(ground - number(record, "gr0", where))
        columns = axis.columns(ranges, np.full(len(ranges), time))[0]
        worst = max(worst, float(np.abs(columns - (ground / spacing + 0.5)).max()))
    return axis, f"polynomials from slant to ground range and back agree within {worst:.2g} px"


def _tie_points(root: Element, where: str) -> FloatArray:
    """Tie points of the annotation (N, 5): column, row, longitude, latitude, ellipsoidal height."""
    names = ("pixel", "line", "longitude", "latitude", "height")
    nodes = root.findall("geolocationGrid/geolocationGridPointList/geolocationGridPoint")
    rows = [[number(node, name, where) for name in names] for node in nodes]
    # Lines and pixels count from 0 at the middle of the first.
    shift = np.array([0.5, 0.5, 0.0, 0.0, 0.0])
    ties: FloatArray = np.array(rows).reshape(-1, 5) + shift
    return ties


def _checked(scene: RadarScene, ties: FloatArray, where: str) -> RadarScene:
    """Scene whose model agrees with the tie points of the annotation, and a note about how well."""
    model = SarModel.of(scene.geometry, scene.size, height=scene.height, where=where)
    ground = Transform(CRS.from_epsg(4979), ECEF)(ties[:, 2:])
    off = np.hypot(*(model.ground_to_image(ground) - ties[:, :2]).T)
    if not (off < _FARTHEST).mean() > 0.5:
        raise InputError(
            "orbit, times and ranges do not agree with the tie points of the same annotation (geolocationGrid): half "
            f"of them are more than {_FARTHEST:g} px off",
            where=where,
            hint="parts of it may be of another scene; get the annotation of the product again",
        )
    note = f"{len(ties)} tie points of the annotation: median {np.nanmedian(off):.2g} px, worst {np.nanmax(off):.2g} px"
    return replace(scene, notes=(*scene.notes, note))
