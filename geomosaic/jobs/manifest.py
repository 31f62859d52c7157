"""Manifest of the last run: what steps read, wrote, found and warned of; layout of a project's files."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.errors import GeomosaicWarning
from geomosaic.inputs.build import gives_exterior
from geomosaic.options.naming import project_key, renamed_values
from geomosaic.project.load import Project
from geomosaic.raster.files import companion
from geomosaic.sensor.registry import capabilities
from geomosaic.whole_files import plain, write_atomic

# End of the names of map sheets.
_SHEET = "-sheet"


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
    def set_aside(self) -> frozenset[Path]:
        """Images that step "orient" set aside; none before it has run, or with damaged facts."""
        try:
            names = set(read_json(self.facts("orient")).get("set_aside", ()))
        except (OSError, ValueError, AttributeError):
            names = set()
        return frozenset(path for path in self.project.images if path.name in names)

    @property
    def orthos(self) -> tuple[Path, ...]:
        """Ortho of each image: its name without extension, or with it where two would else be one file."""
        images = self.project.images
        short = len({path.stem.casefold() for path in images}) == len(images)  # some file systems know no capitals
        return tuple(self.project.output / "orthos" / f"{path.stem if short else path.name}.tif" for path in images)

    @property
    def georeferenced(self) -> tuple[Path, ...]:
        """Each image as its control points place it, written from the studio; no step makes these files."""
        return tuple(self.project.output / "georeferenced" / path.name for path in self.orthos)

    def sheet(self, layout: Path, ending: str) -> Path:
        """Map sheet of the mosaic or an ortho by a layout; `ending` is 'pdf', 'png' or 'tif'."""
        return self.project.output / f"{layout.stem}{_SHEET}.{ending}"

    @property
    def sheets(self) -> tuple[Path, ...]:
        """Georeferenced map sheets that were printed, whatever has become of their layouts."""
        # The mosaic of a project may be called so itself.
        found = sorted(self.project.output.glob(f"[!.]*{_SHEET}.tif"))
        return tuple(path for path in found if path != self.mosaic)

    def no_orthos(self) -> frozenset[Path]:
        """Orthos, with their accuracy, of the images that are set aside, and of which there is none."""
        aside, images = self.set_aside, self.project.images
        files = zip(images * 2, (*self.orthos, *self.ortho_accuracies), strict=True)
        return frozenset(path for image, path in files if image in aside)

    @property
    def mosaic(self) -> Path:
        """Raster of the mosaic: a file, or a virtual raster over tiles."""
        return self.project.output / f"{self.project.name}{self._ending}"

    @property
    def _ending(self) -> str:
        return ".tif" if self.project.options.records.tiling is None else ".vrt"

    @property
    def tiles(self) -> tuple[Path, ...]:
        """Files of the tiles that the mosaic was last written as, with those of their labels."""
        try:
            names = read_json(self.facts("mosaic")).get("tiles", ())
            return tuple(self.project.output / name for name in names)
        except (OSError, ValueError, AttributeError, TypeError):
            return ()

    @property
    def labels(self) -> Path:
        """Raster of source images."""
        return companion(self.mosaic, "-labels", self._ending)

    @property
    def views(self) -> Path:
        """Raster of view angles and resolutions."""
        return companion(self.mosaic, "-views", ".tif")

    @property
    def displacement(self) -> Path:
        """Raster of relief displacements."""
        return companion(self.mosaic, "-displacement", ".tif")

    @property
    def accuracy(self) -> Path:
        """Raster of standard deviations of position."""
        return companion(self.mosaic, "-accuracy", ".tif")

    @property
    def ortho_accuracies(self) -> tuple[Path, ...]:
        """The same of each ortho."""
        return tuple(companion(path, "-accuracy", ".tif") for path in self.orthos)

    @property
    def vectors(self) -> Path:
        """Footprints and seamlines."""
        return companion(self.mosaic, "", ".gpkg")

    @property
    def item(self) -> Path:
        """STAC item."""
        return companion(self.mosaic, "", ".stac.json")

    @property
    def exterior(self) -> Path | None:
        """Table of the exterior orientations that an adjustment gives; None where it gives none."""
        if self.project.adjustment is None:
            gives = gives_exterior(self.project.inputs)
        else:
            gives = any("orientation" in capabilities(part.sensor).exterior for part in self.project.blocks)
        return companion(self.mosaic, "-exterior", ".csv") if gives else None

    @property
    def ties(self) -> tuple[Path, ...]:
        """Table of the tie points that were measured in the images, and their report; empty where none are."""
        names = () if self.project.matching is None else ("tie_points.csv", "tie_points.html")
        return tuple(self.project.output / name for name in names)

    @property
    def reference_page(self) -> tuple[Path, ...]:
        """Report of the images that were found in a reference; empty where none is given."""
        matching = self.project.matching
        referenced = matching is not None and matching.reference is not None
        return (self.project.output / "reference_matches.html",) if referenced else ()

    @property
    def adjustment(self) -> tuple[Path, ...]:
        """Adjusted points, all facts and the report of a block adjustment; empty without one."""
        if self.project.adjustment is None:
            return ()
        return tuple(self.project.output / name for name in ("tie_points.gpkg", "adjustment.json", "adjustment.html"))

    @property
    def tie_section(self) -> Path | None:
        """Section of the report on the ties of adjusted images; None without an adjustment."""
        return None if self.project.adjustment is None else self.project.state / "facts" / "ties.html"

    @property
    def surface(self) -> tuple[Path, ...]:
        """Ground of the adjusted tie points and its standard deviations; empty where the project has another."""
        if not any(part.dem_from_tie_points for part in self.project.blocks):
            return ()
        return self.project.output / "surface.tif", self.project.output / "surface_sigma.tif"

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


FORMAT = 1


@dataclass(frozen=True)
class Record:
    """Record of the last run of a step.

    Attributes
    ----------
    ingredients : mapping
        Everything the result depends on, with digests.
    outputs : mapping
        Name of each file and its SHA-256.
    facts : mapping
        Returned by the step.
    seconds : float
    finished : str
        ISO 8601, UTC.
    """

    ingredients: Mapping[str, str]
    outputs: Mapping[str, str]
    facts: Mapping[str, Any]
    seconds: float
    finished: str


@dataclass
class Manifest:
    """Records by step, the outputs that are the project's to replace, and digests of files.

    Attributes
    ----------
    path : Path
        The manifest's JSON file.
    records : dict of str to Record
        Last run of each step, by its name.
    owned : set of str
        Names of files that this job has made and may write over; see `Job.name`.
    hashes : dict
        State and SHA-256 of each file when it was last read, see `geomosaic.raster.files.Hashes`.
    """

    path: Path
    records: dict[str, Record] = field(default_factory=dict)
    owned: set[str] = field(default_factory=set)
    hashes: dict[str, list[Any]] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Manifest:
        """Manifest of a file; empty, so that all is stale, where it is absent, damaged or of another format."""
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            if values["format"] != FORMAT:
                return cls(path)
            records = {name: Record(**record) for name, record in values["records"].items()}
            return cls(path, records, set(values["owned"]), dict(values["hashes"]))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return cls(path)

    def save(self) -> None:
        """Write the manifest under a temporary name and rename it."""
        values = {
            "format": FORMAT,
            "records": {name: asdict(record) for name, record in self.records.items()},
            "owned": sorted(self.owned),
            "hashes": self.hashes,
        }
        write_atomic(self.path, json.dumps(values, indent=1, ensure_ascii=False))


def write_json(path: Path, values: Any) -> None:
    """JSON file of a step's results, written whole or not at all.

    Parameters
    ----------
    path : Path
    values : object
        Made plain by `plain`.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    # NaN and infinity, which JSON does not know, become null; parameters in texts are named by section and key.
    write_atomic(
        path,
        json.dumps(renamed_values(plain(values), project_key), indent=1, ensure_ascii=False, allow_nan=False) + "\n",
    )


def read_json(path: Path) -> Any:
    """Values of a JSON file that a step has written.

    Parameters
    ----------
    path : Path

    Raises
    ------
    OSError, ValueError
        There is no such file, or it is no JSON.
    """
    return json.loads(path.read_text(encoding="utf-8"))


@contextmanager
def recorded_warnings() -> Iterator[list[str]]:
    """Texts of the GeomosaicWarnings raised within, each once; all warnings go on to the handler outside at the end.

    Yields
    ------
    list of str
        Filled when the context ends.
    """
    texts: dict[str, None] = {}
    found: list[str] = []
    caught: list[warnings.WarningMessage] = []
    try:
        # Recorded rather than intercepted: to replace the handler of warnings for a moment is private to its owner.
        with warnings.catch_warnings(record=True) as caught:
            yield found
    finally:
        for one in caught:
            if issubclass(one.category, GeomosaicWarning):
                texts[str(one.message)] = None
            warnings.showwarning(one.message, one.category, one.filename, one.lineno)
        found += texts


def show_note(text: str) -> None:
    """Note that is a result and not a warning.

    Parameters
    ----------
    text : str
    """
    # It goes to the handler of warnings directly, past the filters: one that makes errors of warnings must not stop a
    # run over it.
    warnings.showwarning(GeomosaicWarning(text), GeomosaicWarning, __file__, 0)
