"""Main annotation of TerraSAR-X and TanDEM-X level-1b products: SSC of stripmap and spotlight, and MGD.

Elements and units are those of the TerraSAR-X Level 1b Product Format Specification (TX-GS-DD-3307). Rows are equally
spaced between the start and the stop of sceneInfo. Range times are two-way, in seconds; ground range in metres of an
MGD is Σ c_k (τ − τ0)^k with the coefficients and the referencePoint τ0 of slantToGroundRangeProjection. Beta nought is
calFactor · (DN² − noise), the noise a polynomial of τ too (Calculation of Beta Naught and Sigma
Naught for TerraSAR-X Data, TSXX-AirbusDS-TN-0049).
"""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import finite_numbers
from geomosaic_sar.annotation import AGAIN, above_zero, number, pixels, state_vectors, text
from geomosaic_sar.calibration import PixelTable, SarCalibration, ThermalNoise
from geomosaic_sar.geometry import LIGHT, GroundRange, ImageGeometry, SlantRange
from geomosaic_sar.scene import Epoch, RadarScene, checked_geometry, orbit_note
from geomosaic_sar.table import ground_range

ROOT = "level1Product"
_RASTER = "productInfo/imageDataInfo/imageRaster"
_SCENE = "productInfo/sceneInfo"
_ORDER = "EARLYAZNEARRG"
_HIGHEST = 12
# Columns at which the polynomials of the noise are tabled: they are of low degree.
_NOISE_NODES = 200


def read_terrasar(root: Element, where: str) -> RadarScene:
    """Radar scene of a main annotation.

    Parameters
    ----------
    root : Element
        Of the XML named as the product.
    where : str
        File, named in errors.

    Raises
    ------
    InputError
        A geocoded product (GEC, EEC), bursts (SSC of ScanSAR), or an element is missing or damaged; names it.
    """
    variant = text(root, "productInfo/productVariantInfo/productVariant", where)
    mode = text(root, "productInfo/acquisitionInfo/imagingMode", where)
    if variant not in ("SSC", "MGD"):
        raise InputError(
            f"this product ({variant[:20]}) is geocoded: its rows are not azimuth times",
            where=where,
            hint="order it as SSC or MGD; a geocoded image can go into a mosaic as it is",
        )
    if variant == "SSC" and mode == "SC":
        raise InputError(
            "this is a single look complex image of ScanSAR: its rows are bursts, and bursts are not read",
            where=where,
            hint="take the detected product (MGD) of the same scene",
        )
    order = root.findtext("productSpecific/complexImageInfo/imageDataStartWith", _ORDER).strip()
    if order != _ORDER:
        raise InputError(
            f"the image begins with {order[:20]}, not with the earliest row at near range ({_ORDER})",
            where=where,
            hint="turn the image over, and describe it in a JSON table",
        )
    size = pixels(root, f"{_RASTER}/numberOfColumns", f"{_RASTER}/numberOfRows", where)
    started = text(root, f"{_SCENE}/start/timeUTC", where)
    epoch = Epoch.of(started, where)
    first = epoch.seconds(started, where)
    last = epoch.seconds(text(root, f"{_SCENE}/stop/timeUTC", where), where)
    states = state_vectors(
        root.findall("platform/orbit/stateVec"),
        "timeUTC",
        ("posX", "posY", "posZ"),
        ("velX", "velY", "velZ"),
        epoch,
        where,
    )
    near, far = (above_zero(root, f"{_SCENE}/rangeTime/{end}Pixel", where) for end in ("first", "last"))
    if not far > near:
        raise InputError("the range times do not grow from the first to the last column", where=where, hint=AGAIN)
    axis: SlantRange | GroundRange
    if variant == "SSC":
        axis = SlantRange(0.5 * LIGHT * near, 0.5 * LIGHT * (far - near) / (size[0] - 1))
    else:
        axis = _ground_range(root, size[0], first, near, where)
    side = {"RIGHT": 1, "LEFT": -1}.get(text(root, "productInfo/acquisitionInfo/lookDirection", where).upper())
    if side is None:
        raise InputError("<lookDirection> is neither RIGHT nor LEFT", where=where, hint=AGAIN)
    interval = (last - first) / (size[1] - 1)
    geometry = checked_geometry(states, size, (first, interval), side, axis, where)
    mission = text(root, "productInfo/missionInfo/mission", where)
    title = f"{mission[:20]} {mode[:20]} {variant}, {started[:19]}"
    height = root.findtext(f"{_SCENE}/sceneAverageHeight")
    ground = finite_numbers([height], 1, "<sceneAverageHeight>", where)[0] if height else 0.0
    known = _calibrations(root, geometry, size, epoch, where)
    return RadarScene(title, size, geometry, (orbit_note(geometry.orbit),), ground, calibrations=known)


def _calibrations(
    root: Element, geometry: ImageGeometry, size: tuple[int, int], epoch: Epoch, where: str
) -> dict[str, SarCalibration]:
    """Beta nought by polarisation: k_s · (DN² − noise), with the calFactor k_s."""
    noises = {text(node, "polLayer", where): node for node in root.findall("noise")}
    found = {}
    for node in root.findall("calibration/calibrationConstant"):
        layer = text(node, "polLayer", where)
        amplitude = PixelTable.constant(above_zero(node, "calFactor", where) ** -0.5)
        noise = None if layer not in noises else _noise(noises[layer], geometry, size, epoch, where)
        found[layer] = SarCalibration("beta0", amplitude, noise)
    return found


def _noise(
    node: Element, geometry: ImageGeometry, size: tuple[int, int], epoch: Epoch, where: str
) -> ThermalNoise | None:
    """Noise in squared amplitudes: polynomials of the two-way range time at some azimuth times; None without any."""
    records = node.findall("imageNoise")
    if not records:
        return None
    times = [epoch.seconds(text(record, "timeUTC", where), where) for record in records]
    cols = np.linspace(0.5, size[0] - 0.5, min(size[0], _NOISE_NODES))
    lines = []
    for record, time in zip(records, times, strict=True):
        path = "noiseEstimate"
        fit = record.find(path)
        terms = [] if fit is None else fit.findall("coefficient")
        if fit is None or not terms:
            raise InputError(f"<{path}> has no coefficients", where=where, hint=AGAIN)
        polynomial = np.polynomial.Polynomial(_by_power(terms, path, where))
        delay = 2.0 / LIGHT * geometry.axis.ranges(cols, np.full(len(cols), time))
        least, most = (number(fit, f"validityRange{end}", where) for end in ("Min", "Max"))
        lines.append(
            (cols, np.maximum(polynomial(np.clip(delay, least, most) - number(fit, "referencePoint", where)), 0.0))
        )
    return ThermalNoise(PixelTable.of_lines(geometry.rows(np.array(times)).tolist(), lines, where))


def _ground_range(root: Element, width: int, time: float, near: float, where: str) -> GroundRange:
    """Columns over ground range: one polynomial of the two-way range time for the scene."""
    path = "productSpecific/projectedImageInfo/slantToGroundRangeProjection"
    node = root.find(path)
    terms = [] if node is None else node.findall("coefficient")
    if node is None or not terms:
        raise InputError(f"<{path}> has no coefficients", where=where, hint=AGAIN)
    values = _by_power(terms, path, where)
    origin = number(node, "referencePoint", where)
    first = float(np.polynomial.Polynomial(values)(near - origin))
    # τ = 2R / c.
    scaled = tuple(value * (2.0 / LIGHT) ** power for power, value in enumerate(values))
    columns = first, above_zero(root, f"{_RASTER}/columnSpacing", where)
    return ground_range(np.array([time]), [0.5 * LIGHT * origin], [scaled], columns, width, where)


def _by_power(terms: list[Element], path: str, where: str) -> list[float]:
    """Coefficients of a polynomial of range times, lowest power first."""
    by_power = dict[int, float]()
    for index, term in enumerate(terms):
        power = term.get("exponent", str(index))
        if not power.isdecimal() or len(power) > 2 or int(power) > _HIGHEST:
            raise InputError(f"a coefficient of <{path}> has the exponent '{power[:10]}'", where=where, hint=AGAIN)
        by_power[int(power)] = _coefficient(term.text or "", int(power), f"<{path}>", where)
    return [by_power.get(power, 0.0) for power in range(max(by_power) + 1)]


def _coefficient(word: str, power: int, what: str, where: str) -> float:
    """Coefficient of a power of the range time, metres per second to that power."""
    # A swath is some 1e-4 s wide: coefficients of high powers are larger than any other number of an annotation.
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    return finite_numbers([repr(value * 1e-5**power)], 1, what, where)[0] * 1e5**power
