"""Annotations of radar products, written element by element as their specifications name them."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np
from sar_rig import Scene, lonlat

LIGHT = 299792458.0
START = datetime(2024, 5, 1, 12, 0, 30, tzinfo=UTC)


def stamp(seconds: float) -> str:
    """UTC of some seconds after 12:00:30, to the nanosecond: microseconds are 7 mm of the orbit."""
    whole = int(np.floor(seconds))
    when = START + timedelta(seconds=whole)
    return f"{when:%Y-%m-%dT%H:%M:%S}{f'{seconds - whole:.9f}'[1:]}"


@dataclass(frozen=True)
class Sentinel1:
    """What an annotation of Sentinel-1 says that geometry needs."""

    first: str
    interval: float
    size: tuple[int, int]
    states: list[tuple[str, list[float], list[float]]]
    records: list[tuple[str, float, list[float], list[float]]] = field(default_factory=list)
    spacing: float = 10.0
    ties: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    slant: tuple[float, float] | None = None
    mode: str = "IW"
    bursts: int = 0

    def xml(self) -> str:
        def vector(name: str, values: list[float]) -> str:
            return f"<{name}>{''.join(f'<{a}>{v!r}</{a}>' for a, v in zip('xyz', values, strict=True))}</{name}>"

        def listed(values: list[float]) -> str:
            return " ".join(repr(float(v)) for v in values)

        orbit = "".join(
            f"<orbit><time>{t}</time><frame>Earth Fixed</frame>{vector('position', p)}{vector('velocity', v)}</orbit>"
            for t, p, v in self.states
        )
        records = "".join(
            f"<coordinateConversion><azimuthTime>{t}</azimuthTime><sr0>{origin!r}</sr0>"
            f"<srgrCoefficients>{listed(there)}</srgrCoefficients><gr0>0.0</gr0>"
            f"<grsrCoefficients>{listed(back)}</grsrCoefficients></coordinateConversion>"
            for t, origin, there, back in self.records
        )
        ties = "".join(
            f"<geolocationGridPoint><line>{row:g}</line><pixel>{col:g}</pixel><latitude>{lat!r}</latitude>"
            f"<longitude>{lon!r}</longitude><height>{height!r}</height></geolocationGridPoint>"
            for col, row, lon, lat, height in self.ties
        )
        near, rate = (2.0 * self.slant[0] / LIGHT, LIGHT / (2.0 * self.slant[1])) if self.slant else (0.005, 6.4e7)
        return (
            "<product><adsHeader><missionId>S1B</missionId>"
            f"<productType>{'SLC' if self.slant else 'GRD'}</productType><polarisation>VV</polarisation>"
            f"<mode>{self.mode}</mode></adsHeader>"
            f"<generalAnnotation><productInformation>"
            f"<projection>{'Slant' if self.slant else 'Ground'} Range</projection>"
            f"<rangeSamplingRate>{rate!r}</rangeSamplingRate></productInformation>"
            f"<orbitList>{orbit}</orbitList></generalAnnotation>"
            f"<imageAnnotation><imageInformation><productFirstLineUtcTime>{self.first}</productFirstLineUtcTime>"
            f"<slantRangeTime>{near!r}</slantRangeTime><rangePixelSpacing>{self.spacing!r}</rangePixelSpacing>"
            f"<azimuthTimeInterval>{self.interval!r}</azimuthTimeInterval>"
            f"<numberOfSamples>{self.size[0]}</numberOfSamples><numberOfLines>{self.size[1]}</numberOfLines>"
            "</imageInformation></imageAnnotation>"
            f"<swathTiming><burstList>{'<burst/>' * self.bursts}</burstList></swathTiming>"
            f"<geolocationGrid><geolocationGridPointList>{ties}</geolocationGridPointList></geolocationGrid>"
            f"<coordinateConversion><coordinateConversionList>{records}</coordinateConversionList>"
            "</coordinateConversion></product>"
        )


def _states(scene: Scene) -> list[tuple[str, list[float], list[float]]]:
    times = np.arange(-40.0, 41.0, 10.0)
    return [(stamp(t), p.tolist(), v.tolist()) for t, p, v in zip(times, *scene.states(times), strict=True)]


def sentinel1_stripmap(scene: Scene) -> Sentinel1:
    """Single look complex stripmap image of an analytic orbit."""
    return Sentinel1(
        stamp(scene.first_row),
        scene.row_interval,
        scene.size,
        _states(scene),
        slant=(scene.near, scene.spacing),
        mode="S3",
    )


def sentinel1_detected(scene: Scene, ground: np.ndarray) -> Sentinel1:
    """Ground range image of an analytic orbit, with tie points at some ground points (N, 3)."""
    table, spacing = scene.ground_table()
    ranges = np.linspace(scene.near - 500.0, scene.near + scene.size[0] * scene.spacing + 500.0, 60)
    records, axis = [], table["ground_range"]["polynomials"]
    for record in axis:
        there = np.polynomial.Polynomial(record["coefficients"])
        back = np.polynomial.Polynomial.fit(there(ranges - record["origin"]), ranges, 8).convert()
        records.append((stamp(record["time"]), record["origin"], record["coefficients"], back.coef.tolist()))
    slant = scene.image(ground)
    origin = scene.ground_range(np.array([scene.near]), scene.first_row)[0]
    ties = []
    for (col, row), point in zip(slant, ground, strict=True):
        time = scene.first_row + (row - 0.5) * scene.row_interval
        length = scene.ground_range(np.array([scene.near + (col - 0.5) * scene.spacing]), time)[0] - origin
        ties.append((length / spacing, row - 0.5, *lonlat(point)))
    # Tie points lie at whole pixels in products; here they lie where the exact orbit has them.
    return Sentinel1(stamp(scene.first_row), scene.row_interval, scene.size, _states(scene), records, spacing, ties)


def terrasar(scene: Scene, variant: str = "SSC", mode: str = "SM", factors: dict[str, float] | None = None) -> str:
    """Main annotation of TerraSAR-X of an analytic orbit; MGD has one polynomial, that of the first row.

    Factors by polarisation make a calibration, with a noise of 40 + 2e5 (τ − near).
    """
    early = 2.0 / LIGHT * scene.near
    calibrated = "".join(
        f"<noise><polLayer>{layer}</polLayer><imageNoise><timeUTC>{stamp(0.0)}Z</timeUTC><noiseEstimate>"
        f"<validityRangeMin>{early!r}</validityRangeMin><validityRangeMax>{1.1 * early!r}</validityRangeMax>"
        f"<referencePoint>{early!r}</referencePoint><polynomialDegree>1</polynomialDegree>"
        '<coefficient exponent="0">40.0</coefficient><coefficient exponent="1">2e5</coefficient>'
        "</noiseEstimate></imageNoise></noise>"
        f"<calibration><calibrationConstant><polLayer>{layer}</polLayer><calFactor>{factor!r}</calFactor>"
        "</calibrationConstant></calibration>"
        for layer, factor in (factors or {}).items()
    )
    states = "".join(
        f"<stateVec><timeUTC>{t}</timeUTC>"
        + "".join(f"<pos{a}>{v!r}</pos{a}>" for a, v in zip("XYZ", p, strict=True))
        + "".join(f"<vel{a}>{x!r}</vel{a}>" for a, x in zip("XYZ", v, strict=True))
        + "</stateVec>"
        for t, p, v in _states(scene)
    )
    last = scene.first_row + (scene.size[1] - 1) * scene.row_interval
    near, far = (2.0 / LIGHT * (scene.near + k * scene.spacing) for k in (0, scene.size[0] - 1))
    columns, projected = scene.spacing, ""
    if variant == "MGD":
        times = np.linspace(near, far, 60)
        middle = 0.5 * (near + far)
        ground = scene.ground_range(times * LIGHT / 2.0, scene.first_row)
        # Polynomials of seconds would be singular: over half the swath they are not.
        half = 0.5 * (far - near)
        fit = np.polynomial.Polynomial.fit((times - middle) / half, ground - ground[0], 6).convert().coef
        terms = "".join(f'<coefficient exponent="{k}">{float(c / half**k)!r}</coefficient>' for k, c in enumerate(fit))
        projected = (
            f"<projectedImageInfo><slantToGroundRangeProjection><referencePoint>{middle!r}</referencePoint>{terms}"
            "</slantToGroundRangeProjection></projectedImageInfo>"
        )
        columns = float(ground[-1] - ground[0]) / (scene.size[0] - 1)
    return (
        "<level1Product><productInfo><missionInfo><mission>TSX-1</mission></missionInfo>"
        f"<acquisitionInfo><imagingMode>{mode}</imagingMode>"
        f"<lookDirection>{'RIGHT' if scene.side > 0 else 'LEFT'}</lookDirection></acquisitionInfo>"
        f"<productVariantInfo><productVariant>{variant}</productVariant></productVariantInfo>"
        f"<imageDataInfo><imageRaster><numberOfRows>{scene.size[1]}</numberOfRows>"
        f"<numberOfColumns>{scene.size[0]}</numberOfColumns><columnSpacing>{columns!r}</columnSpacing>"
        "</imageRaster></imageDataInfo>"
        f"<sceneInfo><start><timeUTC>{stamp(scene.first_row)}Z</timeUTC></start>"
        f"<stop><timeUTC>{stamp(last)}Z</timeUTC></stop><sceneAverageHeight>300.0</sceneAverageHeight>"
        f"<rangeTime><firstPixel>{near!r}</firstPixel><lastPixel>{far!r}</lastPixel></rangeTime></sceneInfo>"
        f"</productInfo><platform><orbit>{states}</orbit></platform>"
        f"<productSpecific><complexImageInfo><imageDataStartWith>EARLYAZNEARRG</imageDataStartWith>"
        f"</complexImageInfo>{projected}</productSpecific>{calibrated}</level1Product>"
    )


def _listed(values: np.ndarray) -> str:
    return f'count="{len(values)}">{" ".join(f"{v:.9g}" for v in values)}'


def calibration(lines: np.ndarray, pixels: np.ndarray, tables: dict[str, np.ndarray], polarisation: str = "VV") -> str:
    """Calibration annotation of Sentinel-1: tables (lines, pixels) by their element."""
    vectors = "".join(
        f"<calibrationVector><azimuthTime>{stamp(0.1 * k)}</azimuthTime><line>{line:g}</line>"
        f"<pixel {_listed(pixels)}</pixel>"
        + "".join(f"<{name} {_listed(table[k])}</{name}>" for name, table in tables.items())
        + "</calibrationVector>"
        for k, line in enumerate(lines)
    )
    return (
        f"<calibration><adsHeader><polarisation>{polarisation}</polarisation></adsHeader><calibrationInformation>"
        "<absoluteCalibrationConstant>1.0</absoluteCalibrationConstant></calibrationInformation>"
        f'<calibrationVectorList count="{len(lines)}">{vectors}</calibrationVectorList></calibration>'
    )


def noise(
    lines: np.ndarray,
    pixels: np.ndarray,
    table: np.ndarray,
    parts: list[tuple[tuple[int, int, int, int], np.ndarray, np.ndarray]] | None = None,
) -> str:
    """Noise annotation of Sentinel-1: the old form, or with parts the new one.

    Parts are first line, first sample, last line, last sample, and factors at some lines.
    """
    old = parts is None
    tag, name = ("noiseVector", "noiseLut") if old else ("noiseRangeVector", "noiseRangeLut")
    vectors = "".join(
        f"<{tag}><azimuthTime>{stamp(0.1 * k)}</azimuthTime><line>{line:g}</line><pixel {_listed(pixels)}</pixel>"
        f"<{name} {_listed(table[k])}</{name}></{tag}>"
        for k, line in enumerate(lines)
    )
    azimuth = "".join(
        f"<noiseAzimuthVector><swath>IW1</swath><firstAzimuthLine>{top}</firstAzimuthLine>"
        f"<firstRangeSample>{left}</firstRangeSample><lastAzimuthLine>{bottom}</lastAzimuthLine>"
        f"<lastRangeSample>{right}</lastRangeSample><line {_listed(at)}</line>"
        f"<noiseAzimuthLut {_listed(factors)}</noiseAzimuthLut></noiseAzimuthVector>"
        for (top, left, bottom, right), at, factors in parts or []
    )
    more = "" if old else f"<noiseAzimuthVectorList>{azimuth}</noiseAzimuthVectorList>"
    return (
        f"<noise><adsHeader><polarisation>VV</polarisation></adsHeader><{tag}List>{vectors}</{tag}List>{more}</noise>"
    )


def published() -> Sentinel1:
    """Figures of S1B_IW_GRDH_1SDV_20210401T052623 (Copernicus Sentinel data): its last row and tie points."""
    states = [
        ("09", (4591801.329, 1445935.027, 5176593.459), (5712.371027, -214.95353, -4994.238602)),
        ("19", (4648665.054, 1443662.953, 5126359.921), (5660.26755, -239.437408, -5052.391447)),
        ("29", (4705004.378, 1441146.551, 5075547.689), (5607.492667, -263.818444, -5109.975608)),
        ("39", (4760812.615, 1438386.868, 5024162.481), (5554.052418, -288.092923, -5166.98454)),
        ("49", (4816083.144, 1435384.988, 4972210.083), (5499.952929, -312.257155, -5223.41176)),
        ("59", (4870809.402, 1432142.032, 4919696.344), (5445.200404, -336.307468, -5279.25085)),
    ]
    there = [
        "3.597660557716154e-02 1.967179033778601e+00 -4.031837051550197e-06 2.125710858602095e-11 "
        "-1.240836604911613e-16 6.651781074222488e-22 -2.725874134012429e-27 7.050676343822730e-33 "
        "-8.327614301883873e-39",
        "3.593575867125764e-02 1.966992654555388e+00 -4.030447390014860e-06 2.124591341903870e-11 "
        "-1.239981316030654e-16 6.646393303863524e-22 -2.723446828029774e-27 7.044028743627126e-33 "
        "-8.319472153856384e-39",
    ]
    back = [
        "8.009428521084344e+05 5.083333310406680e-01 5.303481094233470e-07 -3.386656572646718e-13 "
        "3.769867234009390e-20 2.031237307552480e-25 -2.445271172663596e-31 1.138501436851613e-37 "
        "-1.111800146731473e-45",
        "8.009428521080808e+05 5.083815068222710e-01 5.303154331603859e-07 -3.386757156027306e-13 "
        "3.772704784812203e-20 2.032571202424928e-25 -2.453364377090170e-31 1.157775229889889e-37 "
        "-2.924959411735450e-45",
    ]
    records = [
        (f"2021-04-01T05:26:{second}.884407", origin, [*map(float, one.split())], [*map(float, two.split())])
        for second, origin, one, two in zip(
            ("47", "48"), (800942.8521084344, 800942.8521080808), there, back, strict=True
        )
    ]
    ties = [
        (6450, 11.22221699606200, 45.72335013029570, 862.9488434558734),
        (9030, 10.89192347350523, 45.76548476498511, 1126.930312910117),
        (11610, 10.56431047560463, 45.80627722913451, 1222.921412659809),
        (14190, 10.23257752375489, 45.84656362970955, 1566.000166025013),
        (16770, 9.915953917373338, 45.88408294420092, 864.9404906071723),
        (19350, 9.585592205420058, 45.92222820467087, 1052.925154749304),
        (21930, 9.263783363552808, 45.95843145887581, 573.9580305768177),
        (24510, 8.936735276190353, 45.99424420096488, 430.9675992960110),
        (25787, 8.769626487102904, 46.01215789165039, 767.9413692671806),
    ]
    return Sentinel1(
        "2021-04-01T05:26:23.794457",
        24.998916 / 16684,
        (25788, 16685),
        [(f"2021-04-01T05:26:{second}.000000", [*p], [*v]) for second, p, v in states],
        records,
        10.0,
        [(col, 16684, lon, lat, height) for col, lon, lat, height in ties],
    )
