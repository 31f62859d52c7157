"""Parameters that self-calibration keeps, by what the cameras of a block bear."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from geomosaic.block_adjustment.self_calibrated import without_evidence
from geomosaic.orientation.block.self_calibration import ScoreTest, needs_of


def solution(correlated: list[tuple[str, str, float]], insignificant: list[tuple[str, float, float]]) -> Any:
    names = ("focal_length", "p1", "p2", "k1")
    cameras = [SimpleNamespace(names=[f"{c}: {n}" for n in names], free=[True, True, True, False]) for c in ("a", "b")]
    problem = SimpleNamespace(unknowns=SimpleNamespace(interiors=cameras))
    return SimpleNamespace(
        adjustment=SimpleNamespace(problem=problem),
        correlated=lambda: correlated,
        insignificant=lambda: insignificant,
    )


def test_a_parameter_is_borne_where_one_of_the_cameras_bears_it() -> None:
    """A camera of one odd picture does not take p1 from the camera of all others."""
    found = solution([("a: focal_length", "a: p2", 0.97), ("b: p2", "b: focal_length", 0.99)], [("b: p1", 0.0, 1.0)])
    assert without_evidence(found, ("p1", "p2")) == {"p2"}
    assert without_evidence(solution([], [("a: p1", 0.0, 1.0), ("b: p1", 0.0, 1.0)]), ("p1", "p2")) == {"p1"}
    assert without_evidence(solution([], []), ("p1", "k1")) == {"k1"}


def test_a_radial_term_is_freed_with_those_below_it_and_decentring_as_a_whole() -> None:
    """What a wrong k1 leaves frees k1 with or without that rule; what k2 leaves would free k3 and not k2 without it."""
    names = ["k1", "k2", "k3", "k4", "p1", "p2"]
    assert needs_of(names) == {1: (0,), 2: (1,), 3: (2,), 4: (5,), 5: (4,)}
    radius = np.linspace(0.1, 1.0, 200)
    design = np.column_stack([radius ** (2 * order + 1) for order in range(1, 5)] + [radius * 0 + 1.0, radius])
    noise = np.random.default_rng(3).normal(size=len(radius))

    def chosen(places: list[int], wrong: int = 0, *, needs: bool = True) -> list[str]:
        part, residuals = design[:, places], 30.0 * design[:, wrong] + noise
        test = ScoreTest(
            part.T @ part, part.T @ residuals, np.zeros((0, len(places))), np.zeros(0), float(residuals @ residuals),
            len(radius), needs_of([names[place] for place in places]) if needs else {},
        )  # fmt: skip
        return [names[places[place]] for place in test.worthwhile()]

    assert chosen([0, 1, 2, 3]) == ["k1"]
    assert chosen([0, 1, 2, 3], wrong=1, needs=False) == ["k1", "k3"]
    assert chosen([0, 1, 2, 3], wrong=1) == ["k1"]
    assert chosen([1, 2, 3]) != []
    assert "k1" in chosen([0, 3])
