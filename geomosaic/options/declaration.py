"""Declaration of an option: a dataclass field with its limits, help, group, stage and rules.

An options class is a frozen dataclass whose fields are made by `option`. From the declaration come the flag of the
command line, the key of the project file, the keyword of the library, the table in the docs, the checks and the keys of
reruns. What an option means says its help; docstrings list options only where the reference shows them. A composed
class has options classes as fields; the names of all its options are different, so that values can be given flat
(`compose`).
"""

from __future__ import annotations

import inspect
import sys
import types
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from functools import lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, Union, get_args, get_origin

from geomosaic.errors import InputError, did_you_mean
from geomosaic.limits import Limits

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")

INFINITE = float("inf")
# Headings of help and docs, in their order.
GROUPS = ("input", "geometry", "colour", "seams", "blending", "output", "running")
# What a change of an option makes stale: 'all' also what was found on the way, such as the balance; 'edits' show in
# seams and colours themselves; 'running' changes nothing. An option that does not say makes all stale: who forgets it
# costs a run, and not a rerun that keeps old pixels.
STAGES = ("all", "geometry", "colour", "seams", "edits", "blending", "records", "running")


@dataclass(frozen=True)
class Option:
    """Declaration of one option.

    Attributes
    ----------
    help : str
        One sentence.
    choices : tuple of str
        Admissible words.
    above, least, most : float
        Limits of a number: more than `above`, from `least` to `most`.
    metavar : str
        Unit or kind of the value, as help shows it.
    unit : str
        Unit in which a number counts, '1:' of a scale's denominator; the command line takes others of its kind.
    default : str
        The default in words, where help is to show it and the value does not tell.
    parse : callable, optional
        Reads the value from a text; raises `InputError`.
    files : tuple of str
        Endings by which a text is the path of a file.
    group : str
        One of `GROUPS`.
    stage : str
        One of `STAGES`.
    flag : str, optional
        Flags of the command line where they differ from the name; None where there is none.
    section : str, optional
        Section of the project file; None where there is none.
    key : str
        Key in it, where it differs from the name.
    needs : tuple of str
        Conditions of which one must hold for the option to do anything: 'name' (in effect) or 'name=value'.
    idle_with : tuple of str
        Conditions under which it does nothing.
    """

    help: str = ""
    choices: tuple[str, ...] = ()
    above: float = -INFINITE
    least: float = -INFINITE
    most: float = INFINITE
    metavar: str = ""
    unit: str = ""
    default: str = ""
    parse: Callable[[Any], Any] | None = None
    files: tuple[str, ...] = ()
    group: str = "output"
    stage: str = "all"
    flag: str | None = ""
    section: str | None = None
    key: str = ""
    needs: tuple[str, ...] = ()
    idle_with: tuple[str, ...] = ()

    @property
    def limits(self) -> Limits:
        """Limits of a number."""
        return Limits(self.above, self.least, self.most)


def option(default: Any = MISSING, help: str = "", *, default_factory: Any = MISSING, **declared: Any) -> Any:
    """Field of an options class.

    Parameters
    ----------
    default : object, optional
        A value must be given unless there is one.
    help : str
        One sentence.
    default_factory : callable, optional
        Makes the default, where it is mutable or an options value.
    **declared
        Attributes of `Option`; its `default`, the one in words, is named `shown` here.

    Returns
    -------
    dataclasses.Field
    """
    shown = declared.pop("shown", "")
    metadata = {"option": Option(help, default=shown, **declared), "declared": frozenset(declared)}
    if default_factory is not MISSING:
        return field(default_factory=default_factory, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Declared:
    """Option of a class with its name, type and default.

    Attributes
    ----------
    name : str
    owner : type
        The options class.
    kind : type
        Type of the value, without None.
    optional : bool
        Whether None is a value.
    default : object
        `dataclasses.MISSING` where a value must be given.
    option : Option
    typed : bool
        Whether values of `kind` alone are admissible, and none of the library's own types.
    """

    name: str
    owner: type
    kind: Any
    optional: bool
    default: Any
    option: Option
    typed: bool = True

    @property
    def flag(self) -> str:
        """Long flag of the command line, such as --true-ortho; empty where there is none."""
        if self.option.flag is None:
            return ""
        written = [part for part in self.option.flag.replace("/", " ").split() if part.startswith("--")]
        return written[0] if written else f"--{self.name.replace('_', '-')}"

    @property
    def key(self) -> str:
        """Key of the project file."""
        return self.option.key or self.name


def declared(kind: type) -> tuple[Declared, ...]:
    """Options of a class in their order, with those of the classes that it is composed of in place of these.

    Parameters
    ----------
    kind : type
        Options class.
    """
    return _declared(kind)


@lru_cache
def _declared(kind: Any) -> tuple[Declared, ...]:
    found: list[Declared] = []
    for item in fields(kind):
        written = _annotation(kind, item)
        own, optional = _without_none(written)
        if "option" in item.metadata:
            default = item.default if item.default_factory is MISSING else item.default_factory()
            typed = get_origin(written) not in (Union, types.UnionType) or Any not in get_args(written)
            found.append(Declared(item.name, kind, own, optional, default, item.metadata["option"], typed))
        elif is_part(own):
            found += declared(own)
    return tuple(found)


def is_part(kind: Any) -> bool:
    """Whether a type is an options class, not a value such as a width.

    Parameters
    ----------
    kind : type
    """
    return isinstance(kind, type) and is_dataclass(kind) and any("option" in item.metadata for item in fields(kind))


def field_kind(kind: type, item: Field[Any]) -> tuple[Any, bool]:
    """Type of a field without None, and whether None may stand for it.

    Parameters
    ----------
    kind : type
        Dataclass that has the field; its annotations may be texts.
    item : dataclasses.Field

    Returns
    -------
    kind : type
        `object` where only type checkers know the annotation.
    optional : bool
    """
    return _without_none(_annotation(kind, item))


def _without_none(found: Any) -> tuple[Any, bool]:
    """Type of an annotation without None, and whether None may stand for it."""
    if get_origin(found) in (Union, types.UnionType):
        own = [part for part in get_args(found) if part is not type(None)]
        return own[0], len(own) < len(get_args(found))
    return found, found is object


def _annotation(kind: type, item: Field[Any]) -> Any:
    """Annotation of a field, evaluated where it was written: in the module of the class that has it in its body."""
    if not isinstance(item.type, str):
        return item.type
    home = next(each for each in kind.__mro__ if item.name in inspect.get_annotations(each))
    try:
        return eval(item.type, vars(sys.modules[home.__module__]).copy())  # an annotation in our own source
    except NameError:  # known to type checkers alone: not an option
        return object


def flat_values(value: Any) -> Iterator[tuple[Declared, Any]]:
    """Options of an options value with what they are set to, parts gone through.

    Parameters
    ----------
    value : options value

    Yields
    ------
    one : Declared
    value : object
    """
    own = {one.name: one for one in declared(type(value))}
    for item in fields(value):
        inner = getattr(value, item.name)
        if is_part(type(inner)) and item.name not in own:
            yield from flat_values(inner)
        elif item.name in own:
            yield own[item.name], inner


def paths_of(value: Any, stages: Collection[str] = STAGES) -> tuple[Path, ...]:
    """Files that options name.

    Parameters
    ----------
    value : options value
    stages : collection of str
        Options of these stages only; see `STAGES`.
    """
    found: list[Path] = []
    for one, given in flat_values(value):
        if one.option.stage in stages:
            found += [path for path in (given if isinstance(given, tuple) else (given,)) if isinstance(path, Path)]
    return tuple(found)


def stage_values(value: Any, stage: str) -> dict[str, Any]:
    """Values of the options of a stage, as text for keys of reruns.

    Files are left out: they count by their content, see `paths_of`.

    Parameters
    ----------
    value : options value
    stage : str
        One of `STAGES`.
    """
    named = ((one, given) for one, given in flat_values(value) if one.option.stage == stage)
    return {one.name: repr(given) for one, given in named if not (one.kind is Path or one.kind == tuple[Path, ...])}


def compose(kind: type[T], values: Mapping[str, Any]) -> T:
    """Options value of a composed class from flat values by name.

    Parameters
    ----------
    kind : type
    values : mapping
        By name of the option, or of a part, which is an options value then, of which other values change some.

    Returns
    -------
    options value
        Of type `kind`.

    Raises
    ------
    InputError
        No option has such a name, or a value is wrong; the option is named in backticks.
    """
    left = dict(values)
    needed = [one.name for one in declared(kind) if one.owner is kind and one.default is MISSING]
    missing = " and ".join(f"`{name}`" for name in needed if name not in left)
    if missing:
        raise InputError(f"{missing} {'are' if ' and ' in missing else 'is'} not given", hint=f"give {missing}")
    parts = {field_kind(kind, item)[0]: item.name for item in fields(kind)}
    for name, value in left.items():
        part = parts.get(type(value), name) if is_part(type(value)) else name
        if part != name:
            raise InputError(f"`{name}` takes no {type(value).__name__}", hint=f"give it as `{part}`")
    made = _compose(kind, left)
    if left:
        raise _unknown(next(iter(left)), [one.name for one in declared(kind)])
    return made


def named_only(kind: type[T]) -> type[T]:
    """Dataclass that refuses unknown names as `compose` does.

    Parameters
    ----------
    kind : type
        Decorated; its signature stays as it is.
    """
    # From Python 3.13 on its own error proposes the keyword that was meant, and this is no longer needed.
    own = kind.__init__
    known = [item.name for item in fields(kind) if item.init]

    @wraps(own)
    def init(self: Any, *args: Any, **values: Any) -> None:
        for name in values:
            if name not in known:
                raise _unknown(name, known)
        own(self, *args, **values)

    kind.__init__ = init  # type: ignore[method-assign]
    return kind


def _unknown(name: str, known: Sequence[str]) -> InputError:
    hint = did_you_mean(name, known) or f"the options here are {', '.join(known)}"
    return InputError(f"no option is named `{name}`", hint=hint)


@lru_cache
def _names(kind: type[Any]) -> frozenset[str]:
    """Names of all fields of a class, parts gone through: options, and values that are none, such as a callback."""
    found: set[str] = set()
    for item in fields(kind):
        own, _ = field_kind(kind, item)
        found |= _names(own) if is_part(own) and "option" not in item.metadata else {item.name}
    return frozenset(found)


def _compose(kind: type[T], left: dict[str, Any]) -> T:
    """Take from `left` what belongs to `kind`."""
    given = {}
    for item in fields(kind):
        own, _ = field_kind(kind, item)
        # A part is made only where one of its options is given: PlanarInputs has one that must be.
        part = is_part(own) and "option" not in item.metadata
        inner = _names(own) if part else frozenset()
        if item.name in left and (not part or isinstance(left[item.name], own)):
            whole = left.pop(item.name)
            changed = {name: left.pop(name) for name in inner & left.keys()} if part else {}
            given[item.name] = replace(whole, **changed) if changed else whole
        elif part and item.name in left and item.name not in inner:
            what = f"{type(left[item.name]).__name__} is no set of options"
            raise InputError(what, where=f"`{item.name}`", hint=f"{own.__name__}(...)")
        elif inner & left.keys():
            given[item.name] = _compose(own, left)
    missing = [one.name for one in fields(kind) if one.default is MISSING and one.default_factory is MISSING]
    missing = [name for name in missing if name not in given]
    if missing and given:
        name = next(iter(given))
        hint = f"give `{missing[0]}`, or leave out `{name}`"
        raise InputError(f"`{name}` is given without `{missing[0]}`", hint=hint)
    return kind(**given)
