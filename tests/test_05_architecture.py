"""Layers are kept, and the doors everyone goes through open fast."""

from __future__ import annotations

import ast
import os
import re
import runpy
import subprocess
import sys
import time
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
HEAVY = {
    "affine", "contourpy", "geopandas", "jinja2", "matplotlib", "numpy", "PIL", "pandas", "pydantic",
    "pyogrio", "pyproj", "pystac", "rasterio", "scipy", "shapely",
}  # fmt: skip
HELP_SECONDS = 0.4


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python on this source tree."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "plugins"), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=environment, cwd=ROOT, check=False
    )


def spent() -> float:
    """Seconds that child processes have had of the processor so far; the clock's where there is no telling."""
    if sys.platform == "win32":
        return time.perf_counter()
    import resource

    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return children.ru_utime + children.ru_stime


def modules(pattern: str) -> Iterator[tuple[Path, ast.Module]]:
    """Syntax trees of the files of program and plugins whose text has a pattern; all of them at once take seconds."""
    for root in ("geomosaic", "plugins"):
        for file in (ROOT / root).rglob("*.py"):
            if re.search(pattern, text := file.read_text(encoding="utf-8")):
                yield file.relative_to(ROOT), ast.parse(text)


def imported(*arguments: str) -> set[str]:
    """Top-level packages that a command imports."""
    done = run("-X", "importtime", *arguments)
    assert done.returncode == 0, done.stderr[-2000:]
    lines = [line for line in done.stderr.splitlines() if line.startswith("import time:")]
    return {line.rsplit("|", 1)[1].strip().split(".")[0] for line in lines}


def test_imports_go_down_only() -> None:
    """The contracts of [tool.importlinter]: imports go down, plugins stand apart, raster alone uses GDAL."""
    done = run("-c", "from importlinter.cli import lint_imports_command; lint_imports_command()", "--no-cache")
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert "0 broken" in done.stdout


def imports_of(texts: dict[str, str]) -> dict[str, set[str]]:
    """Modules that each module imports, inside functions too; by a pattern, as syntax trees take seconds."""
    found: dict[str, set[str]] = {name: set() for name in texts}
    for name, text in texts.items():
        for module, members in re.findall(r"^ *from (geomosaic[\w.]*) import (\([^)]*\)|.*)", text, re.MULTILINE):
            names = {f"{module}.{member}" for member in re.findall(r"\w+", members)}
            found[name] |= (names & texts.keys() or {module} & texts.keys()) - {name}
    return found


def test_files_import_each_other_in_no_circle() -> None:
    """The layers are of whole rooms; circles of files inside a room are found here, with imports inside functions."""
    files = {
        file.relative_to(root): file for root in (ROOT, ROOT / "plugins") for file in root.glob("geomosaic*/**/*.py")
    }
    names = {file: ".".join(part.with_suffix("").parts).removesuffix(".__init__") for part, file in files.items()}
    texts = {name: file.read_text(encoding="utf-8") for file, name in names.items()}
    assert len(texts) > 300
    TopologicalSorter(imports_of(texts)).prepare()  # a circle is a `CycleError` that names it
    circle = {"geomosaic.a": "from geomosaic.b import x", "geomosaic.b": "def f():\n    from geomosaic import a"}
    with pytest.raises(CycleError):
        TopologicalSorter(imports_of(circle)).prepare()


def test_import_is_light() -> None:
    assert not imported("-c", "import geomosaic") & HEAVY


def test_lazy_names_are_there() -> None:
    import geomosaic
    import geomosaic.sensor.solve
    import geomosaic.testing
    import geomosaic_planar
    import geomosaic_rpc

    for module in (geomosaic, geomosaic.testing, geomosaic.sensor.solve, geomosaic_planar, geomosaic_rpc):
        for name in module.__all__:
            assert getattr(module, name) is not None
        with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
            _ = module.nonsense


def test_help_imports_nothing_heavy() -> None:
    assert not imported("-m", "geomosaic.cli", "--help") & HEAVY


def test_help_is_fast() -> None:
    """Where the system tells it, in time of the processor: how busy the machine is besides is no fault of ours."""
    best = float("inf")
    for _ in range(5):
        start = spent()
        done = run("-m", "geomosaic.cli", "--help")
        best = min(best, spent() - start)
        assert done.returncode == 0
        assert "Usage" in done.stdout
    assert best < HELP_SECONDS, f"--help takes {best:.2f} s at best"


def named_sensors(tree: ast.Module, names: set[str]) -> list[int]:
    """Lines of string constants that are the name of a sensor.

    Texts that people read may name one (`geomosaic sensors NAME` in a help or a docstring): they are longer than the
    name. A key of a dictionary, of an index or of `.get(...)`, or a section, is a word of a file format or of the
    command line, like `[planar]` of a project, whatever it is spelt like.
    """
    keys: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Dict):
            keys |= {id(key) for key in node.keys}
        elif isinstance(node, ast.Subscript):
            keys.add(id(node.slice))
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
            keys |= {id(argument) for argument in node.args[:1]}
        elif isinstance(node, ast.keyword) and node.arg == "section":
            keys.add(id(node.value))
    return [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and node.value in names and id(node) not in keys
    ]


def test_the_core_knows_no_sensor_by_name() -> None:
    """Sensors are found by their capabilities; see `geomosaic.sensor.plugin.Capabilities`."""
    from geomosaic.sensor.registry import sensors

    names = {entry.name for entry in sensors() if entry.distribution == "geomosaic"}
    assert len(names) >= 5
    found = {
        f"{path}:{line}"
        for path, tree in modules(f"[\"'](?:{'|'.join(names)})[\"']")
        if path.parts[0] == "geomosaic"
        for line in named_sensors(tree, names)
    }
    assert not found
    assert named_sensors(ast.parse("if sensor == 'planar': pass"), names) == [1]
    assert named_sensors(ast.parse("x = {'planar': y['planar']}; 'see `geomosaic sensors planar`'"), names) == []


USER_ERRORS = {
    "InputError", "HeightDatumError", "SensorInputError", "RasterReadError", "OutputExistsError", "SolveError",
}  # fmt: skip
# Readers of other programs' files: whoever calls them says once for all faults to get or write the file again.
UNDER_A_DEFAULT_HINT = ("geomosaic/interchange/",)


def test_every_error_of_a_user_says_how_to_go_on() -> None:
    without = {
        f"{path}:{node.lineno}"
        for path, tree in modules(rf"\b(?:{'|'.join(USER_ERRORS)})\(")
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in USER_ERRORS
        if not {word.arg for word in node.keywords} & {"hint", None}  # None: **keywords
    }
    assert not {place for place in without if not place.startswith(UNDER_A_DEFAULT_HINT)}
    unneeded = [file for file in UNDER_A_DEFAULT_HINT if not any(place.startswith(file) for place in without)]
    assert not unneeded


def test_public_functions_say_their_parameters() -> None:
    """Functions of modules list all of them with shapes and units."""
    count_code = runpy.run_path(str(ROOT / "docs" / "count_code.py"))
    undocumented = count_code["undocumented"]
    found = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in count_code["FILES"].values()
        for name in undocumented(path.read_text(encoding="utf-8"))
    }
    assert not found
    assert undocumented('def f(x: int) -> int:\n    """Square."""\n    return x\n') == ["f"]
    part = '    """Sum.\n\n    Parameters\n    ----------\n    x : int\n    """\n'
    assert undocumented(f"def f(x: int, y: int) -> int:\n{part}    return x + y\n") == ["f"]


# What a small job has no use for: of each it would cost more to load than an image of 512 x 512 pixels to render.
IDLE = (
    "contourpy", "geopandas", "jinja2", "matplotlib", "pandas", "PIL", "pydantic", "pyogrio", "pystac",
    "rasterio.features", "scipy", "shapely", "geomosaic.enhancement", "geomosaic.jobs", "geomosaic.matching",
    "geomosaic.monoplotting", "geomosaic.mosaicking", "geomosaic.options.mosaic", "geomosaic.options.planning",
    "geomosaic.options.sheet", "geomosaic.planning", "geomosaic.project", "geomosaic.relief", "geomosaic.sheets",
)  # fmt: skip
IDLE_WITHOUT_CONTROL = (
    "geomosaic.accuracy", "geomosaic.control.read", "geomosaic.control.diagnostics", "geomosaic.estimation",
    "geomosaic.georeferencing", "geomosaic.options.control", "geomosaic.orientation",
)  # fmt: skip


# Command line, rooms that are idle besides, and the most modules of our own that are loaded: two more than today.
SMALL_JOBS: dict[str, tuple[str, tuple[str, ...], int]] = {
    "ortho": (
        "ortho photo.tif --sensor frame --camera camera.toml --exterior exterior.csv --exterior-crs EPSG:32631 "
        "--heights ellipsoidal --height 100 --res 1 -o out.tif",
        IDLE_WITHOUT_CONTROL,
        117,
    ),
    "reproject": ("reproject map.tif --dst-crs EPSG:2154 -o out.tif", IDLE_WITHOUT_CONTROL, 107),
    "georeference": (
        "georeference photo.tif --gcps control.csv --crs EPSG:32631 --model affine --no-report -o out.tif",
        (),
        134,
    ),
}


@pytest.mark.parametrize("job", SMALL_JOBS)
def test_a_small_job_loads_what_it_needs(tmp_path: Path, job: str) -> None:
    """Starting is most of such a job: what stands in another room is loaded where it is used."""
    from rigs import mosaic_rig, product_rig

    command, beside, most = SMALL_JOBS[job]
    grey = np.arange(4096, dtype=np.uint8).reshape(64, 64, 1)
    product_rig.write(tmp_path / "photo.tif", grey)
    mosaic_rig.write(tmp_path / "map.tif", grey, crs="EPSG:32631")
    (tmp_path / "camera.toml").write_text("size = [64, 64]\nfocal_length_px = 64.0\n")
    (tmp_path / "exterior.csv").write_text("image,x,y,z,omega,phi,kappa\nphoto.tif,500000,5000000,200,0,0,0\n")
    corners = [(5e5 + col, 5e6 - row, col, row) for col in (2, 30, 61) for row in (3, 35, 60)]
    rows = [f"{number},{x},{y},{col},{row}\n" for number, (x, y, col, row) in enumerate(corners)]
    (tmp_path / "control.csv").write_text("id,x,y,col,row\n" + "".join(rows))
    script = (
        "import os, sys; from geomosaic.cli.main import run; os.chdir(sys.argv[1]); code = run(sys.argv[2:]); "
        "print('LOADED', *sys.modules); sys.exit(code)"
    )
    done = run("-W", "ignore", "-c", script, str(tmp_path), *command.split())
    assert done.returncode == 0, done.stderr
    loaded = next(line.split()[1:] for line in done.stdout.splitlines() if line.startswith("LOADED"))
    idle = [name for name in loaded for room in (*IDLE, *beside) if name == room or name.startswith(f"{room}.")]
    assert not idle
    own = [name for name in loaded if name.startswith("geomosaic")]
    assert len(own) <= most, own


def test_a_project_loads_no_control_before_it_reads_any() -> None:
    done = run("-c", "import geomosaic.jobs.project, sys; print(*sys.modules)")
    idle = (
        "geomosaic.control.read", "geomosaic.estimation.blunders", "geomosaic.options.control",
        "geomosaic.options.sheet", "geomosaic.orientation.single", "geomosaic.planning", "scipy", "shapely",
    )  # fmt: skip
    assert not [name for name in done.stdout.split() for room in idle if name == room or name.startswith(f"{room}.")]
    assert done.returncode == 0, done.stderr
