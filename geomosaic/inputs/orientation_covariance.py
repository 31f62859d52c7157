"""Covariance of the orientation of images: what adjustments, tables, the user and the sensor tell, and its source."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedBlock, OrientedImage
from geomosaic.errors import InputError, did_you_mean
from geomosaic.geo.transform import Transform
from geomosaic.inputs.adjusted import AdjustedImage, adjusted_images, parameter_covariance
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.images import photos_of
from geomosaic.sensor.corrected import Corrected
from geomosaic.sensor.plugin import HasCovariance, HasInterior, SensorModel
from geomosaic.types import FloatArray


def orientation(
    model: SensorModel,
    given: Mapping[str, float],
    control: Sequence[ControlPoint] = (),
    crs: CRS | None = None,
    table: FloatArray | None = None,
) -> tuple[SensorModel, FloatArray | None, str]:
    """Covariance of a sensor's parameters, and its source.

    The first available of: standard deviations given by the user; the adjustment of the model to its control
    points; the orientation table; what the image's own data states; standard deviations the sensor comes with.

    Parameters
    ----------
    model : SensorModel
    given : mapping of str to float
        Standard deviations by parameter, in its unit.
    control : sequence of ControlPoint
        Points measured in this image.
    crs : CRS, optional
        3-D CRS of the points.
    table : array (P, P), optional
        Covariance of the parameters that the orientation table tells.

    Returns
    -------
    model : SensorModel
        Adjusted to the control points, where there are any.
    covariance : array (P, P) or None
        None where the standard deviation of any parameter is unknown.
    note : str

    Raises
    ------
    InputError
        A standard deviation is given for a parameter the sensor does not have, or one is missing.
    SolveError
        The control points do not determine the parameters.
    """
    parameters = model.parameters
    for name in given:
        if name not in parameters.names:
            hint = did_you_mean(name, parameters.names)
            raise InputError(
                f"the sensor has no parameter '{name}'",
                where="`sigmas`",
                hint=f"{hint} it has {', '.join(parameters.names) or 'none'}".strip(),
            )
    if control and given:
        raise InputError(
            "control points and standard deviations of the orientation are both given",
            where="`sigmas`",
            hint="leave one of them out: control points tell how well the orientation is known",
        )
    if control and (parameters.sigmas > 0.0).any():
        if crs is None:
            raise InputError("the control points have no CRS", hint="name it with `crs`")
        return _adjusted(model, control, crs)
    if table is not None and not given:
        return model, table, "orientation: standard deviations and correlations of its table"
    inner = model.model if isinstance(model, Corrected) else model
    stated = inner.covariance if isinstance(inner, HasCovariance) and not given else None
    if stated is not None:
        return model, stated, "orientation: as the image's own data states its accuracy"
    sigmas = np.array([given.get(n, s) for n, s in zip(parameters.names, parameters.sigmas.tolist(), strict=True)])
    free = [name for name, sigma in zip(parameters.names, sigmas.tolist(), strict=True) if not np.isfinite(sigma)]
    if free and given:
        raise InputError(
            f"nothing says how well {', '.join(free)} {'is' if len(free) == 1 else 'are'} known",
            where="`sigmas`",
            hint=f"give `sigmas`: {free[0]}=..., 0 where it is exact",
        )
    # Parameters that no adjustment may move are held, not exact: all of them say nothing.
    if free or not (given or sigmas.any()):
        unknown = f"{', '.join(free)} are known" if free else "it is known"
        return (
            model,
            None,
            f"the orientation takes no part in the error: nothing says how well {unknown} (`sigmas`, "
            "control points or the columns sigma_x ... of the orientation table would)",
        )
    source = "standard deviations as given" if given else "a-priori standard deviations of the sensor"
    return model, np.diag(sigmas**2), f"orientation: {source}"


def _adjusted(model: SensorModel, control: Sequence[ControlPoint], crs: CRS) -> tuple[SensorModel, FloatArray, str]:
    """Model adjusted to control points, its covariance and a note; outliers are left out."""
    from geomosaic.sensor.solve import resect_control

    xyz = np.array([point.xyz for point in control], dtype=np.float64)
    image = np.array([point.colrow for point in control], dtype=np.float64)
    sigmas, ids = np.array([point.sigma_px for point in control]), [point.id for point in control]
    found = resect_control(model, Transform(crs, model.crs)(xyz), image, sigmas, ids)
    solved, used = found.solved, int(found.used.sum())
    scene = OrientedImage(control[0].image, "", "", solved.model)
    adjusted = AdjustedImage(scene, solved, used, float(xyz[found.used, 2].mean()), found.left_out)
    return solved.model, adjusted.covariance, "; ".join(filter(None, (adjusted.note, found.undecided)))


def table_covariances(inputs: Block, block: OrientedBlock) -> dict[str, FloatArray]:
    """Covariances (P, P) of the parameters that the orientation table tells, by name of the image.

    Parameters
    ----------
    inputs : Block
    block : OrientedBlock
        Built of them.

    Returns
    -------
    dict
        Without images of which the table tells none.
    """
    if block.crs is None or inputs.exterior is None or inputs.angle_frame == "local":  # the table's refers to the grid
        return {}
    rows = {photo.name: photo.exterior for photo in photos_of(inputs)[0]}
    found = {
        scene.name: parameter_covariance(row, scene.model, block.crs)
        for scene in block.scenes
        if (row := rows.get(scene.name)) is not None
    }
    return {name: covariance for name, covariance in found.items() if covariance is not None}


def with_covariances(
    inputs: Block,
    block: OrientedBlock,
    sigmas: Mapping[str, float],
    adjusted: Sequence[AdjustedImage] | None = None,
) -> OrientedBlock:
    """Block whose images know the covariance of their orientation, as far as anything tells it.

    Parameters
    ----------
    inputs : Block
    block : OrientedBlock
        Built of them; the models stay as they are.
    sigmas : mapping of str to float
        Standard deviations by parameter, given by the user for all images.
    adjusted : sequence of AdjustedImage, optional
        Those of the block, where they are known already.

    Raises
    ------
    InputError
        See `orientation`.
    """
    tables = table_covariances(inputs, block)
    found = {image.scene.name: image for image in (adjusted_images(inputs, block) if adjusted is None else adjusted)}
    scenes: list[OrientedImage] = []
    for scene in block.scenes:
        if scene.name in found and not sigmas:
            own = found[scene.name]
            covariance: FloatArray | None = own.covariance
            note = own.note
        elif scene.covariance is not None and not sigmas:
            covariance, note = scene.covariance, scene.known_by
        else:
            _, covariance, note = orientation(scene.model, sigmas, (), None, tables.get(scene.name))
        covariance, more = _with_interior(scene.model, covariance)
        scenes.append(replace(scene, covariance=covariance, known_by=note + more))
    return replace(block, scenes=tuple(scenes))


def _with_interior(model: SensorModel, covariance: FloatArray | None) -> tuple[FloatArray | None, str]:
    """Covariance with the a-priori standard deviations of an interior orientation that is not held, and its source."""
    interior = model.interior if isinstance(model, HasInterior) else None
    if covariance is None or interior is None or not interior.sigmas.any():
        return covariance, ""
    if not np.isfinite(interior.sigmas).all():
        return covariance, "; the interior orientation takes no part: nothing says how well it is known"
    size, all_of_it = len(covariance), len(covariance) + len(interior)
    whole = np.zeros((all_of_it, all_of_it))
    whole[:size, :size], whole[size:, size:] = covariance, np.diag(interior.sigmas**2)
    return whole, "; interior orientation: a-priori standard deviations"


def with_sigmas(scene: OrientedImage, sigmas: Mapping[str, float]) -> OrientedImage:
    """Image whose covariance is that of standard deviations given by the user, in place of what was known.

    Parameters
    ----------
    scene : OrientedImage
    sigmas : mapping of str to float
        By parameter, in its unit.

    Raises
    ------
    InputError
        See `orientation`.
    """
    _, covariance, note = orientation(scene.model, sigmas)
    covariance, more = _with_interior(scene.model, covariance)
    return replace(scene, covariance=covariance, known_by=note + more)
