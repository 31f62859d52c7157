"""Inputs of sensors, from tables that users write and from metadata files; errors know the image, input and a hint."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.errors import InputError, SensorInputError, counted, did_you_mean, warn
from geomosaic.limits import POSITIVE
from geomosaic.sensor.plugin import SensorInput
from geomosaic.types import PathLike
from geomosaic.whole_files import LARGEST_TABLE, read_text, read_toml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

# Nothing measured of an image, an orbit or the Earth is larger in any unit; powers of such a number would overflow.
LARGEST = 1e15
_DEEPEST = 64
_LONGEST = 400


def finite_number(text: str) -> float:
    """Number in a text of a metadata file.

    Parameters
    ----------
    text : str

    Returns
    -------
    float
        NaN where the text is no number, or one that is infinite or larger than `LARGEST`.
    """
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if abs(value) <= LARGEST else math.nan


def finite_numbers(words: Sequence[str], count: int, what: str, where: str) -> list[float]:
    """Numbers of a metadata file, `count` of them.

    Parameters
    ----------
    words : sequence of str
    count : int
    what : str
        Named in errors, as is `where`; what to do about it is for the reader of the file to say.
    where : str

    Raises
    ------
    InputError
        There are more or fewer words, or one of them is no number or one of no sensible size.
    """
    values = [finite_number(word) for word in words]
    if len(values) != count or any(map(math.isnan, values)):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"{what} is '{' '.join(words)[:60]}', not {wanted} of a sensible size", where=where, hint=None)
    return values


def parse_xml(data: bytes, where: str, skipped: Collection[str] = ()) -> Element:
    """Root of an XML document; a document type, and with it every entity, is refused.

    Parameters
    ----------
    data : bytes
    where : str
        File, named in errors.
    skipped : collection of str
        Elements that are passed over with all they hold.

    Raises
    ------
    InputError
        No well-formed XML, one with a document type, or one nested too deep.
    """
    from xml.etree.ElementTree import ParseError, TreeBuilder
    from xml.parsers.expat import ExpatError, ParserCreate

    # A metadata file comes from anywhere: entities could name other files, or grow without end.
    builder = TreeBuilder()
    parser = ParserCreate()
    parser.buffer_text = True
    depth = skipping = 0

    def refuse(*_: object) -> None:
        raise InputError(
            "the XML has a document type declaration, which may define entities; no metadata file needs one",
            where=where,
            hint="remove the <!DOCTYPE ...> if you trust the file",
        )

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, skipping
        depth += 1
        if depth > _DEEPEST:
            raise InputError(
                f"the XML is nested more than {_DEEPEST} deep: this is no metadata file",
                where=where,
                hint="give the metadata of the product",
            )
        skipping += bool(skipping or tag in skipped)
        if not skipping:
            builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth, skipping
        depth -= 1
        if skipping:
            skipping -= 1
        else:
            builder.end(tag)

    def text(characters: str) -> None:
        if not skipping:
            builder.data(characters)

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    try:
        parser.Parse(data, True)
        return builder.close()
    except (ExpatError, ParseError, ValueError, LookupError, AssertionError) as error:
        raise InputError(f"the XML is damaged ({error})", where=where, hint="get the file again") from error


YAML = (".yaml", ".yml")
_YAML_KEY = re.compile(r"""( *)("[^"]*"|'[^']*'|[^\s"'#\[\]{}&*!|>%@-][^:#]*?) *:(?: +([^&*!|>{%@].*))?""")


def parse_yaml(text: str, where: str) -> dict[str, Any]:
    """Table of a plain YAML file: mappings nested by indentation, numbers, words, and lists of them.

    Parameters
    ----------
    text : str
        No anchors, tags, texts of several lines or tables in braces.
    where : str
        File, named in errors.

    Returns
    -------
    dict
        Keys without a value have an empty dict.

    Raises
    ------
    InputError
        A line is none of these, or a key stands twice; names the line.
    """
    root: dict[str, Any] = {}
    open_tables: list[tuple[int, dict[str, Any], str]] = [(-1, {"": root}, "")]
    for at, line in enumerate(text.splitlines(), 1):
        bare = re.sub(r"(^|\s)#.*", "", line).rstrip()
        if bare.strip() in ("", "---", "..."):
            continue
        indent = len(bare) - len(bare.lstrip(" "))
        item = re.fullmatch(r" *- +([^:]+)", bare)
        # The items of a list may stand as far left as its key.
        while indent < open_tables[-1][0] + (item is None) and len(open_tables) > 1:
            open_tables.pop()
        _, parent, key = open_tables[-1]
        if item and (not parent[key] or isinstance(parent[key], list)) and len(open_tables) > 1:
            parent[key] = [*parent[key], _yaml_value(item[1])]
            continue
        match = _YAML_KEY.fullmatch(bare) if len(bare) <= _LONGEST else None
        table = parent[key]
        name = match[2].strip("\"'") if match else ""
        if match is None or not isinstance(table, dict) or name in table or len(open_tables) > _DEEPEST:
            what = f"'{name}' stands twice" if name and isinstance(table, dict) and name in table else "no plain YAML"
            raise InputError(
                f"{what}: '{bare.strip()[:40]}'",
                where=f"{where}, line {at}",
                hint="write 'name: value', nested by indentation; or give the same as TOML",
            )
        listed = re.fullmatch(r"\[(.*)\]", match[3] or "")
        table[name] = (
            [_yaml_value(word) for word in listed[1].split(",")]
            if listed
            else _yaml_value(match[3])
            if match[3]
            else {}
        )
        if not match[3]:
            open_tables.append((indent, table, name))
    return root


def camera_file(path: PathLike) -> dict[str, Any]:
    """Table of a camera's file; a single [camera] table at its top is unwrapped.

    Parameters
    ----------
    path : path-like
        TOML file, or YAML file of another program.

    Raises
    ------
    InputError
        The file is neither by its ending, cannot be read, or is damaged.
    """
    ending = Path(path).suffix.lower()
    if ending in YAML:
        return parse_yaml(read_text(path, "camera file", LARGEST_TABLE), str(path))
    if ending != ".toml":
        raise InputError(
            "a camera is described in a .toml file, or in orthority's .yaml",
            where=str(path),
            hint="see `geomosaic sensors NAME`",
        )
    values = read_toml(path, "camera file")
    nested = values.get("camera")
    return nested if isinstance(nested, dict) and len(values) == 1 else values


def _yaml_value(text: str) -> Any:
    """Number, truth or word."""
    word = text.strip()
    value = finite_number(word)
    if not math.isnan(value):
        return int(word) if re.fullmatch(r"[-+]?\d+", word) else value
    return {"true": True, "false": False}.get(word.lower(), word.strip("\"'"))


def _input_error(what: str, key: str, where: str, hint: str | None = None) -> SensorInputError:
    """Error about an input, or about a value inside one."""
    return SensorInputError(what, name=key.partition(",")[0].partition("[")[0], where=where, hint=hint)


# Pixels between a declared offset and what the image tells, from which on one of them is doubted.
_LARGEST_OFFSET_ERROR = 100.0


def scene_offset(
    given: Any, size: tuple[int, int], scene: tuple[int, int], title: str, corner: tuple[int, int] | None, where: str
) -> tuple[float, float]:
    """Column and row of an image's upper-left corner in the scene that its metadata describes.

    Parameters
    ----------
    given : object
        The input `offset`; None where it is not given.
    size, scene : tuple of int
        Width and height of the image and of the scene, pixels.
    title : str
        Of the scene.
    corner : tuple of int, optional
        Corner that the image file tells, see `geomosaic.raster.info.corner_in_scene`.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The image is not of the scene's size and no offset is given, or it reaches beyond the scene.
    """
    (width, height), (cols, rows) = scene, size
    col, row = numbers(given if given is not None else (0, 0), 2, "offset", where)
    if given is not None:
        check_scene_offset((col, row), corner, where)
    elif size != scene:
        if corner is not None and corner[0] + cols <= width and corner[1] + rows <= height:
            raise undeclared_offset(corner, where)
        raise InputError(
            f"the image has {cols} x {rows} pixels, the scene ({title}) has {width} x {height}",
            where=where,
            hint="give offset = [col, row] of the image's upper-left corner in the scene, if the image is a cut of it",
        )
    if col < 0 or row < 0 or col + cols > width or row + rows > height:
        raise InputError(
            f"{cols} x {rows} pixels from {col:g}, {row:g} on reach beyond the scene of {width} x {height}",
            where=where,
            hint="check offset",
        )
    return col, row


def check_scene_offset(offset: Sequence[float], corner: tuple[int, int] | None, where: str) -> None:
    """Warning about an input `offset` that the image's own geotransform contradicts.

    Parameters
    ----------
    offset : sequence of float
        Column and row of the image's upper-left corner in its scene, as declared.
    corner : tuple of int, optional
        The same, as the image says; (0, 0) says nothing.
    where : str
        Image, for the message.
    """
    if corner is not None and any(corner) and math.dist(offset, corner) >= _LARGEST_OFFSET_ERROR:
        warn(
            f"{where}: offset = [{offset[0]:g}, {offset[1]:g}] is declared, but by its own geotransform "
            f"the image begins in its scene at column {corner[0]}, row {corner[1]}; "
            f"if that is right, give offset = {[*corner]}"
        )


def undeclared_offset(corner: tuple[int, int], where: str) -> SensorInputError:
    """Error about an image that its own geotransform places in a scene, while the input `offset` does not.

    Parameters
    ----------
    corner : tuple of int
        Column and row of the image's upper-left corner in the scene.
    where : str
        Image, for the message.

    Returns
    -------
    SensorInputError
        To be raised by the caller; it proposes the offset.
    """
    offset = list(corner)
    return SensorInputError(
        f"by its own geotransform the image is cut from its scene at column {corner[0]}, row {corner[1]}, and no input "
        "says so",
        name="offset",
        where=where,
        hint=f"give offset = {offset}; of several images each its own, under [[images]] of a project, as "
        "`geomosaic new` writes it; [0, 0] if it is the upper-left part after all",
        proposed=offset,
    )


def known_keys(table: Mapping[str, Any], allowed: Iterable[str], where: str) -> None:
    """Check that a table has known keys only: a misspelt one would be ignored in silence.

    Parameters
    ----------
    table : mapping
        As the user wrote it.
    allowed : iterable of str
    where : str
        Image, for the message.

    Raises
    ------
    SensorInputError
        Names the key, the nearest one that exists, and all of them.
    """
    names = list(allowed)
    for key in table:
        if key not in names:
            raise _input_error(f"unknown key '{key}'", str(key), where, suggestion(key, "known keys are:", names))


def known_inputs(options: Mapping[str, Any], inputs: Iterable[SensorInput], sensor: str, where: str) -> None:
    """Check that options are inputs of a sensor.

    Parameters
    ----------
    options : mapping
        Sensor options by name.
    inputs : iterable of SensorInput
        Inputs that the sensor declares.
    sensor : str
        Its name, for the message.
    where : str
        Image, for the message.

    Raises
    ------
    SensorInputError
        Names the option, the nearest input that exists, and all of them.
    """
    names = [entry.name for entry in inputs]
    for key in options:
        if key not in names:
            raise _input_error(
                f"sensor '{sensor}' has no input '{key}'", str(key), where, suggestion(key, "it has", names)
            )


def suggestion(word: Any, words: str, known: Iterable[str]) -> str:
    """Hint with the nearest known word, and all of them.

    Parameters
    ----------
    word : object
        What was given.
    words : str
        Introduction of the list, such as 'known keys are:'.
    known : iterable of str
    """
    names = list(known)
    return f"{did_you_mean(str(word), names)} {words} {', '.join(names)}".strip()


def need(table: Mapping[str, Any], key: str, where: str, text: str) -> Any:
    """Value of a required key.

    Parameters
    ----------
    table : mapping
    key : str
    where : str
        Image, for the message.
    text : str
        Meaning of the value, for the hint.

    Returns
    -------
    object
        Unchecked.

    Raises
    ------
    SensorInputError
        The key is missing, or its value is None.
    """
    if key not in table or table[key] is None:
        raise _input_error(f"'{key}' is missing", key, where, f"give {key}: {text}")
    return table[key]


def table_of(value: Any, key: str, where: str) -> Mapping[str, Any]:
    """Value that is a table.

    Parameters
    ----------
    value : object
    key, where : str
        Path of the value and image, for the message.

    Raises
    ------
    SensorInputError
        The value is not a table.
    """
    if not isinstance(value, Mapping):
        raise _input_error(f"'{key}' is {value!r}, not a table", key, where)
    return value


def number(value: Any, key: str, where: str) -> float:
    """Finite number of a number or of its text.

    Parameters
    ----------
    value : object
        What the user gave.
    key : str
        Its path, as for `_input_error`.
    where : str
        Image.

    Raises
    ------
    SensorInputError
        Not a number, NaN, infinite, or larger than `metadata.LARGEST`.
    """
    try:
        # True is a number to Python, and to nobody who writes a project file.
        result = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if not abs(result) <= LARGEST:
        raise _input_error(f"{key} = {value!r} is not a finite number of a sensible size", key, where)
    return result


def positive(value: Any, key: str, where: str) -> float:
    """Finite number above zero.

    Parameters
    ----------
    value : object
    key, where : str
        Path of the value and image, for the message.

    Raises
    ------
    SensorInputError
        The value is no finite number, or is not above 0.
    """
    result = number(value, key, where)
    try:
        POSITIVE.check(result)
    except InputError as error:
        raise _input_error(f"{key}: {error.what}", key, where, error.hint) from None
    return result


def numbers(value: Any, count: int, key: str, where: str) -> tuple[float, ...]:
    """List of a fixed count of finite numbers.

    Parameters
    ----------
    value : object
    count : int
    key, where : str
        Path of the value and image, for the message.

    Returns
    -------
    tuple of float
        `count` of them.

    Raises
    ------
    SensorInputError
        The value is no list, has another length, or an item is no finite number.
    """
    if isinstance(value, str | Mapping) or not isinstance(value, Iterable):
        raise _input_error(f"{key} = {value!r} is not a list of {count} finite numbers", key, where)
    items = list(value)
    if len(items) != count:
        raise _input_error(f"{key} has {counted(len(items), 'value')}, not {count} finite numbers", key, where)
    return tuple(number(item, f"{key}[{i}]", where) for i, item in enumerate(items))


def pair(value: Any, key: str, where: str) -> tuple[float, float]:
    """Pair of positive numbers, where one number stands for both.

    Parameters
    ----------
    value : object
        A number, or a list of two.
    key, where : str
        Path of the value and image, for the message.

    Returns
    -------
    first, second : float

    Raises
    ------
    SensorInputError
        A value is no finite number or not above 0, or the list has another length.
    """
    if isinstance(value, Iterable) and not isinstance(value, str):
        first, second = numbers(value, 2, key, where)
    else:
        first = second = number(value, key, where)
    return positive(first, key, where), positive(second, key, where)


def choice(value: Any, allowed: Iterable[str], key: str, where: str) -> str:
    """Word out of a list of words.

    Parameters
    ----------
    value : object
    allowed : iterable of str
    key, where : str
        Path of the value and image, for the message.

    Raises
    ------
    SensorInputError
        Another word; names the nearest.
    """
    names = list(allowed)
    # TOML and the command line read the word 'true' as a boolean.
    value = str(value).lower() if isinstance(value, bool) else value
    if value not in names:
        raise _input_error(f"{key} = {value!r} is not known", key, where, suggestion(value, "choose from:", names))
    return str(value)


def flag(table: Mapping[str, Any], key: str, where: str) -> bool:
    """Value of a key that is true or false.

    Parameters
    ----------
    table : mapping
    key : str
    where : str
        Image, for the message.

    Returns
    -------
    bool
        False where the key is not given.

    Raises
    ------
    SensorInputError
        The value is neither true nor false; 0 and 1 are not taken for them.
    """
    value = table.get(key)
    if value is not None and not isinstance(value, bool):
        raise _input_error(f"{key} = {value!r} is neither true nor false", key, where)
    return bool(value)


def apriori_sigmas(
    table: Any, usual: Mapping[str, float], groups: Mapping[str, Sequence[str]], where: str
) -> list[float]:
    """A-priori standard deviations of the parameters of a sensor, from the input `sigmas`.

    Parameters
    ----------
    table : mapping
        Sigmas of groups of parameters, and of single ones, which go before.
    usual : mapping of str to float
        Parameters in their order, with the sigmas of those that are not given.
    groups : mapping of str to sequence of str
        Parameters of each group.
    where : str
        Image, for messages.

    Raises
    ------
    SensorInputError
        A name is unknown, or a sigma is no number or negative.
    """
    given = table_of(table, "sigmas", where)
    known_keys(given, (*groups, *usual), f"{where}, sigmas")
    sigmas = {name: number(value, f"sigmas, {name}", where) for name, value in given.items()}
    values = dict(usual)
    for group, names in groups.items():
        if group in sigmas:
            values.update(dict.fromkeys(names, sigmas[group]))
    values.update({name: sigmas[name] for name in usual if name in sigmas})
    negative = [name for name, value in values.items() if value < 0.0]
    if negative:
        raise _input_error(f"the sigma of {negative[0]} is negative", "sigmas", where, "0 holds it fixed")
    return list(values.values())


def point_rows(
    points: Any, keys: Sequence[str], where: str, more: Sequence[str] = ("id", "sigma")
) -> tuple[list[str], list[tuple[float, ...]]]:
    """Names of control points, and rows of their values under `keys` and of sigma (1 unless given).

    Parameters
    ----------
    points : list of tables
    keys : sequence of str
        What each must have.
    where : str
    more : sequence of str
        What each may have besides.
    """
    if not isinstance(points, Sequence) or isinstance(points, str):
        raise _input_error("input 'points' is not a list of points", "points", where)
    names, rows = list[str](), list[tuple[float, ...]]()
    for index, point in enumerate(points, 1):
        if not isinstance(point, Mapping):
            raise _input_error(f"control point {index} is not a table of {', '.join(keys)}", "points", where)
        missing = [key for key in keys if key not in point]
        if missing:
            hints = (did_you_mean(str(key), missing) for key in point if key not in (*keys, *more))
            raise _input_error(
                f"control point {index} has no {', '.join(missing)}",
                "points",
                where,
                f"{' '.join(filter(None, hints))} give each point {', '.join(keys)}".strip(),
            )
        names.append(str(point.get("id", index)))
        own = f"points, {'' if 'id' in point else 'number '}{names[-1]}"
        row = [number(point[key], f"{own}: {key}", where) for key in keys]
        rows.append((*row, positive(point.get("sigma", 1.0), f"{own}: sigma", where)))
    return names, rows
