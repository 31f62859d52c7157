"""Keeping geomosaic's warnings as facts while they are still shown."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from geomosaic.errors import GeomosaicWarning


@contextmanager
def heard() -> Iterator[list[str]]:
    """List the texts of GeomosaicWarnings raised within, each once; all go on to whoever showed them before."""
    texts: list[str] = []
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **how: Any) -> None:
        if issubclass(category, GeomosaicWarning) and str(message) not in texts:
            texts.append(str(message))
        before(message, category, *where, **how)

    warnings.showwarning = show
    try:
        yield texts
    finally:
        warnings.showwarning = before


def tell(text: str) -> None:
    """Show a note that is a result, not a doubt: filters that make errors of warnings leave it alone."""
    warnings.showwarning(GeomosaicWarning(text), GeomosaicWarning, __file__, 0)
