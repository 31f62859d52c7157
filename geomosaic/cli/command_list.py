"""List of the commands: the modules of `cli/commands`, their short help and groups read from docstrings, unimported.

The first line of a command's docstring is its short help. A line `Help group: NAME` below it says under which heading
`geomosaic --help` lists the command. Nothing is imported for that, since a command may import numerical libraries.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

GROUPS = ("Projects", "Orthos and mosaics", "Orientation and accuracy", "Maps", "Calculations and lists")
"""Headings in their order; another one comes after them."""

_DOCSTRING = re.compile(r'\A"""(?P<help>[^\n"]*)(?:\n\nHelp group: (?P<group>[^\n"]+))?')


@dataclass(frozen=True)
class CommandSummary:
    """Line of `geomosaic --help` for one command."""

    name: str
    help: str
    group: str


@lru_cache
def commands() -> dict[str, CommandSummary]:
    """Summaries of all commands by name, in the order of their groups and names."""
    files = (Path(__file__).parent / "commands").glob("[!_]*.py")
    found = sorted((_summary(file) for file in files), key=lambda one: (_rank(one.group), one.group, one.name))
    return {one.name: one for one in found}


def _summary(file: Path) -> CommandSummary:
    with file.open(encoding="utf-8") as opened:
        match = _DOCSTRING.match(opened.read(400))
    found = match.groupdict("") if match else {"help": "", "group": ""}
    return CommandSummary(file.stem, found["help"], found["group"] or "Others")


def _rank(group: str) -> int:
    return GROUPS.index(group) if group in GROUPS else len(GROUPS)
