"""Adjusted block: images with their covariances, points, facts, and the files made of them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.block import ControlPoint, OrientedBlock, OrientedImage
from geomosaic.block_adjustment.determined_images import set_aside_text
from geomosaic.block_adjustment.exchange import reconstruction_of, write_exports
from geomosaic.block_adjustment.height_offset import HeightOffset, height_offset
from geomosaic.block_adjustment.measurements import Measurements
from geomosaic.block_adjustment.start import StartBlock, described, places_of
from geomosaic.block_adjustment.summary import summary_lines
from geomosaic.block_adjustment.tie_point_surface import TiePointSurface, surface_lines
from geomosaic.estimation.expected_errors import ExpectedErrors, expected_text
from geomosaic.inputs.adjusted import exterior_lines, exterior_of, motion_of
from geomosaic.interchange.reconstruction import Reconstruction
from geomosaic.options.render import RunningOptions
from geomosaic.orientation.block.blunder_causes import BlockBlunder, blunders
from geomosaic.orientation.block.facts import block_facts
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.report.block import render_block
from geomosaic.report.block_figures import block_figures
from geomosaic.report.tie_points import render_tie_section
from geomosaic.report.tied_images import TiedImages, tie_facts, tied_images
from geomosaic.sensor.corrected import model_to_dict
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import expected_errors
from geomosaic.stores.path import given_path
from geomosaic.surface.dem import Dem
from geomosaic.types import FloatArray
from geomosaic.whole_files import plain, write_atomic


@dataclass(frozen=True, eq=False)
class AdjustedBlock:
    """Result of a block adjustment.

    Attributes
    ----------
    scenes : tuple of OrientedImage (M,)
        Images with their adjusted models, each with the covariance of its parameters and, behind them, of those of its
        camera where these were estimated: (P, P) or (P + Q, P + Q); None where too little was measured in the image,
        or the block is too large for it.
    solution : BlockSolution
        Points, residuals, reliability: everything that the adjustment knows.
    start : StartBlock
        Images as they were declared.
    measured : Measurements
    control : tuple of ControlPoint
        Control and check points in the CRS of the ground.
    exports : tuple of str
        Programs whose files `write` makes, too.
    nowhere : str
        How a block that lies nowhere on the Earth was given its frame, in words; empty of others.
    set_aside : mapping of str to str
        Images that nothing ties to the others or holds, each with the reason; they are not among `scenes`.
    held : tuple of str
        Camera parameters that were held though they were to be found, in words.
    set_free : tuple of str
        Camera parameters that self-calibration has set free, in words.
    running : RunningOptions
        Threads or workers that make the ground of the adjusted points.
    """

    scenes: tuple[OrientedImage, ...]
    solution: BlockSolution
    start: StartBlock
    measured: Measurements
    control: tuple[ControlPoint, ...]
    exports: tuple[str, ...] = ()
    nowhere: str = ""
    set_aside: Mapping[str, str] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    set_free: tuple[str, ...] = ()
    running: RunningOptions = field(default_factory=RunningOptions)

    @classmethod
    def of(
        cls,
        start: StartBlock,
        measured: Measurements,
        control: Sequence[ControlPoint],
        solution: BlockSolution,
        exports: tuple[str, ...] = (),
    ) -> AdjustedBlock:
        """Result of a solution.

        Parameters
        ----------
        start : StartBlock
        measured : Measurements
        control : sequence of ControlPoint
            Measurements of control and check points.
        solution : BlockSolution
        exports : tuple of str
            Programs for which files are written.
        """
        scenes = tuple(
            replace(scene, model=model, covariance=solution.covariance(index), known_by=_known_by(solution, index))
            for index, (scene, model) in enumerate(zip(start.scenes, solution.models, strict=True))
        )
        return cls(scenes, solution, start, measured, tuple(control), exports)

    def __repr__(self) -> str:
        return f"AdjustedBlock({len(self.scenes)} images, {len(self.points)} points, sigma0 {self.sigma0:.3f})"

    @property
    def models(self) -> dict[str, SensorModel]:
        """Adjusted models by the name of the image."""
        return {scene.name: scene.model for scene in self.scenes}

    @cached_property
    def points(self) -> dict[str, tuple[float, float, float]]:
        """Adjusted points by name, in the CRS of the ground; those without a place are not among them."""
        found = zip(self.solution.ids, self.solution.ground.tolist(), strict=True)
        return {name: (x, y, z) for name, (x, y, z) in found if np.isfinite(x + y + z)}

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight: 1 where all standard deviations given are right."""
        return self.solution.adjustment.sigma0

    @cached_property
    def blunders(self) -> list[BlockBlunder]:
        """Measurements that were left out, with their likely causes, the least probable first."""
        return blunders(self.solution)

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Everything that was found, as JSON values."""
        found = block_facts(self.solution, self.blunders, self.start.camera)
        surface = self.tie_point_surface.facts if self.start.from_tie_points else None
        own: dict[str, Any] = {
            "accuracy": self.accuracy,
            "ties": tie_facts(self.tied),
            "surface": surface,
            "nowhere": self.nowhere,
        }
        own |= {"set_aside": dict(self.set_aside), "held": list(self.held), "set_free": list(self.set_free)}
        own["height_offset"] = None if self.height_offset is None else self.height_offset.facts
        return {"described": described(self.start), **found, **own}

    @cached_property
    def accuracy(self) -> dict[str, Any] | None:
        """Errors to be expected at the corners of the block, see `ExpectedErrors`; None without covariances."""
        known = {scene.name: (scene.model, own) for scene in self.scenes if (own := _of_image(scene)) is not None}
        if not known:
            return None
        height = float(np.nanmedian(self.solution.ground[:, 2]))
        pairs = [expected_errors(model, own, height, self.start.ground) for model, own in known.values()]
        places, sigmas = zip(*pairs, strict=True)
        used = sum(int((weight > 0.0).sum()) for weight in self.solution.adjustment.state.weights)
        fits = [(self.solution.adjustment.redundancy, 2 * used)]
        return ExpectedErrors.of(list(known), np.array(places), np.array(sigmas), fits).facts

    @property
    def summary(self) -> str:
        """The result in some twenty lines."""
        found = any(covariance is not None and covariance.any() for covariance in self.covariances)
        known = self.accuracy if found else None
        surface = self.facts["surface"]
        more = [] if known is None else [expected_text(known, "block")]
        more += [] if surface is None else surface_lines(surface, self.solution.length_unit)
        more += [self.height_offset.text] if self.height_offset is not None and self.height_offset.significant else []
        more += [*self.held, *self.set_free, *([self.nowhere] if self.nowhere else [])]
        more += [set_aside_text(self.set_aside)] if self.set_aside else []
        return "\n".join([*summary_lines(plain(self.facts)), *more])

    @cached_property
    def height_offset(self) -> HeightOffset | None:
        """Adjusted points over the declared ground; None where none was declared."""
        return height_offset(self.solution, self.scenes, self.start)

    @cached_property
    def tied(self) -> TiedImages:
        """Images, as they are oriented now, and their points as reports show them."""
        adjustment = self.solution.adjustment
        views, placed = adjustment.problem.views, ~adjustment.undetermined
        places = np.full((len(self.scenes), 2), np.nan)
        places[placed] = places_of(replace(self.start, scenes=self.scenes, placed=placed))[:, :2]
        out = adjustment.rejected[0]
        rows = np.flatnonzero(out | (adjustment.state.weights[0] > 0.0))
        return tied_images(
            self.scenes, views.points[rows], views.image[rows], views.colrow[rows], places, out[rows]
        )  # fmt: skip

    @cached_property
    def tie_section(self) -> str:
        """Section of reports on which images see each other, with the matches of any two, as HTML."""
        return render_tie_section(self.tied, self.facts["ties"])

    @property
    def covariances(self) -> tuple[FloatArray | None, ...]:
        """Covariance of each image, see `scenes`."""
        return tuple(scene.covariance for scene in self.scenes)

    @cached_property
    def tie_point_surface(self) -> TiePointSurface:
        """Surface through the adjusted points."""
        return TiePointSurface.of(self.solution, self.scenes, self.start.ground, self.running)

    def surface(self) -> Dem:
        """Ground of the adjusted points, in the vertical datum of the positions; its `sigma` says how good it is.

        Raises
        ------
        SolveError
            Fewer than three points, or all on one line.
        """
        return self.tie_point_surface.dem

    def block(self, *names: str) -> OrientedBlock:
        """All images, or some by name, over the ground that was declared, else over that of the adjusted points.

        It is what `gm.mosaic` and, of one image, `gm.ortho` take.

        Parameters
        ----------
        *names : str
            Of images, all unless given.
        """
        ground = (None if self.start.from_tie_points else self.start.surface) or self.surface()
        whole = OrientedBlock(self.scenes, ground, (), self.start.ground)
        return replace(whole, scenes=tuple(whole.scene(name) for name in names)) if names else whole

    def blocks(self) -> list[OrientedBlock]:
        """Adjusted blocks, one for each that was declared."""
        by_name = {scene.name: scene for scene in self.scenes}
        made = self.surface() if self.start.from_tie_points else None
        found = []
        for block in self.start.blocks:
            own = tuple(by_name[scene.name] for scene in block.scenes)
            names = {scene.name for scene in own}
            mine = tuple(p for p in self.control if p.image in names and np.isfinite(p.xyz).all())
            ground = made or block.surface
            found.append(replace(block, scenes=own, surface=ground, control=mine, crs=self.start.ground))
        return found

    def reconstruction(self) -> Reconstruction:
        """Photos, points and accepted measurements for other programs, see `gm.write_reconstruction`."""
        return reconstruction_of(self.scenes, self.solution, self.measured, self.start)

    def write_exports(self, folder: Path, name: str) -> dict[str, Path]:
        """Files of the programs in `exports`, a folder for each, returned; `name` is the block's.

        Parameters
        ----------
        folder : Path
        name : str
            Of the block.
        """
        if not self.exports:
            return {}
        return write_exports(self.reconstruction(), self.start.ground, self.exports, folder, name)

    def write_surface(self, heights: Path, sigma: Path) -> bool:
        """Ground of the adjusted points and its standard deviations as rasters; False where another was declared.

        Parameters
        ----------
        heights, sigma : Path
            Paths of the rasters, metres.
        """
        if self.start.from_tie_points:
            self.tie_point_surface.write(heights, sigma)
        return self.start.from_tie_points

    def model_state(self, index: int) -> dict[str, Any]:
        """State of an image as its file in `models/` holds it.

        Parameters
        ----------
        index : int
            Number of the image in `scenes`.
        """
        scene = self.scenes[index]
        return {
            "image": scene.name,
            "covariance": None if scene.covariance is None else scene.covariance.tolist(),
            "known_by": scene.known_by,
            **model_to_dict(scene.sensor, scene.model),
        }

    def write_exterior(self, path: Path) -> bool:
        """Orientation table with standard deviations and correlations; False where no image has such an orientation.

        Parameters
        ----------
        path : Path
        """
        rows = {scene.name: exterior_of(scene.model, _of_image(scene), self.start.ground) for scene in self.scenes}
        lines = exterior_lines(rows, {scene.name: motion_of(scene.model, self.start.ground) for scene in self.scenes})
        if lines:
            write_atomic(path, "\n".join(lines) + "\n")
        return bool(lines)

    def write_points(self, path: Path) -> Path:
        """Adjusted points as GeoPackage: name, role, number of rays, standard deviations, correlations, reliability.

        Parameters
        ----------
        path : Path
        """
        import shapely

        solution = self.solution
        known = np.flatnonzero(np.isfinite(solution.ground).all(axis=1))
        sigmas, covariance = solution.point_sigmas[known], solution.point_covariance[known]
        role = np.full(len(solution.ids), "tie", dtype=object)
        role[self.measured.control], role[solution.check] = "control", "check"
        columns: dict[str, Any] = {
            "id": [solution.ids[index] for index in known.tolist()],
            "role": role[known].tolist(),
            "rays": solution.rays[known],
        }
        columns |= {f"sigma_{axis}": sigmas[:, index] for index, axis in enumerate("xyz")}
        for name, values in zip(("detectable_px", "shift_m"), solution.point_reliability, strict=True):
            # What nothing checks has no number.
            columns[name] = np.where(np.isfinite(values[known]), values[known], np.nan)
        over = np.maximum(sigmas, 1e-300)
        for i, j in ((0, 1), (0, 2), (1, 2)):
            columns[f"cor_{'xyz'[i]}_{'xyz'[j]}"] = covariance[:, i, j] / (over[:, i] * over[:, j])
        geometries = shapely.points(solution.ground[known])
        layer = Layer(self.start.ground, "Point Z", list(geometries), columns)
        return write_layers(path, {"tie_points": layer}, overwrite=True)

    def page(self, name: str, notes: Sequence[str] = ()) -> str:
        """Report as an HTML page.

        Parameters
        ----------
        name : str
            Of the block, as its title.
        notes : sequence of str
            What the user was warned of.
        """
        surface = (
            [] if self.facts["surface"] is None else surface_lines(self.facts["surface"], self.solution.length_unit)
        )
        own = [self.nowhere] if self.nowhere and self.nowhere not in notes else []
        aside = set_aside_text(self.set_aside) if self.set_aside else ""
        offset = self.height_offset.text if self.height_offset and self.height_offset.significant else ""
        own += [offset] if offset and offset not in notes else []
        own += [aside] if aside and not any(note.startswith(aside) for note in notes) else []
        return render_block(self.facts, block_figures(self.solution), name, (*notes, *own, *surface), self.tie_section)

    def write(self, folder: Path | str) -> dict[str, Path]:
        """Files of the result.

        Parameters
        ----------
        folder : path
            Made where it does not exist: models/IMAGE.json, exterior.csv, tie_points.gpkg, adjustment.json, the
            report, adjustment.html, and exports/PROGRAM; surface.tif and surface_sigma.tif of a ground of tie points.

        Returns
        -------
        dict of str to Path
            Files by what they hold; no 'exterior' where no image has one.
        """
        base = given_path(folder)
        (base / "models").mkdir(parents=True, exist_ok=True)
        for index, scene in enumerate(self.scenes):
            write_atomic(base / "models" / f"{scene.name}.json", json.dumps(plain(self.model_state(index)), indent=1))
        files = {"models": base / "models", "points": base / "tie_points.gpkg", "facts": base / "adjustment.json"}
        self.write_points(files["points"])
        write_atomic(files["facts"], json.dumps(plain(self.facts), indent=1) + "\n")
        files["report"] = base / "adjustment.html"
        name = base.resolve().name
        write_atomic(files["report"], self.page(name))
        files |= self.write_exports(base / "exports", name)
        if self.write_exterior(base / "exterior.csv"):
            files["exterior"] = base / "exterior.csv"
        surface = {"surface": base / "surface.tif", "surface_sigma": base / "surface_sigma.tif"}
        if self.write_surface(*surface.values()):
            files |= surface
        return files


def _known_by(solution: BlockSolution, index: int) -> str:
    """Source of the covariance of an image, or why there is none."""
    covariance = solution.covariance(index)
    if covariance is None:
        lost = solution.adjustment.undetermined[index]
        why = "too little was measured in the image, it is as given" if lost else solution.reservation
        return f"the orientation takes no part in the error: {why}"
    count = len(solution.models[index].parameters)
    if not covariance[:count, :count].any():
        return "orientation: held as given by the block adjustment, without an error of its own"
    return f"orientation: block adjustment, sigma0 {solution.adjustment.sigma0:.2f}"


def _of_image(scene: OrientedImage) -> FloatArray | None:
    """Covariance (P, P) of an image's own parameters."""
    count = len(scene.model.parameters)
    return None if scene.covariance is None else scene.covariance[:count, :count]
