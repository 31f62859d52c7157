"""Names of options in messages: parameters in backticks become flags of a command or keys of a project file.

Below the command line a message says `dem_heights` or `resampling=nearest`: the parameter of the library. A command
says its flag instead, a project its section and key.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache, partial
from typing import Any

from geomosaic.errors import GeomosaicError
from geomosaic.options.declaration import declared

# Name of a parameter, with its value where there is one; None where it is not known.
Naming = Callable[[str, str | None], str | None]


def renamed(text: str, naming: Naming) -> str:
    """Text with the parameters in it named otherwise.

    Parameters
    ----------
    text : str
        Parameters stand in backticks, `name` or `name=value`.
    naming : callable

    Returns
    -------
    str
        What is not known stays as it is.
    """
    if "`" not in text:
        return text
    pattern = r"`(?P<name>[a-z_]+)(=(?P<value>[^`]*))?`"
    return re.sub(pattern, lambda found: naming(found["name"], found["value"]) or found[0], text)


def renamed_values(values: Any, naming: Naming) -> Any:
    """JSON values with the parameters in all their texts named otherwise.

    Parameters
    ----------
    values : dict, list, str, int, float, bool or None
    naming : callable

    Returns
    -------
    dict, list, str, int, float, bool or None
    """
    if isinstance(values, str):
        return renamed(values, naming)
    if isinstance(values, Mapping):
        return {key: renamed_values(value, naming) for key, value in values.items()}
    if isinstance(values, list | tuple):
        return [renamed_values(value, naming) for value in values]
    return values


def flag(name: str, value: str | None = None) -> str:
    """Flag of a parameter, as commands spell it; for pages that are read without a command at hand.

    Parameters
    ----------
    name : str
    value : str, optional

    Returns
    -------
    str
        `--model tps` for `model=tps`, `--no-report` for `report=False`.
    """
    plain = name.replace("_", "-")
    if value in ("True", "False"):
        return f"--{plain}" if value == "True" else f"--no-{plain}"
    return f"--{plain} {value}" if value else f"--{plain}"


@lru_cache
def _project_keys(first: str = "") -> Mapping[str, str]:
    """Section and key of every parameter that a project file has; of two of one name that in the section `first`."""
    # A control report names flags only, and needs no class of these.
    from geomosaic.options.adjustment import AdjustmentOptions
    from geomosaic.options.inputs import Area, BlockInputs, QualityLimits
    from geomosaic.options.mosaic import MosaicOptions
    from geomosaic.options.tie_points import TiePointOptions

    kinds = (TiePointOptions, AdjustmentOptions, QualityLimits, BlockInputs, Area, MosaicOptions)
    options = sorted((one for kind in kinds for one in declared(kind)), key=lambda one: one.option.section == first)
    return {one.name: f"[{one.option.section}] {one.key}" for one in options if one.option.section}


def project_key(name: str, value: str | None = None, first: str = "") -> str | None:
    """Section and key of a parameter, with its value as a project file writes it.

    Parameters
    ----------
    name : str
    value : str, optional
    first : str
        Section whose parameter is meant where two have one name.

    Returns
    -------
    str or None
        None where a project has no such parameter.
    """
    key = _project_keys(first).get(name)
    if key is None or value is None:
        return key
    plain = re.fullmatch(r"True|False|[-+\d.]+", value)
    return f"{key} = {value.lower() if plain else repr(value)}"


@contextmanager
def keys_in_errors(path: str, first: str = "") -> Iterator[None]:
    """Errors raised within that name options by section and key: `feather` becomes [mosaic] feather.

    Parameters
    ----------
    path : str
        Project file, as errors name it.
    first : str
        Section whose parameter is meant where two have one name.

    Raises
    ------
    GeomosaicError
        The one raised within, with its texts translated.
    """
    try:
        yield
    except GeomosaicError as error:
        before, place = error.what, (error.where or "").strip("`")
        named = partial(project_key, first=first)
        error.what = renamed(before, named)
        error.hint = error.hint and renamed(error.hint, named)
        if place in _project_keys(first):
            error.where = f"{path}, {named(place)}"
        elif error.what != before:
            error.where = error.where or path
        error.args = (error.what,)
        raise
