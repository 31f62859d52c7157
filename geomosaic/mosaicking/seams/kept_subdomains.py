"""Seams of subdomains kept from run to run: a run that was stopped goes on, and a rerun lays what has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from geomosaic.digests import digest_of
from geomosaic.geo.grid import Window
from geomosaic.mosaicking.result_cache import PARTS, ResultCache
from geomosaic.mosaicking.seams.subdomains import Subdomain, SubdomainSeams

# Results of a subdomain that are kept: one for each rank of images, of which few meet at a place.
_KEPT = 4


@dataclass(frozen=True, eq=False)
class KeptSubdomains:
    """Seams of subdomains under the digest of all that they depend on.

    Attributes
    ----------
    cache : ResultCache
    base : str
        Digest of what all subdomains depend on: grid, ground, options, layers.
    images : sequence of str
        Digest of each image: its file and model, what it shows, its colours.
    """

    cache: ResultCache
    base: str
    images: Sequence[str]

    def get(self, part: Subdomain) -> SubdomainSeams | None:
        """Seams of a subdomain; None where they have to be laid.

        Parameters
        ----------
        part : Subdomain
        """
        import shapely

        try:
            polygons, rims = self.cache.table(_kind(part))[self._key(part)]
            shapes = shapely.from_wkb([bytes.fromhex(text) for text, _ in polygons])
            return SubdomainSeams(
                list(zip(shapes, [number for _, number in polygons], strict=True)),
                [(Window(*place), labels) for place, labels in rims],
            )
        # A file that is missing, damaged or of an older version: its seams are laid again.
        except (KeyError, ValueError, TypeError, shapely.errors.ShapelyError):
            return None

    def keep(self, part: Subdomain, seams: SubdomainSeams) -> None:
        """Seams of a subdomain kept for the next run.

        Parameters
        ----------
        part : Subdomain
        seams : SubdomainSeams
        """
        import shapely

        polygons = [(shapely.to_wkb(shape, hex=True), number) for shape, number in seams.polygons]
        rims = [((at.col, at.row, at.width, at.height), labels) for at, labels in seams.rims]
        others = list(self.cache.table(_kind(part)).items())[1 - _KEPT :]
        self.cache.keep(_kind(part), {**dict(others), self._key(part): (polygons, rims)})

    def reused(self, number: int, total: int) -> None:
        """Number of subdomains of an earlier run, for the record of this one.

        Parameters
        ----------
        number, total : int
        """
        if number:
            self.cache.from_cache.append(f"{number} of {total} parts of seams")

    def _key(self, part: Subdomain) -> str:
        rims = [value for at, labels in part.rims for value in (at, labels.tobytes())]
        images = [(i, self.images[i]) for i in part.images]
        return digest_of(self.base, part.core, part.window, part.neighbours, images, *rims)


def _kind(part: Subdomain) -> str:
    """Name of the file of a subdomain."""
    return f"{PARTS}/seams-{part.core.row}-{part.core.col}"
