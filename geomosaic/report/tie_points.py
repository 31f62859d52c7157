"""Report of tie points as an HTML page, and as a section of other reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from geomosaic.report.page import rendered
from geomosaic.report.tie_point_figures import tie_figures
from geomosaic.report.tied_images import TiedImages, tie_facts


def render_tie_section(tied: TiedImages, facts: Mapping[str, Any]) -> str:
    """Section of a page: which images see each other, which are weakly held, and the matches of any two.

    Parameters
    ----------
    tied : TiedImages
    facts : mapping
        `tie_facts` of them.

    Returns
    -------
    str
        HTML; text from files is escaped, nothing is loaded from elsewhere, and no script runs.
    """
    return rendered("tie_points", ties=facts, tied=tie_figures(tied, facts))


def render_ties(tied: TiedImages, name: str, summary: Sequence[str], notes: Sequence[str] = ()) -> str:
    """HTML page of tie points that were measured in the images.

    Parameters
    ----------
    tied : TiedImages
    name : str
        Of the block.
    summary, notes : sequence of str
        The result in words, and what the user was warned of.
    """
    section = render_tie_section(tied, tie_facts(tied))
    return rendered("match", name=name, summary=summary, notes=notes, tie_section=section)
