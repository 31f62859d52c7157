"""What the colour options of `geomosaic mosaic` undo, against the true radiance of the ground."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from mosaic_rig import scene, write

from geomosaic.cli.main import run

pytestmark = pytest.mark.ci

SIZE, STEP, COLS, ROWS = (240, 180), (96, 72), 3, 3
LEFT, TOP = 500_000.0, 5_600_000.0
EFFECTS: dict[str, dict[str, float]] = {
    "gain": {},
    "vignetting": {"falloff": 0.35},
    "vignetting,trend,hotspot": {"falloff": 0.2, "hotspot": 0.25},
    "vignetting,haze": {"haze": 18.0},
    "gamma": {"bent": 0.45},
    "dodging": {"blot": 0.08},
}


def radiance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Ground (rows, cols, 2) of about 40 to 130, x and y in metres from the upper left."""
    wave = np.sin(x / 17 + 2 * np.sin(y / 31)) + np.sin(y / 13 - x / 41) + np.sin(x / 5) * np.sin(y / 6)
    return np.asarray(85 + 14 * wave)[..., None] * np.array([1.0, 0.9])


def photograph(path: Path, index: int, effects: dict[str, float], dtype: str) -> None:
    rng = np.random.default_rng(index)
    col, row = index % COLS * STEP[0], index // COLS * STEP[1]
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    u, v = (np.array([x, y]) - np.array(SIZE)[:, None, None] / 2) / (np.hypot(*SIZE) / 2)
    rho2 = (u**2 + v**2)[..., None]
    light = radiance(x + col, y + row) * (1 - effects.get("falloff", 0) * rho2)
    light = light * (1 + effects.get("hotspot", 0) * np.exp(-((u - 0.25) ** 2 + (v + 0.2) ** 2) / 0.125))[..., None]
    turn = 2 * np.pi * rng.random(2)
    light = light * (1 + effects.get("blot", 0) * np.sin(3 * u + turn[0]) * np.sin(3 * v + turn[1]))[..., None]
    values = np.exp(rng.normal(0, 0.1, 2)) * light + rng.uniform(-5, 5, 2)
    values = values + effects.get("haze", 0) * rng.uniform(0.7, 1.3) * rho2 * np.array([0.7, 1.2])
    values = 255 * (np.maximum(values, 1) / 255) ** np.exp(rng.normal(0, effects.get("bent", 0), 2))
    scale, noise = (1, 0.3) if dtype == "uint8" else (40, 0.05)
    values = scale * (values + rng.normal(0, noise, values.shape))
    with rasterio.open(
        path, "w", driver="GTiff", width=SIZE[0], height=SIZE[1], count=2, dtype=dtype, crs="EPSG:32633",
        transform=Affine(1, 0, LEFT + col, 0, -1, TOP - row),
    ) as file:  # fmt: skip
        file.write(np.clip(np.rint(values), 0, np.iinfo(dtype).max).astype(dtype).transpose(2, 0, 1))


def off_truth(path: Path, powers: int, ramp: bool = False) -> float:
    """RMS of the mosaic about true radiance in parts of its mean, worst band, but for what overlaps cannot tell.

    That is one polynomial of the value; and a ramp over the block where light changes across photos.
    """
    with rasterio.open(path) as file:
        shown, valid = file.read().astype(float), file.dataset_mask() > 0
    y, x = np.mgrid[: shown.shape[1], : shown.shape[2]] + 0.5
    truth, found = radiance(x, y), []
    for band in range(2):
        a, b = shown[band][valid] / shown[band].max(), truth[..., band][valid]
        same = [a**k for k in range(powers + 1)]
        same += [a * x[valid] / 500, a * y[valid] / 500] if ramp else []
        fit = np.stack(same, axis=1)
        found.append(np.sqrt(np.mean((fit @ np.linalg.lstsq(fit, b, rcond=None)[0] - b) ** 2)) / b.mean())
    return float(np.max(found))


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., list[str]]:
    known: dict[str, list[str]] = {}

    def shoot(effects: dict[str, float], dtype: str = "uint8") -> list[str]:
        key = f"{effects} {dtype}"
        if key not in known:
            folder = tmp_path_factory.mktemp("shots")
            known[key] = [str(folder / f"p{i:02d}.tif") for i in range(COLS * ROWS)]
            for i, path in enumerate(known[key]):
                photograph(Path(path), i, effects, dtype)
        return known[key]

    return shoot


@pytest.fixture
def mosaic(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., tuple[Path, dict[str, Any]]]:
    def call(images: list[str], *words: object) -> tuple[Path, dict[str, Any]]:
        output = tmp_path / "m.tif"
        always = ("--feather", 0, "--no-records", "--no-labels", "--overwrite", "--json", "-o", output)
        capsys.readouterr()
        code = run(["mosaic", *images, *(str(word) for word in (*words, *always))])
        said, err = capsys.readouterr()
        assert code == 0, err
        return output, json.loads(said)

    return call


SEVERAL = ("vignetting,trend,hotspot", "gamma", "dodging")
"""Terms judged by default; what is left out stands among these, or in the test on sixteen bits."""


@pytest.mark.parametrize(
    "terms", [terms if terms in SEVERAL else pytest.param(terms, marks=pytest.mark.slow) for terms in EFFECTS]
)
def test_each_term_undoes_what_it_is_for(shots, mosaic, terms):
    effects = EFFECTS[terms]
    powers, ramp = 3 if "bent" in effects else 1, "hotspot" in effects
    images = shots(effects, "uint16" if "bent" in effects else "uint8")  # powers spread eight bits too thinly
    raw = off_truth(mosaic(images, "--no-balance")[0], powers, ramp)
    plain = off_truth(mosaic(images, "--colour", "gain")[0], powers, ramp)
    path, facts = mosaic(images, "--colour", terms)
    error = off_truth(path, powers, ramp)
    said = f"{100 * raw:.2f} % as they are, {100 * plain:.2f} % gain and offset, {100 * error:.2f} % {terms}"
    if terms == "dodging":  # a net follows what is coarser than its meshes
        assert error < 0.75 * plain, said
    else:
        assert error < 0.01, said
    if terms == "gamma":  # over so little contrast a line does nearly as well
        assert error < plain, said
    elif terms != "gain":
        assert error < 0.8 * plain, said
    assert raw > 0.05, said
    assert {*terms.split(",")} <= {*facts["colour"]["terms"]}


def test_sixteen_bits_and_what_auto_chooses(shots, mosaic):
    path, facts = mosaic(shots(EFFECTS["vignetting,haze"], "uint16"))
    assert {"vignetting", "haze"} <= {*facts["colour"]["terms"]}, facts["colour"]["trials"]
    assert off_truth(path, 1) < 0.01


PAIRS = [("overlap", "uint16"), ("sequence", "uint8"), ("whole", "uint16")]
OTHER_PAIRS = [
    pytest.param(*pair, marks=pytest.mark.slow)
    for pair in (("overlap", "uint8"), ("sequence", "uint16"), ("whole", "uint8"))
]


@pytest.mark.parametrize(("method", "dtype"), PAIRS + OTHER_PAIRS)
def test_histograms_to_a_master(shots, mosaic, tmp_path, method, dtype):
    """The master keeps its own values; over the overlap the others come to it, wherever what they show is alike."""
    images = shots({"bent": 0.25}, dtype)
    before = off_truth(mosaic(images, "--no-balance")[0], 1)
    path, facts = mosaic(images, "--histogram", method, "--master", "p05")
    error = off_truth(path, 3)
    assert error < {"overlap": 0.02, "sequence": 0.04, "whole": 0.06}[method], f"{error}, {before} before"
    assert error < 0.8 * before
    with rasterio.open(images[5]) as file:
        own = file.read()
    with rasterio.open(path) as file:
        shown = file.read()
    col, row = 5 % COLS * STEP[0] + 100, 5 // COLS * STEP[1] + 80  # its middle, far from seams
    middle = np.s_[:, row : row + 20, col : col + 40]
    assert np.array_equal(shown[middle], own[:, 80:100, 100:140])
    assert facts["overlap_difference_after"][0] < 0.5 * facts["overlap_difference_before"][0] or method == "whole"


def test_areas_of_water_say_nothing_of_histograms(shots, mosaic, tmp_path):
    """A lake that every photo shows in a tone of its own fills much of the overlaps."""
    images, folder = [], tmp_path / "lake"
    folder.mkdir()
    for i, name in enumerate(shots({})):
        with rasterio.open(name) as file:
            values, profile, here = file.read(), file.profile, file.transform
        y, x = np.mgrid[: SIZE[1], : SIZE[0]]
        x, y = x + here.c - LEFT, y + TOP - here.f
        lake = (x > 150) & (x < 400) & (y > 120) & (y < 300)
        values[:, lake] = np.clip(values[:, lake] * (0.4 + 0.07 * i), 0, 250)
        images.append(str(folder / Path(name).name))
        with rasterio.open(images[-1], "w", **profile) as file:
            file.write(values)
    area = shapely.box(LEFT + 148, TOP - 302, LEFT + 402, TOP - 118)
    geopandas.GeoDataFrame(geometry=[area], crs="EPSG:32633").to_crs("EPSG:4326").to_file(tmp_path / "lake.gpkg")
    outside = shapely.box(LEFT, TOP - 600, LEFT + 700, TOP).difference(area)
    geopandas.GeoDataFrame(geometry=[outside], crs="EPSG:32633").to_file(tmp_path / "land.gpkg")

    def land(*words: object) -> float:
        path = mosaic(images, "--histogram", "overlap", "--master", "p00", *words)[0]
        with rasterio.open(path) as file:
            shown, valid = file.read().astype(float), file.dataset_mask() > 0
        y, x = np.mgrid[: shown.shape[1], : shown.shape[2]] + 0.5
        valid &= ~((x > 145) & (x < 405) & (y > 115) & (y < 305))
        a, b = shown[0][valid], radiance(x, y)[..., 0][valid]
        line = np.polynomial.Polynomial.fit(a, b, 1)
        return float(np.sqrt(np.mean((line(a) - b) ** 2)) / b.mean())

    spoilt, masked = land(), land("--mask", tmp_path / "lake.gpkg")
    region = land("--region", tmp_path / "land.gpkg")
    assert masked < 0.6 * spoilt, f"{masked}, {spoilt} without mask"
    assert region < 0.6 * spoilt, f"{region}, {spoilt} without region"


LIMITS = {
    "max_clipped_percent": ("clipped_percent", "pixels clipped by colour corrections"),
    "max_gain_spread_percent": ("gain_spread_percent", "spread of gains"),
    "max_colour_trend_percent": ("trend_percent", "trend of colour corrections"),
    "max_colour_difference": ("rms_difference", "colour corrections, RMS"),
}


def test_a_project_ends_with_the_code_of_quality_where_its_colours_do_more_harm_than_is_allowed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A dark photo with a bright field that the others do not show: its right gain clips the field."""
    ground, images = scene(120, 400), []
    for i, (first, gain) in enumerate([(0, 1.0), (120, 0.72), (240, 1.05)]):
        part = ground[:, first : first + 160] * gain
        part[40:60, 70:90] = 240.0 if i == 1 else part[40:60, 70:90]
        images.append(str(write(tmp_path / f"p{i}.tif", part.astype(np.uint8), first)))
    project = tmp_path / "p.toml"
    assert run(["new", str(project), *images]) == 0
    plain = project.read_text().partition("[quality]")[0]
    project.write_text(plain + "[quality]\n" + "".join(f"{name} = 0.01\n" for name in LIMITS))
    capsys.readouterr()
    assert run(["run", str(project)]) == 3
    told = capsys.readouterr().err
    change: dict[str, float] = json.loads((tmp_path / "output" / "report.json").read_text())["mosaic"]["colour"][
        "radiometric_change"
    ]
    for fact, words in LIMITS.values():
        assert change[fact] > 0.01
        assert words in told
    kept = "".join(f"{name} = {1.01 * change[fact]}\n" for name, (fact, _) in LIMITS.items())
    project.write_text(plain + "[quality]\n" + kept)
    assert run(["run", str(project)]) == 0
