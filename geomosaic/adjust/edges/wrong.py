"""Wrong control and common points, found in the adjustment of all photos together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from geomosaic.adjust.edges.problem import Problem
from geomosaic.adjust.edges.solve import Solution
from geomosaic.adjust.edges.stations import CommonPoint
from geomosaic.adjust.network.findings import Findings, findings
from geomosaic.adjust.network.labels import Doubt, named
from geomosaic.adjust.network.search import search
from geomosaic.block.block import ControlPoint


def look(problem: Problem, solution: Solution) -> tuple[Findings, list[Doubt]]:
    """Look for wrong points in a solution; what is found as (point, photo), None for coordinates."""
    s = problem.stations
    images = [problem.photos[k] for k in s.photo]
    shifts, labels, doubts = named(solution.network, s.ids, images, s.where, "common point")
    said = findings(shifts, search(shifts), labels, bent=True)
    return said, [doubts[each.shift] for each in said.wrong]


def without(
    control: Sequence[ControlPoint], common: Sequence[CommonPoint], left: Sequence[Doubt]
) -> tuple[list[ControlPoint], list[CommonPoint]]:
    """Points that are kept; control whose coordinates are wrong becomes common, a common point alone goes too."""
    out, places = set(left), {name for name, image in left if image is None}
    points = [p for p in control if (p.id, p.image) not in out]
    shared = [p for p in common if (p.id, p.image) not in out]
    shared += [CommonPoint(p.id, p.image, p.colrow, p.sigma_px, p.xyz[2]) for p in points if p.id in places]
    seen = Counter(p.id for p in shared)
    return [p for p in points if p.id not in places], [p for p in shared if seen[p.id] > 1]
