"""`geomosaic enhance`, and enhancement on sheets, from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine

from geomosaic.cli.main import run

NO_GRIDS = '[grid]\nstyle = "none"\n[graticule]\nstyle = "none"\n'


def write(path: Path, values: np.ndarray, pixel: float, **more: object) -> Path:
    rows, cols = values.shape[1:]
    with rasterio.open(
        path, "w", driver="GTiff", width=cols, height=rows, count=len(values), dtype=values.dtype.name,
        crs="EPSG:32633", transform=Affine(pixel, 0, 400_000, 0, -pixel, 5_500_000), **more,
    ) as out:  # fmt: skip
        out.write(values)
    return path


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Four bands of 16 bits that rise to the east, south, in both and not at all; the first columns are unknown."""
    row, col = np.mgrid[0:600, 0:700]
    values = np.stack([1000 + 2 * col, 500 + row, 300 + col + row, np.full_like(row, 800)]).astype(np.uint16)
    values[:, :, :40] = 0
    return write(tmp_path / "scene.tif", values, 10.0, nodata=0)


def test_bands_and_stretch(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.tif"
    assert run(["enhance", str(scene), "-b", "3,2,1", "--stretch", "percentile", "-o", str(out)]) == 0
    with rasterio.open(scene) as a, rasterio.open(out) as b:
        raw, made, mask = a.read().astype(float), b.read().astype(float), b.dataset_mask() > 0
        assert b.dtypes == ("uint8",) * 3
        assert b.transform == a.transform
    assert np.array_equal(mask, raw[0] > 0)
    for k, band in enumerate((2, 1, 0)):
        low, high = np.percentile(raw[band][mask], (2, 98))
        want = np.clip(np.floor(255 * (raw[band] - low) / (high - low) + 0.5), 0, 255)
        assert np.abs(made[k] - want)[mask].max() <= 1


def test_pictures_larger_than_the_limit_are_refused(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.tif"
    for more in (["-b", "3,2,1"], ["--pan", str(scene)]):
        assert run(["enhance", str(scene), *more, "--max-output", "10K", "-o", str(out)]) == 1
        assert "--max-output allows 10.2 kB" in capsys.readouterr().err
    assert not out.exists()


def test_windows_do_not_show(scene: Path, tmp_path: Path) -> None:
    """Local contrast and sharpening across the blocks of the output are those of the whole picture."""
    row, col = np.mgrid[0:600, 0:2300]
    values = (120 + 60 * np.sin(col / 9) * np.cos(row / 11)).astype(np.uint8)[None]
    write(tmp_path / "wave.tif", values, 1.0)
    words = ["enhance", str(tmp_path / "wave.tif"), "--clahe", "3", "--sharpen", "1", "--radius", "2"]
    assert run([*words, "-o", str(tmp_path / "a.tif")]) == 0
    with rasterio.open(tmp_path / "a.tif") as a:
        made = a.read(1).astype(int)
    # Seams lie at row 512 and column 2048: steps across them are as those elsewhere.
    across = np.abs(np.diff(made, axis=0))
    assert across[511].max() <= across[[505, 517, 300]].max() + 6
    along = np.abs(np.diff(made, axis=1))
    assert along[:, 2047].max() <= along[:, 2000:2040].max() + 2
    # The same bytes again.
    assert run([*words, "-o", str(tmp_path / "c.tif")]) == 0
    assert (tmp_path / "c.tif").read_bytes() == (tmp_path / "a.tif").read_bytes()


def test_sharp_bands_come_back_by_pansharpening(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Sharp bands of which both inputs are made come back nearer than by magnifying; unknown pixels stay unknown."""
    random = np.random.default_rng(3)
    size, factor = 1200, 4
    y, x = np.mgrid[0:size, 0:size] / size
    detail = random.normal(0, 1, (size // 2, size // 2)).repeat(2, 0).repeat(2, 1)
    sharp = np.stack([2000 + 800 * np.sin(9 * x + k) * np.cos(7 * y) + 90 * detail for k in range(3)])
    coarse = sharp.reshape(3, 300, factor, 300, factor).mean(axis=(2, 4)).round().astype(np.uint16)
    coarse[:, :20, :20] = 0
    pan = (sharp * np.array([0.3, 0.5, 0.2])[:, None, None]).sum(0).round().astype(np.uint16)[None]
    xs, fine = write(tmp_path / "xs.tif", coarse, 4.0, nodata=0), write(tmp_path / "pan.tif", pan, 1.0)
    assert run(["enhance", str(xs), "--pan", str(fine), "-o", str(tmp_path / "sharp.tif"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["weights"] == pytest.approx([0.3, 0.5, 0.2], abs=0.02)
    assert facts["r2"] > 0.999
    with rasterio.open(tmp_path / "sharp.tif") as file:
        made, mask = file.read().astype(float), file.dataset_mask() > 0
        assert file.dtypes[0] == "uint16"
    assert not mask[:80, :80].any()
    assert mask[80:, 80:].all()
    nearest = coarse.repeat(4, 1).repeat(4, 2)
    inner = slice(100, -8), slice(100, -8)
    before = np.sqrt(((nearest - sharp)[:, *inner] ** 2).mean())
    after = np.sqrt(((made - sharp)[:, *inner] ** 2).mean())
    assert after < 0.4 * before  # the gains are those of the slow waves, not of the detail
    plain = tmp_path / "plain.tif"
    assert run(["enhance", str(xs), "--pan", str(fine), "--method", "weighted", "-o", str(plain)]) == 0
    with rasterio.open(plain) as file:
        after = np.sqrt(((file.read().astype(float) - sharp)[:, *inner] ** 2).mean())
    assert after < 0.1 * before
    for words in (
        ["enhance", str(fine), "--pan", str(xs)],
        ["enhance", str(xs), "--pan", str(fine), "--gamma", "2"],
        ["enhance", str(xs), "-b", "5", "--pan", str(fine)],
        ["enhance", str(xs), "-b", "1,2"],
    ):
        assert run([*words, "-o", str(tmp_path / "no.tif")]) == 1
        assert not (tmp_path / "no.tif").exists()


def test_sheet_with_looks(scene: Path, tmp_path: Path) -> None:
    """Bands, stretch and hillshade reach the sheet; slopes that look away from the sun are darker."""
    col = np.mgrid[0:120, 0:140][1]
    ridge = (500 - 8.0 * np.abs(col - 70)).astype(np.float32)[None]
    dem = tmp_path / "dem.tif"
    with rasterio.open(
        dem, "w", driver="GTiff", width=140, height=120, count=1, dtype="float32", crs="EPSG:32633+5773",
        transform=Affine(50, 0, 400_000, 0, -50, 5_500_000),
    ) as out:  # fmt: skip
        out.write(ridge)
    flat = write(tmp_path / "flat.tif", np.full((3, 600, 700), 120, np.uint8), 10.0)
    (tmp_path / "l.toml").write_text(NO_GRIDS + "[enhance]\nazimuth = 270.0\n")
    common = ["--scale", "1:50000", "--dpi", "100", "--layout", str(tmp_path / "l.toml")]
    assert run(["sheet", str(flat), *common, "--hillshade", str(dem), "-o", str(tmp_path / "h.tif")]) == 0
    with rasterio.open(tmp_path / "h.tif") as file:
        made = file.read(1).astype(int)
    west, east = made[100:300, 60:200].mean(), made[100:300, -200:-60].mean()
    slope = 8 / 50
    level = np.sin(np.radians(45))
    want = [
        120
        * (1 + 0.6 * ((np.sin(np.radians(45)) + s * slope * np.cos(np.radians(45))) / np.hypot(1, slope) / level - 1))
        for s in (1, -1)
    ]
    assert [west, east] == pytest.approx(want, abs=0.6)
    assert run(["sheet", str(scene), *common, "-b", "1", "--gamma", "2", "-o", str(tmp_path / "g.tif")]) == 0
    with rasterio.open(tmp_path / "g.tif") as file:
        grey = file.read().astype(int)
    assert np.abs(grey[0] - grey[1]).max() == 0
    assert np.all(np.diff(grey[0][200, 40:-10]) >= 0)
    assert run(["sheet", str(scene), *common, "-b", "1,2", "-o", str(tmp_path / "x.tif")]) == 1


def test_limits_and_percentiles_of_ones_own(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with rasterio.open(scene) as file:
        raw, mask = file.read(1).astype(float), file.dataset_mask() > 0
    for words, low, high in (
        (["--limits", "1200", "2000"], 1200, 2000),
        (["--stretch", "linear", "--limits", "-50", "4000.5"], -50, 4000.5),
        (["--percentiles", "0", "75"], *np.percentile(raw[mask], (0, 75))),
    ):
        out = tmp_path / "out.tif"
        assert run(["enhance", str(scene), "-b", "1", *words, "-o", str(out), "--overwrite"]) == 0
        with rasterio.open(out) as file:
            made = file.read(1).astype(float)
        want = np.clip(np.floor(255 * (raw - low) / (high - low) + 0.5), 0, 255)
        assert np.abs(made - want)[mask].max() <= 1
    for words, part in (
        (["--stretch", "linear"], "give --limits"),
        (["--stretch", "equalise", "--limits", "1", "2"], "belongs to --stretch linear"),
        (["--limits", "2", "1"], "wrong way round"),
        (["--limits", "2", "3", "--percentiles", "2", "98"], "leave one of them out"),
    ):
        assert run(["enhance", str(scene), *words, "-o", str(tmp_path / "no.tif")]) == 1
        assert part in capsys.readouterr().err
        assert not (tmp_path / "no.tif").exists()


def test_sheets_of_deep_pixels_have_one_tone(scene: Path, tmp_path: Path) -> None:
    """Where nothing is asked for, two sheets of different parts show common ground alike, by limits of the raster."""
    (tmp_path / "l.toml").write_text(NO_GRIDS)
    made = []
    for name, left in (("w", 400_000), ("e", 401_500)):
        words = ["--scale", "1:50000", "--dpi", "100", "--layout", str(tmp_path / "l.toml")]
        area = ["--bounds", str(left), "5495000", str(left + 4500), "5499000"]
        assert run(["sheet", str(scene), *words, *area, "-o", str(tmp_path / f"{name}.tif")]) == 0
        with rasterio.open(tmp_path / f"{name}.tif") as file:
            places = [(x, y) for x in range(402_000, 404_001, 400) for y in range(5_496_000, 5_498_001, 400)]
            made.append(np.array(list(file.sample(places))).astype(int))
    assert np.ptp(made[0]) > 20
    assert np.abs(made[0] - made[1]).max() <= 1
    with rasterio.open(scene) as file:
        raw, mask = file.read((1, 2, 3)).astype(float), file.dataset_mask() > 0
        seen = np.array(list(file.sample(places, (1, 2, 3)))).astype(float)
    low, high = np.percentile(raw[:, mask], (2, 98))
    assert np.abs(made[0] - np.clip(255 * (seen - low) / (high - low), 0, 255)).max() <= 2


def test_hillshade_of_a_whole_raster(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A plane shades a flat picture by the cosine of its normal to the sun, the same at the seams of the windows."""
    flat = write(tmp_path / "flat.tif", np.full((3, 600, 700), 120, np.uint8), 10.0)
    row, col = np.mgrid[0:70, 0:80]
    east, north = 0.2, 0.1
    with rasterio.open(
        tmp_path / "dem.tif", "w", driver="GTiff", width=80, height=70, count=1, dtype="float32", crs="EPSG:32633",
        transform=Affine(100, 0, 399_500, 0, -100, 5_500_500),
    ) as out:  # fmt: skip
        out.write((500 + 100 * (east * col - north * row)).astype(np.float32)[None])
    words = ["enhance", str(flat), "--hillshade", str(tmp_path / "dem.tif")]
    assert run([*words, "-o", str(tmp_path / "h.tif")]) == 0
    with rasterio.open(tmp_path / "h.tif") as file:
        made = file.read()
    a, h = np.radians(315), np.radians(45)
    sun = np.array([np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)])
    light = np.array([-east, -north, 1]) @ sun / np.sqrt(1 + east**2 + north**2)
    assert np.unique(made).tolist() == [int(np.floor(120 * (1 + 0.6 * (light / np.sin(h) - 1)) + 0.5))]
    assert run([*words, "-o", str(flat), "--overwrite"]) == 1
    assert "one of the inputs" in capsys.readouterr().err
