"""The seven sheets of the gallery, made and read back: page, scale, place on the Earth, text. All but one are slow."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from sheet_reading import SheetPdf, crossing, overlaps

GALLERY = Path(__file__).resolve().parent.parent / "docs" / "gallery"
A3, A4 = (420.0, 297.0), (210.0, 297.0)
EXPECTED: dict[str, dict[str, Any]] = {
    "photomap": {
        "paper": A3, "scale": 5_000, "bar": 100.0, "crs": 32633, "bounds": (399_180, 5_499_460, 400_680, 5_500_580),
        "text": ["Sample Valley", "Sheet 33-117-4", "Long Hill", "Date of photography: 2024-06-21", "12 images",
                 "Sample Brook", "400 000", "1 : 5 000", "13°37′00″ E", "4.9° ± 0.4° east (WMM2025, 2026-06)"],
    },
    "spot": {
        "paper": A3, "scale": 25_000, "bar": 80.0, "crs": 32633,
        "text": ["Great Valley", "Valley Road", "Bridge Street", "Index contours, every 100 m", "Spot heights",
                 "1 : 25 000", "5 500 000", "Heights: EGM96 height"],
    },
    "puwg": {
        "paper": (560.0, 545.0), "scale": 10_000, "bar": 100.0, "crs": 2180,
        "text": ["Wzgórza Przykładowe", "Sheet M-34-64-D-c-3", "Neighbouring sheets", "M-34-64-D-c-1", "M-34-76-B-a-1",
                 "1 : 10 000", "19°46′ E", "EPSG:2180"],
    },
    "zones": {
        "paper": A3, "scale": 25_000, "bar": 80.0, "crs": 32633,
        "text": ["Across the zone edge", "WGS 84 / UTM zone 34N", "717 000", "283 000", "edge of zones 33 and 34"],
    },
    "old": {
        "paper": A4, "scale": 5_000, "bar": 40.0, "crs": 32633, "bounds": (399_760, 5_499_650, 400_540, 5_500_180),
        "text": ["Sample Brook", "Sheet IV", "Upper Fields", "Brook Meadows", "Bridge Street", "400 200"],
    },
    "dome": {
        "paper": A3, "scale": 75, "bar": 5000.0 / 75, "crs": None,
        "text": ["Painted dome", "developed sphere, every 1 m", "−8", "1 : 75", "not tied to the Earth"],
    },
    "symbols": {
        "paper": A3, "scale": 10_000, "bar": 100.0, "crs": 32633,
        "text": ["Trigonometric point", "Water tower", "Boundary stone", "Windmill", "Embankment", "narrow gauge"],
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], SheetPdf]:
    """Make a sheet of the gallery, once."""
    folder, made = tmp_path_factory.mktemp("gallery"), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(GALLERY))
        script = importlib.import_module("make_gallery")
    script.prepare(folder)

    def one(name: str) -> SheetPdf:
        if name not in made:
            made[name] = SheetPdf(script.SHEETS[name](folder))
        return made[name]

    return one


names = pytest.mark.parametrize(
    "name", [name if name == "old" else pytest.param(name, marks=pytest.mark.slow) for name in EXPECTED]
)


@names
def test_a_sheet_of_the_gallery(
    sheets: Callable[[str], SheetPdf], name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    sheet, wanted = sheets(name), EXPECTED[name]
    told = capfd.readouterr().err
    assert "no room" not in told
    assert "no glyph" not in told
    width, height = wanted["paper"]
    assert sheet.trim[2:] - sheet.trim[:2] == pytest.approx([width, height], abs=0.01)
    assert sheet.fonts_embedded()
    for words in wanted["text"]:
        assert words in re.sub(r"\s+", " ", sheet.text.replace("\u00a0", " ")), words

    # Text never overlaps, and nothing is cut off by paper or neatline, or runs over the frame of the panel.
    letters, boxes = sheet.characters()
    assert overlaps(letters, boxes) == []
    assert (boxes >= 3.0).all()
    assert (boxes[:, 2:] <= np.array([width, height]) - 3.0).all()
    paths = sheet.paths()
    frames = sheet.paths(range(4, 7))
    frames = frames[((frames[:, 2:] - frames[:, :2]) > 25.0).all(axis=1)]  # neatline, border, panel
    assert len(frames) >= 3
    neatline = sheet.map_box()
    for frame in (*frames, neatline):
        cut = [letters[k] for k in crossing(boxes, frame)]
        # Names of neighbours stand in gaps of the border; a curved neatline is no rectangle.
        assert not cut or name == "puwg", "".join(cut)

    # Boxes of the scale bar stand end to end, and are as long as the figures say.
    sizes = paths[:, 2:] - paths[:, :2]
    parts = paths[(np.abs(sizes[:, 1] - 1.1) < 0.02) & (sizes[:, 0] > 4.0)]
    parts = parts[np.argsort(parts[:, 0])]
    assert np.abs(parts[1:, 0] - parts[:-1, 2]).max() < 0.02
    assert parts[-1, 2] - parts[0, 0] == pytest.approx(wanted["bar"], abs=0.1)


@names
def test_where_it_lies(sheets: Callable[[str], SheetPdf], name: str) -> None:
    """The corners of the viewport by PROJ give the scale; grid lines stand where it puts their coordinates."""
    sheet, wanted = sheets(name), EXPECTED[name]
    if wanted["crs"] is None:
        # A local frame: the measure dictionary gives metres; 1 m of the map's grid is 1000 / scale mm on the paper.
        found = re.search(rb"/Subtype /RL.*?/X \[ << /Type /NumberFormat /U \(m\) /C ([\d.]+)", sheet.data)
        assert found
        assert float(found[1]) * 72 / 25.4 == pytest.approx(wanted["scale"] / 1000, rel=1e-9)
        origin = re.search(rb"/O \[ ([\d.]+) ([\d.]+) \]", sheet.data)
        assert origin
        x = float(origin[1]) * 25.4 / 72 - sheet.trim[0]
        assert any(abs(x + 1000 / 75 * 8 - at) < 0.1 for at in upright(sheet.paths()))
        return
    box, parts, degrees = sheet.viewport()
    move = Transformer.from_crs(4258 if wanted["crs"] == 2180 else 4326, wanted["crs"], always_xy=True)
    xy = np.column_stack(move.transform(*degrees.T))
    mm = box[:2] + parts * (box[2:] - box[:2])
    unit = 1000.0 / wanted["scale"]
    # Corner coordinates within 0.1 mm: as distances on the paper, and as named by the layout.
    for a, b in ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2)):
        assert np.hypot(*(xy[a] - xy[b])) * unit == pytest.approx(np.hypot(*(mm[a] - mm[b])), abs=0.1)
    if "bounds" in wanted:
        left, bottom, right, top = wanted["bounds"]
        corners = np.array([(left, bottom), (left, top), (right, top), (right, bottom)])
        assert np.abs(xy - corners).max() * unit < 0.1
    lines = upright(sheet.paths())
    labels = [line for line in sheet.lines() if re.fullmatch(r"\d{6}", line.text) and line.box[3] < box[1]]
    hits = 0
    for label in labels:
        x = mm[0, 0] + (float(label.text) - xy[0, 0]) * unit
        if abs(x - label.box[[0, 2]].mean()) < 0.5:  # a label of the map's own grid
            assert np.abs(lines - x).min() < 0.1, label.text
            hits += 1
    assert hits >= 2


@pytest.mark.slow
def test_the_satellite_scene_lies_true(sheets: Callable[[str], SheetPdf]) -> None:
    """Shift of the rectified scene against the formulas of its ground, by least squares on their slopes: 0.01 pixels.

    The satellite is written without the plugin that rectifies it.
    """
    path = sheets("spot").path.with_suffix(".tif")
    ground = importlib.import_module("make_gallery").SPOT
    with rasterio.open(path) as source:
        image, affine = source.read().astype(float), source.transform
        assert source.dataset_mask().all()
    rng = np.random.default_rng(1)
    col, row = rng.integers(10, image.shape[2] - 10, 20_000), rng.integers(10, image.shape[1] - 10, 20_000)

    def colour(across: float, down: float) -> np.ndarray:
        return 255.0 * ground.colour(*(affine @ (col + 0.5 + across, row + 0.5 + down)), (4, 1, 2))

    slopes = [2 * (colour(u, v) - colour(-u, -v)).ravel() for u, v in ((0.25, 0.0), (0.0, 0.25))]
    differences = (image[:, row, col].T - colour(0.0, 0.0)).ravel()
    shift = np.linalg.lstsq(np.column_stack(slopes), differences)[0]
    assert np.abs(shift).max() < 0.01
    assert differences.std() < 1.5


def upright(paths: np.ndarray) -> np.ndarray:
    """Middles of upright lines and ticks, mm."""
    sizes = paths[:, 2:] - paths[:, :2]
    found: np.ndarray = paths[(sizes[:, 0] < 1.5) & (sizes[:, 1] > 1.5)][:, [0, 2]].mean(axis=1)
    return found


def test_every_sheet_has_its_picture_and_its_words() -> None:
    page = (GALLERY / "index.md").read_text(encoding="utf-8")
    for name in EXPECTED:
        assert f"({name}.jpg)" in page
        assert (GALLERY / f"{name}.jpg").stat().st_size > 20_000
        assert (GALLERY / f"{name}.toml").is_file()
