"""Steps of a job, and their keys: digests of everything a result depends on.

Beside parameters and inputs these are files beside rasters, versions of libraries, and files of sensor plug-ins.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from geomosaic.digests import digest_of, sha256, source_digest
from geomosaic.errors import GeomosaicError
from geomosaic.options.declaration import declared
from geomosaic.options.inputs import BlockInputs
from geomosaic.project.load import Project
from geomosaic.raster.info import companions
from geomosaic.sensor.plugin import HasFiles
from geomosaic.sensor.registry import plugin
from geomosaic.sensor.registry import sensors as installed
from geomosaic.types import Progress

# Keys of [project] that decide what images show, and which of them come first.
KEYS_OF_IMAGES = tuple(one.key for one in declared(BlockInputs) if one.option.section == "project")


@dataclass(frozen=True)
class Machine:
    """Processors, memory and workers that a run may use; results do not depend on them.

    Attributes
    ----------
    threads : int, optional
        All processors unless given.
    memory_limit : int, optional
        Bytes.
    workers : int, str, Executor or Client, optional
        See `RenderOptions`.
    """

    threads: int | None = None
    memory_limit: int | None = None
    workers: Any = None

    @property
    def options(self) -> dict[str, Any]:
        """Values that were given, as keywords of `RenderOptions`."""
        given = {"threads": self.threads, "memory_limit": self.memory_limit, "workers": self.workers}
        return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class Context:
    """Input of a running step, beside its files.

    Attributes
    ----------
    progress : callable
        Called with (done, total, stage); may raise to stop the step.
    digests : mapping
        SHA-256 of the step's inputs by path.
    forced : bool
        Nothing of an earlier run is to be taken.
    digest : callable
        SHA-256 of any file; one that has not changed since it was last asked for is not read again.
    """

    progress: Progress
    digests: Mapping[Path, str] = field(default_factory=dict)
    forced: bool = False
    digest: Callable[[Path], str] = sha256


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes
    ----------
    name : str
    run : callable
        Takes a `Context`, writes the outputs and returns facts as JSON values. Picklable where the executor is another
        process.
    parameters : mapping
        JSON values that the result depends on.
    inputs : tuple of Path
        Files the result depends on, by content.
    outputs : tuple of Path
        Files the step writes.
    made : callable
        Returns further outputs, of which only a run has told which there are, as the last one found.
    without : callable
        Returns those inputs and outputs that there are not this time, as earlier steps found.
    """

    name: str
    run: Callable[[Context], Mapping[str, Any]]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: tuple[Path, ...] = ()
    outputs: tuple[Path, ...] = ()
    without: Callable[[], frozenset[Path]] = frozenset
    made: Callable[[], tuple[Path, ...]] = tuple

    def settled(self) -> Step:
        """Step with the inputs and outputs that there are, once the steps before it have run."""
        absent = self.without()
        every = (self.inputs, (*self.outputs, *self.made()))
        inputs, outputs = (tuple(path for path in dict.fromkeys(paths) if path not in absent) for paths in every)
        return replace(self, inputs=inputs, outputs=outputs)

    @property
    def code(self) -> str:
        """Digest of the source that decides the result: of its function's module and of all that this imports."""
        function = self.run.func if isinstance(self.run, partial) else self.run
        return source_digest(function.__module__)


@dataclass(frozen=True)
class Job:
    """Steps in the order they run; a step reads what earlier ones write.

    Attributes
    ----------
    steps : tuple of Step
    root : Path
        Folder that paths are named from, so that a job can be moved.
    state : Path
        Folder of the manifest and the lock.
    """

    steps: tuple[Step, ...]
    root: Path
    state: Path

    def name(self, path: Path) -> str:
        """Name of a file: relative to the root where it lies in it."""
        return path.relative_to(self.root).as_posix() if path.is_relative_to(self.root) else str(path)


@dataclass(frozen=True)
class State:
    """Whether a step has to run.

    Attributes
    ----------
    name : str
    fresh : bool
    reason : str
        'fresh', 'never run', or what has changed.
    seconds : float, optional
        How long the last run took.
    finished : str, optional
        When it ended (ISO 8601, UTC).
    changed : tuple of Path
        Inputs that were changed while the run was under way: the result may be of neither state of them.
    """

    name: str
    fresh: bool
    reason: str
    seconds: float | None = None
    finished: str | None = None
    changed: tuple[Path, ...] = ()


# What can change the bytes of a result.
LIBRARIES = ("geomosaic", "numpy", "scipy", "rasterio", "pyproj", "shapely", "opencv-python-headless")


@lru_cache
def versions() -> dict[str, str]:
    """Installed versions of the libraries that can change a result; "absent" for one that is not installed."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


def ingredients(step: Step, files: Mapping[str, str]) -> dict[str, str]:
    """Everything a step's result depends on, each by itself, so that a change can be named.

    Parameters
    ----------
    step : Step
    files : mapping
        SHA-256 by name of file.

    Returns
    -------
    dict of str to str
        'step', 'parameter NAME', 'file NAME' and 'library NAME', each with its digest or version.
    """
    parts = {"step": f"{step.name} {step.code}"}
    parts |= {f"parameter {key}": digest_of(value) for key, value in step.parameters.items()}
    parts |= {f"file {path}": digest for path, digest in files.items()}
    parts |= {f"library {library}": found for library, found in versions().items()}
    return parts


def with_companions(
    project: Project, rasters: Sequence[Path], bands: Sequence[int] | None = None
) -> tuple[tuple[Path, ...], dict[str, str]]:
    """Rasters with the files beside them that count, and digests of what each raster says of itself.

    Parameters
    ----------
    project : Project
    rasters : sequence of Path
    bands : sequence of int, optional
        Bands that are read, counted from 1; all unless given.

    Returns
    -------
    files : tuple of Path
        Each raster with its companions after it, each file once.
    said : dict of str to str
        Digest of georeference and kind of each raster, under a name that `status` can show.
    """
    # A world file or a mask that comes, goes or changes makes a step stale; statistics in a .aux.xml do not. A raster
    # that cannot be opened has nothing beside it; the step that reads it says what is wrong.
    files: dict[Path, None] = {}
    said: dict[str, str] = {}
    for raster in rasters:
        files[raster] = None
        try:
            found = companions(raster, bands)
        except GeomosaicError:
            continue
        files.update(dict.fromkeys(found.files))
        name = raster.relative_to(project.folder) if raster.is_relative_to(project.folder) else raster
        said[f"georeference or kind of {name.as_posix()}"] = digest_of(asdict(found.metadata))
    return tuple(files), said


def plugin_versions(*sensors: str) -> dict[str, str]:
    """Version of the distribution that each sensor comes from, and digest of its source.

    Parameters
    ----------
    *sensors : str

    Returns
    -------
    dict of str to str
        The version of geomosaic's own sensors is left out: it counts for every step already.
    """
    found = {}
    for entry in installed():
        if entry.name in sensors:
            found[f"code of {entry.name}"] = source_digest(entry.target.partition(":")[0])
            if entry.distribution != "geomosaic":
                found[f"version of {entry.distribution}"] = entry.version
    return found


def sensor_files(sensor: str, named: Sequence[Path]) -> tuple[Path, ...]:
    """Files that a sensor takes models from, beside the images and the files that are named for them.

    Parameters
    ----------
    sensor : str
    named : sequence of Path

    Returns
    -------
    tuple of Path
        Each once; none where the sensor cannot be loaded or reads no files.
    """
    try:
        loaded = plugin(sensor)
    except GeomosaicError:
        return ()
    if not isinstance(loaded, HasFiles):
        return ()
    return tuple(dict.fromkeys(file for path in named for file in loaded.files(path)))
