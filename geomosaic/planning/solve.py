"""Plans by topic, and derivation of all quantities that follow from the given ones, in whatever direction."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from geomosaic.errors import InputError, did_you_mean
from geomosaic.options.declaration import compose
from geomosaic.options.planning import (
    ControlNeedOptions,
    CoverageOptions,
    FlightOptions,
    ProcessingOptions,
    ProductOptions,
    TableOptions,
)
from geomosaic.planning.coverage import control_plan, coverage
from geomosaic.planning.guidelines import scale_tables
from geomosaic.planning.processing import processing_plan
from geomosaic.planning.product_quality import flight, requirements
from geomosaic.planning.relations import QUANTITIES, TOPICS, Relation, checked, parameters, shown

# Relative difference below which two derivations of one quantity agree: rounding of floats is far below it, and a value
# that a user has rounded to four figures far above, so that it is refused rather than silently overruled.
_AGREES = 1e-6


@dataclass(frozen=True)
class Derived:
    """Derived quantity.

    Attributes
    ----------
    name : str
    value : float, in the unit of `QUANTITIES`
    relation : Relation, it was solved from
    """

    name: str
    value: float
    relation: Relation


def derive(relations: Sequence[Relation], given: Mapping[str, float]) -> list[Derived]:
    """Quantities that follow from the given ones, in the order of derivation.

    Parameters
    ----------
    relations : sequence of Relation
    given : mapping of str to float, by name, in the units of `QUANTITIES`

    Raises
    ------
    InputError
        A value is out of range, values contradict each other, or nothing follows.
    """
    known = {name: checked(name, value) for name, value in given.items()}
    found: list[Derived] = []
    # A limit taken for an equation would give a quantity its limit before an equation gives it its value.
    ordered = sorted(relations, key=lambda relation: bound(relation) is not None)
    while True:
        # One at a time, from the first relation on: the source that is named for a quantity is the first that gives it.
        new = next((made for relation in ordered if (made := _next(relation, known)) is not None), None)
        if new is None:
            break
        known[new.name] = new.value
        found.append(new)
    for relation in relations:
        if bound(relation) is None:
            _agree(relation, known)
    if not found and not limits(relations, known):
        what = f"nothing follows from {parameters(given)} alone" if given else "nothing is given"
        raise InputError(what, hint=f"give {_wanted(relations, known)}")
    return found


def _wanted(relations: Sequence[Relation], known: Mapping[str, float]) -> str:
    """What would let something follow: one more quantity for each relation that lacks two, else all but one."""
    related = [relation for relation in relations if any(name in known for name in relation.names)] or list(relations)
    lacking = {relation.formula: [name for name in relation.names if name not in known] for relation in related}
    least = min(map(len, lacking.values()))
    words = [
        f"{'' if least == 2 else 'all but one of '}"
        f"{' or '.join(f'`{n}`' for n in names) if least == 2 else parameters(names)} ({formula})"
        for formula, names in lacking.items()
        if len(names) == least
    ]
    return "; ".join(words)


@dataclass(frozen=True)
class Limit:
    """Limit of a given quantity.

    Attributes
    ----------
    name : str
    limit : float, in the unit of `QUANTITIES`
    relation : Relation, it follows from
    kept : bool, whether the quantity keeps it
    """

    name: str
    limit: float
    relation: Relation
    kept: bool


def bound(relation: Relation) -> str | None:
    """Sign of the limit that a relation sets to its first quantity.

    Parameters
    ----------
    relation : Relation

    Returns
    -------
    str or None, '>=' or '<='; None of an equation
    """
    return next((sign for sign in (">=", "<=") if f" {sign} " in relation.formula), None)


def limits(relations: Sequence[Relation], known: Mapping[str, float]) -> list[Limit]:
    """Limits that relations set to given quantities.

    Parameters
    ----------
    relations : sequence of Relation, those that are equations, or name a quantity that is not known, are passed over
    known : mapping of str to float, by name, in the units of `QUANTITIES`
    """
    found = []
    for relation in relations:
        sign, name = bound(relation), relation.names[0]
        if sign is None or any(other not in known for other in relation.names):
            continue
        limit = relation.solve(name, known)
        if limit is not None and math.isfinite(limit):
            over = (known[name] - limit) * (1.0 if sign == ">=" else -1.0)
            found.append(Limit(name, limit, relation, over >= -_AGREES * abs(limit)))
    return found


def _next(relation: Relation, known: Mapping[str, float]) -> Derived | None:
    unknown = [name for name in relation.names if name not in known]
    if len(unknown) != 1:
        return None
    try:
        value = relation.solve(unknown[0], known)
    except ZeroDivisionError:
        value = None
    if value is None or not math.isfinite(value):
        return None
    return Derived(unknown[0], _within_limits(unknown[0], value, relation), relation)


def _within_limits(name: str, value: float, relation: Relation) -> float:
    try:
        return checked(name, value)
    except InputError as error:
        raise InputError(
            f"{QUANTITIES[name].text} would be {value:g} {QUANTITIES[name].unit}".rstrip(),
            where=relation.formula,
            hint="the values given do not go together",
        ) from error


def _agree(relation: Relation, known: Mapping[str, float]) -> None:
    """Check of known values against a relation; values that contradict it are refused."""
    if any(name not in known for name in relation.names):
        return
    for name in relation.names:
        try:
            value = relation.solve(name, known)
        except ZeroDivisionError:
            continue
        if value is not None and math.isfinite(value):
            if abs(value - known[name]) > _AGREES * max(abs(value), abs(known[name])):
                raise InputError(
                    f"{QUANTITIES[name].text} is {shown(name, known[name])}, "
                    f"and {shown(name, value)} by {relation.formula}",
                    where=parameters(relation.names),
                    hint="leave out one of them",
                )
            return


_PLANS: Mapping[str, tuple[type[Any], Callable[[Any], Any]]] = {
    "flight": (FlightOptions, flight),
    "area": (CoverageOptions, coverage),
    "control": (ControlNeedOptions, control_plan),
    "product": (ProductOptions, requirements),
    "tables": (TableOptions, scale_tables),
    "run": (ProcessingOptions, processing_plan),
}


def plan(topic: str, **known: Any) -> Any:
    """Flight, photos, scans, control and accuracy of a map, from what is known of them.

    Parameters
    ----------
    topic : str
        'photo', 'relief', 'accuracy', 'swath' or 'overlap' derive quantities; 'flight' plans the photos of a map,
        'area' covers a rectangle, 'control' counts control points, 'product' says what a map needs of its inputs,
        'tables' are those of K-2.8, 'run' says what processing a block takes.
    **known : float
        Quantities by their names in `geomosaic.planning.relations`, or fields of the options in
        `geomosaic.options.planning`; metres on the ground, mm in the camera.

    Returns
    -------
    dict of str to Derived or Limit
        Value and formula of what follows, by name, and the limits of given quantities. `FlightPlan`, `Coverage`,
        `ControlPlan`, list of `Requirement`, tuple of `ScaleTable` and `ProcessingPlan` of the others.

    Raises
    ------
    InputError
        No such topic or quantity, or numbers that contradict each other.

    Examples
    --------
    >>> plan("photo", height=3000.0, camera_constant=150.0)["photo_scale"].value
    20000.0
    >>> plan("flight", ortho_scale=5000.0, camera_constant=150.0, area=(10000.0, 8000.0)).coverage.photos
    24
    """
    if topic not in (*TOPICS, *_PLANS):
        hint = did_you_mean(topic, (*TOPICS, *_PLANS)) or f"one of {', '.join((*TOPICS, *_PLANS))}"
        raise InputError(f"there is no topic '{topic}'", where="`topic`", hint=hint)
    if topic in _PLANS:
        kind, made = _PLANS[topic]
        return made(compose(kind, known))
    relations = TOPICS[topic]
    names = {name for relation in relations for name in relation.names}
    unknown = sorted(set(known) - names)
    if unknown:
        hint = did_you_mean(unknown[0], names) or f"one of {', '.join(sorted(names))}"
        raise InputError(f"the topic '{topic}' has no quantity '{unknown[0]}'", hint=hint)
    for name, value in known.items():
        if not isinstance(value, int | float):
            raise InputError(f"'{value}' is no number", where=f"`{name}`", hint="give one in the unit of the quantity")
    found = derive(relations, known)
    used = [item.relation for item in found]
    kept = limits(relations, known | {item.name: item.value for item in found})
    return {item.name: item for item in found} | {item.name: item for item in kept if item.relation not in used}
