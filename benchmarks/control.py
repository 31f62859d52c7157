"""Good and bad control, many times: what `geomosaic georeference --model auto` makes of it, as a table.

python -m benchmarks.control [--trials 10] [--only IMAGE]     prints the table of docs/georeferencing.md
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass

import numpy as np

from geomosaic.control.parsing import Reading
from geomosaic.control.points import ControlPoints, Origin
from geomosaic.errors import SolveError
from geomosaic.geo.crs import parse_crs
from geomosaic.georeferencing.fit_diagnostics import BadControlError
from geomosaic.georeferencing.solution import solve
from geomosaic.options.control import FitOptions
from geomosaic.types import FloatArray

SIZE = np.array([4000, 3000])
NOISE = 0.3
LEAST, MOST = 30.0, 200.0
CRS = "EPSG:32633"
FEW = np.array(
    [[0.06, 0.06], [0.94, 0.06], [0.06, 0.94], [0.94, 0.94], [0.5, 0.5], [0.5, 0.08], [0.07, 0.5], [0.93, 0.5]]
)
"""Where a few points lie, in parts of the image."""
OUTCOMES = (
    "refused, exactly those named",
    "refused, others named too",
    "refused, not all named",
    "mapped with a warning",
    "mapped",
)


@dataclass(frozen=True)
class Case:
    """Points of an image of a kind, some of them measured 30 to 200 px elsewhere."""

    image: str
    counts: tuple[int, ...]
    wrong: int
    part: float = 1.0
    """Of the trials asked for: many points take long."""


CASES = (
    *(Case(image, (count,), 1, 4.0) for image in ("affine", "oblique") for count in (5, 6, 7, 8)),
    Case("affine", (20,), 6),
    Case("oblique", (20,), 6),
    Case("waves", (30,), 1),
    Case("waves", (48,), 8),
    Case("waves", (200,), 60, 0.6),
    *(
        Case(image, tuple(range(4, 12)), 0, 0.8)
        for image in ("affine", "slightly oblique", "oblique", "poly2", "poly3")
    ),
    *(Case(image, (12, 20, 30), 0, 0.5) for image in ("affine", "oblique", "poly2", "poly3", "waves")),
    *(Case(f"barrel {percent} %", (35, 108), 0, 0.2) for percent in (2, 5, 12, 25)),
)


def ground(colrow: FloatArray, image: str) -> FloatArray:
    """Map of a photo of 4000 x 3000 pixels of 0.5 m, turned by 20°."""
    flat = colrow - SIZE / 2
    if image.startswith("barrel"):
        flat = flat * (1.0 + int(image.split()[1]) / 100 * (np.hypot(*flat.T) / 2500.0)[:, None] ** 2)
    c, r = (flat * 0.5).T
    u, v = (colrow / SIZE - 0.5).T
    c = c * (1.02 if image == "affine" else 1.0)
    turn = np.radians(20.0)
    x, y = c * np.cos(turn) + r * np.sin(turn), c * np.sin(turn) - r * np.cos(turn)
    tilt = {"oblique": 1e-4, "slightly oblique": 1e-5}.get(image, 0.0)
    below = 1.0 + 1.5 * tilt * c - 2.0 * tilt * r
    x, y = x / below, y / below
    if image in ("poly2", "poly3"):
        x, y = x + 15 * u * v + 10 * u**2, y + 20 * v**2
    if image == "poly3":
        x, y = x + 30 * u**3, y - 30 * v**2 * u
    if image == "waves":
        x, y = x + 15 * np.sin(5 * u) * v, y + 15 * np.cos(4 * v + u)
    return np.column_stack([612_000 + x, 5_412_000 + y])


def control(case: Case, count: int, seed: int) -> tuple[ControlPoints, set[str]]:
    """Points all over the image, and the names of the wrong ones."""
    random = np.random.default_rng([seed, count, case.wrong])
    across = int(np.ceil(np.sqrt(count * 4 / 3)))
    down = int(np.ceil(count / across))
    c, r = np.meshgrid((np.arange(across) + 0.5) / across, (np.arange(down) + 0.5) / down)
    cells = np.column_stack([c.ravel(), r.ravel()])
    if case.image.startswith("barrel"):  # to the very corners, where distortion is largest
        cells = (cells - cells.min(axis=0)) / np.ptp(cells, axis=0) * 0.99 + 0.005
        shaken = cells[:count]
    else:
        shaken = FEW[:count] if count <= len(FEW) else cells[random.permutation(len(cells))[:count]]
        shaken = shaken + random.uniform(-0.05, 0.05, (count, 2))
    colrow = np.clip(shaken * SIZE, 10, SIZE - 10)
    measured = colrow + random.normal(0.0, NOISE, colrow.shape)
    bad = random.permutation(count)[: case.wrong]
    angle, length = random.uniform(0, 2 * np.pi, case.wrong), random.uniform(LEAST, MOST, case.wrong)
    measured[bad] += np.column_stack([length * np.cos(angle), length * np.sin(angle)])
    points = ControlPoints(
        tuple(f"P{i}" for i in range(count)),
        np.clip(measured, 0, SIZE),
        ground(colrow, case.image),
        parse_crs(CRS),
        np.ones(count),
        ("control",) * count,
        np.ones(count, dtype=np.bool_),
        tuple(Origin("points.csv", i + 2) for i in range(count)),
    )
    return points, {f"P{i}" for i in bad}


def outcome(points: ControlPoints, bad: set[str]) -> str:
    """One of `OUTCOMES`."""
    size = (int(SIZE[0]), int(SIZE[1]))
    try:
        solved = solve(Reading(points, "csv", ()), "scan.tif", size, points.crs, FitOptions(), None, "m", 1 << 30)
    except BadControlError as error:
        named = {name for found in error.diagnostics if found.severity == "error" for name in found.points}
        return OUTCOMES[0 if named == bad else 1 if named > bad else 2]
    except SolveError:
        return OUTCOMES[2]
    warned = any(found.code in ("blunder", "contradiction", "suspect") for found in solved.diagnostics)
    return OUTCOMES[3 if warned else 4]


def row(case: Case, trials: int) -> str:
    """Line of the table."""
    each = max(1, round(trials * case.part))
    found = Counter(outcome(*control(case, count, seed)) for count in case.counts for seed in range(each))
    last = case.counts[-1]
    counts = str(last) if len(case.counts) == 1 else ", ".join(map(str, case.counts))
    counts = f"{case.counts[0]} to {last}" if len(case.counts) > 3 else counts
    cells = (counts, case.image, case.wrong, each * len(case.counts), *(found[name] or "" for name in OUTCOMES))
    return f"| {' | '.join(map(str, cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=10, help="of each case, more or less [10]")
    parser.add_argument("--only", default="", help="images whose kind begins so")
    given = parser.parse_args()
    print("| points | image | wrong | trials | " + " | ".join(OUTCOMES) + " |\n" + "|---" * (4 + len(OUTCOMES)) + "|")
    for case in CASES:
        if case.image.startswith(given.only):
            print(row(case, given.trials), flush=True)


if __name__ == "__main__":
    main()
