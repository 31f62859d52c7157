"""Images that stand in the list of a project file as comments, as `new` leaves them, each with its reason."""

from __future__ import annotations

import json
import re
import tomllib

from geomosaic.errors import InputError

_ENTRY = re.compile(r'^(?P<indent>\s*)#\s*(?P<name>"(?:[^"\\]|\\.)*"),\s*#\s*(?P<reason>.*?)\s*$')


def commented_images(text: str) -> dict[str, str]:
    """Images of the list in section `project` that are commented out.

    Parameters
    ----------
    text : str
        Valid TOML.

    Returns
    -------
    dict of str to str
        Reason by the path of each, as it is written.
    """
    return {name: found["reason"] for name, found, _ in _entries(text)}


def with_commented_image(text: str, name: str) -> str:
    """Text of a project file in which an image that was commented out is one of the project's again.

    Parameters
    ----------
    text : str
        Valid TOML.
    name : str
        Path as `commented_images` tells it.

    Returns
    -------
    str
        The reason stays as a comment; all else stays as it is.

    Raises
    ------
    InputError
        No comment names it, or the list is written in a way that is not understood.
    """
    entry = next((one for one in _entries(text) if one[0] == name), None)
    if entry is None:
        raise InputError(f"no image '{name}' is commented out in the list of images", hint="load the page again")
    _, found, index = entry
    lines = text.splitlines(keepends=True)
    ending = lines[index][len(lines[index].rstrip("\r\n")) :]
    lines[index] = f"{found['indent']}{found['name']},    # {found['reason']}{ending}"
    changed = "".join(lines)
    try:
        same = sorted(_images(changed)) == sorted([*_images(text), name])
    except tomllib.TOMLDecodeError:
        same = False
    if not same:
        raise InputError(f"'{name}' could not be put into the list of images", hint="change it by hand")
    return changed


def _entries(text: str) -> list[tuple[str, re.Match[str], int]]:
    """Path, match and line of each entry that is commented out, and is not in the list already."""
    known, found = set(_images(text)), []
    for index, line in enumerate(text.splitlines()):
        match = _ENTRY.match(line)
        if match is None:
            continue
        try:
            name = str(json.loads(match["name"]))
        except ValueError:
            continue
        if name not in known:
            found.append((name, match, index))
    return found


def _images(text: str) -> list[str]:
    section = tomllib.loads(text).get("project", {})
    images = section.get("images", []) if isinstance(section, dict) else []
    return [images] if isinstance(images, str) else list(images)
