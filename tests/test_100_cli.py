"""The command line: what it prints, what it writes, how it fails."""

from __future__ import annotations

import base64
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from html.parser import HTMLParser
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image

from geomosaic.cli.main import COMMANDS, run
from geomosaic.jobs.facts import read_json

PHOTOS = ("strip1_02.jpg", "strip1_03.jpg", "strip2_02.jpg", "strip2_03.jpg")
PLACE = ("--res", "1", "--bounds", "399850", "5499850", "400250", "5500150")
HEAVY = ("pydantic", "rich", "geopandas", "pandas", "scipy", "shapely", "numba", "pystac", "jinja2", "PIL", "pyogrio")


@pytest.fixture(scope="session")
def block(sample, tmp_path_factory) -> Path:
    """Four photos of the sample with their tables; read only."""
    folder = tmp_path_factory.mktemp("block")
    (folder / "photos").mkdir()
    for name in PHOTOS:
        shutil.copy(sample / "photos" / name, folder / "photos")
    for name in ("camera.toml", "exterior.csv", "gcps.csv", "dem.tif"):
        shutil.copy(sample / name, folder)
    return folder


def flags(block: Path, **change: object) -> list[str]:
    """Flags of the block, some of them changed or (None) left out."""
    given = {
        "sensor": "frame",
        "camera": block / "camera.toml",
        "exterior": block / "exterior.csv",
        "crs": "EPSG:32633",
        "heights": "egm96",
        "dem": block / "dem.tif",
    } | change
    return [
        word
        for name, value in given.items()
        if value is not None
        for word in (f"--{name.replace('_', '-')}", str(value))
    ]


def photos(block: Path) -> list[str]:
    return [str(block / "photos" / name) for name in PHOTOS]


@pytest.fixture(scope="session")
def project(block, tmp_path_factory) -> Path:
    """A project made by `new` and run once over a small place; tests copy it before they change it."""
    folder = tmp_path_factory.mktemp("project") / "one"
    shutil.copytree(block, folder)
    file = folder / "trial.toml"
    words = ["new", str(file), *photos(folder), *flags(folder), "--gcps", str(folder / "gcps.csv")]
    assert run(words) == 0
    text = file.read_text().replace("# resolution = 0.5 ", "resolution = 1.0 ")
    file.write_text(text.replace("# bounds = [left, bottom, right, top]", f"bounds = [{', '.join(PLACE[3:])}]"))
    assert run(["run", str(file)]) == 0
    return file


@pytest.fixture
def own(project, tmp_path) -> Path:
    """A copy of the project that a test may change."""
    shutil.copytree(project.parent, tmp_path / "own")
    return tmp_path / "own" / project.name


@pytest.fixture
def tell(capsys) -> Callable[..., tuple[int, str, str]]:
    """Run the command line: exit code, standard output, standard error."""

    def call(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(word) for word in words])
        return code, *capsys.readouterr()

    return call


def elsewhere(*words: object, **more: object) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own."""
    command = [sys.executable, "-m", "geomosaic.cli", *map(str, words)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=300, **more)


# Start-up


def test_help_names_every_command_and_loads_nothing():
    """How quick it is, `test_05_architecture.py` measures."""
    command = [sys.executable, "-X", "importtime", "-m", "geomosaic.cli", "--help"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert all(name in done.stdout for name in COMMANDS)
    loaded = {line.split("|")[2].strip().split(".")[0] for line in done.stderr.splitlines() if line.count("|") == 2}
    assert not loaded & {"numpy", "rasterio", "pyproj", *HEAVY}


def test_every_command_has_help_with_its_options(tell):
    def asked(*words: str) -> str:
        code, out, _ = tell(*words, "--help")
        assert code == 0
        return out

    for name in COMMANDS:
        command = import_module(f"geomosaic.cli.{name}").command
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


def test_sensors(tell):
    code, out, _ = tell("sensors", "--json")
    assert code == 0
    assert {"frame", "planar"} <= {entry["name"] for entry in json.loads(out)["sensors"]}
    code, out, _ = tell("sensors", "frame")
    assert code == 0
    assert all(word in out for word in ("camera", "orientation", "treatment", "angle_unit"))
    code, _, err = tell("sensors", "fram")
    assert code == 1
    assert "did you mean 'frame'" in err


def test_a_broken_sensor_is_listed_and_told_by_name_only(tell, monkeypatch):
    from geomosaic.sensor import registry

    broken = EntryPoint("broken", "no_such_module:plugin", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda **_: [broken])
    registry.plugin.cache_clear()
    assert tell("sensors")[:2] == (0, "broken  unknown \n")
    code, _, err = tell("sensors", "broken")
    assert code == 1
    assert "no_such_module" in err
    registry.plugin.cache_clear()


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
        (["ortho", "a.tif", "-o", "b.tif", "--res", "wide"], "'--res': 'wide' is not a pixel size"),
        (["ortho", "a.tif", "-o", "b.tif", "--res", "0"], "such as 0.5"),
        (["ortho", "a.tif", "-o", "b.tif", "--res", "inf"], "such as 0.5"),
        (["ortho", "a.tif", "-o", "b.tif", "--dst-crs", "EPSG:999999"], "'--dst-crs': 'EPSG:999999' is not a coord"),
        (["mosaic", "a.tif", "-o", "b.tif", "--dst-crs", "there.prj"], "such as EPSG:32633"),
        (["mosaic", "a.tif", "-o", "b.tif", "--dst-crs", ""], "such as EPSG:32633"),
        (["mosaic", "a.tif", "-o", "b.tif", "--dst-crs", "EPSG:5773"], "has not two axes"),
        (["mosaic", "a.tif", "-o", "b.tif", "--dst-crs", "EPSG:4978"], "has not two axes"),
    ],
)
def test_wrong_usage_is_2(tell, words, said):
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
    code, _, err = tell("ortho", photos(block)[0], *flags(block), "--res", "1e-6", "-o", tmp_path / "o.tif")
    assert code == 1
    assert "more than a GeoTIFF can hold" in err
    assert "resolution" in err


def test_a_limit_that_cannot_be_kept_is_noted_and_the_work_goes_on(tell, block, tmp_path):
    words = ["ortho", photos(block)[0], *flags(block), "--res", 8, "--overwrite", "-o", tmp_path / "o.tif"]
    code, out, err = tell(*words, "--mem-limit", "100M", "--threads", 2, "--json")
    assert code == 0
    assert json.loads(out)["valid_pixels"] > 0
    assert err.startswith("note: --mem-limit 100M may be exceeded: with 2 threads")
    assert "300M" in err
    for kept in (["--mem-limit", "256M"], []):
        assert tell(*words, "--threads", 1, *kept)[2] == ""


@pytest.mark.parametrize(("command", "below", "least"), [("ortho", 89, 90), ("mosaic", 169, 170)])
def test_a_limit_that_not_even_the_smallest_work_keeps_is_refused(tell, block, tmp_path, command, below, least):
    words = [command, photos(block)[0], *flags(block), "--res", 8, "--threads", 1, "-o", tmp_path / "o.tif"]
    code, out, err = tell(*words, "--mem-limit", f"{below}M")
    assert (code, out) == (2, "")
    assert f"at least {least}M" in err
    assert not (tmp_path / "o.tif").exists()
    assert tell(*words, "--mem-limit", f"{least}M")[0] == 0


def test_a_project_is_run_in_no_less_than_it_takes(tell):
    for command, least in (("run", 190), ("demo", 450)):
        code, _, err = tell(command, "nowhere", "--mem-limit", f"{least - 1}M")
        assert code == 2
        assert f"at least {least}M" in err


def test_sizes_are_read():
    from geomosaic.cli.values import size

    assert [size(None, None, text) for text in ("512M", "2G", "1.5g", "100MiB", str(1 << 28))] == [
        512 << 20, 2 << 30, 3 << 29, 100 << 20, 1 << 28,
    ]  # fmt: skip


def test_a_bug_is_told_as_one_and_ctrl_c_is_130(tell, monkeypatch):
    import geomosaic.project.make as make

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


# Orthos and mosaics


def test_a_project_and_the_command_make_the_same_bytes(tell, block, project, tmp_path):
    code, out, _ = tell("mosaic", *photos(block), *flags(block), *PLACE, "-o", tmp_path / "m.tif", "--json")
    assert code == 0
    facts = json.loads(out)
    assert (tmp_path / "m.tif").read_bytes() == (project.parent / "output" / "trial.tif").read_bytes()
    assert facts["lattice_error_px"] <= facts["tolerance_px"]
    assert sum(facts["pixels_per_image"]) == facts["valid_pixels"] > 50_000
    after, before = np.array(facts["overlap_difference_after"]), np.array(facts["overlap_difference_before"])
    assert (after < before).all()


def test_a_mosaic_and_nothing_else(tell, block, project, tmp_path):
    """The same bytes, without what says how they came about."""
    words = [*photos(block), *flags(block), *PLACE, "--no-labels", "--no-records", "--json"]
    code, out, err = tell("mosaic", *words, "-o", tmp_path / "m.tif")
    assert code == 0, err
    assert [path.name for path in tmp_path.iterdir()] == ["m.tif"]
    assert (tmp_path / "m.tif").read_bytes() == (project.parent / "output" / "trial.tif").read_bytes()
    facts = json.loads(out)
    assert facts["labels"] is facts["vectors"] is facts["stac"] is None
    assert sum(facts["pixels_per_image"]) == facts["valid_pixels"]


def test_georeferenced_images_need_no_sensor(tell, project, tmp_path):
    """A mosaic of a mosaic on its own grid is itself."""
    mosaic = project.parent / "output" / "trial.tif"
    words = ["--resampling", "nearest", "--no-balance", "--no-labels", "-f", "GTiff"]
    with rasterio.open(mosaic) as source:
        bounds = [str(v) for v in source.bounds]
        code, _, err = tell("mosaic", mosaic, "--res", 1, "--bounds", *bounds, *words, "-o", tmp_path / "again.tif")
        assert code == 0, err
        with rasterio.open(tmp_path / "again.tif") as again:
            seen = source.dataset_mask() > 0
            assert ((again.dataset_mask() > 0) == seen).mean() > 0.999
            both = seen & (again.dataset_mask() > 0)
            assert (again.read()[:, both] == source.read()[:, both]).all()
    assert not (tmp_path / "again-labels.tif").exists()


def test_an_output_is_never_written_over_unasked(tell, block, tmp_path):
    out = tmp_path / "o.tif"
    out.write_text("precious")
    words = ["ortho", photos(block)[0], *flags(block), "--res", 8, "-o", out]
    code, _, err = tell(*words)
    assert code == 1
    assert "--overwrite" in err
    assert out.read_text() == "precious"
    assert tell(*words, "--overwrite")[0] == 0
    with rasterio.open(out) as made:
        assert made.count == 3


def test_an_input_is_never_written_over_asked_for_or_not(tell, block, tmp_path):
    """The first photo as output, as companion of the output, and where the project file should be named."""
    own = tmp_path / "own"
    shutil.copytree(block, own)
    before = {path: path.read_bytes() for path in own.rglob("*.*")}
    link = own / "link.jpg"
    link.symlink_to(photos(own)[0])
    for output in (photos(own)[0], link, own / "dem.tif", own / "exterior.csv"):
        code, _, err = tell("ortho", photos(own)[0], *flags(own), "--res", 8, "--overwrite", "-o", output)
        assert code == 1
        assert "one of the inputs" in err
        assert str(output) in err
    labels = own / "all-labels.tif"
    labels.write_bytes(Path(photos(own)[1]).read_bytes())
    before[labels] = labels.read_bytes()
    code, _, err = tell("mosaic", labels, *flags(own), "--res", 8, "--overwrite", "-o", own / "all.tif")
    assert (code, "one of the inputs" in err) == (1, True)
    code, _, err = tell("new", *photos(own), *flags(own), "--overwrite")
    assert code == 2
    assert "the project file comes first" in err
    link.unlink()
    assert {path: path.read_bytes() for path in own.rglob("*.*")} == before


def test_a_raster_is_not_written_under_the_name_of_another_format(tell, block, tmp_path):
    for name, said in (("m.jpg", "called '.jpg'"), ("m.gpkg", "called '.gpkg'")):
        for command, image in (("ortho", photos(block)[:1]), ("mosaic", photos(block))):
            code, printed, err = tell(command, *image, *flags(block), "--res", 8, "-o", tmp_path / name)
            assert (code, printed) == (1, "")
            assert said in err
            assert "m.tif" in err
    code, _, err = tell("ortho", photos(block)[0], *flags(block), "--overwrite", "-o", os.devnull)
    assert (code, "no ordinary file" in err) == (1, True)
    code, _, err = tell("ortho", photos(block)[0], *flags(block), "--overwrite", "-o", tmp_path)
    assert (code, "is a folder" in err) == (1, True)
    assert not list(tmp_path.iterdir())


def test_numbers_of_a_palette_are_not_averaged(tell, block, tmp_path):
    """Between colour 3 and colour 5 of a palette lies colour 4, which may be any."""
    paletted = [tmp_path / Path(name).with_suffix(".png").name for name in photos(block)]
    for path, name in zip(paletted, photos(block), strict=True):
        with Image.open(name) as image:
            image.convert("P", palette=Image.Palette.ADAPTIVE).save(path)
    out = tmp_path / "out.tif"
    for command, images in (("ortho", paletted[:1]), ("mosaic", paletted), ("mosaic", [*paletted, "--rule", "first"])):
        words = (command, *images, *flags(block), "--res", 8, "-o", out)
        code, _, err = tell(*words)
        assert code == 1
        assert "palette" in err
        assert "gdal_translate -expand rgb" in err
        assert not out.exists()
    assert tell("ortho", paletted[0], *flags(block), "--res", 8, "--resampling", "nearest", "-o", out)[0] == 0
    with rasterio.open(out) as made, Image.open(paletted[0]) as image:
        assert set(np.unique(made.read(1))) <= set(np.unique(np.asarray(image))) | {0}


# Bad input: each with a message, exit code 1, and nothing under the final name


def spoil(block: Path, tmp_path: Path, kind: str) -> tuple[list[str], dict[str, object], tuple[str, ...]]:
    """Image, changed flags, and words that the message must have."""
    image = photos(block)[0]
    table = (block / "exterior.csv").read_text()
    spoiled = tmp_path / "exterior.csv"

    def angles(change: Callable[[list[str]], list[str]]) -> Path:
        lines = table.splitlines()
        spoiled.write_text("\n".join([lines[0], *(",".join(change(line.split(","))) for line in lines[1:])]))
        return spoiled

    if kind == "missing image":
        return [str(tmp_path / "none.jpg")], {}, ("none.jpg", "does not exist")
    if kind == "truncated image":
        cut = tmp_path / PHOTOS[0]
        cut.write_bytes(Path(image).read_bytes()[:90_000])
        return [str(cut)], {}, (PHOTOS[0],)
    if kind == "no vertical datum":
        return [image], {"heights": None}, ("no vertical datum", " m here", " px", "--heights")
    if kind == "no vertical datum of the DEM":
        bare = tmp_path / "dem.tif"
        with rasterio.open(block / "dem.tif") as source:
            profile = source.profile | {"crs": "EPSG:32633"}
            with rasterio.open(bare, "w", **profile) as target:
                target.write(source.read())
        return [image], {"dem": bare}, ("no vertical datum", " m here", " px", "--dem-heights")
    if kind == "DEM elsewhere":
        away = tmp_path / "dem.tif"
        with rasterio.open(block / "dem.tif") as source:
            t = source.transform
            profile = source.profile | {"transform": rasterio.Affine(t.a, t.b, t.c + 1e5, t.d, t.e, t.f)}
            with rasterio.open(away, "w", **profile) as target:
                target.write(source.read())
        return [image], {"dem": away}, ("outside the DEM", PHOTOS[0])
    if kind == "DEM of NaN":
        empty = tmp_path / "dem.tif"
        with rasterio.open(block / "dem.tif") as source, rasterio.open(empty, "w", **source.profile) as target:
            target.write(np.full((1, *source.shape), np.nan, np.float32))
        return [image], {"dem": empty}, ("DEM", "no height")
    if kind == "sky":
        return [image], {"exterior": angles(lambda row: [*row[:4], str(float(row[4]) + 180), *row[5:]])}, ("sky",)
    if kind == "radians":
        turn = angles(lambda row: [*row[:4], *(str(float(v) * np.pi / 180) for v in row[4:])])
        return photos(block), {"exterior": turn}, ("radians", "rad")
    if kind == "wrong CRS":
        return [image], {"crs": "EPSG:99999"}, ("EPSG:99999", "not a coordinate reference system")
    if kind == "vertical CRS":
        return [image], {"crs": "EPSG:5773"}, ("EPSG:5773", "nothing of x and y", "horizontal CRS")
    if kind == "geocentric CRS with a geoid":
        return [image], {"crs": "EPSG:4978"}, ("geocentric", "egm96")
    if kind == "unknown sensor":
        return [image], {"sensor": "farme"}, ("did you mean 'frame'",)
    if kind == "unknown input":
        return [image], {"option": "treatmnet=planar"}, ("did you mean 'treatment'",)
    if kind == "no camera":
        return [image], {"camera": tmp_path / "none.toml"}, ("none.toml", "does not exist")
    if kind == "not an image":
        text = tmp_path / PHOTOS[0]
        text.write_text("this is no image")
        return [str(text)], {}, ("not a raster",)
    raise ValueError(kind)


KINDS = (
    "missing image", "truncated image", "no vertical datum", "no vertical datum of the DEM", "DEM elsewhere",
    "DEM of NaN", "sky", "radians", "wrong CRS", "vertical CRS", "geocentric CRS with a geoid",
    "unknown sensor", "unknown input", "no camera", "not an image",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_bad_input(tell, block, tmp_path, kind):
    images, change, said = spoil(block, tmp_path, kind)
    out = tmp_path / "out"
    out.mkdir()
    words = ["mosaic", *images, *flags(block, **change), "--res", 8, "-o", out / "m.tif"]
    code, printed, err = tell(*words)
    assert (code, printed) == (1, ""), err
    for word in said:
        assert word in err, err
    assert "fault of geomosaic" not in err
    assert not list(out.iterdir())
    code, printed, err = tell(*words, "--json")
    assert code == 1
    assert set(json.loads(printed)["error"]) == {"what", "where", "mend"}


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limits")
def test_a_full_disk_leaves_nothing_behind(block, tmp_path):
    import resource

    out = tmp_path / "out"
    out.mkdir()
    done = elsewhere(
        "ortho", photos(block)[0], *flags(block), "--res", 2, "-f", "GTiff", "-o", out / "o.tif",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000)),
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "o.tif" in done.stderr
    assert "fault of geomosaic" not in done.stderr
    assert not list(out.iterdir())


# Projects


def test_new_says_what_it_understood_and_what_it_needs(tell, block, tmp_path):
    file = tmp_path / "p.toml"
    code, out, _ = tell(
        "new", file, photos(block)[0], "--sensor", "frame", "--exterior", block / "exterior.csv", "--json"
    )
    assert code == 0
    said = json.loads(out)
    assert [any(word in text for text in said["needed"]) for word in ("camera", "CRS", "datum", "ground")] == [True] * 4
    code, _, err = tell("new", file, photos(block)[0])
    assert code == 1
    assert "--overwrite" in err
    code, out, _ = tell("new", file, *photos(block), *flags(block), "--overwrite")
    assert code == 0
    for word in ("4, 1200 x 900 pixels", "UTM zone 33N (EPSG:32633), metre; heights: EGM96", "angles in deg", "omega"):
        assert word in out
    assert "needs" not in out
    assert "ground sampling 0.7" in out


def test_new_tells_what_does_not_fit_together(tell, block, tmp_path):
    file = tmp_path / "p.toml"
    far = tmp_path / "far.csv"
    lines = (block / "exterior.csv").read_text().splitlines()
    head = lines[0].split(",")
    rows = [dict(zip(head, line.split(","), strict=True)) for line in lines[1:]]
    far.write_text("\n".join([lines[0], *(",".join({**row, "x": "700000"}[name] for name in head) for row in rows)]))
    code, out, _ = tell("new", file, *photos(block), *flags(block, exterior=far))
    assert code == 0
    assert "does not fit together" in out
    assert "mend that first" in out
    assert "run it" not in out


def test_new_marks_the_undeclared_datum_of_a_dem(tell, block, tmp_path):
    file = tmp_path / "p.toml"
    flat = tmp_path / "dem.tif"
    with rasterio.open(block / "dem.tif") as dem:
        profile, heights = {**dem.profile, "crs": "EPSG:32633"}, dem.read()
    with rasterio.open(flat, "w", **profile) as copy:
        copy.write(heights)
    code, out, _ = tell("new", file, *photos(block), *flags(block, dem=flat))
    assert code == 0
    assert "needs the vertical datum of the DEM" in out
    section = file.read_text().split("[dem]")[1].split("[control]")[0]
    assert "NEEDED" in section


def test_a_resolution_in_the_wrong_unit_is_told_as_such(tell, block, tmp_path):
    code, _, err = tell(
        "mosaic", *photos(block), *flags(block), "--dst-crs", "EPSG:4326", "--res", 0.7, "-o", tmp_path / "m.tif"
    )
    assert code == 1
    assert "degree" in err
    assert "larger than all the images show" in err


def test_an_output_of_days_that_shows_no_more_than_the_images_is_refused(tell, block, tmp_path):
    """Millimetres for metres. A small place may be as fine as anyone likes."""
    for command, images in (("ortho", photos(block)[:1]), ("mosaic", photos(block))):
        code, _, err = tell(command, *images, *flags(block), "--res", 0.001, "-o", tmp_path / "m.tif")
        assert code == 1
        assert "the images show no more than 0.6" in err
        assert "a pixel size of about 0.6" in err
    assert not list(tmp_path.iterdir())
    place = ("--res", 0.001, "--bounds", 399900, 5500300, 399900.1, 5500300.1)
    assert tell("ortho", photos(block)[0], *flags(block), *place, "-o", tmp_path / "m.tif")[0] == 0


def test_an_output_crs_far_from_its_area_is_told(tell, block, tmp_path):
    code, _, err = tell(
        "ortho", photos(block)[0], *flags(block), "--dst-crs", "EPSG:2180", "--res", 20, "-o", tmp_path / "o.tif"
    )
    assert code == 0
    assert "far outside" not in err  # a neighbour of Poland
    code, _, err = tell(
        "ortho", photos(block)[0], *flags(block), "--dst-crs", "EPSG:32618", "--res", 20, "-o", tmp_path / "n.tif"
    )
    assert "note: the images lie far outside the area that WGS 84 / UTM zone 18N is made for" in err


def test_status_and_only_what_is_stale(tell, own):
    code, out, _ = tell("status", own, "--json")
    assert code == 0
    states = json.loads(out)["steps"]
    assert [state["name"] for state in states] == ["orient", "mosaic", "check", "report"]
    assert all(state["fresh"] for state in states)
    own.write_text(own.read_text().replace('resampling = "bilinear"', 'resampling = "cubic"'))
    _, out, _ = tell("status", own)
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert "fresh" in lines["orient"]
    assert "stale: 'output' changed" in lines["mosaic"]
    code, out, _ = tell("run", own, "--json", "--threads", 1, "--mem-limit", "512M")
    ran = {state["name"]: not state["fresh"] for state in json.loads(out)["steps"]}
    assert (code, ran) == (0, {"orient": False, "mosaic": True, "check": True, "report": True})
    assert [path.name for path in (own.parent / "output").iterdir() if path.name.startswith(".")] == []


def test_a_failed_threshold_is_3_with_everything_written(tell, own):
    text = own.read_text().replace("# max_check_rms_px = 1.0", "max_check_rms_px = 0.01")
    own.write_text(text)
    report = own.parent / "output" / "report.html"
    report.unlink()
    code, _, err = tell("run", own)
    assert code == 3
    assert "check points, RMS" in err
    assert report.is_file()
    code, out, err = tell("run", own, "--json")
    assert code == 3
    assert "check points" in json.loads(out)["quality"]


def test_a_step_can_be_asked_for(tell, own):
    assert tell("run", own, "orient", "--force")[0] == 0
    code, _, err = tell("run", own, "mozaic")
    assert code == 1
    assert "orient, mosaic, check, report" in err


def test_a_project_that_is_not_filled_in_says_all_it_needs(tell, block, tmp_path):
    file = tmp_path / "bare.toml"
    code, out, _ = tell("new", file, *photos(block), "--sensor", "frame", "--json")
    assert code == 0
    code, _, err = tell("run", file)
    assert code == 1
    assert "bare.toml: the project is not complete" in err
    for text in json.loads(out)["needed"]:
        assert text in err
    assert not (tmp_path / "output" / "bare.tif").exists()


def test_outputs_are_not_mixed_with_images(tell, own):
    own.write_text(own.read_text().replace('folder = "output"', 'folder = "photos"'))
    before = sorted((own.parent / "photos").iterdir())
    code, _, err = tell("run", own)
    assert code == 1
    assert "the output folder holds an image" in err
    assert sorted((own.parent / "photos").iterdir()) == before


def test_an_output_folder_that_is_a_file(tell, own):
    own.write_text(own.read_text().replace('folder = "output"', 'folder = "exterior.csv"'))
    code, _, err = tell("run", own)
    assert code == 1
    assert "exterior.csv" in err
    assert "cannot be written" in err


def test_an_unknown_project_key(tell, own):
    own.write_text(own.read_text().replace("[mosaic]", "[mosaic]\nfeathre = 3"))
    code, _, err = tell("run", own)
    assert code == 1
    assert "did you mean 'feather'" in err
    assert "line " in err


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM")
def test_sigterm_is_4_and_the_same_command_resumes_to_the_same_bytes(own, project):
    shutil.rmtree(own.parent / "output")
    shutil.rmtree(own.parent / ".geomosaic")
    command = [sys.executable, "-m", "geomosaic.cli", "run", str(own), "--threads", "1"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    oriented = own.parent / ".geomosaic" / "trial" / "facts" / "orient.json"
    for _ in range(3000):
        if oriented.exists() or process.poll() is not None:
            break
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 4, err
    assert "resumes" in err
    output = own.parent / "output"
    assert [path.name for path in output.iterdir()] == ["models"]
    done = elsewhere("run", own)
    assert done.returncode == 0, done.stderr
    assert "orient  fresh" in done.stdout
    assert (output / "trial.tif").read_bytes() == (project.parent / "output" / "trial.tif").read_bytes()


# The report


class Page(HTMLParser):
    """Tags and pictures of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for key, value in attrs if key in ("src", "href", "xlink:href") and value]


def test_the_report_is_one_file_with_its_numbers(project):
    output = project.parent / "output"
    text = (output / "report.html").read_text()
    data = read_json(output / "report.json")
    page = Page(text)
    assert "script" not in page.tags
    assert "link" not in page.tags
    assert all(link.startswith("data:image/png;base64,") for link in page.links)
    assert base64.b64decode(page.links[0].partition(",")[2]).startswith(b"\x89PNG")
    assert "://" not in text
    for file in [*data["inputs"], *data["outputs"]]:
        path = project.parent / file["path"]
        assert path.is_file()
        assert len(file["sha256"]) == 64
        assert file["sha256"] in text
    for words in ("EGM96 height", "opk", "tolerance", *PHOTOS, data["versions"]["numpy"]):
        assert words in text
    assert len(data["mosaic"]["images"]) == len(PHOTOS)
    assert {point["role"] for point in data["orient"]["control"]} == {"control", "check"}
    assert data["orient"]["rms_check_px"] < 0.5


def test_what_files_are_called_cannot_become_part_of_the_page(project):
    from geomosaic.product.report.report import render_html

    output = project.parent / "output"
    data = read_json(output / "report.json")
    evil = "<script>alert(1)</script>"
    data["name"] = evil
    data["mosaic"]["images"][0]["name"] = evil
    data["orient"]["control"][0]["id"] = evil
    data["warnings"] = [evil]
    page = Page(render_html(data, output / "trial.tif", output / "trial.gpkg"))
    assert "script" not in page.tags


def test_numbers_of_the_report_have_the_decimals_their_units_ask_for(project):
    """A map in degrees and values between 0 and 1 are not rounded to nothing."""
    from geomosaic.product.report.numbers import decimals
    from geomosaic.product.report.report import render_html

    assert [decimals(scale) for scale in (500.0, 0.5, 9e-6, 0.0, None)] == [0, 3, 8, 0, 0]
    assert decimals(500.0, 2) == 2
    output = project.parent / "output"
    data = read_json(output / "report.json")
    made = data["mosaic"]
    made["grid"] |= {"resolution": [9e-6, 9e-6], "bounds": [14.1, 49.2, 14.123456789, 49.212345678]}
    made["images"][0] |= {"sampling": 8.7e-6, "offset": [0.00123]}
    made |= {"feather": 0.000288, "before": [0.0213], "after": [0.00414]}
    text = render_html(data, output / "trial.tif", output / "trial.gpkg")
    for shown in ("0.00000870", "0.00028800", "14.12345679, 49.21234568", "0.0012", "0.0213 → 0.0041"):
        assert shown in text


def test_pictures_of_the_report_show_the_mosaic(project):
    from io import BytesIO

    from geomosaic.raster.preview import preview

    page = Page((project.parent / "output" / "report.html").read_text())
    shown = np.asarray(Image.open(BytesIO(base64.b64decode(page.links[0].partition(",")[2]))).convert("RGB"))
    rgb, _ = preview(project.parent / "output" / "trial.tif", max(shown.shape))
    assert shown.shape == rgb.shape
    assert np.array_equal(shown, rgb)


# The demo


@pytest.mark.slow
def test_demo(tmp_path):
    done = elsewhere("demo", tmp_path / "demo", "--json", env={**os.environ, "NO_COLOR": "1"})
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["check"]["reference"]["registration_rms_px"] < 0.1
    assert facts["orient"]["rms_check_px"] < 0.5
    assert np.mean(facts["mosaic"]["after"]) < 0.5 * np.mean(facts["mosaic"]["before"])


def test_the_sample_is_never_copied_over_something_else(tell, tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    code, _, err = tell("demo", tmp_path)
    assert code == 1
    assert "not empty" in err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limits")
def test_a_sample_that_does_not_fit_is_not_there_at_all(tmp_path):
    import resource

    (tmp_path / "empty").mkdir()
    for folder in ("new", "empty"):
        done = elsewhere(
            "demo", tmp_path / folder, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (99_000, 99_000))
        )
        assert done.returncode == 1
        assert "the sample cannot be copied" in done.stderr
        assert len(done.stderr) < 600
    assert [(path.name, list(path.iterdir())) for path in tmp_path.iterdir()] == [("empty", [])]


def test_the_sample_fits_into_an_empty_folder(tmp_path, monkeypatch):
    from geomosaic.project.sample import copy_sample, sample_folder

    monkeypatch.chdir(tmp_path)
    assert copy_sample(Path()).resolve() == tmp_path / "project.toml"
    copied = {path.relative_to(tmp_path) for path in tmp_path.rglob("*")}
    there = {path.relative_to(sample_folder()) for path in sample_folder().rglob("*")}
    assert copied == {path for path in there if path.parts[0] != "output" and not path.parts[0].startswith(".")}
    assert copy_sample(Path()).is_file()
