"""Parameters that self-calibration keeps, by what the cameras of a block bear."""

from types import SimpleNamespace
from typing import Any

from geomosaic.block_adjustment.self_calibrated import not_borne


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
    assert not_borne(found, ("p1", "p2")) == {"p2"}
    assert not_borne(solution([], [("a: p1", 0.0, 1.0), ("b: p1", 0.0, 1.0)]), ("p1", "p2")) == {"p1"}
    assert not_borne(solution([], []), ("p1", "k1")) == {"k1"}
