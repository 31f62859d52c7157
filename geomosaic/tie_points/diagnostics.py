"""Diagnostics of matched images, in words that say what to do: nothing to see, no overlap, copies, parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from geomosaic.errors import SolveError, counted, listed
from geomosaic.report.tied_images import TiedImages
from geomosaic.types import IntArray

# Features below which an image shows no more than water, snow, fog or a lens cap.
LITTLE = 50
# Pixels that points of two copies of one photo lie apart, nineteen of twenty at most, and points that tell.
SAME, TELLING = 0.5, 20


@dataclass(frozen=True)
class Finding:
    """What is wrong, and what to do about it."""

    what: str
    hint: str

    def __str__(self) -> str:
        return f"{self.what}; {self.hint}"


def diagnostics(tied: TiedImages, features: IntArray) -> list[Finding]:
    """Diagnostics of matched images: what is wrong, and what to do about it.

    Parameters
    ----------
    tied : TiedImages
    features : int array (M,)
        Features found in each.
    """
    return [*_little_to_see(tied, features), *_copies(tied), *_apart(tied, features)]


def nothing_in_common(names: Sequence[str], features: IntArray) -> SolveError:
    """Error of images of which no two are tied.

    Parameters
    ----------
    names : sequence of str (M,)
    features : int array (M,)
    """
    poor = [name for name, count in zip(names, features.tolist(), strict=True) if count < LITTLE]
    if len(poor) > len(names) - 2:
        what = f"{counted(len(poor), 'image')} of {len(names)} have hardly any features to match"
        hint = "water, snow, fog and blur cannot be matched: add photos that show land; or is all of it `nodata`, or "
        return SolveError(f"{what}: {listed(poor, 6)}", hint=hint + "beyond `usable` or `margin`?")
    return SolveError(
        f"no two of {counted(len(names), 'image')} show anything in common: {listed(names, 6)}",
        hint="are they of one place, and do they overlap by half or more? If so, try more `features`, or a larger "
        "`match_size`",
    )


def _little_to_see(tied: TiedImages, features: IntArray) -> list[Finding]:
    poor = [name for name, count in zip(tied.names, features.tolist(), strict=True) if count < LITTLE]
    if not poor:
        return []
    what = f"{counted(len(poor), 'image')} with hardly any features to match: {listed(poor, 6)}"
    return [Finding(what, "water, snow, fog and blur tie nothing; leave such images out where nothing else holds them")]


def _copies(tied: TiedImages) -> list[Finding]:
    """Pairs of images that show the same at the same place."""
    pairs, found = tied.pairs[tied.pairs[:, 2] >= TELLING], []
    order = np.lexsort((tied.point, tied.image))
    part = np.split(order, np.searchsorted(tied.image[order], np.arange(1, len(tied.names))))
    for one, other, _ in pairs[(tied.sizes[pairs[:, 0]] == tied.sizes[pairs[:, 1]]).all(axis=1)].tolist():
        _, a, b = np.intersect1d(tied.point[part[one]], tied.point[part[other]], return_indices=True)
        apart = np.linalg.norm(tied.colrow[part[one][a]] - tied.colrow[part[other][b]], axis=1)
        if np.percentile(apart, 95) < SAME:
            found.append(f"{tied.names[one]} and {tied.names[other]}")
    if not found:
        return []
    what = f"{counted(len(found), 'pair')} of images show the same at the same place: {listed(found, 6)}"
    return [Finding(what, "leave out one of two copies of a photo; two photos from one place tell nothing of heights")]


def _apart(tied: TiedImages, features: IntArray) -> list[Finding]:
    """Images and groups of images that no tie point joins to the others."""
    joined = tied.pairs[tied.pairs[:, 2] > 0]
    count = len(tied.names)
    graph = sparse.coo_array((np.ones(len(joined)), (joined[:, 0], joined[:, 1])), shape=(count, count))
    number, part = connected_components(graph, directed=False)
    groups = [np.flatnonzero(part == k) for k in range(number)]
    alone = [tied.names[g[0]] for g in groups if len(g) == 1 and features[g[0]] >= LITTLE]
    several, found = sorted((g for g in groups if len(g) > 1), key=len, reverse=True), []
    if alone and several:
        what = f"{counted(len(alone), 'image')} tied to no other: {listed(alone, 6)}"
        found.append(Finding(what, "is it of this place? Leave it out, or add photos that overlap it and the others"))
    if len(several) > 1:
        listing = [f"{len(g)} ({listed([tied.names[k] for k in g.tolist()], 3)})" for g in several]
        what = f"the images form {len(several)} groups without a tie point in common: {listed(listing, 6, '; ')}"
        found.append(Finding(what, "add photos between them, try more `neighbours` or `features`, or make two blocks"))
    return found
