"""Type aliases used in signatures; shapes, units and frames of arrays stand in each docstring."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
Float32Array: TypeAlias = NDArray[np.float32]
BoolArray: TypeAlias = NDArray[np.bool_]
ByteArray: TypeAlias = NDArray[np.uint8]
IntArray: TypeAlias = NDArray[np.int64]
AnyArray: TypeAlias = NDArray[Any]
PathLike: TypeAlias = str | Path
# Called with how much is done, of how much (0 where nobody knows), and the name of the stage.
Progress: TypeAlias = Callable[[int, int, str], None]


Item = TypeVar("Item")
Result = TypeVar("Result")


class Map(Protocol):
    """Form of `map`: results of a function over items, in their order; see `execution.units.unit_map`."""

    def __call__(self, function: Callable[[Item], Result], items: Iterable[Item], /) -> Iterable[Result]:
        """Results of a function over items."""


def no_progress(done: int, total: int, stage: str) -> None:
    """Progress that is shown nowhere; unlike a lambda it can be sent to another process.

    Parameters
    ----------
    done, total : int
    stage : str
    """
