"""Runs of pixels that follow each other, as of maps brought to another CRS, have the bytes of NumPy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy_kernels as plain
import numpy_warp
import pytest
from helpers import ArrayReader

from geomosaic import kernels
from geomosaic.geo.grid import Window
from geomosaic.kernels import blend
from geomosaic.resample.warp import Colour, Sampling, Target, warp
from geomosaic.sensor.lattice import Lattice

SIZE = (1500, 900)

BILINEAR = Sampling("bilinear")


def lattice_of(turn: float, scale: float, window: Window, bend: float = 0.0) -> Lattice:
    """Turned by radians, scaled, and bent by `bend` pixels across the block."""
    ny, nx = -(-window.height // 64) + 1, -(-window.width // 64) + 1
    c, r = np.meshgrid(np.arange(nx) * 64.0 + window.col, np.arange(ny) * 64.0 + window.row)
    nodes = np.zeros((ny, nx, 8))
    nodes[..., 0] = 200.37 + scale * (np.cos(turn) * c - np.sin(turn) * r) + bend * (c / window.width) ** 2
    nodes[..., 4] = 90.81 + scale * (np.sin(turn) * c + np.cos(turn) * r) - bend * (r / window.height) ** 2
    seen = np.ones((ny - 1, nx - 1), dtype=bool)
    return Lattice(
        window, 64, nodes, np.zeros((ny, nx, 2)), 0.0, 0.0, 0.0, (0.0, 0.0, *SIZE), scale, seen, nodes[None, ..., ::4]
    )


@pytest.mark.parametrize("turn", [0.0, 0.0007, -0.02, 0.12])
@pytest.mark.parametrize("scale", [1.0, 1.0003, 0.97, 0.61])
@pytest.mark.parametrize(("dtype", "bands"), [("uint8", 3), ("uint16", 1), ("uint16", 4), ("float32", 2)])
def test_the_same_bytes_as_numpy(monkeypatch, turn: float, scale: float, dtype: str, bands: int) -> None:
    image = np.random.default_rng(3).integers(0, 256, (SIZE[1], SIZE[0], bands)).astype(dtype)
    lattice = lattice_of(turn, scale, Window(0, 0, 640, 128), bend=2.0)
    for method in ("bilinear", "cubic"):
        ways = []
        for kernel in (kernels.warp.warp, numpy_warp.warp):
            with monkeypatch.context() as patch:
                patch.setattr(kernels.warp, "warp", kernel)
                out, valid = np.zeros((128, 640, bands), dtype=dtype), np.zeros((128, 640), dtype=np.uint8)
                same = Colour.identity(bands)
                warp(ArrayReader(image, None), SIZE, lattice, None, Sampling(method), same, Target(out, valid))
                ways.append((out, valid))
        assert (ways[0][1] == 1).all()
        assert np.array_equal(ways[0][1], ways[1][1])
        assert np.array_equal(ways[0][0], ways[1][0])


def test_what_a_block_shows_beyond_the_image_stays_empty() -> None:
    image = np.full((SIZE[1], SIZE[0], 3), 77, dtype=np.uint8)
    lattice = lattice_of(0.6, 1.3, Window(0, 0, 1024, 512))
    out, valid = np.zeros((512, 1024, 3), dtype=np.uint8), np.zeros((512, 1024), dtype=np.uint8)
    warp(
        ArrayReader(image, None),
        SIZE,
        lattice,
        None,
        Sampling("bilinear"),
        Colour.identity(3),
        Target(out, valid),
    )
    assert 0.2 < valid.mean() < 0.95
    assert np.array_equal(out[..., 0] == 77, valid == 1)
    assert (out[valid == 0] == 0).all()


@pytest.mark.parametrize("need", [None, "chequered"])
def test_a_block_across_the_edge_has_the_bytes_of_numpy(monkeypatch, need: str | None) -> None:
    image = np.random.default_rng(4).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    lattice = lattice_of(0.03, 1.0, Window(640, 384, 1000, 500))
    cells = None if need is None else np.indices((8, 16)).sum(axis=0).astype(np.uint8) % 2
    ways = []
    for kernel in (kernels.warp.warp, numpy_warp.warp):
        with monkeypatch.context() as patch:
            patch.setattr(kernels.warp, "warp", kernel)
            out, valid = np.zeros((500, 1000, 3), dtype=np.uint8), np.zeros((500, 1000), dtype=np.uint8)
            same, target = Colour.identity(3), Target(out, valid, cells)
            warp(ArrayReader(image, None), SIZE, lattice, None, Sampling("bilinear"), same, target)
            ways.append((out, valid))
    assert 0.2 < ways[0][1].mean() < 0.95
    assert np.array_equal(*(valid for _, valid in ways))
    assert np.array_equal(*(out for out, _ in ways))


@pytest.mark.parametrize(("bands", "planar"), [(1, False), (2, False), (3, False), (3, True), (4, True), (7, False)])
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_values_by_table_are_those_of_numpy(dtype: str, bands: int, planar: bool) -> None:
    """Into any type, all pixels or some; tables as transposed arrays have them, too."""
    rng, shape = np.random.default_rng(3), (20, 90)

    def in_form(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.moveaxis(array, -1, 0)).transpose(1, 2, 0) if planar else array

    values = rng.integers(0, np.iinfo(dtype).max, (*shape, bands), dtype=dtype, endpoint=True)
    wanted = (rng.random(shape) < 0.7).astype(np.uint8)
    for kind in ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64"):
        table = rng.integers(0, 100, (np.iinfo(dtype).max + 1, bands)).astype(kind).T
        for choose in (False, True):
            made = []
            for kernel in (blend.lookup, plain.lookup):
                out, seen = np.full((*shape, bands), 101, dtype=kind), np.zeros(shape, dtype=np.uint8)
                out = in_form(out)
                kernel(in_form(values), table, wanted, choose, out, seen)
                made.append((out.tobytes(), seen.tobytes()))
            assert made[0] == made[1]
            assert (out == 101).any() == choose


class Counted(ArrayReader):
    reads = 0

    def read(self, window: Window, shrink: int = 1):
        self.reads += 1
        return super().read(window, shrink)


def test_a_window_that_falls_short_is_read_again() -> None:
    """The nodes of this lattice promise less of the image than its pixels take."""
    image = np.random.default_rng(4).integers(0, 60000, (SIZE[1], SIZE[0], 1), dtype=np.uint16)
    lattice = lattice_of(0.3, 1.0, Window(0, 0, 512, 512))
    short = replace(lattice, levels=0.5 * lattice.levels + 0.5 * lattice.levels.mean(axis=(1, 2), keepdims=True))
    ways = []
    for promised in (lattice, short):
        reader = Counted(image, None)
        out, valid = np.zeros((512, 512, 1), dtype=np.uint16), np.zeros((512, 512), dtype=np.uint8)
        warp(reader, SIZE, promised, None, Sampling("cubic"), Colour.identity(1), Target(out, valid))
        ways.append((out, valid, reader.reads))
    assert ways[0][2] == 1 < ways[1][2]
    assert np.array_equal(ways[0][0], ways[1][0])
    assert np.array_equal(ways[0][1], ways[1][1])


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="only Linux tells what its processor has")
def test_kernels_are_those_for_the_widest_vectors_that_the_processor_has() -> None:
    from geomosaic.kernels.library import library

    flags = set(Path("/proc/cpuinfo").read_text().split())
    end = "-avx512" if "avx512vl" in flags else "-avx2" if "avx2" in flags else ""
    assert Path(library()._name).stem == f"kernels{end}"
