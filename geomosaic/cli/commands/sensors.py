"""List sensors, or show the inputs of one.

Help group: Calculations and lists
"""

from __future__ import annotations

from dataclasses import asdict

import click

from geomosaic.cli.options import running_options
from geomosaic.cli.output import answer
from geomosaic.sensor.plugin import HasExample, SensorExample
from geomosaic.sensor.registry import SensorEntry, plugin, sensors

HEAD = """\
format = 1

[project]
images = ["image.tif"]

"""


@click.command()
@click.argument("name", required=False)
@running_options
def command(name: str | None, as_json: bool) -> None:
    """List the installed sensors; with NAME, show what that one needs.

    The list loads no plugin, so a broken one does no harm; naming it shows why it fails.
    """
    if name is None:
        entries = sensors()
        answer({"sensors": [asdict(entry) for entry in entries]}, _table(entries), as_json)
        return
    loaded = plugin(name)
    words = [f"{loaded.name}: {loaded.summary}", "", "inputs:"]
    width = max((len(entry.name) for entry in loaded.inputs), default=0)
    for entry in loaded.inputs:
        extra = [entry.unit] if entry.unit else []
        extra += [f"default {entry.default}"] if entry.default is not None else []
        tail = f" [{', '.join(extra)}]" if extra else ""
        words.append(f"  {entry.name:<{width}}  {entry.text}{tail}")
    words += ["", "In a project these are keys of [sensor]; on the command line --option NAME=VALUE."]
    inputs = [asdict(entry) for entry in loaded.inputs]
    result: dict[str, object] = {"name": loaded.name, "summary": loaded.summary, "inputs": inputs}
    if isinstance(loaded, HasExample):
        words += ["", *_example(loaded.example)]
        result["example"] = {**asdict(loaded.example), "project": HEAD + loaded.example.project}
    answer(result, "\n".join(words), as_json)


def _example(example: SensorExample) -> list[str]:
    """Project and files of an example, as they would be written."""
    width, height = example.size
    lines = [f"example: a project, project.toml, for image.tif of {width} x {height} pixels", ""]
    lines += [f"  {line}".rstrip() for line in (HEAD + example.project).splitlines()]
    for name, text in example.files.items():
        lines += ["", f"with {name}:", "", *(f"  {line}".rstrip() for line in text.splitlines())]
    return lines


def _table(entries: list[SensorEntry]) -> str:
    if not entries:
        return "no sensors are installed"
    width = max(len(entry.name) for entry in entries)
    return "\n".join(f"{entry.name:<{width}}  {entry.distribution} {entry.version}" for entry in entries)
