"""The block kernels for maps brought to another CRS: the bytes of the plain way, whatever the turn and the scale."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import ArrayReader

from geomosaic.geo.grid import Window
from geomosaic.resample.engine import Target, numba_engine, numpy_engine
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


def test_code_that_is_kept_starts_without_the_compilers_knowledge() -> None:
    """Linear algebra among it, a quarter of a second; who compiles afterwards has it all."""
    program = """
import sys
import numpy as np
from geomosaic.resample.kernels.blend import lookup
values, table, seen = np.zeros((4, 4, 1), np.uint8), np.full((1, 256), 7, np.uint8), np.zeros((4, 4), np.uint8)
out = np.zeros_like(values)
lookup(values, table, seen, False, out, seen)
assert (out == 7).all()
print("numba.np.arraymath" in sys.modules, "scipy.linalg" in sys.modules)
from numba import njit
product = njit(lambda a, b: (a @ b).sum())
a = np.arange(9.0).reshape(3, 3) + np.eye(3)
assert np.allclose(product(a, a), (a @ a).sum())
"""
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["False", "False"]


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="only Linux tells what its processor has")
def test_kernels_are_those_for_the_widest_vectors_that_the_processor_has() -> None:
    from geomosaic.resample.kernels.library import library

    flags = set(Path("/proc/cpuinfo").read_text().split())
    end = "-avx512" if "avx512vl" in flags else "-avx2" if "avx2" in flags else ""
    assert Path(library()._name).stem == f"kernels{end}"
