"""The library of compiled kernels: built of the sources here, the same bytes from every variant, missed with a hint."""

from __future__ import annotations

import ctypes
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomosaic.errors import InstallationError
from geomosaic.kernels import library as kernels

ROOT = Path(__file__).parents[1]
FOLDER = Path(kernels.__file__).parent


def hatch_build() -> Any:
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def variants() -> list[ctypes.CDLL]:
    """Libraries that this processor can run, the plainest first."""
    lowest = ctypes.CDLL(str(FOLDER / f"kernels{kernels.SUFFIX}"))
    more = ("-avx2", "-avx512")[: lowest.vector_instructions()]
    return [lowest, *(ctypes.CDLL(str(FOLDER / f"kernels{end}{kernels.SUFFIX}")) for end in more)]


def test_the_libraries_are_built_of_the_sources_that_stand_here() -> None:
    assert kernels.sources(FOLDER) == hatch_build().digest()
    for built in variants():
        built.sources.restype = ctypes.c_char_p
        assert built.sources().decode() == kernels.sources(FOLDER), "run `python hatch_build.py`"


def test_a_library_that_is_missing_or_of_other_sources_is_refused_with_how_to_build_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernels, "__file__", str(tmp_path / "library.py"))
    with pytest.raises(ImportError, match=r"cannot be loaded .*kernels") as caught:
        kernels.library.__wrapped__()
    assert isinstance(caught.value, InstallationError)
    assert "python hatch_build.py" in str(caught.value.hint)
    for file in (*FOLDER.glob("*.[ch]pp"), *FOLDER.glob(f"kernels*{kernels.SUFFIX}")):
        shutil.copy(file, tmp_path)
    assert kernels.library.__wrapped__().vector_instructions() >= 0
    with (tmp_path / "array.hpp").open("a") as header:
        header.write("// edited\n")
    with pytest.raises(InstallationError, match="not of the C"):
        kernels.library.__wrapped__()


def test_every_variant_gives_the_same_bytes() -> None:
    """Each kernel, called by what draws a picture; in a process of its own, where none has been loaded yet."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True, check=False, cwd=ROOT / "tests")
    assert done.returncode == 0, done.stderr
    kernels_here = {
        name for file in FOLDER.glob("*.cpp") for name in re.findall(r"(?m)^KERNEL int64_t (\w+)\(", file.read_text())
    }
    assert kernels_here - set(done.stdout.split()) == {"vector_instructions"}


@pytest.mark.skipif(sys.platform == "win32", reason="pages are guarded by what POSIX has")
def test_kernels_touch_nothing_beside_their_arrays() -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "rigs" / "guarded.py")], capture_output=True, text=True, check=False
    )
    assert done.stdout == "untouched\n", f"ended with {done.returncode} {done.stderr}"


class Compared:
    """A kernel by all variants, one after the other, on the same arrays."""

    argtypes: Any = None
    restype: Any = None

    def __init__(self, name: str, found: list[ctypes.CDLL], lock: Lock) -> None:
        self.name, self.forms, self.lock = name, [each[name] for each in found], lock

    def __call__(self, *values: Any) -> Any:
        arrays = [as_array(value._obj) for value in values if hasattr(value, "_obj")]
        with self.lock:
            before = [array.copy() for array in arrays]
            results = []
            for form in self.forms:
                for array, first in zip(arrays, before, strict=True):
                    if array.tobytes() != first.tobytes():  # an array that is only read may not be written to
                        array[...] = first
                form.argtypes, form.restype = self.argtypes, self.restype
                results.append((form(*values), *(array.tobytes() for array in arrays)))
        assert all(result == results[0] for result in results[1:]), f"{self.name} differs"
        return results[0][0]


def as_array(described: Any) -> np.ndarray:
    """The array that a kernel is told of."""
    dtype = np.dtype(kernels.TYPES[described.type])
    axes = max((k + 1 for k in range(4) if described.stride[k]), default=0)
    there = {
        "data": (described.data, False), "typestr": dtype.str, "version": 3, "shape": tuple(described.shape[:axes]),
        "strides": tuple(stride * dtype.itemsize for stride in described.stride[:axes]),
    }  # fmt: skip
    return np.asarray(SimpleNamespace(__array_interface__=there))


def draw(folder: Path) -> None:
    """Call each kernel as the program does."""
    from mosaic_rig import run, scene, write

    ground = scene(300, 420)
    ways: list[tuple[str, dict[str, Any]]] = [
        ("uint8", {"blend": "multiband"}),
        ("uint8", {"blend": "overlap", "resampling": "cubic"}),
        ("uint16", {"balance": True, "colour": ("gain", "haze"), "resampling": "lanczos"}),
        ("float32", {"resampling": "average"}),
    ]
    for dtype, words in ways:
        values = ground.astype(dtype)
        left, right = write(folder / "a.tif", values[:, :260]), write(folder / "b.tif", values[40:, 130:], 130.3, 40.4)
        run([left, right], folder / "mosaic.tif", labels=False, vectors=False, **words)
    moved = ground[40:, 130:].astype(np.uint8)
    moved[60:100, 40:90] = 250
    left, right = write(folder / "a.tif", ground[:, :260].astype(np.uint8)), write(folder / "b.tif", moved, 130, 40)
    run([left, right], folder / "mosaic.tif", labels=False, vectors=False)
    resample()
    correct()
    see()
    find()
    adjust()
    place()


def resample() -> None:
    """Sample over relief: all methods, and several types, numbers of bands and interleavings."""
    from geomosaic.kernels.warp import METHODS, Geometry, OutputScaling, Pixels, coordinates, sample, warp

    rng = np.random.default_rng(1)
    down, along = np.mgrid[0:3, 0:4]
    nodes = rng.normal(0.0, 0.2, (3, 4, 8))
    nodes[..., 0], nodes[..., 4] = 15.3 + 55.1 * along + 3.0 * down, 9.8 + 51.7 * down
    heights = rng.normal(100.0, 30.0, (40, 50)).astype(np.float32)
    geometry = Geometry(nodes, np.stack([12.3 * along, 14.1 * down], axis=-1), heights, 100.0, 0.01, False, 64)
    need, size = np.ones((2, 3), dtype=np.uint8), (190, 120)
    places = np.empty((2, 2 * 128, 2 * 180))
    coordinates(geometry, 0, 2, size, need, *places)
    seen = (rng.random(size[::-1]) < 0.98).astype(np.uint8)
    for dtype, bands, valid in (("uint8", 3, None), ("uint16", 4, seen), ("int16", 2, seen), ("float32", 1, None)):
        image = (100.0 * rng.random((bands, *size[::-1]))).astype(dtype).transpose(1, 2, 0)
        pixels = Pixels(np.ascontiguousarray(image) if bands == 3 else image, valid, 0, 0, 1, size)
        ending = OutputScaling(np.full(bands, 1.3), np.full(bands, -2.1), 0.0, 250.0, dtype != "float32")
        for method in METHODS:
            for n in (1, 2):
                out, found = np.zeros((128, 180, bands), dtype=dtype), np.zeros((128, 180), dtype=np.uint8)
                assert warp(geometry, 0, n, need, pixels, method, ending, out, found) == 128
                assert found.mean() > 0.3
            out, found = np.zeros((256, 360, bands), dtype=dtype), np.zeros((256, 360), dtype=np.uint8)
            sample(*places, pixels, method, ending, out, found)


def correct() -> None:
    """Correct colours by table, and by place and curve."""
    from geomosaic.kernels.blend import lookup, shade

    rng, shape = np.random.default_rng(3), (70, 300)
    seen = (rng.random(shape) < 0.9).astype(np.uint8)
    for dtype, high in (("uint8", 255.0), ("uint16", 65535.0)):
        values = rng.integers(0, int(high), (*shape, 3), dtype=dtype)
        out, valid = np.zeros_like(values), np.zeros(shape, dtype=np.uint8)
        lookup(values, rng.integers(0, 255, (3, int(high) + 1), dtype=dtype), seen, True, out, valid)
        net, path, curve = rng.uniform(0.5, 2, (5, 7, 3)), rng.random((5, 7)), rng.uniform(0, high, (3, 4097))
        dark, haze, offset = rng.normal(0, 3, (3, 3))
        place = -0.4, 0.7, 0.02, 0.05
        shade(values, seen, net, path, haze, place, dark, curve, high, offset, 0.0, high, True, out, valid)


def see() -> None:
    """Follow lines of sight, and find summits."""
    from geomosaic.relief.spot_heights import prominences
    from geomosaic.resample import occlusion

    rng = np.random.default_rng(2)
    heights = rng.normal(0.0, 0.3, (170, 190)).astype(np.float32)
    heights[30:60, 80:100], heights[90:130, 20:40] = 20.0, 9.0
    nodes = np.zeros((3, 3, 8))
    nodes[..., 1], nodes[..., 0] = np.mgrid[0:3, 0:3] * occlusion.STEP + 20.2
    nodes[..., 2], nodes[..., 5], nodes[..., 3] = 0.6, -0.4, 0.01
    hidden = np.zeros((128, 128), dtype=np.uint8)
    relief = occlusion.Relief.of(heights, 1.0, 0.5)
    occlusion.hidden(occlusion.Field(nodes, 10.0, 0.1, 0.5), relief, np.ones_like(hidden), hidden)
    assert 0.05 < hidden.mean() < 0.5
    occlusion.upright(heights, (0.3, 70.0, -0.3, 60.0), 1.5, np.empty((99, 101), dtype=np.float32))
    prominences(heights)


def find() -> None:
    """Compare descriptors of features, anywhere and near expected places, and match patches."""
    from scipy.ndimage import gaussian_filter

    from geomosaic.matching.descriptors import Expected, match_descriptors
    from geomosaic.matching.features import Features
    from geomosaic.matching.least_squares import match_patches

    rng = np.random.default_rng(4)
    values, colrow = rng.integers(0, 120, (300, 128), dtype=np.uint8), rng.uniform(0.0, 500.0, (300, 2))
    one = Features(colrow, np.ones(300), np.zeros(300), values)
    other = Features(colrow + 3.0, one.scale, one.angle, values + rng.integers(0, 9, values.shape, dtype=np.uint8))
    lines = np.column_stack([np.zeros(300), np.ones(300), -colrow[:, 1]])
    for expected in (None, Expected(colrow, lines, 40.0, 5.0)):
        assert len(match_descriptors(one, other, expected)) > 250
    image = 128.0 + 300.0 * gaussian_filter(rng.normal(0.0, 1.0, (150, 160)), 2.0)
    pixels = rng.integers(20, 130, (100, 2))
    for dtype in ("uint8", "float64"):
        first, second = image[:-1, :-1].astype(dtype), np.roll(image, (-2, -3), (0, 1))[:-1, :-1].astype(dtype)
        start = pixels + 0.5 - [3.0, 2.0] + rng.uniform(-0.8, 0.8, pixels.shape)
        found = match_patches(first, second, pixels, start, np.broadcast_to([[1.02, 0.01], [0.0, 0.99]], (100, 2, 2)))
        assert found.found.mean() > 0.8


def adjust() -> None:
    """Solve a network of images and points, with all its cofactors."""
    from network_rig import random_network

    network = random_network(5, images=20, points=60)
    network.step(1e-3)
    network.point_cofactors()
    network.redundancy_numbers()


def place() -> None:
    """Place points by RPCs."""
    from geomosaic_rpc.coefficients import evaluate

    rng = np.random.default_rng(6)
    evaluate(rng.normal(0.0, 1.0, (4, 20)), rng.uniform(-1.0, 1.0, (150, 3)))


class Libraries:
    """What takes the place of the library: its functions, compared."""

    def __init__(self) -> None:
        self.found, self.lock, self.called = variants(), Lock(), dict[str, Compared]()

    def __getitem__(self, name: str) -> Compared:
        return self.called.setdefault(name, Compared(name, self.found, self.lock))


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT / "tests" / "rigs"))
    libraries = Libraries()
    kernels.library = lambda: libraries  # type: ignore[assignment]
    with TemporaryDirectory() as name:
        draw(Path(name))
    print(*libraries.called)
