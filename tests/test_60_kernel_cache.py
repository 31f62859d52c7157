"""The kernels' cache on disk: machine code is taken again, and never with an old part."""

from __future__ import annotations

import importlib
import pickle
import pkgutil
import subprocess
import sys

import pytest

import geomosaic.resample.kernels

CALLEE = """
from geomosaic.resample.kernels.compiled import part
LIMIT = {limit}

@part
def scaled(x):
    return {factor} * x
"""
CALLER = """
from callee import LIMIT, scaled
from geomosaic.resample.kernels.compiled import kernel

@kernel
def total(x):
    return scaled(x) + LIMIT

print(total(10.0), sum(total.stats.cache_hits.values()))
"""


@pytest.fixture
def total(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)

    def run(factor: float, limit: float) -> tuple[float, int]:
        """Value of the caller in a new process, and how many of its kernels came from the cache."""
        (tmp_path / "callee.py").write_text(CALLEE.format(factor=factor, limit=limit))
        words = [sys.executable, "-B", "-c", "import caller"]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
        value, hits = done.stdout.split()
        return float(value), int(hits)

    return run


def test_a_kernel_notices_that_what_it_calls_in_another_module_has_changed(total):
    assert total(2.0, 1.0) == (21.0, 0)
    assert total(2.0, 1.0) == (21.0, 1)
    assert total(3.0, 5.0) == (35.0, 0)


def test_an_index_that_names_a_class_that_is_gone_is_written_anew(total, tmp_path):
    assert total(2.0, 1.0) == (21.0, 0)
    for index in tmp_path.rglob("*.nbi"):
        with index.open("rb") as file:
            version = pickle.load(file)
        # By hand: what Python pickles for a class is its module and its name.
        index.write_bytes(pickle.dumps(version) + b"ccallee\nGone\n.")
    assert total(2.0, 1.0) == (21.0, 0)
    assert total(2.0, 1.0) == (21.0, 1)


def test_nothing_that_changes_from_process_to_process_is_part_of_a_key():
    from geomosaic.resample.kernels.compiled import _KernelCache, _sources

    for module in pkgutil.iter_modules(geomosaic.resample.kernels.__path__, "geomosaic.resample.kernels."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(getattr(value, "_cache", None), _KernelCache):
                texts = list(_sources(value.py_func, set()))
                assert texts
                assert not [text for text in texts if " at 0x" in text or "frozenset" in text]
