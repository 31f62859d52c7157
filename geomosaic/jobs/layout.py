"""Layout of a project's files: paths of outputs and of the state kept between runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from geomosaic.mosaicking.outputs import companion
from geomosaic.project.load import Project


@dataclass(frozen=True)
class Layout:
    """Paths of everything a project writes.

    Attributes
    ----------
    project : Project
    """

    project: Project

    @property
    def models(self) -> tuple[Path, ...]:
        """State of each image's model."""
        return tuple(self.project.output / "models" / f"{path.name}.json" for path in self.project.images)

    @property
    def orthos(self) -> tuple[Path, ...]:
        """Ortho of each image: its name without extension, or with it where two would else be one file."""
        images = self.project.images
        short = len({path.stem.casefold() for path in images}) == len(images)  # some file systems know no capitals
        return tuple(self.project.output / "orthos" / f"{path.stem if short else path.name}.tif" for path in images)

    @property
    def mosaic(self) -> Path:
        """Raster of the mosaic."""
        return self.project.output / f"{self.project.name}.tif"

    @property
    def labels(self) -> Path:
        """Raster of source images."""
        return companion(self.mosaic, "-labels", ".tif")

    @property
    def views(self) -> Path:
        """Raster of view angles and resolutions."""
        return companion(self.mosaic, "-views", ".tif")

    @property
    def displacement(self) -> Path:
        """Raster of relief displacements."""
        return companion(self.mosaic, "-displacement", ".tif")

    @property
    def vectors(self) -> Path:
        """Footprints and seamlines."""
        return companion(self.mosaic, "", ".gpkg")

    @property
    def item(self) -> Path:
        """STAC item."""
        return companion(self.mosaic, "", ".stac.json")

    @property
    def report(self) -> Path:
        """Report for people."""
        return self.project.output / "report.html"

    @property
    def report_json(self) -> Path:
        """Report for programs."""
        return self.project.output / "report.json"

    @property
    def places(self) -> Path:
        """Pictures of the worst places on seams, for the report."""
        return self.project.state / "facts" / "seam-places.json"

    def facts(self, step: str) -> Path:
        """Facts that a step found, as JSON for the steps after it."""
        return self.project.state / "facts" / f"{step}.json"
