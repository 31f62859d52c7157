"""The registry of sensors, tried with real distributions in folders of their own."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from helpers import forget_sensors
from pyproj import CRS

from geomosaic.errors import SensorError
from geomosaic.sensor import corrected as state_of
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest

ROOT = Path(__file__).resolve().parent.parent
Install = Callable[..., None]

GOOD = """
from geomosaic.sensor.plugin import Capabilities
from solve_rig import Camera, camera

class Plugin:
    name = "kite"
    summary = "a camera on a kite"
    inputs = ()
    capabilities = Capabilities()
    model = Camera

    def build(self, request):
        return camera()

plugin = Plugin()
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Put a distribution on the path: its name, its entry points, its modules."""

    def make(distribution: str, points: dict[str, str], **modules: str) -> None:
        folder = tmp_path / distribution
        info = folder / f"{distribution.replace('-', '_')}-1.2.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.2\n")
        lines = [f"{name} = {target}" for name, target in points.items()]
        (info / "entry_points.txt").write_text("\n".join(["[geomosaic.sensors]", *lines, ""]))
        for name, text in modules.items():
            (folder / f"{name}.py").write_text(textwrap.dedent(text))
        monkeypatch.syspath_prepend(str(folder))
        forget_sensors()

    before = set(sys.modules)
    forget_sensors()
    yield make
    forget_sensors()
    for name in set(sys.modules) - before:
        if name.startswith("acme_"):
            del sys.modules[name]


def test_third_party_plugin_is_listed_and_built(install: Install) -> None:
    install("acme-kite", {"kite": "acme_kite:plugin"}, acme_kite=GOOD)
    entry = next(entry for entry in registry.sensors() if entry.name == "kite")
    assert (entry.distribution, entry.version, entry.target) == ("acme-kite", "1.2", "acme_kite:plugin")
    assert "acme_kite" not in sys.modules
    model = registry.build("kite", SensorRequest("photo", (10, 10)))
    assert "acme_kite" in sys.modules
    state = state_of.model_to_dict("kite", model)
    back = state_of.model_from_dict(state)
    point = np.array([model.seed])
    np.testing.assert_array_equal(back.ground_to_image(point), model.ground_to_image(point))


def test_listing_loads_nothing() -> None:
    """In a process of its own: neither a plugin nor what plugins need is imported by listing them."""
    code = (
        "import sys; from geomosaic.sensor import registry; names = [e.name for e in registry.sensors()]; "
        "print(*names); print(*[m for m in sys.modules if m.startswith('geomosaic_')])"
    )
    path = [str(ROOT), str(ROOT / "plugins"), *sys.path]
    command = [sys.executable, "-c", f"import sys; sys.path[:0] = {path!r}; {code}"]
    names, loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\n")[:2]
    assert "planar" in names.split()
    assert names.split() == sorted(names.split())
    assert loaded == ""


def test_broken_plugin_names_its_cause_and_harms_no_other(install: Install) -> None:
    install("acme-broken", {"broken": "acme_broken:plugin"}, acme_broken="import acme_that_is_nowhere")
    assert "broken" in [entry.name for entry in registry.sensors()]
    with pytest.raises(SensorError, match=r"acme-broken 1\.2 cannot be loaded") as caught:
        registry.plugin("broken")
    assert "acme_that_is_nowhere" in str(caught.value)
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)
    assert registry.plugin("planar").name == "planar"


@pytest.mark.parametrize(("text", "says"), [("1 / 0", "ZeroDivisionError"), ("other = 1", "AttributeError")])
def test_other_breaks_are_named_too(install: Install, text: str, says: str) -> None:
    install("acme-broken", {"broken": "acme_broken:plugin"}, acme_broken=text)
    with pytest.raises(SensorError, match=says):
        registry.plugin("broken")


def test_half_a_plugin_is_refused(install: Install) -> None:
    install("acme-half", {"half": "acme_half:plugin"}, acme_half="class plugin:\n    name = 'half'")
    with pytest.raises(SensorError, match="has no summary, inputs, capabilities, model, build"):
        registry.plugin("half")


def test_doubled_names_name_both_distributions(install: Install) -> None:
    install("acme-one", {"kite": "acme_one:plugin"}, acme_one=GOOD)
    install("acme-two", {"kite": "acme_two:plugin"}, acme_two=GOOD)
    with pytest.raises(SensorError, match="two sensors are named 'kite'") as caught:
        registry.plugin("kite")
    assert "acme-one 1.2" in str(caught.value)
    assert "acme-two 1.2" in str(caught.value)
    assert [entry.distribution for entry in registry.sensors() if entry.name == "kite"] == ["acme-one", "acme-two"]
    assert registry.plugin("planar").name == "planar"


def test_a_plugin_cannot_take_the_name_of_a_built_in(install: Install) -> None:
    install("acme-planar", {"planar": "acme_planar:plugin"}, acme_planar=GOOD)
    with pytest.raises(SensorError, match="acme-planar"):
        registry.plugin("planar")


def test_unknown_sensor_suggests_and_lists() -> None:
    with pytest.raises(SensorError, match="no sensor named 'plannar'") as caught:
        registry.plugin("plannar")
    assert "did you mean 'planar'?" in str(caught.value)
    assert all(name in str(caught.value) for name in ("frame", "planar"))


def test_built_in_goes_through_the_same_door() -> None:
    request = SensorRequest("ortho", (100, 80), {"transform": Affine(2, 0, 5e5, 0, -2, 5e6)}, CRS.from_epsg(32633))
    model = registry.build("planar", request)
    assert type(model).__module__.split(".")[0] == "geomosaic_planar"
    back = state_of.model_from_dict(state_of.model_to_dict("planar", model))
    point = np.array([[500_100.0, 4_999_950.0, 0.0]])
    np.testing.assert_allclose(back.ground_to_image(point), [[50.0, 25.0]], atol=1e-9)
