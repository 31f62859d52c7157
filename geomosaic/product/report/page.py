"""What makes pages of templates."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from geomosaic.product.report.numbers import byte_size, number, share, words

if TYPE_CHECKING:
    from jinja2 import Environment
    from jinja2.bccache import Bucket


_FOLDER = Path(__file__).parent
_COMPILED = _FOLDER / "__pycache__"


def environment() -> Environment:
    """Return templates of this folder; text is escaped, and a name that is not given is an error.

    Compiled they are kept where Python keeps its modules, if it may: to compile them takes a fifth of a second.
    """
    import jinja2

    class Kept(jinja2.FileSystemBytecodeCache):
        def dump_bytecode(self, bucket: Bucket) -> None:
            with suppress(OSError):  # of a folder that cannot be written, or a full disk: no report fails by this
                super().dump_bytecode(bucket)

    keep = not sys.dont_write_bytecode and _COMPILED.is_dir()
    # Raise the number when an option below changes: kept templates know nothing of options.
    name = f"__jinja2_{jinja2.__version__}_1_%s.cache"
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_FOLDER),
        bytecode_cache=Kept(str(_COMPILED), name) if keep else None,
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(number=number, bytes=byte_size, share=share, words=words)
    return made
