"""The block kernels for maps brought to another CRS: the bytes of the plain way, whatever the turn and the scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy_kernels as plain
import pytest
from helpers import ArrayReader

from geomosaic.geo.grid import Window
from geomosaic.resample.engine import Target, numba_engine, numpy_engine
from geomosaic.resample.kernels import blend
from geomosaic.resample.warp import Colour, Sampling, warp
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
def test_the_same_bytes_as_the_reference_engine(turn: float, scale: float) -> None:
    image = np.random.default_rng(3).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    lattice = lattice_of(turn, scale, Window(0, 0, 640, 512), bend=2.0)
    ways, taken = [], []
    compiled = numba_engine()
    inner = compiled.block_kernels["bilinear, inner"]
    watched = {**compiled.block_kernels, "bilinear, inner": lambda *a: (taken.append(1), inner(*a))[1]}
    for engine in (numpy_engine(), replace(compiled, block_kernels=watched)):
        out, valid = np.zeros((512, 640, 3), dtype=np.uint8), np.zeros((512, 640), dtype=np.uint8)
        reader = ArrayReader(image, None)
        warp(engine, reader, SIZE, lattice, None, BILINEAR, Colour.identity(3), Target(out, valid))
        ways.append((out, valid))
    assert taken, "no block kernel was called"
    assert (ways[0][1] == 1).all()
    assert np.array_equal(*(valid for _, valid in ways))
    assert np.array_equal(*(out for out, _ in ways))


def test_a_block_that_leaves_the_image_goes_the_careful_way() -> None:
    image = np.full((SIZE[1], SIZE[0], 3), 77, dtype=np.uint8)
    lattice = lattice_of(0.6, 1.3, Window(0, 0, 1024, 512))
    out, valid = np.zeros((512, 1024, 3), dtype=np.uint8), np.zeros((512, 1024), dtype=np.uint8)
    warp(
        numba_engine(),
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
def test_a_block_across_the_edge_is_cut(need: str | None) -> None:
    """What is inside goes the short way, what is not the careful one: the bytes and the mask of the twin."""
    image = np.random.default_rng(4).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    lattice = lattice_of(0.03, 1.0, Window(640, 384, 1000, 500))
    cells = None if need is None else np.indices((8, 16)).sum(axis=0).astype(np.uint8) % 2
    compiled = numba_engine()
    taken: list[str] = []

    def watched(name: str) -> Callable[..., int]:
        return lambda *a: (taken.append(name), compiled.block_kernels[name](*a))[1]

    ways = []
    for engine in (
        numpy_engine(),
        replace(compiled, block_kernels={name: watched(name) for name in compiled.block_kernels}),
    ):
        out, valid = np.zeros((500, 1000, 3), dtype=np.uint8), np.zeros((500, 1000), dtype=np.uint8)
        warp(
            engine,
            ArrayReader(image, None),
            SIZE,
            lattice,
            None,
            Sampling("bilinear"),
            Colour.identity(3),
            Target(out, valid, cells),
        )
        ways.append((out, valid))
    assert {"bilinear", "bilinear, inner"} <= set(taken)
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


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="only Linux tells what its processor has")
def test_kernels_are_those_for_the_widest_vectors_that_the_processor_has() -> None:
    from geomosaic.resample.kernels.library import library

    flags = set(Path("/proc/cpuinfo").read_text().split())
    end = "-avx512" if "avx512vl" in flags else "-avx2" if "avx2" in flags else ""
    assert Path(library()._name).stem == f"kernels{end}"
