"""Seams of large blocks: laid by subdomains as well as in one piece, with the same bytes whoever works."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from pyproj import CRS
from scipy.ndimage import gaussian_filter

import geomosaic as gm
from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.seams import cost, layout, subdomains
from geomosaic.mosaicking.seams.subdomains import FREE, OUTSIDE, RIM, Subdomain, SubdomainSeams, rims_of, seams_in_turns
from geomosaic.options.render import RenderOptions
from geomosaic.raster.vector import Layer, read_layer, write_layers
from geomosaic.render import regions

LEFT, TOP, WIDTH, HEIGHT, RIGHT, DOWN, COLS, ROWS = 500_000.0, 5_500_000.0, 260, 220, 150, 120, 4, 3
LEAN = 0.12
"""Part of its distance from the middle of an image by which a house leans outwards."""


@pytest.fixture(scope="module")
def block(tmp_path_factory) -> list[Path]:
    """Twelve orthos of a rough ground with houses, which lean away from the middle of each."""
    folder, chance, paths = tmp_path_factory.mktemp("block"), np.random.default_rng(3), []
    rows, cols = HEIGHT + DOWN * (ROWS - 1), WIDTH + RIGHT * (COLS - 1)
    ground = 100.0 + 120.0 * gaussian_filter(chance.normal(size=(rows, cols)), 3)
    houses = np.column_stack(
        [chance.integers(0, cols, 160), chance.integers(0, rows, 160), chance.integers(5, 14, 160)]
    )
    profile = {"driver": "GTiff", "width": WIDTH, "height": HEIGHT, "count": 1, "dtype": "uint8", "crs": "EPSG:32631"}
    for r, c in product(range(ROWS), range(COLS)):
        top, left = r * DOWN, c * RIGHT
        view = ground[top : top + HEIGHT, left : left + WIDTH] + chance.normal(0.0, 2.0, (HEIGHT, WIDTH))
        for x, y, half in houses - [left, top, 0]:
            x, y = x + LEAN * (x - WIDTH / 2), y + LEAN * (y - HEIGHT / 2)
            view[max(0, int(y - half)) : max(0, int(y + half)), max(0, int(x - half)) : max(0, int(x + half))] = 240
        paths.append(folder / f"r{r}c{c}.tif")
        with rasterio.open(paths[-1], "w", transform=Affine(1, 0, LEFT + left, 0, -1, TOP - top), **profile) as dataset:
            dataset.write(view.clip(0, 255).astype(np.uint8), 1)
    return paths


SMALL = {"SIDE": 150, "MARGIN": 80, "CONTEXT": 24}


class Mosaics:
    """Mosaics of the block, each made once: shares, labels and file."""

    def __init__(self, block: list[Path], folder: Path) -> None:
        self.block, self.folder, self.made = block, folder, dict[str, tuple[list[Any], np.ndarray, bytes]]()

    def __call__(self, seams: str, largest: int = 10_000, **how: Any) -> tuple[list[Any], np.ndarray, bytes]:
        name = f"{seams}-{largest}-{'-'.join(how)}"
        if name not in self.made:
            with pytest.MonkeyPatch.context() as patch:
                for constant, value in SMALL.items():
                    patch.setattr(subdomains, constant, value)
                patch.setattr(layout, "LARGEST", largest)
                patch.setattr(regions, "MOST_IMAGES", 4)  # workers get those of a few subdomains
                out = self.folder / f"{name}.tif"
                gm.mosaic(self.block, out, resolution=1.0, balance=False, feather=0.0, seams=seams, stac=False, **how)
            shares = list(read_layer(out.with_suffix(".gpkg"), "seams").geometry)
            with rasterio.open(out.with_name(f"{name}-labels.tif")) as labels:
                self.made[name] = shares, labels.read(1).astype(int) - 1, out.read_bytes()
        return self.made[name]


@pytest.fixture(scope="module")
def mosaics(block, tmp_path_factory) -> Mosaics:
    return Mosaics(block, tmp_path_factory.mktemp("mosaics"))


def seam_difference(block: list[Path], labels: np.ndarray) -> float:
    """Sum over all seams of the difference between the two images that meet there."""
    total = 0.0
    shown = np.full((len(block), *labels.shape), np.nan)
    for image, (r, c) in zip(shown, product(range(ROWS), range(COLS)), strict=True):
        path = block[r * COLS + c]
        with rasterio.open(path) as dataset:
            image[r * DOWN : r * DOWN + HEIGHT, c * RIGHT : c * RIGHT + WIDTH] = dataset.read(1)
    for one, two in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        here, there = labels[one], labels[two]
        rows, cols = np.nonzero(here != there)
        place = (slice(None), *one) if isinstance(one, tuple) else (slice(None), one)
        images = shown[place]
        i, j = here[rows, cols], there[rows, cols]
        total += float(np.nansum(np.abs(images[i, rows, cols] - images[j, rows, cols])))
    return total


WHOLE = 10**9


def test_seams_by_subdomains_are_nearly_as_good_as_in_one_piece(block, mosaics) -> None:
    """Subdomains are smaller than a footprint here. Over 100 images in 12 of the usual size the differences along seams
    are 1.6 % larger than in one piece, since either is a local minimum."""
    parts, labels, _ = mosaics("graph-cut", threads=1)
    whole = mosaics("graph-cut", WHOLE)[1]
    nearest = seam_difference(block, mosaics("nearest")[1])
    by_parts, at_once = seam_difference(block, labels), seam_difference(block, whole)
    assert (labels != whole).any()
    assert at_once < 0.4 * nearest
    assert by_parts < 1.1 * at_once, (by_parts, at_once, nearest)
    covered = shapely.union_all(parts)
    assert all(share.is_valid for share in parts)
    assert sum(share.area for share in parts) == pytest.approx(covered.area, rel=1e-9)
    assert covered.area == pytest.approx((labels >= 0).sum(), rel=1e-9)


@pytest.mark.parametrize("seams", ["graph-cut", "halve"])
def test_whoever_lays_the_subdomains_lays_the_same_seams(seams, mosaics) -> None:
    one, _, file = mosaics(seams, threads=1)
    with ThreadPoolExecutor(1) as executor:  # packs and opens everything as for another process
        sent, _, sent_file = mosaics(seams, workers=executor)
    assert (sent, sent_file) == (one, file)


@pytest.mark.ci
def test_threads_and_processes_lay_the_same_seams(mosaics) -> None:
    one, _, file = mosaics("graph-cut", threads=1)
    assert mosaics("graph-cut", threads=3, tile=1024)[::2] == (one, file)
    assert mosaics("graph-cut", workers=2)[::2] == (one, file)


def test_overlaps_are_halved_by_subdomains_where_they_are_in_one_piece(mosaics) -> None:
    assert (mosaics("halve", threads=1)[1] != mosaics("halve", WHOLE)[1]).mean() < 0.002


def test_too_little_memory_is_told_before_anything_is_laid(block, tmp_path) -> None:
    how = {"resolution": 1.0, "balance": False, "threads": 1, "stac": False, "memory_limit": 321 << 20}
    with pytest.raises(
        InputError, match=r"321M is too little memory for seams of 0.3 million cells, .* 36\dM"
    ) as caught:
        gm.mosaic(block, tmp_path / "m.tif", seams="graph-cut", **how)
    assert (caught.value.where, list(tmp_path.iterdir())) == ("`memory_limit`", [])


def test_no_seam_cuts_an_area_to_avoid_on_the_corner_of_subdomains(mosaics, tmp_path) -> None:
    corners = product((178, 355, 533), (115, 230, 345))
    areas = [shapely.box(LEFT + x - 20, TOP - y - 15, LEFT + x + 20, TOP - y + 15) for x, y in corners]
    buildings = write_layers(tmp_path / "buildings.gpkg", {"buildings": Layer(CRS("EPSG:32631"), "Polygon", areas, {})})
    shares = mosaics("graph-cut", threads=1, avoid=[buildings])[0]
    for area in areas:
        assert max(share.intersection(area).area for share in shares) == pytest.approx(area.area, rel=1e-9)


def test_a_large_image_is_looked_at_in_coarser_cells(block, mosaics, tmp_path, monkeypatch) -> None:
    """A scene below a thousand photos is not read whole in the photos' cells; seams are as good."""
    most, seen, read = WIDTH * HEIGHT // 9, list[Window](), cost.thumbnail

    def thumbnail(photo: Any, surface: Any, grid: Grid, window: Window, *how: Any) -> Any:
        seen.append(window)
        return read(photo, surface, grid, window, *how)

    monkeypatch.setattr(cost, "MAX_CELLS", most)
    monkeypatch.setattr(cost, "thumbnail", thumbnail)
    labels = Mosaics(block, tmp_path)("graph-cut", threads=1)[1]
    coarse, parts = seen[::2], seen[1::2]
    assert max(window.width * window.height for window in coarse) <= 1.05 * most
    assert max(max(window.width, window.height) for window in parts) <= SMALL["SIDE"] + 2 * SMALL["MARGIN"]
    by_cells = seam_difference(block, mosaics("graph-cut", threads=1)[1])
    assert seam_difference(block, labels) == pytest.approx(by_cells, rel=0.1)


def test_raised_objects_are_the_same_in_all_windows(monkeypatch) -> None:
    """Houses on hills, cut by the edges of windows."""
    chance, grid = np.random.default_rng(5), Grid.from_bounds(CRS("EPSG:32633"), (0.0, 0.0, 700.0, 500.0), 1.0)
    heights = 300.0 * gaussian_filter(chance.normal(size=grid.shape), 30)
    for row, col in chance.integers(0, (460, 660), (80, 2)):
        heights[row : row + 30, col : col + 25] += 8.0

    def cells(_: object, own: Grid) -> np.ndarray:
        col, row = grid.colrow(own.xy(np.zeros((1, 2))))[0].round().astype(int)
        return heights[row : row + own.height, col : col + own.width]

    monkeypatch.setattr(cost, "_cell_heights", cells)
    whole = cost._raised_objects_in(None, grid, grid.window)
    assert 0.1 < (whole > 0.9).mean() < 0.5
    for window in grid.window.split(150, 140):
        found = cost._raised_objects_in(None, grid, window)
        np.testing.assert_allclose(found, whole[window.slices_in(grid.window)], atol=1e-3)


@dataclass(frozen=True)
class Waves(layout.SeamMethod):
    """Seam of two images that crosses the borders of subdomains again and again."""

    def labels(self, part: Subdomain, options: RenderOptions) -> np.ndarray:
        rows, cols = np.indices((part.window.height, part.window.width))
        rows, cols = rows + part.window.row, cols + part.window.col
        return (rows > 250 + 60 * np.sin(cols / 15)).astype(int)


@pytest.mark.parametrize("turned", [0.0, 17.0])
def test_shares_have_no_slits_along_subdomains(turned, monkeypatch) -> None:
    """In grids that are turned the borders of subdomains have no exact coordinates."""
    for constant, value in SMALL.items():
        monkeypatch.setattr(subdomains, constant, value)
    monkeypatch.setattr(layout, "LARGEST", 10_000)
    place = Affine.translation(LEFT + 0.1, TOP) @ Affine.rotation(turned) @ Affine.scale(0.7, -0.7)
    grid = Grid(CRS("EPSG:32631"), place, 700, 500)
    corners = grid.xy(np.array([[3.3, 3.3], [695.1, 3.3], [695.1, 495.1], [3.3, 495.1]]))
    outlines, photos = [shapely.Polygon(corners)] * 2, SimpleNamespace(centres=[tuple(corners[0]), tuple(corners[2])])
    shares = layout._laid_out(Waves(photos, outlines, grid), RenderOptions(threads=1), None)
    assert [(share.geom_type, len(share.interiors)) for share in shares] == [("Polygon", 0)] * 2
    assert sum(share.area for share in shares) == pytest.approx(outlines[0].area, rel=1e-9)


GRID = Grid.from_bounds(CRS("EPSG:32633"), (0.0, 0.0, 700.0, 500.0), 1.0)
WINDOWS = [Window(0, 0, 700, 500), Window(0, 0, 420, 500)]
"""Of two images: the cores from column 466 on are shown by the first alone."""


def test_a_subdomain_takes_the_cells_along_its_core_as_its_neighbours_decided_them(monkeypatch) -> None:
    for constant, value in SMALL.items():
        monkeypatch.setattr(subdomains, constant, value)
    seen, decided = np.full(GRID.shape, -9), list[Subdomain]()
    chance, told = np.random.default_rng(1), []

    def laid(part: Subdomain) -> SubdomainSeams:
        known, core = part.decided, part.core.slices_in(part.window)
        assert (known[core] == FREE).all()
        ring = known != FREE
        for neighbour in part.neighbours:
            common = part.window.intersection(neighbour)
            assert not common.empty
            ring[common.slices_in(part.window)] = False
        assert not ring.any()
        close = known > OUTSIDE
        now = seen[part.window.slices_in(GRID.window)]
        assert (known[close] == now[close]).all()
        wide = Window(part.core.col - RIM, part.core.row - RIM, part.core.width + 2 * RIM, part.core.height + 2 * RIM)
        rim = wide.intersection(GRID.window).slices_in(GRID.window)
        told.append(close.sum() == (seen[rim] > -9).sum())
        decided.append(part)
        labels = chance.integers(-1, 2, (part.core.height, part.core.width))
        seen[part.core.slices_in(GRID.window)] = labels
        return SubdomainSeams([(part.core, 0)], rims_of(part.core, labels))

    reports: list[tuple[int, int, str]] = []
    options = RenderOptions(threads=1, progress=lambda *report: reports.append(report))
    cores = [core for core, _ in seams_in_turns(GRID, WINDOWS, lambda _: laid, options)]
    assert all(told)
    assert [part.core for part in decided] == cores
    # Four turns; none looks at a core of its own turn, and the ground of one image alone is nobody's.
    assert sum(core.width * core.height for core in cores) == 500 * 420 == (seen > -9).sum()
    assert [len(part.neighbours) for part in decided][:4] == [0, 0, 0, 0]
    assert max(len(part.neighbours) for part in decided) == 8
    assert reports[-1] == (len(cores), len(cores), "seams")


@pytest.mark.ci
def test_a_run_that_stops_amid_the_seams_goes_on_and_a_changed_image_costs_its_surroundings(
    block, mosaics, tmp_path, monkeypatch
) -> None:
    for constant, value in SMALL.items():
        monkeypatch.setattr(subdomains, constant, value)
    monkeypatch.setattr(layout, "LARGEST", 10_000)
    laid, lay, most = list[Subdomain](), layout._seams_of, 7

    def counted(method: Any, part: Subdomain, options: RenderOptions) -> SubdomainSeams:
        if len(laid) == most:
            raise KeyboardInterrupt
        laid.append(part)
        return lay(method, part, options)

    monkeypatch.setattr(layout, "_seams_of", counted)
    images = [Path(shutil.copy(path, tmp_path)) for path in block]
    how = {"resolution": 1.0, "balance": False, "feather": 0.0, "seams": "graph-cut", "threads": 1, "stac": False}
    with pytest.raises(KeyboardInterrupt):
        gm.mosaic(images, tmp_path / "m.vrt", tiling="1024px", **how)
    most = 1000
    gm.mosaic(images, tmp_path / "m.vrt", tiling="1024px", **how)
    whole = list({part.core: part for part in laid})
    assert len(laid) == len(whole) > 15
    assert list(read_layer(tmp_path / "m.gpkg", "seams").geometry) == mosaics("graph-cut", threads=1)[0]

    laid.clear()
    with rasterio.open(images[0], "r+") as dataset:
        values = dataset.read(1)
        values[-40:, -40:] = 255
        dataset.write(values, 1)
    gm.mosaic(images, tmp_path / "m.vrt", tiling="1024px", overwrite=True, **how)
    assert 0 < len(laid) < len(whole)
    fresh = gm.mosaic(images, tmp_path / "fresh.tif", **how)
    again = read_layer(tmp_path / "m.gpkg", "seams").geometry
    assert list(again) == list(read_layer(fresh.path.with_suffix(".gpkg"), "seams").geometry)
