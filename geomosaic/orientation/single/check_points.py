"""Check point statistics, and outliers among the check points themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.estimation.statistics import axis_rms, mean_probability, total_rms
from geomosaic.orientation.single.fit import circular_error_95
from geomosaic.orientation.single.problem import map_by_image
from geomosaic.sensor.plugin import SensorModel
from geomosaic.types import AnyArray, BoolArray, FloatArray

# RMSE_r to the 95 % radius of equal normal errors in x and y (FGDC-STD-007.3-1998).
NSSDA_FACTOR = 1.7308
# RMSE_z to the 95 % interval of normal errors in height (the same standard).
NSSDA_HEIGHT_FACTOR = 1.96
NSSDA_POINTS = 20
ASPRS_POINTS = 30
# Smallest ratio of the RMSE of both axes for which the NSSDA lets errors pass as circular.
CIRCULAR = 0.6
SHIFT_ALPHA = 0.01


@dataclass(frozen=True, eq=False)
class CheckStatistics:
    """Statistics of check point errors, found minus true.

    Attributes
    ----------
    ids : tuple of str
    errors : array (N, 2)
        x, y in map units.
    unit : str
        Of them, for sentences, such as 'm'.
    survey_rms : float
        RMS length of the errors of the check points' own survey, in the same unit.
    """

    ids: tuple[str, ...]
    errors: FloatArray
    unit: str
    survey_rms: float = 0.0

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def rms(self) -> tuple[float, float]:
        """RMSE in x and y."""
        return axis_rms(self.errors)

    @property
    def rms_total(self) -> float:
        """RMSE_r, the RMS length."""
        return total_rms(self.errors)

    @property
    def circular_error_95(self) -> float:
        """Radius of 95 % after the textbook, 2.5 × RMS of one axis."""
        return circular_error_95(self.errors)

    @property
    def nssda(self) -> float:
        """95 % radius of the NSSDA, 1.7308 × RMSE_r; see `statement` for when it may be claimed."""
        return NSSDA_FACTOR * self.rms_total

    @property
    def rms_with_survey(self) -> float:
        """RMSE_H of ASPRS Edition 2: the errors found and those of the survey of the check points, in quadrature."""
        return float(np.hypot(self.rms_total, self.survey_rms))

    @property
    def mean(self) -> tuple[float, float]:
        """Mean shift in x and y."""
        x, y = self.errors.mean(axis=0)
        return float(x), float(y)

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations about the mean shift; NaN for one point."""
        if len(self) < 2:
            return float("nan"), float("nan")
        x, y = self.errors.std(axis=0, ddof=1)
        return float(x), float(y)

    @property
    def shift_probability(self) -> float:
        """Probability of a mean shift as long as this by chance alone (Hotelling's T²); NaN for fewer than 4 points."""
        return mean_probability(self.errors)

    @property
    def shifted(self) -> bool:
        """Whether the mean shift is systematic: less than 1 % probable by chance."""
        return self.shift_probability < SHIFT_ALPHA

    @property
    def shift_statement(self) -> str:
        """Statement on the mean shift, in a sentence."""
        x, y = self.mean
        length = f"{np.hypot(x, y):.3g} {self.unit} (x {x:+.3g}, y {y:+.3g})"
        if np.isnan(self.shift_probability):
            points = "one check point is" if len(self) == 1 else f"{len(self)} check points are"
            mean = "mean " * (len(self) > 1)
            return f"the {mean}shift is {length}; {points} too few to tell whether it is systematic"
        if self.shifted:
            return (
                f"the map is shifted by {length}, which chance would bring with a probability of "
                f"{self.shift_probability:.1g}: look for an error common to all control (datum, map, survey)"
            )
        return f"the mean shift of {length} is within chance (probability {self.shift_probability:.2g})"

    @property
    def nssda_statement(self) -> str:
        """Statement of the NSSDA, or why it may not be made."""
        if len(self) < NSSDA_POINTS:
            return f"not tested after the NSSDA: it asks for {NSSDA_POINTS} check points, there are {len(self)}"
        text = f"Tested {self.nssda:.3g} {self.unit} horizontal accuracy at 95% confidence level (NSSDA)"
        low, high = sorted(self.rms)
        if low < CIRCULAR * high:
            text += "; the errors of x and y differ too much for this radius to be exact"
        return text

    @property
    def asprs_statement(self) -> str:
        """Statement of ASPRS Edition 2, or why it may not be made."""
        if len(self) < ASPRS_POINTS:
            return f"not tested after ASPRS Edition 2: it asks for {ASPRS_POINTS} check points, there are {len(self)}"
        survey = "" if self.survey_rms > 0.0 else ", the survey of the check points taken as free of errors"
        return (
            f"Tested after the ASPRS Positional Accuracy Standards, Edition 2 (2024): horizontal accuracy "
            f"RMSE_H = {self.rms_with_survey:.3g} {self.unit} from {len(self)} check points{survey}"
        )


def check_errors(
    ids: Sequence[str], errors: AnyArray, unit: str = "map units", survey_rms: float = 0.0
) -> CheckStatistics:
    """Statistics of errors (N, 2), found minus true, in map units.

    Parameters
    ----------
    ids : sequence of str
        Names of the points.
    errors : array (N, 2)
        x and y, found minus true.
    unit : str
        Of the errors, for sentences.
    survey_rms : float
        RMS length of the errors of the check points' own survey, in the same unit.

    Raises
    ------
    InputError
        There are none, or one is not finite; the point is named.
    """
    found = np.array(errors, dtype=np.float64).reshape(-1, 2)
    if len(found) != len(ids):
        raise ValueError(f"{len(ids)} ids for {len(found)} errors")
    if not len(found):
        raise InputError("there are no check points", hint="give points of role 'check'")
    bad = ~np.isfinite(found).all(axis=1)
    if bad.any():
        raise InputError(
            f"check point '{ids[int(np.argmax(bad))]}' has no place on the map or in the image",
            hint="look whether it lies beyond the horizon of the fit, or leave it out",
        )
    if not survey_rms >= 0.0:
        raise InputError(
            f"an RMS error of {survey_rms} for the survey of check points is not 0 or more",
            hint="give metres, 0 for check points without error",
        )
    return CheckStatistics(tuple(map(str, ids)), found, unit, float(survey_rms))


def height_statements(errors: AnyArray) -> list[str]:
    """Statements of the NSSDA and of ASPRS Edition 2 on heights, those that the number of points allows.

    Parameters
    ----------
    errors : array (N,)
        Found minus true, metres.
    """
    heights = np.asarray(errors, dtype=np.float64)
    count, rmse = len(heights), float(np.sqrt(np.mean(np.square(heights))))
    said = [f"Tested {NSSDA_HEIGHT_FACTOR * rmse:.3g} m vertical accuracy at 95% confidence level (NSSDA)"]
    said.append(
        f"Tested after the ASPRS Positional Accuracy Standards, Edition 2 (2024): vertical accuracy "
        f"RMSE_V = {rmse:.3g} m from {count} check points, their survey taken as free of errors"
    )
    return [text for text, least in zip(said, (NSSDA_POINTS, ASPRS_POINTS), strict=True) if count >= least]


def check_model(
    model: SensorModel, ids: Sequence[str], ground: AnyArray, colrow: AnyArray, unit: str
) -> CheckStatistics:
    """Statistics of check points measured in an image with a model.

    The error of a point is where its measured image lies on the map, minus its true place: the residual in pixels,
    brought to the map by the local derivative.

    Parameters
    ----------
    model : SensorModel
    ids : sequence of str
    ground : array (N, 2) or (N, 3)
        True places in `model.crs`.
    colrow : array (N, 2)
        Measured pixels.
    unit : str
        Of the map, for sentences.
    """
    places = np.asarray(ground, dtype=np.float64)
    xyz = np.zeros((len(places), 3))
    xyz[:, : places.shape[1]] = places
    pixels = np.asarray(colrow, dtype=np.float64) - model.ground_to_image(xyz)
    errors = np.einsum("nij,nj->ni", map_by_image(model, xyz), pixels)
    return check_errors(ids, errors, unit)


# Median distances from the median error, from which on a point is wrong; of few points more, by 1 + 12 / N².
TIMES = 6.0
# Pixels below which nothing is named, and those of fewer than four points, which tell little.
SEEN, FEW_SEEN = 1.5, 5.0
# Share of the points, beyond which it is the map that is wrong, not they.
MOST = 0.4


@dataclass(frozen=True, eq=False)
class CheckPointOutliers:
    """Outliers among check points.

    Attributes
    ----------
    outliers : bool array (N,)
    centre : array (2,)
        Median error of all, pixels: of what is systematic in the map.
    rms : float
        RMS length of the errors of the others, pixels.
    """

    outliers: BoolArray
    centre: FloatArray
    rms: float


def check_point_outliers(errors: FloatArray, expected: float = 0.0) -> CheckPointOutliers:
    """Check points whose errors are far from the median error.

    A shift of the whole map moves the median and makes none of them an outlier. With normal errors in both axes a good
    point is named in less than one of 200 sets of four points or more.

    Parameters
    ----------
    errors : array (N, 2)
        Pixels.
    expected : float
        RMS length of the errors to be expected of the map, pixels, where the fit tells (leave-one-out); with it fewer
        than three points can be tested, too.
    """
    count = len(errors)
    centre: FloatArray = np.median(errors, axis=0) if count >= 3 else np.zeros(2)
    apart = np.hypot(*(errors - centre).T)
    if count >= 3:
        limit = TIMES * (1.0 + 12.0 / count**2) * max(float(np.median(apart)), expected)
        outliers = apart > max(limit, SEEN if count > 3 else FEW_SEEN)
    else:
        outliers = (apart > max(TIMES * expected, FEW_SEEN)) & (expected > 0.0)
    if count >= 3 and outliers.mean() > MOST:
        outliers = np.zeros(count, dtype=np.bool_)
    return CheckPointOutliers(outliers, centre, total_rms(errors[~outliers]))
