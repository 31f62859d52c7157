"""Partition of the footprints by seam polygons: exact, without slivers, gaps or islands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.mosaicking.seams.voronoi import polygonal
from geomosaic.types import IntArray

# Half the width in cells below which a part is a sliver.
SLIVER_WIDTH = 0.5


def partition(
    shares: Sequence[Any], outlines: Sequence[Any], rest: Sequence[Any], cell: float, smallest: float
) -> list[Any]:
    """Partition of the footprints that follows given shares.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
        One per image, with borders along cells; they share no area.
    outlines : sequence of Polygon
        Footprints.
    rest : sequence of Polygon or MultiPolygon
        A partition of the footprints, such as `voronoi.voronoi_regions`, for ground that no share covers.
    cell : float
        Size of a cell in map units.
    smallest : float
        Area in square map units below which a part of a share is given to a neighbour that shows it.

    Returns
    -------
    list of Polygon or MultiPolygon
        Each within its outline; their union is that of the outlines.
    """
    import shapely

    # Borders of cells cross the exact outlines; what they leave open goes to the nearest image in `rest`.
    within = [polygonal(share.intersection(outline)) for share, outline in zip(shares, outlines, strict=True)]
    tree = shapely.STRtree(within)
    whole = []
    for share, own in zip(within, rest, strict=True):
        near = [within[int(k)] for k in tree.query(own)]
        whole.append(polygonal(shapely.union(share, polygonal(own.difference(shapely.union_all(near))))))
    return without_slivers(whole, outlines, cell, smallest)


def without_slivers(shares: Sequence[Any], outlines: Sequence[Any], cell: float, smallest: float) -> list[Any]:
    """Shares without small and thin parts: each goes to the neighbour that shows it, with the longest border.

    Parameters
    ----------
    shares, outlines : sequence of Polygon or MultiPolygon
        Shares and footprints of the images, in the output map.
    cell : float
        Size of a cell in map units.
    smallest : float
        Area in square map units below which a part is small.

    Returns
    -------
    list of Polygon or MultiPolygon
        With the same union. A small part that no neighbour shows stays where it is.
    """
    import shapely

    parts = [(i, part) for i, share in enumerate(shares) for part in shapely.get_parts(share)]
    shapes = [part for _, part in parts]
    # Overlays round vertices: parts within a hair of each other touch.
    tree, owner, hair = shapely.STRtree(shapes), [i for i, _ in parts], 1e-6 * cell
    kept: dict[int, list[Any]] = {i: [] for i in range(len(shares))}
    slight = [p.area < smallest or p.buffer(-SLIVER_WIDTH * cell).is_empty for p in shapes]
    # Largest first, so that a chain of slivers ends at a neighbour that stays.
    for number in sorted(range(len(parts)), key=lambda k: (slight[k], -shapes[k].area)):
        if not slight[number]:
            continue
        part = shapes[number]
        lengths: dict[int, float] = {}
        for k in sorted(int(k) for k in tree.query(part, predicate="dwithin", distance=hair)):
            if (not slight[k] and owner[k] != owner[number]) or (owner[k] == owner[number] and k != number):
                length = part.boundary.intersection(shapes[k].buffer(hair)).length
                lengths[owner[k]] = lengths.get(owner[k], 0.0) + length
        showing = [i for i in lengths if lengths[i] > 10 * hair and _contains(outlines[i], part)]
        if showing:
            owner[number] = max(showing, key=lambda i: (lengths[i], -i))
    for i, part in zip(owner, shapes, strict=True):
        kept[i].append(part)
    return [polygonal(shapely.union_all(kept[i])) if kept[i] else shapely.Polygon() for i in range(len(shares))]


def undivided(shares: Sequence[Any], outlines: Sequence[Any], areas: Sequence[Any]) -> list[Any]:
    """Shares in which no seam divides an area, where one image shows all of it: the one with the largest part gets it.

    Parameters
    ----------
    shares, outlines : sequence of Polygon or MultiPolygon
        Shares and footprints of the images, in the output map.
    areas : sequence of Polygon or MultiPolygon
        Areas to keep whole, such as buildings.

    Returns
    -------
    list of Polygon or MultiPolygon
        With the same union.
    """
    import shapely

    result = list(shares)
    tree = shapely.STRtree(result)
    for area in areas:
        near = sorted(int(k) for k in tree.query(area, predicate="intersects"))
        held = {i: result[i].intersection(area).area for i in near}
        cut = [i for i in near if held[i] > 1e-9 * area.area]
        able = [i for i in cut if outlines[i].covers(area)]
        if len(cut) < 2 or not able:
            continue
        winner = max(able, key=lambda i: (held[i], -i))
        for i in cut:
            if i != winner:
                result[i] = polygonal(result[i].difference(area))
        result[winner] = polygonal(result[winner].union(area))
    return result


def _contains(outline: Any, part: Any) -> bool:
    """Whether a part lies within an outline, but for rounding."""
    return bool(part.difference(outline).area <= 1e-9 * part.area)


def canonical(share: Any, step: float) -> Any:
    """Canonical form of a share: vertices on multiples of a tiny step, parts and rings in order.

    Parameters
    ----------
    share : Polygon or MultiPolygon
    step : float
        Map units.

    Returns
    -------
    Polygon or MultiPolygon
        With vertices as they were where moving them would make it invalid.
    """
    # A GIS that edits and saves a layer moves vertices in the last digit and turns rings round. In canonical form a
    # share that was not edited is equal to the one before, and what was computed for it is found again.
    import shapely

    snapped = shapely.normalize(shapely.transform(share, lambda xy: np.round(xy / step) * step))
    return snapped if snapped.is_valid else shapely.normalize(share)


# Cells of the smallest island of one image within others that is kept.
MIN_ISLAND = 30


def extrapolated(label: IntArray, cells: int) -> IntArray:
    """Labels extended into unlabelled cells, so that cells leave no sliver along exact outlines.

    Parameters
    ----------
    label : int array (rows, cols)
        Number of the image; -1 where there is none.
    cells : int
        Largest distance to a labelled cell.

    Returns
    -------
    int array (rows, cols)
        With the label of the nearest labelled cell.
    """
    from scipy.ndimage import distance_transform_edt

    if (label >= 0).all() or not (label >= 0).any():
        return label
    far, (rows, cols) = distance_transform_edt(label < 0, return_indices=True)
    return np.where(far <= cells, label[rows, cols], -1)


def without_islands(label: IntArray, smallest: int = MIN_ISLAND) -> IntArray:
    """Labels without small islands: each goes to the image that surrounds most of it.

    Parameters
    ----------
    label : int array (rows, cols)
        Number of the image; -1 where there is none.
    smallest : int
        Cells of the smallest island that is kept.

    Returns
    -------
    int array (rows, cols)
        A copy.
    """
    from scipy.ndimage import find_objects

    label = label.copy()
    for value, box in enumerate(find_objects(label + 1)):
        if box is None:
            continue
        rows, cols = box
        own = slice(max(rows.start - 1, 0), rows.stop + 1), slice(max(cols.start - 1, 0), cols.stop + 1)
        _reassign_islands(label[own], value, smallest)
    return label


def _reassign_islands(label: IntArray, value: int, smallest: int) -> None:
    """Small islands of one image relabelled in place; the only part of an image is no island."""
    from scipy.ndimage import binary_dilation, find_objects
    from scipy.ndimage import label as parts_of

    parts, count = parts_of(label == value)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    if count < 2 or sizes[1:].min() >= smallest:
        return
    boxes = find_objects(parts)
    for part in np.flatnonzero(sizes < smallest).tolist():
        if part == 0:
            continue
        rows, cols = boxes[part - 1]
        around = slice(max(rows.start - 1, 0), rows.stop + 1), slice(max(cols.start - 1, 0), cols.stop + 1)
        own = parts[around] == part
        rim = label[around][binary_dilation(own) & ~own]
        rim = rim[rim >= 0]
        if len(rim):
            label[around][own] = np.bincount(rim).argmax()


def without_spurs(label: IntArray, rounds: int = 3) -> IntArray:
    """Labels without spurs a cell wide: cells with at most two equal neighbours join the majority.

    Parameters
    ----------
    label : int array (rows, cols)
        Number of the image; -1 where there is none.
    rounds : int
        Largest length in cells of a spur that goes.

    Returns
    -------
    int array (rows, cols)
        A copy.
    """
    label = label.copy()
    for _ in range(rounds):
        wide = np.pad(label, 1, mode="edge")
        shape = label.shape
        around = [wide[r : r + shape[0], c : c + shape[1]] for r in range(3) for c in range(3) if (r, c) != (1, 1)]
        same = np.zeros(shape, dtype=np.int8)
        for other in around:
            same += other == label
        weak = np.nonzero((same <= 2) & (label >= 0))
        if not len(weak[0]):
            break
        others = np.stack([other[weak] for other in around])
        votes = (others[:, None] == others[None]).sum(axis=0) * (others >= 0)
        best = others[votes.argmax(axis=0), np.arange(others.shape[1])]
        label[weak] = np.where(best >= 0, best, label[weak])
    return label
