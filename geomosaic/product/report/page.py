"""What makes pages of templates."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from geomosaic.product.report.numbers import byte_size, number, share, words

if TYPE_CHECKING:
    from jinja2 import Environment


def environment() -> Environment:
    """Return templates of this folder; text is escaped, and a name that is not given is an error."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    made = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters.update(number=number, bytes=byte_size, share=share, words=words)
    return made
