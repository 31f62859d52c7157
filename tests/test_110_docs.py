"""The docs say what is true: their commands run and print what they show, their options, keys and tables exist."""

from __future__ import annotations

import ast
import doctest
import importlib
import itertools
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
INSTALL = ("cd geomosaic", "cd ..", "python3 -m venv", ". .venv", "pip install", "geomosaic --version")
"""Lines of getting-started that make the environment these tests run in."""


def fenced(page: Path, *languages: str) -> list[tuple[str, str]]:
    """Fenced blocks of a page in order, with their languages."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [(language, text) for language, text in found if language in languages]


def pattern(line: str) -> str:
    """Regular expression of a printed line: decimals, times and what '...' stands for may differ."""
    parts = re.split(r"(\.\.\.|\d+\.\d+)", line)
    return "".join(
        ".*" if part == "..." else r"\d+\.\d+" if re.fullmatch(r"\d+\.\d+", part) else re.escape(part) for part in parts
    )


def shell(script: str, tell: Callable[..., tuple[int, str, str]]) -> tuple[int, str]:
    """Exit code and output of one block of commands; those of geomosaic run in this process."""
    code, output = 0, ""
    for line in script.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] == ["cd"]:
            os.chdir(words[1])
        elif words[:1] == ["geomosaic"]:
            names = [sorted(Path().glob(word)) if "*" in word else [word] for word in words[1:]]
            code, out, err = tell(*itertools.chain(*names))
            output += out + err
        elif words:
            subprocess.run(["bash", "-c", line], check=True)
    return code, output


WHOLE_RUNS = ("geomosaic demo demo", "geomosaic status demo/project.toml", "geomosaic run block.toml")
"""Commands of getting-started that make the mosaic of the whole sample, or need it."""


@pytest.mark.skipif(sys.platform == "win32", reason="the page is for a Unix shell")
@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_getting_started_runs_as_written(
    tmp_path: Path,
    sample: Path,
    tell: Callable[..., tuple[int, str, str]],
    monkeypatch: pytest.MonkeyPatch,
    whole: bool,
) -> None:
    """Every command runs in the order of the page and prints the lines that stand below it.

    Unless `whole`, those that make the mosaic of the whole sample are left out, with what they print.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "100")
    code, output, commands, left_out = 0, "", 0, False
    for language, text in fenced(DOCS / "getting-started.md", "sh", "text"):
        if language == "sh":
            if all(line.startswith(INSTALL) for line in text.splitlines()):
                continue
            left_out = not whole and not set(text.splitlines()).isdisjoint(WHOLE_RUNS)
            if left_out:
                if "geomosaic demo demo" in text:
                    shutil.copytree(sample, "demo")
                continue
            code, output = shell(text, tell)
            commands += 1
            assert code in (0, 1, 3), f"exit code {code} of\n{text}\n{output}"
            assert (code == 1) == ("error: " in output), f"exit code {code} of\n{text}\n{output}"
        elif left_out or text.startswith(("image,", "id,")):
            continue
        else:
            missing = [line for line in text.splitlines() if not re.search(f"^{pattern(line)}$", output, re.MULTILINE)]
            assert not missing, f"not printed: {missing}\nbut:\n{output}"
            assert (code == 3) == ("quality: " in text), f"exit code {code} with\n{output}"
            assert (code == 1) == ("error: " in text), f"exit code {code} with\n{output}"
    assert commands > 10


def test_getting_started_shows_the_sample_as_it_is() -> None:
    """Lines of tables and of the camera file on the page are those of the sample."""
    sample = ROOT / "data" / "sample"
    shown = [text for _, text in fenced(DOCS / "getting-started.md", "text") if text.startswith(("image,", "id,"))]
    assert len(shown) == 2
    for text, name in zip(shown, ("exterior.csv", "gcps.csv"), strict=True):
        assert set(text.splitlines()) <= set((sample / name).read_text().splitlines())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_of_a_page_give_the_results_they_show(page: Path) -> None:
    """Python examples give the results they show."""
    text = "\n".join(text for _, text in fenced(page, "pycon"))
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0))
    assert runner.failures == 0
    assert page.stem != "conventions" or runner.tries > 10


def commands_of_the_program() -> dict[str, set[str]]:
    """Options of every command, read off click."""
    from geomosaic.cli.main import cli, commands

    context = click.Context(cli)
    found = {}
    for name in commands():
        command = cli.get_command(context, name)
        assert command is not None
        found[name] = {
            option for item in command.params for option in (*item.opts, *item.secondary_opts) if option[0] == "-"
        }
        for part in getattr(command, "commands", {}).values():
            found[name] |= {option for item in part.params for option in item.opts if option[0] == "-"}
        found[name] |= {"--help", "-h"}
    return found


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.stem)
def test_options_and_commands_exist(page: Path) -> None:
    """Every option and command that a page names is one of the program's."""
    if not page.is_file():
        pytest.skip(f"{page.name} is not here")
    known = commands_of_the_program()
    everything = {"--version"}.union(*known.values())
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text))
    assert named <= everything, f"no such option: {sorted(named - everything)}"
    code = "\n".join([block for _, block in fenced(page, "sh", "console")] + re.findall(r"`([^`\n]+)`", text))
    for line in re.findall(r"(?:^|&& |/)geomosaic ([^`\n]+)", code.replace("\\\n", " "), re.MULTILINE):
        words = line.split("#")[0].split()
        if words[0].startswith("--"):
            continue
        assert words[0] in known, f"no such command: geomosaic {line}"
        used = {word for word in words if re.fullmatch(r"--?[a-z][a-z-]*", word)}
        assert used <= known[words[0]], f"geomosaic {words[0]} has no {sorted(used - known[words[0]])}"


def tables(page: Path) -> dict[str, dict[str, list[str]]]:
    """Tables of a page by the heading above them: first column, without backticks, to the other cells."""
    found: dict[str, dict[str, list[str]]] = {}
    heading = ""
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ").replace("`", "")
        elif line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split(" | ")]
            cells[-1] = cells[-1].rstrip("| ")
            for name in re.findall(r"`([^`]+)`", cells[0]):
                found.setdefault(heading, {})[name] = cells[1:]
    return found


def test_every_key_of_a_project_is_documented() -> None:
    """The page has every key of the schema, no other, and the right defaults."""
    from pydantic_core import PydanticUndefined

    from geomosaic.project.schema import ProjectFile

    shown = tables(DOCS / "projects.md")
    for section, field in ProjectFile.model_fields.items():
        if section == "format":
            continue
        kinds: list[Any] = [field.annotation, *getattr(field.annotation, "__args__", ())]
        model = next(kind for kind in kinds if hasattr(kind, "model_fields"))
        rows = shown.get(f"[{section}]") or shown[f"[[{section}]]"]
        assert set(rows) == set(model.model_fields), section
        for key, entry in model.model_fields.items():
            default = rows[key][-1]
            if entry.default is PydanticUndefined and entry.default_factory is None:
                assert default == "required", f"[{section}] {key}"
            elif isinstance(entry.default, bool):
                assert default == f"`{str(entry.default).lower()}`", f"[{section}] {key}"
            elif isinstance(entry.default, str | float | int):
                value = f'"{entry.default}"' if isinstance(entry.default, str) else str(entry.default)
                assert default == f"`{value}`", f"[{section}] {key}"
            else:
                assert default != "required", f"[{section}] {key}"
                assert not default.startswith("`"), f"[{section}] {key}"


def test_the_reference_has_every_public_name() -> None:
    from geomosaic import _HOMES

    pages = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "reference").glob("*.md"))
    documented = {line.removeprefix("::: ").strip() for line in pages.splitlines() if line.startswith("::: ")}
    missing = [name for name, home in _HOMES.items() if not {home, f"{home}.{name}"} & documented]
    assert missing == []


def test_the_page_of_options_is_made_from_their_declarations() -> None:
    made = runpy.run_path(str(DOCS / "make_options_page.py"))["page"]()
    assert (DOCS / "options.md").read_text(encoding="utf-8") == made, "run python docs/make_options_page.py"


def test_every_key_of_a_camera_is_documented() -> None:
    """The page has every key and every coefficient of the camera file."""
    from geomosaic_frame.camera import KEYS
    from geomosaic_frame.lenses import COEFFICIENTS

    shown = tables(DOCS / "projects.md")
    assert set(shown["camera.toml"]) == set(KEYS)
    lenses = shown["[distortion]"]
    assert set(lenses) == set(COEFFICIENTS)
    for lens, coefficients in COEFFICIENTS.items():
        assert re.findall(r"[kps]\d", lenses[lens][0]) == list(coefficients)


def test_every_column_of_the_tables_is_documented() -> None:
    """The page has the columns of orientation and control point tables, and the angle systems."""
    from geomosaic.inputs.control_points import COLUMNS, CORRELATIONS, SIGMAS_OF_AXES, SIGMAS_OF_POSITION
    from geomosaic.options.inputs import ANGLE_SYSTEMS
    from geomosaic_frame.orientation import SYSTEMS

    shown = tables(DOCS / "projects.md")
    accuracy = {"sigma_xy", "sigma_z", "sigma_px", *SIGMAS_OF_AXES, *CORRELATIONS, *SIGMAS_OF_POSITION}
    assert set(shown["gcps.csv"]) == {*COLUMNS, *accuracy, "role"}
    assert {"image", "x", "y", "z"} <= set(shown["exterior.csv"])
    page = (DOCS / "projects.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in page for name in ANGLE_SYSTEMS)
    angles = tables(DOCS / "conventions.md")["Angles"]
    assert set(angles) == set(SYSTEMS) | set(ANGLE_SYSTEMS)
    for name, system in SYSTEMS.items():
        assert angles[name][-1].startswith("true" if system.frame in ("local", "topocentric") else "grid"), name


def test_every_input_of_a_sensor_is_documented() -> None:
    """The page has the inputs of the built-in sensors."""
    from geomosaic.sensor.registry import plugin

    shown = tables(DOCS / "sensors.md")
    for name in ("frame", "panoramic", "planar", "pushbroom", "rpc"):
        assert set(shown[name]) == {entry.name for entry in plugin(name).inputs}


def test_the_sample_sensor_passes_the_kit_as_the_page_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kit's example runs, on the sensor the page shows."""
    from geomosaic.testing import failures

    monkeypatch.syspath_prepend(str(ROOT / "tests" / "sample_plugin"))
    names: dict[str, Any] = {}
    example = next(text for _, text in fenced(DOCS / "sensors.md", "python") if "SensorModelTests" in text)
    exec(example.replace("@pytest.fixture", ""), names)
    tests = names["TestVertical"]()
    assert failures(tests.model(), tests.ground()) == {}
    names["test_inputs"]()


def test_pictures_and_files_that_pages_name_are_there() -> None:
    """Pictures exist; paths of the repository named in the architecture page exist."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for picture in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text):
            assert (DOCS / picture).is_file(), f"{page.name}: {picture}"
        for path in re.findall(r"`((?:geomosaic|plugins|tests|data|docs|benchmarks)/[\w./]*)`", text):
            assert (ROOT / path).exists(), f"{page.name}: {path}"


def example(title: str) -> dict[str, Any]:
    """Names that a whole module on the page of extensions defines, found by the beginning of its docstring."""
    [code] = [code for _, code in fenced(DOCS / "extending.md", "python") if code.startswith(f'"""{title}')]
    names: dict[str, Any] = {"__name__": "example"}
    exec(compile(code, "extending.md", "exec"), names)
    return names


def test_the_command_of_the_page_of_extensions_works() -> None:
    from click.testing import CliRunner

    done = CliRunner().invoke(example("Print the extent")["command"], [str(ROOT / "data" / "sample" / "dem.tif")])
    assert done.exit_code == 0
    assert "398815 5499050 401155 5500955, WGS 84 / UTM zone 33N" in done.output


def test_the_control_format_of_the_page_of_extensions_is_read(tmp_path: Path) -> None:
    from geomosaic.control.parsing import read_lines
    from geomosaic.control.table import header_at
    from geomosaic.errors import InputError

    made = example("Control points of")
    file = tmp_path / "scan.pix"
    file.write_text("PIX\nA 10.5 20.5 400000 5500000 100\nB 90.5 20.5 400080 5500000 101\n")
    lines = read_lines(file)
    at = header_at(lines)
    assert at is not None
    assert made["is_pix"](lines[at][1])
    assert made["read_pix"](file, crs="EPSG:32633").control.names == ("A", "B")
    file.write_text("PIX\nA 10.5 20.5 400000\n")
    with pytest.raises(InputError, match="line 2: not six values"):
        made["read_pix"](file, crs="EPSG:32633")


def test_the_architecture_names_what_exists() -> None:
    """Each path is the end of one of the repository; each contract stands in the file or room named beside it."""
    sources = [
        path
        for folder in ("benchmarks", "docs", "geomosaic", "plugins", "tests")
        for path in (ROOT / folder, *(ROOT / folder).rglob("*"))
    ]
    sources += ROOT.glob("*.py")
    places = {f"/{path.relative_to(ROOT).as_posix()}" for path in sources}
    for page in (DOCS / "architecture.md", ROOT / "README.md"):
        for path in re.findall(r"`([\w./-]+(?:\.py|/))`", page.read_text(encoding="utf-8")):
            assert any(place.endswith(f"/{path.rstrip('/')}") for place in places), f"{page.name}: {path}"
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    for names, place in re.findall(r"^\| ([^|]+) \| `(geomosaic/[\w./]+)` \|", text, re.MULTILINE):
        files = [ROOT / place] if place.endswith(".py") else sorted((ROOT / place).glob("*.py"))
        code = "\n".join(file.read_text(encoding="utf-8") for file in files)
        for name in re.findall(r"`(\w+)[\w.]*`", names):
            assert re.search(rf"^class {name}\b", code, re.MULTILINE), f"{place}: {name}"


def test_scripts_beside_the_program_import_what_exists() -> None:
    """Pictures of the pages, the gallery and the benchmarks are made seldom; what they import is looked up here."""
    for file in sorted([*DOCS.rglob("*.py"), *(ROOT / "benchmarks").glob("*.py")]):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("geomosaic"):
                module = importlib.import_module(node.module or "")
                missing = [name.name for name in node.names if not hasattr(module, name.name)]
                assert not missing, f"{file.name}, line {node.lineno}: {missing}"


@pytest.mark.slow  # by default only what they import of the program is looked up
@pytest.mark.parametrize("script", sorted(DOCS.glob("**/make_*.py")), ids=lambda script: script.stem)
def test_scripts_of_the_pages_find_what_they_import(script: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"import {script.stem}"], check=False, capture_output=True, text=True, cwd=ROOT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, [script.parent, ROOT, ROOT / "plugins"]))},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_no_page_names_a_place_of_one_machine() -> None:
    """Pages hold for every machine."""
    for page in PAGES:
        assert not re.search(r"(?<![\w.])/(work|tmp|home|root|opt)\b", page.read_text(encoding="utf-8")), page.name
