"""Control points of one image as values, and check points measured on a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, counted, did_you_mean
from geomosaic.geo.crs import crs_code, parse_crs
from geomosaic.geo.transform import Transform
from geomosaic.types import BoolArray, FloatArray

ROLES = ("control", "check")

# Columns of ground coordinates, with other names that can mean nothing else.
GROUND_NAMES = {
    "x": ("easting", "east", "lon", "longitude", "mapx"),
    "y": ("northing", "north", "lat", "latitude", "mapy"),
    "z": ("height", "alt", "altitude", "elevation"),
}


def possible_covariances(covariance: FloatArray) -> BoolArray:
    """Whether matrices (N, 2, 2) are symmetric and positive definite, (N,); those with NaN, which are not told, count.

    Parameters
    ----------
    covariance : array (N, 2, 2)
    """
    (xx, xy), (yx, yy) = covariance.transpose(1, 2, 0)
    declared = np.isfinite(covariance).all(axis=(1, 2))
    right = (xx > 0.0) & (xx * yy > xy * yx) & (np.abs(xy - yx) <= 1e-6 * (xx + yy))
    possible: BoolArray = right | ~declared
    return possible


def mean_sigmas(covariance: FloatArray) -> FloatArray:
    """Standard deviation (N,) of an axis that stands for covariances (N, 2, 2): the root of their mean variance.

    Parameters
    ----------
    covariance : array (N, 2, 2)
    """
    sigmas: FloatArray = np.sqrt(np.maximum(np.trace(covariance, axis1=1, axis2=2), 0.0) / 2.0)
    return sigmas


@dataclass(frozen=True, slots=True)
class Origin:
    """File and position in it from which a point was read.

    Attributes
    ----------
    path : str
    number : int
        Counted from 1.
    unit : str
        What is counted: 'line' of a text, 'GCP' of a raster, 'corner' of the image a world file belongs to.
    """

    path: str
    number: int
    unit: str = "line"

    def __str__(self) -> str:
        return f"{self.path}, {self.unit} {self.number}"


@dataclass(frozen=True, eq=False)
class ControlPoints:
    """Control and check points of one image, with image and ground coordinates.

    Attributes
    ----------
    names : tuple of str
        Unique names of the N points.
    colrow : array (N, 2)
        Pixels, corner-based: (0.5, 0.5) is the centre of the upper-left pixel.
    ground : array (N, 2) or (N, 3)
        x, y and, where heights are given, z (NaN where one is not known), in `crs`.
    crs : CRS
        CRS of the ground coordinates.
    sigma : array (N,)
        Standard deviation of the image coordinates, pixels.
    roles : tuple of str
        'control' takes part in fits, 'check' serves as independent check.
    enabled : bool array (N,)
        False for points that are neither control nor check.
    origins : tuple of Origin
        File and line of each point.
    sigma_ground : array (N, 3), optional
        Standard deviations of x, y and z, metres, where they are known; block adjustment uses them.
    covariance : array (N, 2, 2), optional
        Of the image coordinates, square pixels, where it is known (NaN where not); block adjustment uses it in place of
        `sigma`.

    Raises
    ------
    InputError
        Parts of different length, a name twice, a coordinate that is not finite, a sigma that is not positive, a
        covariance that is none, or an unknown role; the point is named.
    """

    names: tuple[str, ...]
    colrow: FloatArray
    ground: FloatArray
    crs: CRS
    sigma: FloatArray
    roles: tuple[str, ...]
    enabled: BoolArray
    origins: tuple[Origin, ...]
    sigma_ground: FloatArray | None = None
    covariance: FloatArray | None = None

    def __repr__(self) -> str:
        checks = self.roles.count("check")
        return f"ControlPoints({counted(len(self), 'point')}, {checks} of them for checks, {crs_code(self.crs)})"

    def __post_init__(self) -> None:
        count = len(self.names)
        arrays = {
            "colrow": np.array(self.colrow, dtype=np.float64).reshape(-1, 2),
            "ground": np.array(self.ground, dtype=np.float64),
            "sigma": np.array(self.sigma, dtype=np.float64),
            "enabled": np.array(self.enabled, dtype=np.bool_),
        }
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if self.sigma_ground is not None:
            known = np.array(self.sigma_ground, dtype=np.float64)
            if known.shape != (count, 3) or not (known >= 0.0).all():
                what = f"standard deviations on the ground of {known.shape}, not {count} x 3, or below 0"
                raise InputError(what, hint="give those of x, y and z for each point, metres")
            known.flags.writeable = False
            object.__setattr__(self, "sigma_ground", known)
        if self.covariance is not None:
            whole = np.array(self.covariance, dtype=np.float64).reshape(-1, 2, 2)
            whole.flags.writeable = False
            object.__setattr__(self, "covariance", whole)
            arrays["covariance"] = whole
        lengths = {*map(len, arrays.values()), len(self.roles), len(self.origins)}
        if lengths != {count} or self.ground.ndim != 2 or self.ground.shape[1] not in (2, 3):
            raise InputError(
                f"control of {count} names has parts of other lengths: {sorted(lengths)}",
                hint="give one value for each point in every array",
            )
        finite: BoolArray = np.array(np.isfinite(np.hstack([self.colrow, self.ground[:, :2]])).all(axis=1))
        weighed = np.isfinite(self.sigma) & (self.sigma > 0)
        likely = np.ones(count, dtype=bool) if self.covariance is None else possible_covariances(self.covariance)
        first: dict[str, Origin] = {}
        for index, (name, origin) in enumerate(zip(self.names, self.origins, strict=True)):
            if not finite[index]:
                raise InputError(
                    f"point '{name}' has a coordinate that is not finite", where=str(origin), hint="give a number"
                )
            if not weighed[index]:
                raise InputError(
                    f"point '{name}' has the sigma {self.sigma[index]:g}", where=str(origin), hint="above 0, pixels"
                )
            if not likely[index]:
                what = f"point '{name}' has no covariance in {np.asarray(self.covariance)[index].tolist()}"
                hint = "give sigmas above 0 and correlations between -1 and 1"
                raise InputError(what, where=str(origin), hint=hint)
            if self.roles[index] not in ROLES:
                raise InputError(
                    f"point '{name}' has the role '{self.roles[index]}'",
                    where=str(origin),
                    hint=f"write {' or '.join(ROLES)}",
                )
            if name in first:
                raise InputError(
                    f"two points are called '{name}': {first[name]} has the other",
                    where=str(origin),
                    hint="rename one; one point is measured once in an image",
                )
            first[name] = origin

    @classmethod
    def from_arrays(
        cls,
        colrow: FloatArray,
        ground: FloatArray,
        crs: CRS | str,
        *,
        names: Sequence[str] | None = None,
        sigma: FloatArray | float = 1.0,
        roles: Sequence[str] | str = "control",
    ) -> ControlPoints:
        """Points of one image from arrays.

        Parameters
        ----------
        colrow : array (N, 2)
            Pixels, corner-based: (0.5, 0.5) is the centre of the upper-left pixel.
        ground : array (N, 2) or (N, 3)
            x, y and, where they are known, heights, in `crs`.
        crs : CRS or str
            Of the ground.
        names : sequence of str, optional
            '1', '2', ... unless given.
        sigma : array (N,) or float
            Standard deviation of the image coordinates, pixels.
        roles : sequence of str, or str
            'control' or 'check', for each or for all.

        Raises
        ------
        InputError
            See `ControlPoints`.

        Examples
        --------
        >>> ground = [[500000.0, 5400000.0], [500195.0, 5399995.0]]
        >>> points = ControlPoints.from_arrays([[10.0, 20.0], [400.0, 30.0]], ground, "EPSG:32633")
        >>> points.names, points.roles
        (('1', '2'), ('control', 'control'))
        """
        count = len(colrow)
        return cls(
            tuple(map(str, range(1, count + 1))) if names is None else tuple(names),
            colrow,
            ground,
            parse_crs(crs, "`crs`"),
            np.broadcast_to(np.asarray(sigma, dtype=np.float64), (count,)),
            (roles,) * count if isinstance(roles, str) else tuple(roles),
            np.ones(count, dtype=np.bool_),
            tuple(Origin("values", number, "point") for number in range(1, count + 1)),
        )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def xy(self) -> FloatArray:
        """Ground coordinates without heights, (N, 2)."""
        return self.ground[:, :2]

    def select(self, which: BoolArray | Sequence[bool]) -> ControlPoints:
        """Points for which `which` (N,) is true.

        Parameters
        ----------
        which : bool array or sequence of bool (N,)
            True for points to keep.
        """
        kept = np.flatnonzero(np.asarray(which, dtype=np.bool_))
        return ControlPoints(
            tuple(self.names[i] for i in kept),
            self.colrow[kept],
            self.ground[kept],
            self.crs,
            self.sigma[kept],
            tuple(self.roles[i] for i in kept),
            self.enabled[kept],
            tuple(self.origins[i] for i in kept),
            None if self.sigma_ground is None else self.sigma_ground[kept],
            None if self.covariance is None else self.covariance[kept],
        )

    def of_role(self, role: str) -> ControlPoints:
        """Enabled points of a role, 'control' or 'check'.

        Parameters
        ----------
        role : str
            'control' or 'check'.
        """
        return self.select(self.enabled & np.array([own == role for own in self.roles], dtype=np.bool_))

    def without(self, names: Sequence[str], where: str | None = None) -> ControlPoints:
        """Same points with those of these names disabled.

        Parameters
        ----------
        names : sequence of str
        where : str, optional
            Named in errors.

        Raises
        ------
        InputError
            There is no such point.
        """
        unknown = sorted(set(names) - set(self.names))
        if unknown:
            hint = did_you_mean(unknown[0], self.names)
            shown = ", ".join(self.names[:12]) + (" ..." if len(self) > 12 else "")
            hint = f"{hint} there are {shown}".strip()
            raise InputError(f"there is no point '{unknown[0]}'", where=where, hint=hint)
        return replace(self, enabled=self.enabled & ~np.isin(np.array(self.names), list(names)))

    def to_crs(self, crs: CRS) -> ControlPoints:
        """Same points with ground coordinates in another CRS.

        Heights take part where both CRS have them, else they pass through (`geo.transform.Transform`).

        Parameters
        ----------
        crs : CRS

        Raises
        ------
        InputError
            No trustworthy transformation, or a point that cannot be transformed, which is named.
        """
        transform = Transform(self.crs, crs)
        unknown = np.zeros(len(self), dtype=np.bool_)
        ground = self.ground.copy()
        if ground.shape[1] == 3:
            unknown = np.isnan(ground[:, 2])
            ground[unknown, 2] = 0.0
            if transform.spatial and unknown.any():
                at = int(np.flatnonzero(unknown)[0])
                raise InputError(
                    f"point '{self.names[at]}' has no height, which '{self.crs.name}' to '{crs.name}' needs",
                    where=str(self.origins[at]),
                    hint="give its height, or CRS without heights",
                )
        moved = transform(ground)
        lost = np.flatnonzero(~np.isfinite(moved).all(axis=1))
        if len(lost):
            raise InputError(
                f"point '{self.names[lost[0]]}' at {self.xy[lost[0]].tolist()} has no place in '{crs.name}'"
                + (f"; nor have {len(lost) - 1} more" if len(lost) > 1 else ""),
                where=str(self.origins[lost[0]]),
                hint=f"check that the coordinates are in '{self.crs.name}', x before y",
            )
        moved[unknown, 2:] = np.nan
        return replace(self, ground=moved, crs=crs)
