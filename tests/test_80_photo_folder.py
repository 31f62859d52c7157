"""`geomosaic new` of a folder of photos: what is in it is sorted, told and drafted; nothing is asked for."""

from __future__ import annotations

import csv
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from photo_rig import PLACES, SIZE, ground, photo
from PIL import Image, ImageFilter

from geomosaic.cli.main import run
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.summary import list_missing_inputs
from geomosaic.project import folders
from geomosaic.project.drafts import Draft, new_project
from geomosaic.project.load import load_project

Draw = np.random.default_rng


def drafted(folder: Path, **more: Any) -> tuple[Draft, dict[str, Any], str]:
    """Draft of a folder, the project as read, and what was told; it is a project that can be run."""
    draft = new_project(folder.parent / "p.toml", folder, **more)
    if not draft.needed:
        assert list_missing_inputs(load_project(draft.path).inputs, tied=True) == []
    return draft, tomllib.loads(draft.text), "\n".join(draft.recognised)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four photos of a drone, of one strip."""
    home = tmp_path / "photos"
    home.mkdir()
    for number in range(4):
        photo(home / f"{number}.jpg", (13.4 + 0.0003 * number, 52.52), values=ground(number))
    return home


def georeferenced(path: Path, dtype: str) -> None:
    """Raster of noise in UTM, each another one."""
    values = Draw(len(path.name) + ord(path.name[0])).uniform(0.0, 200.0, (1, SIZE[1], SIZE[0])).astype(dtype)
    kind = {"count": 1, "dtype": dtype, "crs": "EPSG:32633", "transform": Affine.translation(400_000.0, 5_800_000.0)}
    with rasterio.open(path, "w", "GTiff", SIZE[0], SIZE[1], **kind) as file:
        file.write(values)


def test_drone_photos_become_a_project_that_asks_for_nothing(folder: Path) -> None:
    draft, project, told = drafted(folder)
    assert (draft.needed, draft.misfit, draft.aside) == ([], None, {})
    assert "NEEDED" not in draft.text
    assert project["match"] == {}
    assert project["adjust"]["position_sigma"] == 3.0
    assert project["adjust"]["attitude_sigma"] == 5.0
    assert [text.partition("=")[0] for text in project["adjust"]["interior"]] == [
        "focal_length", "principal_point", "k1", "k2",
    ]  # fmt: skip
    assert project["dem"] == {"from_tie_points": True}
    assert project["quality"]["max_corner_sigma_px"] == pytest.approx(9.0 / 0.365, rel=0.02)
    assert project["output"]["crs"] == "EPSG:32633"
    assert project["exterior"] == {
        "file": "p-exterior.csv", "crs": "EPSG:4326", "heights": "egm96", "angles": "dji",
    }  # fmt: skip
    assert "4 of 4 photos have a position, 4 a gimbal attitude" in told
    assert "101.2 to 101.2 m above the place of take-off, ground sampling some 36 cm" in told
    # The geoid lies 39 m above the ellipsoid there.
    assert "vertical datum of the altitudes assumed: egm96" in told
    assert "if they count from the ellipsoid, all heights shift by 39." in told
    assert "ASSUMED" in draft.text.split("heights = ")[1].splitlines()[0]


def test_positions_by_rtk_are_taken_at_their_word(folder: Path) -> None:
    tags = {"RtkFlag": "50", "RtkStdLon": "0.011", "RtkStdLat": "0.012", "RtkStdHgt": "0.08"}
    for number in range(4):
        place = (13.4 + 0.0003 * number, 52.52)
        photo(folder / f"{number}.jpg", place, values=ground(number), more_xmp=tags)
    _, project, _ = drafted(folder)
    assert project["adjust"]["position_sigma"] == 0.08
    assert project["exterior"]["heights"] == "ellipsoidal"


def test_photos_with_positions_alone_are_drafted_for_tie_points(folder: Path) -> None:
    for number in range(4):
        place = (13.4 + 0.0003 * number, 52.52) if number else None
        photo(folder / f"{number}.jpg", place, values=ground(number), gimbal=False)
    draft, project, _ = drafted(folder)
    assert draft.needed == []
    assert project["exterior"]["angles"] == "none"
    assert "attitude_sigma" not in project["adjust"]
    lines = (folder.parent / "p-positions.csv").read_text().splitlines()
    assert lines[:2] == ["image,x,y,z", "0.jpg,,,"]
    assert len(lines) == 5


def test_photos_that_say_nothing_get_a_frame_of_their_own_and_a_camera_that_is_assumed(folder: Path) -> None:
    for number in range(4):
        Image.fromarray(ground(number)).save(folder / f"{number}.jpg")
    draft, project, told = drafted(folder)
    assert draft.needed == []
    assert project["exterior"] == {"crs": "local"}
    assert "position_sigma" not in project["adjust"]
    assert "without a place on the Earth" in told
    assert "focal length 480.0 px, ASSUMED, 1.2 times the longer side" in told
    assert "ASSUMED" in (folder.parent / "p-camera.toml").read_text()
    assert project["adjust"]["interior"][0] == "focal_length=140"


def test_two_cameras_are_one_block_of_two_cameras(folder: Path) -> None:
    for number in (2, 3):
        place = (13.4 + 0.0003 * number, 52.52)
        photo(folder / f"{number}.jpg", place, values=ground(number), equivalent=50, camera="Model 2")
    photo(folder / "4.jpg", PLACES[0], values=ground(4, (300, 400)))  # stored turned
    Image.fromarray(ground(5)).save(folder / "5.jpg")  # an edited photo, whose size two cameras have
    _, project, told = drafted(folder)
    own = {table["path"][0]: table["camera"] for table in project["images"]}
    assert project["sensor"]["camera"] == "p-camera.toml"
    assert own == {
        "photos/2.jpg": "p-camera-2.toml", "photos/4.jpg": "p-camera-3.toml", "photos/5.jpg": "p-camera-4.toml",
    }  # fmt: skip
    cameras = [tomllib.loads((folder.parent / name).read_text()) for name in ("p-camera.toml", *own.values())]
    diagonal = np.hypot(*SIZE) / np.hypot(36.0, 24.0)
    assert [camera["focal_length_px"] for camera in cameras] == pytest.approx(
        [24 * diagonal, 50 * diagonal, 24 * diagonal, 1.2 * 400], abs=1e-3
    )
    assert [camera["size"] for camera in cameras[1:3]] == [[400, 300], [300, 400]]
    assert "4 cameras or lens settings: one block" in told
    # Each as its focal length is known: by tags, by others, and by nothing.
    assert project["adjust"]["interior"][:3] == ["focal_length=11", "focal_length:2.jpg=23", "focal_length:5.jpg=140"]


def test_an_edited_photo_has_the_camera_of_the_others_of_its_size(folder: Path) -> None:
    Image.fromarray(ground(5)).save(folder / "5.jpg")
    _, project, told = drafted(folder)
    assert "images" not in project
    assert "no tags: 5.jpg; taken for photos of the Maker Model 1" in told


def test_a_flag_that_says_turned_turns_nothing(folder: Path) -> None:
    drafted(folder)
    tables = [(folder.parent / name).read_text() for name in ("p-exterior.csv", "p-camera.toml")]
    for number in range(4):
        place = (13.4 + 0.0003 * number, 52.52)
        photo(folder / f"{number}.jpg", place, values=ground(number), orientation=6)
    _, _, told = drafted(folder, overwrite=True)
    assert [(folder.parent / name).read_text() for name in ("p-exterior.csv", "p-camera.toml")] == tables
    assert "taken as they are stored" in told


def test_what_is_no_photo_of_the_block_is_set_aside_with_its_reason(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "BLOCK", 3)
    (folder / "notes.txt").write_text("side-cars of nothing are not spoken of")
    (folder / "flight.srt").write_text("x")
    (folder / "clip.mov").write_text("x")
    (folder / "raw.dng").write_text("x")
    (folder / "0.dng").write_text("the raw of a photo that is there")
    (folder / "sub").mkdir()
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "film.jpg").write_bytes(b"\0\0\0\x18ftypmp42" + bytes(40))
    (folder / "noise.jpg").write_bytes(Draw(0).bytes(300))
    shutil.copy(folder / "1.jpg", folder / "copy.jpg")
    with Image.open(folder / "2.jpg") as picture:
        picture.resize((80, 60)).save(folder / "small.jpg")
        picture.resize((200, 150)).save(folder / "half.jpg")
        picture.filter(ImageFilter.GaussianBlur(1)).save(folder / "shaken.jpg", exif=picture.getexif())
        picture.save(folder / "edited.png")
    draft, project, told = drafted(folder)
    assert project["project"]["images"] == [f"photos/{number}.jpg" for number in range(4)]
    assert draft.aside == {
        "empty.jpg": "the file is empty",
        "film.jpg": "a movie, whatever its name says; take single pictures out of it",
        "noise.jpg": "it cannot be read as an image",
        "copy.jpg": "the same file as 1.jpg",
        "small.jpg": "80 x 60 pixels, a thumbnail beside the others",
        "half.jpg": "a reduced copy of 2.jpg",
        "edited.png": "a copy of 2.jpg without its tags",
        "shaken.jpg": "it shows from the same place what 2.jpg shows sharper",
    }
    for name, why in draft.aside.items():
        assert f"set aside {name}: {why}" in told
        assert f'    # "photos/{name}",    # {why}' in draft.text
    assert "1 movie: clip.mov" in told
    assert "1 raw photo: raw.dng" in told
    assert "1 file that is no image: flight.srt" in told
    assert "not looked into: sub/" in told
    assert not any(f"photos/{name}" in str(project) for name in draft.aside)


def test_pictures_that_are_named_one_by_one_are_never_set_aside(folder: Path) -> None:
    shutil.copy(folder / "1.jpg", folder / "copy.jpg")
    draft = new_project(folder.parent / "p.toml", sorted(folder.iterdir()))
    assert draft.aside == {}
    assert "photos/copy.jpg" in draft.text


def test_blurred_photos_are_told_and_those_beyond_use_set_aside(folder: Path) -> None:
    soft = Image.fromarray(ground(4)).filter(ImageFilter.GaussianBlur(1.0))
    photo(folder / "4.jpg", PLACES[0], values=np.asarray(soft))
    shaken = Image.fromarray(ground(5, (100, 75))).resize(SIZE).filter(ImageFilter.GaussianBlur(2.0))
    photo(folder / "5.jpg", PLACES[0], values=np.asarray(shaken))
    water = np.clip(90.0 + 0.4 * Draw(1).normal(size=(SIZE[1], SIZE[0], 1)) + np.zeros(3), 0, 255).astype(np.uint8)
    photo(folder / "6.jpg", PLACES[0], values=water)
    draft, project, told = drafted(folder)
    assert draft.aside == {"5.jpg": "blurred beyond use"}
    assert "blurred beside the others, and kept: 4.jpg" in told
    assert "next to no detail (water, clouds, fog, or blurred), and kept: 6.jpg" in told
    assert len(project["project"]["images"]) == 6


def test_positions_that_cannot_be_are_not_used(folder: Path) -> None:
    photo(folder / "4.jpg", (0.0, 0.0), values=ground(4))
    photo(folder / "5.jpg", (70.6, 33.4), values=ground(5))
    draft, _, told = drafted(folder)
    assert draft.aside == {}
    assert "position 0, 0 not used (the receiver had none yet): 4.jpg" in told
    assert "position of 5.jpg not used: at 33.4000, 70.6000" in told
    lines = (folder.parent / "p-positions.csv").read_text().splitlines()
    assert [line.split(",")[1] for line in lines[5:]] == ["", ""]


def test_positions_of_two_photos_on_two_continents_are_not_used(folder: Path) -> None:
    for number in range(1, 4):
        (folder / f"{number}.jpg").unlink()
    photo(folder / "4.jpg", (18.4, -33.9), values=ground(4))
    _, project, told = drafted(folder)
    assert "positions not used: neighbours lie " in told
    assert "km apart" in told
    assert project["exterior"]["crs"] == "local"


def test_photos_of_another_place_are_set_aside_together(folder: Path) -> None:
    for number in range(4, 7):
        photo(folder / f"{number}.jpg", (13.9 + 0.0003 * number, 52.52), values=ground(number))
    photo(folder / "7.jpg", (13.4012, 52.52), values=ground(7))
    draft, project, _ = drafted(folder)
    assert [*draft.aside] == ["4.jpg", "5.jpg", "6.jpg"]
    assert all("km from the others: make a project of its own" in why for why in draft.aside.values())
    assert len(project["project"]["images"]) == 5


def test_of_two_places_with_as_many_photos_one_is_a_project_of_its_own(folder: Path) -> None:
    for number in range(4, 8):
        photo(folder / f"{number}.jpg", (13.9 + 0.0003 * number, 52.52), values=ground(number))
    draft, project, _ = drafted(folder)
    assert [*draft.aside] == ["4.jpg", "5.jpg", "6.jpg", "7.jpg"]
    assert len(project["project"]["images"]) == 4


def test_a_dem_among_the_photos_is_set_aside(folder: Path) -> None:
    georeferenced(folder / "dem.tif", "float32")
    draft, project, _ = drafted(folder)
    assert draft.aside == {"dem.tif": "it is georeferenced: no photo as it was taken"}
    assert project["project"]["images"] == [f"photos/{number}.jpg" for number in range(4)]


def test_what_lies_among_orthos_is_told_and_stands_in_their_project(tmp_path: Path) -> None:
    (tmp_path / "orthos").mkdir()
    for name in "ab":
        georeferenced(tmp_path / "orthos" / f"{name}.tif", "uint8")
    (tmp_path / "orthos" / "clip.mov").write_text("x")
    (tmp_path / "orthos" / "empty.tif").write_bytes(b"")
    draft = new_project(tmp_path / "p.toml", tmp_path / "orthos")
    assert draft.aside == {"empty.tif": "the file is empty"}
    assert "1 movie: clip.mov" in "\n".join(draft.recognised)
    assert '# "orthos/empty.tif",' in draft.text


def test_names_with_quotes_are_found_again_in_the_table(folder: Path) -> None:
    (folder / "0.jpg").rename(folder / '0 "first".jpg')
    drafted(folder)
    with (folder.parent / "p-exterior.csv").open(encoding="utf-8", newline="") as table:
        assert [row[0] for row in csv.reader(table)][1] == '0 "first".jpg'


def test_a_local_frame_that_is_asked_for_takes_no_positions(folder: Path) -> None:
    block = Block(sorted(folder.iterdir()), "frame", crs="local")
    draft = new_project(folder.parent / "p.toml", block)
    assert draft.needed == []
    assert "a local frame was asked for, which has no place on the Earth" in "\n".join(draft.recognised)
    assert "file" not in tomllib.loads(draft.text)["exterior"]


def test_positions_that_are_all_the_same_place_nothing(folder: Path) -> None:
    for number in range(4):
        photo(folder / f"{number}.jpg", PLACES[0], values=ground(number))
    _, project, told = drafted(folder)
    assert "positions not used: all photos have the same" in told
    assert project["exterior"]["crs"] == "local"


def test_photos_without_altitudes_lie_at_one_height(folder: Path) -> None:
    for number in range(4):
        place = (13.4 + 0.0003 * number, 52.52)
        photo(folder / f"{number}.jpg", place, values=ground(number), gimbal=False, altitude=None)
    _, _, told = drafted(folder)
    assert "no altitude: all photos are taken to be at one height" in told
    assert (folder.parent / "p-positions.csv").read_text().splitlines()[1].endswith(",0.0000")


def test_photos_in_folders_of_the_folder_are_found(folder: Path) -> None:
    (folder / "101MEDIA").mkdir()
    for file in sorted(folder.glob("*.jpg")):
        file.rename(folder / "101MEDIA" / file.name)
    _, project, _ = drafted(folder)
    assert project["project"]["images"][0] == "photos/101MEDIA/0.jpg"


def test_a_camera_or_an_orientation_that_is_given_comes_first(folder: Path) -> None:
    (folder.parent / "camera.toml").write_text("size = [400, 300]\nfocal_length_px = 300.0\n")
    words = ["new", str(folder.parent / "p.toml"), str(folder), "--sensor", "frame"]
    assert run([*words, "--camera", str(folder.parent / "camera.toml")]) == 0
    project = tomllib.loads((folder.parent / "p.toml").read_text())
    assert project["sensor"]["camera"] == "camera.toml"
    assert "interior" not in project["adjust"]
    table = folder.parent / "e.csv"
    table.write_text("image,x,y,z,omega,phi,kappa\n" + "".join(f"{i}.jpg,{i},0,100,0,0,0\n" for i in range(4)))
    assert run([*words, "--exterior", str(table), "--overwrite"]) == 0
    assert "# [adjust]" in (folder.parent / "p.toml").read_text()


def test_one_photo_alone_is_told_what_it_needs(folder: Path) -> None:
    for number in range(1, 4):
        (folder / f"{number}.jpg").unlink()
    draft, _, told = drafted(folder)
    assert "one photo alone: two or more that overlap" in told
    assert "`geomosaic georeference`" in told
    assert draft.needed


def test_a_folder_without_photos_says_what_is_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "clip.mov").write_text("x")
    assert run(["new", str(tmp_path / "p.toml"), str(tmp_path / "photos")]) == 1
    said = capsys.readouterr().err
    assert "no image" in said
    assert "1 movie: clip.mov" in said
    (tmp_path / "photos" / "a.jpg").write_bytes(b"")
    assert run(["new", str(tmp_path / "p.toml"), str(tmp_path / "photos")]) == 1
    assert "a.jpg: the file is empty" in capsys.readouterr().err
    assert not list(tmp_path.glob("p*.toml"))
