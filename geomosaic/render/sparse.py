"""Sequence of which some items are known, the others being left where the whole is."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Generic, TypeVar, overload

Item = TypeVar("Item")


class SparseSequence(Sequence[Item], Generic[Item]):
    """Sequence of which some items are known, under their numbers in the whole; to ask for another one is an error.

    Parameters
    ----------
    whole : sequence
    known : collection of int
        Numbers of the items that it has.
    """

    def __init__(self, whole: Sequence[Item], known: Collection[int]) -> None:
        self._items, self._length = {i: whole[i] for i in sorted(known)}, len(whole)

    def __len__(self) -> int:
        """Number of items of the whole."""
        return self._length

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | Sequence[Item]:
        """Item by its number."""
        if isinstance(index, slice) or index not in self._items:
            raise KeyError(f"item {index} is not known here")
        return self._items[index]
