"""Images adjusted on control points: expected errors, and exterior orientations with standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.block import OrientedBlock, OrientedImage
from geomosaic.errors import SolveError, counted, listed
from geomosaic.estimation.expected_errors import ExpectedErrors, expected_text, residual_text
from geomosaic.estimation.statistics import correlations, total_rms
from geomosaic.geo.transform import Transform
from geomosaic.inputs.build import is_adjusted
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import ELEMENTS, MOTION, ExteriorRow
from geomosaic.sensor.corrected import Corrected, left_out
from geomosaic.sensor.plugin import ControlBlunder, HasExterior, HasMotion, SensorModel
from geomosaic.sensor.solve import Resection, expected_errors, precision
from geomosaic.types import FloatArray
from geomosaic.whole_files import write_atomic


@dataclass(frozen=True, eq=False)
class AdjustedImage:
    """Image adjusted on control points.

    Attributes
    ----------
    scene : OrientedImage
    found : Resection
        Statistics at its model.
    used : int
        Number of points that took part.
    height : float
        Mean height of the points that took part, in the CRS of the block.
    left_out : tuple of ControlBlunder
        Points that contradict the others.
    """

    scene: OrientedImage
    found: Resection[SensorModel]
    used: int
    height: float
    left_out: tuple[ControlBlunder, ...] = ()

    @property
    def covariance(self) -> FloatArray:
        """Covariance (P, P) of the parameters in their units."""
        return self.found.pooled_covariance

    @property
    def note(self) -> str:
        """How the orientation is known, in words."""
        out = f", {len(self.left_out)} left out ({listed(self.left_out, 3, '; ')})" if self.left_out else ""
        points = f"{self.used} control point{'s' * (self.used != 1)}"
        return f"orientation: adjusted to {points}{out}, sigma0 {self.found.sigma0:.2f}"

    @property
    def observations(self) -> int:
        """Image coordinates and a-priori values of parameters."""
        sigmas = self.scene.model.parameters.sigmas
        return 2 * self.used + int(((sigmas > 0.0) & np.isfinite(sigmas)).sum())

    def expected_errors(self, crs: CRS) -> tuple[FloatArray, FloatArray]:
        """Map positions (5, 2) of the corners and the middle, and expected lengths (5,) of their errors, pixels."""
        return expected_errors(self.scene.model, self.covariance, self.height, crs)


def adjusted_images(inputs: Block, block: OrientedBlock) -> list[AdjustedImage]:
    """Images of a block that control points have oriented or corrected.

    Parameters
    ----------
    inputs : Block
    block : OrientedBlock
        Built of them.

    Returns
    -------
    list of AdjustedImage
        Images without control points are not among them.
    """
    if block.crs is None or inputs.planar is not None or not is_adjusted(inputs):
        return []
    found = []
    for scene in block.scenes:
        points = [point for point in block.control if point.image == scene.name and point.role == "control"]
        if not points or not scene.model.parameters.sigmas.any():
            continue
        xyz = np.array([point.xyz for point in points], dtype=np.float64)
        image, sigmas = np.array([point.colrow for point in points]), np.array([point.sigma_px for point in points])
        ground = Transform(block.crs, scene.model.crs)(xyz)
        wrong = left_out(scene.model)
        used = ~np.isin([point.id for point in points], [blunder.id for blunder in wrong])
        with suppress(SolveError):  # adjusted in the sensor's own way, these points alone do not determine the model
            resected = precision(scene.model, ground[used], image[used], sigmas[used])
            found.append(AdjustedImage(scene, resected, int(used.sum()), float(xyz[used, 2].mean()), wrong))
    return found


def adjustment_facts(images: Sequence[AdjustedImage], crs: CRS) -> dict[str, Any]:
    """Facts of adjusted images as JSON values.

    Parameters
    ----------
    images : sequence of AdjustedImage
        At least one.
    crs : CRS
        3-D CRS of the block.

    Returns
    -------
    dict
        `summary` in words, `accuracy` of `ExpectedErrors.facts`, and `images`: for each its redundancy, sigma0, RMS of
        residuals and, of photos, exterior orientation with covariance.
    """
    places, sigmas = zip(*(image.expected_errors(crs) for image in images), strict=True)
    names, fits = [image.scene.name for image in images], [(i.found.redundancy, i.observations) for i in images]
    accuracy = ExpectedErrors.of(names, np.array(places), np.array(sigmas), fits).facts
    residuals = np.concatenate([image.found.residuals for image in images])
    measured = counted(sum(image.used for image in images), "measurement")
    wrong = [f"{blunder} in {image.scene.name}" for image in images for blunder in image.left_out]
    how = f"{counted(len(images), 'image')} adjusted on {measured} of control points"
    how += f", {len(wrong)} left out ({listed(wrong, 6, '; ')})" if wrong else ""
    product = "image" if len(images) == 1 else "mosaic"
    return {
        "summary": [f"{how}: {residual_text(total_rms(residuals), accuracy)}", expected_text(accuracy, product)],
        "accuracy": accuracy,
        "images": [
            {
                "image": image.scene.name,
                "points": image.used,
                "left_out": [
                    {"point": each.id, "size_px": list(each.size), "cause": each.cause} for each in image.left_out
                ],
                "redundancy": image.found.redundancy,
                "sigma0": image.found.sigma0 if np.isfinite(image.found.sigma0) else None,
                "rms_px": total_rms(image.found.residuals),
                **_exterior_facts(image, crs),
            }
            for image in images
        ],
    }


def _exterior_facts(image: AdjustedImage, crs: CRS) -> dict[str, Any]:
    found = exterior_of(image.scene.model, image.covariance, crs)
    if found is None or (covariance := found[1]) is None:
        return {}
    values = found[0]
    sigmas = np.sqrt(np.diag(covariance))
    return {
        "exterior": dict(zip(ELEMENTS, values.tolist(), strict=True)),
        "exterior_sigmas": dict(zip(ELEMENTS, sigmas.tolist(), strict=True)),
        "exterior_correlations": correlations(covariance).tolist(),
    }


def exterior_of(
    model: SensorModel, covariance: FloatArray | None, crs: CRS
) -> tuple[FloatArray, FloatArray | None] | None:
    """Exterior orientation (6,) of a photo and its covariance (6, 6) if it is known, in the order of `ELEMENTS`.

    Parameters
    ----------
    model : SensorModel
    covariance : array (P, P), optional
        Of its parameters in their units.
    crs : CRS
        3-D CRS of x, y, z, whose grid north the angles, in degrees, refer to.

    Returns
    -------
    tuple or None
        None of a model that has no exterior orientation.
    """
    inner = model.model if isinstance(model, Corrected) else model
    if not isinstance(inner, HasExterior):
        return None
    if covariance is None:
        return inner.exterior(crs), None
    slopes = _slopes(inner, crs)
    return inner.exterior(crs), slopes @ covariance @ slopes.T


def _slopes(model: Any, crs: CRS) -> FloatArray:
    """Derivatives (6, P) of a photo's exterior orientation by the parameters of its model."""
    values, steps = model.parameters.values, model.parameters.steps
    columns = []
    for step in np.diag(steps):
        change = model.with_values(values + step).exterior(crs) - model.with_values(values - step).exterior(crs)
        change[3:] = np.mod(change[3:] + 180.0, 360.0) - 180.0
        columns.append(change / (2.0 * step.sum()))
    return np.column_stack(columns)


def parameter_covariance(row: ExteriorRow, model: SensorModel, crs: CRS) -> FloatArray | None:
    """Covariance (P, P) of a photo's parameters from that of its row in an orientation table.

    Parameters
    ----------
    row : ExteriorRow
    model : SensorModel
        Built of the row.
    crs : CRS
        3-D CRS of the table.

    Returns
    -------
    array or None
        None where the row has no standard deviations, or the model no exterior orientation.
    """
    inner = model.model if isinstance(model, Corrected) else model
    if row.covariance is None or not isinstance(inner, HasExterior):
        return None
    all_slopes, known = _slopes(inner, crs), inner.parameters.sigmas
    # The motion of a photo is not in the table, and changes nothing that is.
    pose = all_slopes.any(axis=0)
    slopes = all_slopes[:, pose]
    # Where a photo looks along x, omega and kappa turn about one axis, and their sigmas say nothing of either.
    if not np.isfinite(slopes).all() or not np.linalg.cond(slopes / np.abs(slopes).max(axis=1)[:, None]) < 1e9:
        return None
    back = np.linalg.inv(slopes)
    covariance: FloatArray = np.diag(np.where(np.isfinite(known) & ~pose, known, 0.0) ** 2)
    covariance[np.ix_(pose, pose)] = back @ row.covariance @ back.T
    return covariance


def motion_of(model: SensorModel, crs: CRS) -> FloatArray | None:
    """Motion (6,) of a photo while it is exposed, see `HasMotion`; None of one that is exposed at once.

    Parameters
    ----------
    model : SensorModel
    crs : CRS
        3-D CRS of the velocity.
    """
    inner = model.model if isinstance(model, Corrected) else model
    return inner.motion(crs) if isinstance(inner, HasMotion) else None


def exterior_lines(
    rows: Mapping[str, tuple[FloatArray, FloatArray | None] | None], motions: Mapping[str, FloatArray | None]
) -> list[str]:
    """Lines of an orientation table with standard deviations and correlations; empty where unknown, none where all are.

    Parameters
    ----------
    rows : mapping
        Exterior orientation (6,) and covariance (6, 6) by image, see `exterior_of`.
    motions : mapping
        Motion (6,) by image, see `motion_of`.

    Returns
    -------
    list of str
        Empty where no image has an exterior orientation.
    """
    pairs = list(combinations(range(6), 2))
    sigma_names = [f"sigma_{name}" for name in ELEMENTS]
    correlation_names = [f"cor_{ELEMENTS[i]}_{ELEMENTS[j]}" for i, j in pairs]
    known = any(found[1] is not None for found in rows.values() if found is not None)
    moving = any(motion is not None for motion in motions.values())
    header = ("image", *ELEMENTS, *((*sigma_names, *correlation_names) if known else ()), *(MOTION if moving else ()))
    lines = [",".join(header)]
    for name, found in rows.items():
        if found is None:
            continue
        values, covariance = found
        # Thirteen digits: 1e-6 m of a northing, and the same pixels when the table is read again.
        numbers = [f"{value:.13g}" for value in values]
        if known and covariance is None:
            numbers += [""] * (len(sigma_names) + len(pairs))
        elif covariance is not None:
            rho = correlations(covariance)
            numbers += [f"{value:.6g}" for value in np.sqrt(np.diag(covariance))]
            numbers += [f"{rho[i, j]:.9f}" for i, j in pairs]
        if moving:
            motion = motions.get(name)
            numbers += [""] * 6 if motion is None else [f"{value:.13g}" for value in motion]
        lines.append(",".join([f'"{name}"' if "," in name else name, *numbers]))
    return lines if len(lines) > 1 else []


def write_exterior(path: Path, images: Sequence[AdjustedImage], crs: CRS) -> bool:
    """Orientation table of adjusted photos, with standard deviations and correlations, that `exterior` reads.

    Parameters
    ----------
    path : Path
    images : sequence of AdjustedImage
    crs : CRS
        See `exterior_of`.

    Returns
    -------
    bool
        False where no image has an exterior orientation, so that nothing is written.
    """
    lines = exterior_lines(
        {i.scene.name: exterior_of(i.scene.model, i.covariance, crs) for i in images},
        {i.scene.name: motion_of(i.scene.model, crs) for i in images},
    )
    if lines:
        write_atomic(path, "\n".join(lines) + "\n")
    return bool(lines)
