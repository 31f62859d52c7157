"""An option that would do nothing beside the others is refused: by the library, the command line and projects alike."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mosaic_rig import write

from geomosaic.cli.main import run
from geomosaic.enhancement.raster import enhance
from geomosaic.errors import InputError
from geomosaic.inputs.declarations import Block, Scene
from geomosaic.jobs.project import run_project
from geomosaic.options.declaration import declared
from geomosaic.options.inputs import Area
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.project.load import load_project

AREAS = "areas.gpkg"

IDLE: list[tuple[dict[str, Any], str]] = [
    ({"rule": "mean", "feather": "5m"}, "feather"),
    ({"rule": "mean", "blend": "multiband"}, "blend"),
    ({"rule": "mean", "ramp": "smooth"}, "ramp"),
    ({"rule": "mean", "limit": False}, "limit"),
    ({"rule": "mean", "seams": "graph-cut"}, "seams"),
    ({"rule": "mean", "cutlines": AREAS}, "cutlines"),
    ({"rule": "mean", "water": AREAS}, "water"),
    ({"rule": "mean", "exclude": ["a.tif"]}, "exclude"),
    ({"rule": "mean", "retouch": {"a.tif": {"gain": 1.1}}}, "retouch"),
    ({"rule": "mean", "stretch": "2,98"}, "stretch"),
    ({"rule": "mean", "true_ortho": True}, "true_ortho"),
    ({"rule": "mean", "views": True}, "views"),
    ({"rule": "mean", "displacement": 0.0}, "displacement"),
    ({"rule": "mean", "seam_quality": True}, "seam_quality"),
    ({"rule": "mean", "colour": "gain"}, "colour"),
    ({"rule": "max", "base": "a.tif"}, "base"),
    ({"rule": "median", "order": "name"}, "order"),
    ({"rule": "count", "balance": True}, "balance"),
    ({"histogram": "overlap", "balance": True}, "balance"),
    ({"feather": "0px", "ramp": "smooth"}, "ramp"),
    ({"feather": "0", "limit": False}, "limit"),
    ({"blend": "multiband", "ramp": "smooth"}, "ramp"),
    ({"seams": "graph-cut", "seam_weights": {"follow": 0.5}}, "seam_weights"),
    ({"seams": "graph-cut", "seam_weights": {"avoid": 5.0}}, "seam_weights"),
    ({"blend": "none", "limit": True}, "limit"),
    ({"blend": "none", "feather": "20px"}, "feather"),
    ({"blend": "none", "ramp": "smooth"}, "ramp"),
    ({"balance": False, "colour": "gain"}, "colour"),
    ({"balance": False, "mask": AREAS}, "mask"),
    ({"balance": False, "master": "a.tif"}, "master"),
    ({"balance": False, "reference": "a.tif"}, "reference"),
    ({"histogram": "whole", "colour": "gain"}, "colour"),
    ({"region": AREAS}, "region"),
    ({"reference_bands": [1]}, "reference_bands"),
    ({"follow": [AREAS]}, "follow"),
    ({"avoid": [AREAS]}, "avoid"),
    ({"seam_weights": {"heights": 5.0}}, "seam_weights"),
    ({"water_fill": "tone"}, "water_fill"),
    ({"day": "2024-07-15"}, "day"),
    ({"rule": "mean", "order": "season", "day": "07-15"}, "order"),
    ({"labels": False, "views": True}, "views"),
    ({"labels": False, "displacement": 0.0}, "displacement"),
    ({"convert": "range"}, "convert"),
]
OPTIONS = {one.name: one for one in declared(MosaicOptions)}
BY_FLAG = [case for case in IDLE if all(OPTIONS[key].flag for key in case[0])]
BY_KEY = [case for case in IDLE if all(OPTIONS[key].option.section is not None for key in case[0])]


def _title(value: Any) -> str:
    return value if isinstance(value, str) else f"beside {', '.join(sorted(value))}"


@pytest.fixture
def image(tmp_path: Path) -> Path:
    return write(tmp_path / "a.tif", np.full((20, 20, 1), 90, np.uint8), 0, 0)


@pytest.mark.parametrize(("given", "name"), IDLE, ids=_title)
def test_the_library_refuses_idle_options(given: dict[str, Any], name: str) -> None:
    with pytest.raises(InputError, match=f"^`{name}` would do nothing with"):
        MosaicOptions.of(**typed(given))


@pytest.mark.parametrize(("given", "name"), BY_FLAG, ids=_title)
def test_the_command_line_refuses_idle_options(
    given: dict[str, Any], name: str, image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [word for key, value in given.items() for word in flags(key, value)]
    assert run(["mosaic", str(image), "-o", str(image.with_name("out.tif")), *words]) == 1
    assert f"{OPTIONS[name].flag} would do nothing with" in capsys.readouterr().err
    assert not image.with_name("out.tif").exists()


@pytest.mark.parametrize(("given", "name"), BY_KEY, ids=_title)
def test_projects_refuse_idle_options(given: dict[str, Any], name: str, image: Path) -> None:
    project = image.with_name("block.toml")
    lines = [f"{OPTIONS[key].key} = {toml(value)}" for key, value in given.items()]
    head = 'format = 1\n[project]\nimages = ["a.tif"]\n[sensor]\nname = "planar"\n[mosaic]\n'
    project.write_text(head + "\n".join(lines) + "\n")
    with pytest.raises(InputError, match=rf": \[mosaic\] {OPTIONS[name].key} would do nothing with"):
        load_project(project)


def test_a_radius_without_sharpening_and_a_world_file_of_a_pdf_are_refused(
    image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match="`radius` would do nothing without `sharpen`"):
        enhance(image, image.with_name("out.tif"), radius=2.0)
    assert run(["enhance", str(image), "--radius", "2", "-o", str(image.with_name("out.tif"))]) == 1
    assert "--radius would do nothing without --sharpen" in capsys.readouterr().err
    assert run(["enhance", str(image), "--method", "brovey", "-o", str(image.with_name("out.tif"))]) == 1
    assert "--method would do nothing without --pan" in capsys.readouterr().err
    for radius in (-3.0, 1e4, float("nan")):
        with pytest.raises(InputError, match=r"out of range|no finite number") as caught:
            enhance(image, image.with_name("out.tif"), sharpen=1.0, radius=radius)
        assert caught.value.where == "`radius`"
    assert run(["sheet", str(image), "--world-file", "-o", str(image.with_name("out.pdf"))]) == 1
    assert "--world-file would do nothing without --output .png" in capsys.readouterr().err
    assert run(["sheet", str(image), "--title", "X", "-o", str(image.with_name("out.tif"))]) == 1
    assert "--title would do nothing without --collar" in capsys.readouterr().err


IDLE_INPUTS: list[tuple[dict[str, Any], list[str], str]] = [
    ({"camera": "camera.toml"}, ["--camera", "camera.toml"], "camera"),
    ({"exterior": "exterior.csv"}, ["--exterior", "exterior.csv"], "exterior"),
    ({"dem": "dem.tif", "height": 3.0}, ["--dem", "dem.tif", "--height", "3"], "height"),
    ({"bands": (1,), "band_names": ("red",)}, ["--bidx", "1", "--bands", "red"], "bands"),
]


@pytest.mark.parametrize(("given", "words", "name"), IDLE_INPUTS, ids=_title)
def test_inputs_that_would_do_nothing_are_refused(
    given: dict[str, Any], words: list[str], name: str, image: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match="would do nothing with"):
        Block(image, **given)
    for each in words[::2]:
        image.with_name(words[words.index(each) + 1]).touch()
    assert run(["mosaic", str(image), "-o", str(image.with_name("out.tif")), *words]) == 1
    assert f"--{name} would do nothing with" in capsys.readouterr().err


def test_georeferenced_images_need_no_ground(image: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from geomosaic.products.mosaics import make_mosaic
    from geomosaic.products.orthos import make_ortho

    out, dem = image.with_name("out.tif"), write(image.with_name("dem.tif"), np.ones((20, 20, 1), np.float32))
    given: dict[str, Any]
    for given in ({"dem": dem}, {"height": 3.0}, {"heights": "egm96"}, {"crs": "EPSG:32633"}):
        [name] = given
        for make, options in ((make_mosaic, MosaicOptions()), (make_ortho, MosaicOptions().render)):
            with pytest.raises(InputError, match=f"^`{name}` would do nothing: the images are georeferenced"):
                make(Scene(image, **given), Area(), out, options)
    assert run(["mosaic", str(image), "--exterior-crs", "EPSG:32633", "-o", str(out)]) == 1
    assert "--exterior-crs would do nothing" in capsys.readouterr().err
    project, seams = image.with_name("block.toml"), '[mosaic]\nseams = "graph-cut"\n'
    head = 'format = 1\n[project]\nimages = ["a.tif"]\n[sensor]\nname = "planar"\n'
    idle = (('[dem]\nfile = "dem.tif"\n', r"\[dem\] file"), ('[exterior]\ncrs = "EPSG:32633"\n', r"\[exterior\] crs"))
    for text, key in idle:
        project.write_text(head + text)
        with pytest.raises(InputError, match=f"^block.toml: {key} would do nothing: the images are georeferenced"):
            run_project(project)
    project.write_text(head + seams + '[dem]\nfile = "dem.tif"\nheights = "egm96"\n')
    assert run_project(project).states
    # Seams of least cost keep to the ground beside raised objects, those between finished orthos too.
    weighed = MosaicOptions.of(seams="graph-cut")
    assert make_mosaic(Block(image, dem=dem, dem_heights="egm96"), Area(), out, weighed).valid_pixels == 400


def test_an_extent_is_that_of_a_raster_or_ones_own() -> None:
    with pytest.raises(InputError, match="`resolution` would do nothing with `like`"):
        Area(resolution=1.0, like="a.tif")
    with pytest.raises(InputError, match="`snap` would do nothing without `bounds`"):
        Area(resolution=1.0, snap=True)
    with pytest.raises(InputError, match="is no area"):
        Area(bounds=(0, 0, 1))
    assert Area(bounds=[0, 0, 1, 2]).bounds == (0.0, 0.0, 1.0, 2.0)


def test_tolerance_may_be_zero_everywhere(image: Path) -> None:
    assert MosaicOptions.of(tolerance=0).render.tolerance == 0.0
    project = image.with_name("block.toml")
    project.write_text(
        'format = 1\n[project]\nimages = ["a.tif"]\n[sensor]\nname = "planar"\n[output]\ntolerance = 0\n'
    )
    assert load_project(project).options.render.tolerance == 0.0
    assert run(["mosaic", str(image), "--tolerance", "0", "-o", str(image.with_name("out.tif"))]) == 0


def typed(given: dict[str, Any]) -> dict[str, Any]:
    """Values of the library: options classes in place of tables."""
    from geomosaic.options.mosaic import Retouch, SeamWeights

    made = dict(given)
    if "seam_weights" in made:
        made["seam_weights"] = SeamWeights(**made["seam_weights"])
    if "retouch" in made:
        made["retouch"] = {name: Retouch(**own) for name, own in made["retouch"].items()}
    return made


def flags(name: str, value: Any) -> list[str]:
    """Words of the command line."""
    flag = OPTIONS[name].flag
    if isinstance(value, bool):
        return [flag if value else f"--no-{flag[2:]}"]
    if isinstance(value, dict):
        return [word for key, part in value.items() for word in (flag, f"{key}={part}")]
    return [word for part in (value if isinstance(value, list) else [value]) for word in (flag, str(part))]


def toml(value: Any) -> str:
    """Value in TOML."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{ " + ", ".join(f'"{key}" = {toml(part)}' for key, part in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else str(value)


def test_options_of_options_may_be_tables() -> None:
    made = MosaicOptions.of(seams="graph-cut", seam_weights={"heights": 5}, retouch={"a": {"gain": 2}})
    assert made.seamlines.seam_weights.heights == 5.0
    assert made.colours.retouch["a"].gain == 2.0
    with pytest.raises(InputError, match="no option is named `hights`") as refused:
        MosaicOptions.of(seams="graph-cut", seam_weights={"hights": 5})
    assert (refused.value.where, refused.value.hint) == ("`seam_weights`", "did you mean 'heights'?")


def test_a_weight_of_raised_objects_needs_a_surface_on_which_some_stand(image: Path) -> None:
    from geomosaic.products.mosaics import make_mosaic

    options = MosaicOptions.of(seams="graph-cut", seam_weights={"heights": 5})
    with pytest.raises(InputError, match="`seam_weights` would do nothing with 'heights'"):
        make_mosaic(Block(image), Area(), image.with_name("out.tif"), options)
    with pytest.raises(InputError, match="a width of 0 leaves nothing to blend over"):
        MosaicOptions.of(blend="overlap", feather=0)
