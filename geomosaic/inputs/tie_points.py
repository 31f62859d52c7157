"""Tie points: image positions of points without given coordinates, from a table, another program's files or values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geomosaic.control.points import mean_sigmas, possible_covariances
from geomosaic.errors import InputError
from geomosaic.image_names import find_by_name
from geomosaic.inputs.tables import read_columns, read_table
from geomosaic.interchange.formats import format_of, read_reconstruction
from geomosaic.interchange.reconstruction import Reconstruction
from geomosaic.stores.path import given_path, to_path
from geomosaic.types import FloatArray, PathLike
from geomosaic.whole_files import write_atomic

COLUMNS = ("id", "image", "col", "row")
# What a table may say of the accuracy of a position: one standard deviation, or those along both axes.
ACCURACY = ("sigma_px", "sigma_col", "sigma_row", "correlation")


@dataclass(frozen=True, eq=False)
class TiePoints:
    """Image positions of tie points, N in all.

    Attributes
    ----------
    points, images : sequence of str (N,)
        Name of the point and of the image of each.
    colrow : array (N, 2)
        Pixels, corner-based: (0.5, 0.5) is the centre of the upper-left pixel.
    sigma : array (N,), optional
        Standard deviations in pixels; NaN where none is known.
    origins : sequence of str (N,), optional
        File and line of each, for messages.
    covariance : array (N, 2, 2), optional
        Square pixels; counts in place of `sigma` where it is finite.
    """

    points: Sequence[str]
    images: Sequence[str]
    colrow: FloatArray
    sigma: FloatArray | None = None
    origins: Sequence[str] = ()
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        colrow = np.asarray(self.colrow, dtype=np.float64).reshape(-1, 2)
        sigma = np.full(len(colrow), np.nan) if self.sigma is None else np.asarray(self.sigma, dtype=np.float64)
        whole = None if self.covariance is None else np.asarray(self.covariance, dtype=np.float64).reshape(-1, 2, 2)
        given = (("points", self.points), ("images", self.images), ("sigma", sigma), ("covariance", whole))
        for name, values in given:
            if values is None:
                continue
            if len(values) != len(colrow):
                what = f"{len(values)} {name} for {len(colrow)} image positions"
                raise InputError(what, where="`ties`", hint="give one of each per measurement")
        wrong = np.flatnonzero(~np.isfinite(colrow).all(axis=1) | (sigma <= 0.0) | np.isinf(sigma))
        if len(wrong):
            row = int(wrong[0])
            what = f"point '{self.points[row]}' in {self.images[row]}: {colrow[row].tolist()} ± {sigma[row]} px"
            hint = "give finite positions, and standard deviations above 0 or none"
            raise InputError(what, where=self.origin(row), hint=hint)
        object.__setattr__(self, "colrow", colrow)
        object.__setattr__(self, "covariance", whole)
        object.__setattr__(self, "sigma", sigma if whole is None else self._mean_sigma(sigma, whole))

    def _mean_sigma(self, sigma: FloatArray, covariance: FloatArray) -> FloatArray:
        """Standard deviations, those of covariances as the root of their mean variance."""
        wrong = np.flatnonzero(~possible_covariances(covariance))
        if len(wrong):
            row = int(wrong[0])
            what = f"point '{self.points[row]}' in {self.images[row]}: {covariance[row].tolist()} is no covariance"
            hint = "give sigmas above 0 and correlations between -1 and 1"
            raise InputError(what, where=self.origin(row), hint=hint)
        return np.where(np.isfinite(covariance).all(axis=(1, 2)), mean_sigmas(covariance), sigma)

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of(cls, found: Reconstruction) -> TiePoints:
        """Measurements of a reconstruction.

        Parameters
        ----------
        found : Reconstruction
        """
        seen, name = found.observations, [image.name for image in found.images]
        return cls(
            [found.points.ids[point] for point in seen.point.tolist()],
            [name[image] for image in seen.image.tolist()],
            seen.colrow,
            seen.sigma,
        )

    def write(self, path: PathLike) -> Path:
        """Table with the columns id, image, col, row and of their accuracy, as `read_ties` reads it.

        Parameters
        ----------
        path : path-like
        """
        known = accuracy_columns(np.asarray(self.sigma), self.covariance)
        lines = [",".join((*COLUMNS, *known))]
        accuracy = np.column_stack(list(known.values())).tolist()
        for point, image, (col, row), values in zip(
            self.points, self.images, self.colrow.tolist(), accuracy, strict=True
        ):
            cells = ",".join("" if np.isnan(value) else f"{value:.4f}" for value in values)
            lines.append(f"{quoted(point)},{quoted(image)},{col:.4f},{row:.4f},{cells}")
        write_atomic(given_path(path), "\n".join(lines) + "\n")
        return given_path(path)

    def origin(self, row: int) -> str:
        """File and line of a measurement, for messages.

        Parameters
        ----------
        row : int
            Number of the measurement, from 0.
        """
        return self.origins[row] if len(self.origins) else f"`ties`, measurement {row + 1}"


def accuracy_columns(sigma: FloatArray, covariance: FloatArray | None) -> dict[str, FloatArray]:
    """Columns of a table that tell how accurate image positions are, by name.

    Parameters
    ----------
    sigma : array (N,)
        Pixels.
    covariance : array (N, 2, 2) or None
    """
    if covariance is None:
        return {ACCURACY[0]: sigma}
    both = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    columns = (sigma, both[:, 0], both[:, 1], covariance[:, 0, 1] / both.prod(axis=1))
    return dict(zip(ACCURACY, columns, strict=True))


def covariances_of(values: FloatArray) -> FloatArray | None:
    """Covariances (N, 2, 2) of columns sigma_col, sigma_row and correlation; None where none is told.

    Parameters
    ----------
    values : array (N, 3)
        NaN where a field is empty.
    """
    x, y, correlation = values.T
    if not np.isfinite(x * y).any():
        return None
    mixed = x * y * np.nan_to_num(correlation)
    found: FloatArray = np.stack([np.stack([x**2, mixed], axis=-1), np.stack([mixed, y**2], axis=-1)], axis=-2)
    return found


def quoted(text: str) -> str:
    """Field of a table: quoted where it has a comma or a quote.

    Parameters
    ----------
    text : str
    """
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in ',"') else text


def read_ties(path: PathLike, sizes: Mapping[str, tuple[int, int]] | None = None) -> TiePoints:
    """Tie points of a table, or of files of another program.

    Parameters
    ----------
    path : path-like
        Text with the columns id, image, col, row, one line per measurement, and optionally sigma_px, or sigma_col,
        sigma_row and correlation; or what `read_reconstruction` reads.
    sizes : mapping of str to (int, int), optional
        Width and height of each image by its name, which not every program's files tell.

    Raises
    ------
    InputError
        Names file and line.
    """
    if format_of(to_path(path)) is not None:
        return _of_program(to_path(path), sizes or {})
    whole = read_columns(path, "tie point table", ",".join(COLUMNS), COLUMNS[:2], COLUMNS[2:], ACCURACY)
    if whole is not None and not (whole[1][:, 2:5] <= 0.0).any():
        (points, images), values, origins = whole
        return TiePoints(points, images, values[:, :2], values[:, 2], origins, covariances_of(values[:, 3:]))
    table = read_table(path, "tie point table", ",".join(COLUMNS))
    table.require(*COLUMNS, what="tie points")
    points, images, numbers, places = [], [], [], []
    for row in table:
        accuracy = [row.number(name, float("nan")) for name in ACCURACY]
        for name, sigma in zip(ACCURACY[:3], accuracy, strict=False):
            if sigma <= 0.0:
                hint = "a standard deviation is greater than 0; leave the field empty where it is not known"
                raise InputError(f"{name} is {sigma:g}", where=row.where, hint=hint)
        points.append(row.text("id"))
        images.append(row.text("image"))
        numbers.append((row.number("col"), row.number("row"), *accuracy))
        places.append(row.where)
    values = np.array(numbers, dtype=np.float64).reshape(-1, 6)
    return TiePoints(points, images, values[:, :2], values[:, 2], places, covariances_of(values[:, 3:]))


def _of_program(path: Path, sizes: Mapping[str, tuple[int, int]]) -> TiePoints:
    """Tie points of files of another program."""
    found = read_reconstruction(path)
    if not len(found.observations.point):
        raise InputError(
            "the file has no measurements of points",
            where=str(path),
            hint="; ".join(found.notes) or "give a table with the columns id, image, col, row",
        )
    if any("size" not in camera for camera in found.cameras.values()):
        known = {image.name: find_by_name(sizes, image.name) for image in found.images}
        found = found.with_sizes({name: size for name, size in known.items() if size is not None})
    return TiePoints.of(found)
