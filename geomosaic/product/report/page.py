"""What makes pages of templates."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from geomosaic.product.report.numbers import byte_size, number, share, words

if TYPE_CHECKING:
    from jinja2 import Environment


_FOLDER = Path(__file__).parent
_COMPILED = _FOLDER / "__pycache__"


def environment() -> Environment:
    """Return templates of this folder; text is escaped, and a name that is not given is an error.

    Compiled they are kept where Python keeps its modules, if it may: to compile them takes a fifth of a second.
    """
    from jinja2 import Environment, FileSystemBytecodeCache, FileSystemLoader, StrictUndefined

    keep = not sys.dont_write_bytecode and os.access(_COMPILED, os.W_OK)
    made = Environment(
        loader=FileSystemLoader(_FOLDER),
        bytecode_cache=FileSystemBytecodeCache(str(_COMPILED)) if keep else None,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(number=number, bytes=byte_size, share=share, words=words)
    return made
