"""Steps of a job: inputs, outputs, and the function that makes the one from the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geomosaic.digests import sha256
from geomosaic.types import Progress


@dataclass(frozen=True)
class Machine:
    """Processors and memory that a run may use; results do not depend on them.

    Attributes
    ----------
    threads : int, optional
        All processors unless given.
    memory_limit : int, optional
        Bytes.
    """

    threads: int | None = None
    memory_limit: int | None = None

    @property
    def options(self) -> dict[str, int]:
        """Values that were given, as keywords of `RenderOptions`."""
        given = {"threads": self.threads, "memory_limit": self.memory_limit}
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
    version : int
        Raised when the step's code gives another result.
    """

    name: str
    run: Callable[[Context], Mapping[str, Any]]
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: tuple[Path, ...] = ()
    outputs: tuple[Path, ...] = ()
    version: int = 1


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
    """

    name: str
    fresh: bool
    reason: str
    seconds: float | None = None
    finished: str | None = None
