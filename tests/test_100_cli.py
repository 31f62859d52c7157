"""The command line: how quickly it starts, and what it says."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from importlib.metadata import EntryPoint

import click
import pytest
from cli_rig import flags, photos
from helpers import forget_sensors

from geomosaic.cli.main import GROUPS, commands
from geomosaic.cli.values import json_pairs

HEAVY = ("pydantic", "rich", "geopandas", "pandas", "scipy", "shapely", "pystac", "jinja2", "PIL", "pyogrio")

# Start-up


def test_help_names_every_command_and_loads_nothing():
    """How quick it is, `test_05_architecture.py` measures."""
    command = [sys.executable, "-X", "importtime", "-m", "geomosaic.cli", "--help"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert all(name in done.stdout for name in (*commands(), *GROUPS))
    loaded = {line.split("|")[2].strip().split(".")[0] for line in done.stderr.splitlines() if line.count("|") == 2}
    assert not loaded & {"numpy", "rasterio", "pyproj", *HEAVY}


def test_every_command_has_help_with_its_options(tell):
    def asked(*words: str) -> str:
        code, out, _ = tell(*words, "--help")
        assert code == 0
        return out

    for name in commands():
        command = import_module(f"geomosaic.cli.commands.{name}").command
        own = getattr(command, "commands", None)
        for out in [asked(name)] if own is None else [asked(name, part) for part in own]:
            assert "--json" in out


def test_an_ortho_of_a_small_job_loads_nothing_heavy(block, tmp_path):
    script = "import sys; from geomosaic.cli.main import run; code = run(sys.argv[1:]); print(code, *sys.modules)"
    words = ["ortho", photos(block)[0], *flags(block), "--res", "8", "-o", str(tmp_path / "o.tif")]
    done = subprocess.run([sys.executable, "-c", script, *words], check=True, capture_output=True, text=True)
    code, *modules = done.stdout.splitlines()[-1].split()
    assert code == "0"
    assert not {name.split(".")[0] for name in modules} & set(HEAVY)


# What it says


def test_sensors_lists_the_plugins(tell):
    code, out, _ = tell("sensors", "--json")
    assert code == 0
    assert {"frame", "planar"} <= {entry["name"] for entry in json.loads(out)["sensors"]}
    code, out, _ = tell("sensors", "frame")
    assert code == 0
    assert all(word in out for word in ("camera", "orientation", "treatment", "angle_unit"))
    code, _, err = tell("sensors", "fram")
    assert code == 1
    assert "did you mean 'frame'" in err


def test_a_broken_sensor_is_listed_and_reported_by_name_only(tell, monkeypatch):
    from geomosaic.sensor import registry

    broken = EntryPoint("broken", "no_such_module:plugin", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda **_: [broken])
    forget_sensors()
    assert tell("sensors")[:2] == (0, "broken  unknown \n")
    code, _, err = tell("sensors", "broken")
    assert code == 1
    assert "no_such_module" in err
    forget_sensors()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["orto"], "Did you mean 'ortho'"),
        (["ortho"], "IMAGE"),
        (["ortho", "a.tif", "-o", "b.tif", "--resampling", "cubid"], "cubid"),
        (["ortho", "a.tif", "-o", "b.tif", "--mem-limit", "lots"], "512M"),
        (["ortho", "a.tif", "-o", "b.tif", "--mem-limit", "1M"], "too little"),
        (["ortho", "a.tif", "-o", "b.tif", "--co", "COMPRESS"], "NAME=VALUE"),
        (["ortho", "a.tif", "-o", "b.tif", "--threads", "0"], "threads"),
        (["ortho", "a.tif", "-o", "b.tif", "--bounds", "1", "2", "3", "x"], "'--bounds': '1 2 3 x' is no area"),
        (["ortho", "a.tif", "-o", "b.tif", "--bounds", "5", "2", "3", "9"], "such as 399850 5499850"),
        (["ortho", "a.tif", "-o", "b.tif", "--bounds", "nan", "2", "3", "9"], "is no area"),
        (["ortho", "a.tif", "-o", "b.tif", "--resolution", "1"], "Did you mean '--res'?"),
        (["ortho", "a.tif", "-o", "b.tif", "--res", "wide"], "'--res': 'wide' is not a number; give a number above 0"),
        (["ortho", "a.tif", "-o", "b.tif", "--res", "0"], "0 is out of range; give a number above 0"),
        (["ortho", "a.tif", "-o", "b.tif", "--res", "inf"], "inf is no finite number"),
        (["ortho", "a.tif", "-o", "b.tif", "--dst-crs", "EPSG:999999"], "'--dst-crs': 'EPSG:999999' is not a coord"),
        (["mosaic", "a.tif", "-o", "b.tif", "--dst-crs", "there.prj"], "such as EPSG:32633"),
        (["mosaic", "a.tif", "-o", "b.tif", "--dst-crs", ""], "such as EPSG:32633"),
        (["mosaic", "a.tif", "-o", "b.tif", "--dst-crs", "EPSG:5773"], "has not two axes"),
        (["mosaic", "a.tif", "-o", "b.tif", "--dst-crs", "EPSG:4978"], "has not two axes"),
    ],
)
def test_wrong_usage_has_its_exit_code(tell, words, said):
    code, out, err = tell(*words)
    assert (code, out) == (2, "")
    assert said in err
    code, out, err = tell(*words, "--json")
    assert (code, err) == (2, "")
    assert said in json.loads(out)["error"]["what"]


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="names are text here")
def test_names_that_are_no_text(tell, block, tmp_path):
    odd = os.fsdecode(os.fsencode(tmp_path) + b"/b\xff.jpg")
    shutil.copy(photos(block)[0], odd)
    for words in (["ortho", odd, "-o", tmp_path / "o.tif"], ["ortho", photos(block)[0], "-o", odd]):
        code, _, err = tell(*words, *flags(block))
        assert code == 2
        assert "not UTF-8" in err
    project = tmp_path / "p.toml"
    project.write_text('format = 1\n[project]\nimages = ["*.jpg"]\n[sensor]\nname = "planar"\n')
    code, _, err = tell("run", project)
    assert code == 1
    assert "not UTF-8" in err


def test_a_raster_that_no_file_can_hold_is_refused_before_any_work(tell, block, tmp_path):
    words = ("ortho", photos(block)[0], *flags(block), "-o", tmp_path / "o.tif")
    code, _, err = tell(*words, "--res", "1e-6")
    assert code == 1
    assert "resolve no more than" in err
    code, _, err = tell(*words, "--res", "50", "--bounds", 0, 0, 5e6, 2e11)
    assert code == 1
    assert "more than a GeoTIFF can hold" in err
    assert "--res" in err


def test_outputs_larger_than_the_limit_are_refused_with_their_size_until_they_are_asked_for(tell, block, tmp_path):
    words = (*photos(block)[:2], *flags(block), "--no-balance", "--res", "2")
    for command, out in (("ortho", [photos(block)[0], *flags(block), "--res", "2"]), ("mosaic", words)):
        code, _, err = tell(command, *out, "-o", tmp_path / "o.tif", "--max-output", "100K")
        assert code == 1
        assert re.search(r"would have \d+ x \d+ pixels, [\d.]+ [kM]B uncompressed; --max-output allows 102\.4 kB", err)
        assert "--max-output 1G" in err
        assert list(tmp_path.iterdir()) == []
    bounds = ("--bounds", 375_000, 5_450_000, 425_000, 5_550_000)
    code, _, err = tell("ortho", photos(block)[0], *flags(block), "--res", "0.1", *bounds, "-o", tmp_path / "o.tif")
    assert code == 1
    assert "1500.0 GB uncompressed" in err
    assert "--max-output 1397G" in err


@pytest.mark.parametrize(
    "words",
    [
        ["ortho", "none.tif", "--sensor", "frame", "--camera", "none.toml", "--exterior", "none.csv"],
        ["mosaic", "none.tif", "other.tif"], ["reproject", "none.tif", "--dst-crs", "EPSG:32633"],
        ["georeference", "none.tif", "--gcps", "none.points"], ["enhance", "none.tif"],
    ],
)  # fmt: skip
def test_a_raster_called_as_a_picture_is_the_first_complaint(tell, tmp_path, words):
    code, _, said = tell(*words, "-o", tmp_path / "x.png")
    assert code == 1
    assert "x.png: the output would be a GeoTIFF, and is called '.png'" in said


@pytest.mark.parametrize(("command", "one"), [("ortho", 220), ("mosaic", 400), ("run", 450), ("demo", 450)])
def test_a_limit_that_cannot_be_kept_is_refused_with_the_least_that_can(tell, block, tmp_path, command, one):
    words = {
        "ortho": ["ortho", photos(block)[0], *flags(block), "-o", tmp_path / "o.tif"],
        "mosaic": ["mosaic", photos(block)[0], *flags(block), "-o", tmp_path / "o.tif"],
    }.get(command, [command, tmp_path / "nowhere"])
    code, out, err = tell(*words, "--mem-limit", f"{one - 1}M")
    assert (code, out) == (2, "")
    assert f"takes up to {one}M with 1 thread; write {one}M, or leave it out" in err
    code, out, err = tell(*words, "--mem-limit", f"{one + 1}M", "--threads", 2)
    assert code == 2
    assert f"write {one + 80}M, or --threads 1" in err
    assert list(tmp_path.iterdir()) == []


def test_a_limit_lowers_the_threads_that_nobody_asked_for(tell, block, tmp_path, monkeypatch):
    from geomosaic.cli import options as module

    monkeypatch.setattr("geomosaic.options.memory.os.cpu_count", lambda: 64)
    given = []
    limited = module.threads_within_memory
    monkeypatch.setattr(module, "threads_within_memory", lambda values: given.append(limited(values)) or given[-1])
    words = ["ortho", photos(block)[0], *flags(block), "--res", 8, "--overwrite", "-o", tmp_path / "o.tif"]
    for more in (["--mem-limit", "310M"], ["--mem-limit", "2G", "--threads", 2], []):
        assert tell(*words, *more)[0] == 0
    assert given == [{"threads": 2}, {"threads": 2}, {}]


@pytest.mark.parametrize("command", ["match", "layover"])
def test_a_limit_is_taken_by_commands_whose_memory_is_not_foretold(tell, tmp_path, command):
    code, _, err = tell(command, tmp_path / "none.tif", "--mem-limit", "1G", "-o", tmp_path / "o.tif")
    assert (code, "fault of geomosaic" in err) == (1, False)


def test_sizes_are_read():
    from geomosaic.options.render import parse_size

    assert [parse_size(text) for text in ("512M", "2G", "1.5g", "100MiB", str(1 << 28))] == [
        512 << 20, 2 << 30, 3 << 29, 100 << 20, 1 << 28,
    ]  # fmt: skip


def test_a_bug_is_reported_as_one_and_ctrl_c_exits_as_shells_expect(tell, monkeypatch):
    import geomosaic.products.orthos as make

    def fail(*_: object) -> None:
        raise RuntimeError("boom")

    monkeypatch.setattr(make, "make_ortho", fail)
    code, _, err = tell("ortho", "a.tif", "-o", "b.tif")
    assert code == 1
    assert "RuntimeError: boom" in err
    assert "report it" in err
    assert "Traceback" not in err
    assert "Traceback" in tell("ortho", "a.tif", "-o", "b.tif", "--debug")[2]

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(make, "make_ortho", interrupt)
    assert tell("ortho", "a.tif", "-o", "b.tif")[0] == 130


def test_values_of_names_are_what_json_has_a_list_of_numbers_or_a_text() -> None:
    given = ("offset=5150,5000", "corner=[1, 2]", "north=true", "gain=1.5", "name=a,b", "text=", "mixed=1,b")
    read = json_pairs(click.Context(click.Command("x")), click.Option(["--option"]), given)
    numbers = {"offset": [5150, 5000], "corner": [1, 2], "north": True, "gain": 1.5}
    assert read == numbers | {"name": "a,b", "text": "", "mixed": "1,b"}
