"""Failures of object stores, those too that a library which reads cannot carry through."""

from __future__ import annotations

import threading

from geomosaic.errors import GeomosaicError, InputError


class StoreError(InputError):
    """An object store refuses, does not answer, or has no such bucket."""


class _Failed(threading.local):
    """Last failure of a store in this thread that a library has swallowed."""

    error: GeomosaicError | None = None


_failed = _Failed()


def keep_failure(error: GeomosaicError) -> None:
    """Keep the failure of a store for `raise_failure`, where a library cannot carry it.

    Parameters
    ----------
    error : GeomosaicError
    """
    _failed.error = error


def raise_failure() -> None:
    """Raise the failure of a store that stands behind the last error of GDAL in this thread.

    Raises
    ------
    StoreError
    """
    error, _failed.error = _failed.error, None
    if error is not None:
        raise error
