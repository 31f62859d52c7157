"""What every test shares: where the real data is, the sample block, a project made of it, and the command line."""

from __future__ import annotations

import gc
import importlib.util
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

# Tests fill the processors; threads of linear algebra would only wait for each other. Set before NumPy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")
os.environ.setdefault("OGR_SQLITE_SYNCHRONOUS", "OFF")

import pytest
from cli_rig import PHOTOS, PLACE, flags, photos
from hypothesis import settings

# Syntax trees of all tests are made while they are collected, and nothing of them is garbage; what the tests are stays
# to the end. Looking through it again and again took a third of the collection.
gc.disable()

# Files of tests need not outlast a power cut, nor GeoPackages (above): waiting for the disk took a fifth of the time.
os.fsync = lambda _: None


def pytest_collection_finish() -> None:
    """Collect garbage of tests only."""
    gc.enable()
    gc.freeze()


# A script that runs tests in the background has them ignore Ctrl-C, and children inherit that; a handler they do not.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parent.parent

# The same examples in every run; HYPOTHESIS_PROFILE=search looks for new ones, twenty times as many.
settings.register_profile("fixed", derandomize=True, deadline=None)
settings.register_profile("search", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))


@pytest.fixture(scope="session")
def real_data() -> Callable[[str], Path]:
    """Folder of a real data set, or a skip that says why."""
    base = Path(os.environ.get("GEOMOSAIC_REAL_DATA") or ROOT.parent / "shared" / "data" / "real")

    def find(name: str) -> Path:
        folder = base / name
        if not folder.is_dir():
            pytest.skip(f"real data set '{name}' is not here ({base}); set GEOMOSAIC_REAL_DATA to its parent folder")
        return folder

    return find


@pytest.fixture(scope="session")
def sample() -> Path:
    """Folder of the sample block in the repository."""
    return ROOT / "data" / "sample"


@pytest.fixture(scope="session")
def generator() -> ModuleType:
    """Module that made the sample block."""
    spec = importlib.util.spec_from_file_location("make_sample", ROOT / "data" / "make_sample.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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


@pytest.fixture(scope="session")
def project(block, tmp_path_factory) -> Path:
    """A project made by `new` and run once over a small place; tests copy it before they change it."""
    from geomosaic.cli.main import run

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
    from geomosaic.cli.main import run

    def call(*words: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = run([str(word) for word in words])
        return code, *capsys.readouterr()

    return call


@pytest.fixture(scope="session")
def object_server() -> Iterator[Any]:
    """S3 server of moto with the bucket `tests`, in a process of its own; keys are checked."""
    from rigs.object_store import NO_MOTO, moto_python, moto_server

    if moto_python() is None:
        pytest.skip(NO_MOTO)
    with moto_server() as server:
        yield server


@pytest.fixture
def object_store(object_server: Any, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Bucket `tests` behind a proxy that counts and makes faults, as the environment of the process has it."""
    from rigs.object_store import proxied

    from geomosaic.stores import clients, objects

    with proxied(object_server.endpoint) as proxy:
        settings = {
            "AWS_ACCESS_KEY_ID": object_server.key,
            "AWS_SECRET_ACCESS_KEY": object_server.secret,
            "AWS_ENDPOINT_URL": proxy.endpoint,
            "GDAL_HTTP_MAX_RETRY": "4",
            "GDAL_HTTP_RETRY_DELAY": "0.02",
        }
        for name, value in settings.items():
            monkeypatch.setenv(name, value)
        clients.forget()
        objects.forget()
        yield proxy
    clients.forget()
    objects.forget()
