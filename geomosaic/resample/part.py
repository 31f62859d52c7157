"""Parts of a window that some of the images need."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.ndimage import find_objects

from geomosaic.types import IntArray


@dataclass(frozen=True)
class Part:
    """Part of a window, on multiples of the size of the coarsest cells of a pyramid.

    Attributes
    ----------
    rows, cols : slice
        Of the window.
    """

    rows: slice
    cols: slice

    @classmethod
    def whole(cls, shape: tuple[int, ...]) -> Part:
        """Part that is all of a window of this shape (rows, cols)."""
        return cls(slice(0, shape[0]), slice(0, shape[1]))

    @property
    def size(self) -> int:
        """Pixels."""
        return int((self.rows.stop - self.rows.start) * (self.cols.stop - self.cols.start))

    def level(self, level: int) -> tuple[slice, slice]:
        """Rows and columns of a level of the pyramid."""
        rows, cols = (slice(along.start >> level, along.stop >> level) for along in (self.rows, self.cols))
        return rows, cols


def parts_of(label: IntArray, images: int, margin: int, levels: int) -> list[Part | None]:
    """Parts of a window that the images of a label array need: where each is shown, and a margin around.

    Parameters
    ----------
    label : int array (rows, cols)
        Image of each pixel, −1 where none; rows and columns are multiples of 2 ** `levels`.
    images : int
        Number of images.
    margin : int
        Pixels.
    levels : int
        Of the pyramid that the parts are cut from.

    Returns
    -------
    list of Part or None
        None for an image that is shown nowhere.
    """
    found: list[Part | None] = []
    for box in find_objects(label + 1, images):
        if box is None:
            found.append(None)
            continue
        ends = [
            (max(0, along.start - margin) >> levels, -(-min(most, along.stop + margin) >> levels))
            for along, most in zip(box, label.shape, strict=True)
        ]
        found.append(Part(*(slice(first << levels, last << levels) for first, last in ends)))
    return found


def both_of(one: slice, other: slice) -> slice:
    """Common part of two slices; empty if there is none.

    Parameters
    ----------
    one, other : slice
        With start and stop.

    Returns
    -------
    slice
    """
    start = max(one.start, other.start)
    return slice(start, max(start, min(one.stop, other.stop)))


def within(outer: slice, inner: slice) -> slice:
    """Slice counted from the start of one that holds it.

    Parameters
    ----------
    outer, inner : slice
        With start and stop.

    Returns
    -------
    slice
    """
    return slice(inner.start - outer.start, inner.stop - outer.start)
