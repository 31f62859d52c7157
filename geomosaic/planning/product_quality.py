"""Requirements on the inputs of a photo map, from the quality that it shall have, and the flight for its photos."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import get_args

from geomosaic.errors import InputError
from geomosaic.options.planning import CoverageOptions, FlightOptions, ProductOptions
from geomosaic.options.sheet import scale_text
from geomosaic.planning import guidelines
from geomosaic.planning.coverage import Coverage, check_stereo, coverage
from geomosaic.planning.relations import BASE, GROUND_PIXEL, SCALE, SCAN, SCAN_PIXEL, SPACING, checked

HEIGHTS = "K-2.8: m_O · 140/r · c/150"


@dataclass(frozen=True)
class Requirement:
    """Requirement of a plan on one quantity.

    Attributes
    ----------
    name : str
    text : str, meaning, as in the table
    least, most : float, optional, range in `unit`; None where it is open
    unit : str, '1:' for the denominator of a scale
    source : str, formula, or the table it is from
    """

    name: str
    text: str
    least: float | None
    most: float | None
    unit: str
    source: str


def requirements(wanted: ProductOptions) -> list[Requirement]:
    """Requirements on photos, scan, DEM and control of a photo map.

    Parameters
    ----------
    wanted : ProductOptions

    Raises
    ------
    InputError
        No ratio is known for the scale, or the other errors alone exceed the target.
    """
    scale, other_errors, film = checked("ortho_scale", wanted.ortho_scale), wanted.other_errors, wanted.film
    least = guidelines.position_error(scale)
    target = least if wanted.position_error is None else checked("position_error", wanted.position_error)
    k = _ratio(scale, wanted.ratio)
    for error in other_errors:
        if not 0 <= error < math.inf:
            raise InputError(f"{error:g} m is no error", where="`other_error`", hint="give metres, 0 or more")
    # Independent errors add as squares: what the others leave of the target is the DEM's.
    left = target**2 - sum(error**2 for error in other_errors)
    if not left > 0:
        total = math.sqrt(sum(error**2 for error in other_errors))
        raise InputError(
            f"the other errors make {total:.3g} m, the target is {target:.3g} m",
            where="`other_error`",
            hint="better control and orientation, or a smaller scale",
        )
    photo = k * scale
    c, share = checked("camera_constant", wanted.camera_constant), math.sqrt(left) / least
    # The table holds for the whole of 0.3 mm on the map; an error of height shifts pixels in proportion.
    height = guidelines.height_error(scale, c, wanted.radius) * share
    dpi = _given(SCAN.solve("scan_dpi", {"ratio": k}))
    pixel = _given(SCAN_PIXEL.solve("scan_pixel", {"scan_dpi": dpi}))
    ground = _given(GROUND_PIXEL.solve("ground_pixel", {"scan_pixel": pixel, "photo_scale": photo}))
    flown = _given(SCALE.solve("height", {"photo_scale": photo, "camera_constant": c}))
    out = [
        Requirement(
            "position_error", "error of position at check points", None, target, "m",
            "K-2.8: 0.3 mm of map" if wanted.position_error is None else "as given",
        ),
        Requirement("photo_scale", "scale of the photos", None, photo, "1:", "K-2.8: K = M_photo / M_ortho"),
        Requirement("height", "flying height above the ground", None, flown, "m", SCALE.formula),
        Requirement("scan_dpi", "scanning resolution", dpi, None, "dpi", SCAN.formula),
        Requirement("scan_pixel", "pixel of the scan", None, pixel, "µm", SCAN_PIXEL.formula),
        Requirement("scan_pixel_usual", "usual scanning pixel", *guidelines.SCAN_UM[film], "µm", "K-2.8: scanning"),
        Requirement("ground_pixel", "pixel of the scan on the ground", None, ground, "m", GROUND_PIXEL.formula),
        Requirement(
            "ortho_pixel", "pixel of the photo map", None, guidelines.ortho_pixel(scale, film), "m",
            "K-2.8: 0.08 mm of the map in grey, 0.10 mm in colour",
        ),
        Requirement(
            "ortho_pixel_of_scan", "pixel of the photo map that such a scan gives", guidelines.PIXEL_GAIN[0] * ground,
            guidelines.PIXEL_GAIN[1] * ground, "m", "K-2.8: 10 to 20 % more than that of the scan",
        ),
        Requirement("dem_error", f"error of heights at r = {wanted.radius:g} mm", None, height, "m", HEIGHTS),
        Requirement(
            "control_error", "error of control and check points", None, target / 3, "m",
            "a third of the target: then they take 5 % of it (errors add as squares)",
        ),
    ]  # fmt: skip
    if round(scale) in guidelines.INTERVALS:
        for terrain in get_args(guidelines.Terrain):
            text = f"grid of the DEM, {terrain} terrain"
            range_ = guidelines.interval(scale, terrain)
            out.append(Requirement(f"dem_interval_{terrain}", text, *range_, "m", "K-2.8: grid interval"))
    return out


def _ratio(scale: float, given: float | None) -> float:
    """K = M_photo / M_ortho: the given one, else that of K-2.8."""
    k = guidelines.RATIOS.get(round(scale)) if given is None else checked("ratio", given)
    if k is None:
        raise InputError(
            f"K-2.8 has no ratio K for {scale_text(scale)}",
            where="`ortho_scale`",
            hint=f"give `ratio`; the table has {', '.join(f'1:{s}: {v:g}' for s, v in guidelines.RATIOS.items())}",
        )
    return k


@dataclass(frozen=True)
class FlightPlan:
    """Flight for a photo map.

    Attributes
    ----------
    ortho_scale, photo_scale, ratio : float
        Denominators, and K = M_photo / M_ortho.
    height : float
        Flying height above the ground, metres.
    scan_pixel : float
        µm.
    ground_pixel, ortho_pixel : float
        Pixel of the photo and of the map on the ground, metres.
    footprint : tuple of float
        Metres that a photo covers along and across the strip.
    base, spacing : float
        Metres between exposures and between strips.
    overlap, sidelap : float
        Percent.
    coverage : Coverage, optional
        Strips and photos of the area, and its raster.
    """

    ortho_scale: float
    photo_scale: float
    ratio: float
    height: float
    scan_pixel: float
    ground_pixel: float
    ortho_pixel: float
    footprint: tuple[float, float]
    base: float
    spacing: float
    overlap: float
    sidelap: float
    coverage: Coverage | None = None


def flight(wanted: FlightOptions) -> FlightPlan:
    """Flight for a photo map: M_photo = K · M_ortho, H = c · M_photo, and the steps that the overlaps leave.

    Parameters
    ----------
    wanted : FlightOptions

    Raises
    ------
    InputError
        No ratio is known for the scale, a value is out of its range, or the overlap leaves places on one photo.
    """
    scale, c = checked("ortho_scale", wanted.ortho_scale), checked("camera_constant", wanted.camera_constant)
    k = _ratio(scale, wanted.ratio)
    known = {"photo_scale": k * scale, "camera_constant": c, "ratio": k, "overlap": checked("overlap", wanted.overlap)}
    known |= {name: checked(name, getattr(wanted, name)) for name in ("format_along", "format_across", "sidelap")}
    known["scan_dpi"] = _given(SCAN.solve("scan_dpi", known))
    largest = _given(SCAN_PIXEL.solve("scan_pixel", known))
    known["scan_pixel"] = largest if wanted.scan_pixel is None else checked("scan_pixel", wanted.scan_pixel)
    size = guidelines.ortho_pixel(scale, wanted.film)
    base, footprint = (
        _given(BASE.solve("base", known)),
        (wanted.format_along * k * scale / 1000, wanted.format_across * k * scale / 1000),
    )
    if not wanted.monoscopic:
        check_stereo(base, footprint[0])
    covered = None
    if wanted.area is not None:
        covered = coverage(
            CoverageOptions(
                area=wanted.area, photo_scale=k * scale, ortho_pixel=size, format_along=wanted.format_along,
                format_across=wanted.format_across, overlap=wanted.overlap, sidelap=wanted.sidelap,
                monoscopic=wanted.monoscopic,
            )
        )  # fmt: skip
    return FlightPlan(
        scale,
        k * scale,
        k,
        _given(SCALE.solve("height", known)),
        known["scan_pixel"],
        _given(GROUND_PIXEL.solve("ground_pixel", known)),
        size,
        footprint,
        base,
        _given(SPACING.solve("spacing", known)),
        wanted.overlap,
        wanted.sidelap,
        covered,
    )


def _given(value: float | None) -> float:
    if value is None:
        raise InputError("the values given leave the plan open", hint="give positive numbers")
    return value
