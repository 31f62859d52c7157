"""Tables and project files: what they say, and what is said of what is wrong in them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from geomosaic.errors import GeomosaicWarning, HeightDatumError, InputError
from geomosaic.geo.crs import height_name, parse_crs
from geomosaic.image_names import find_by_name, stem
from geomosaic.inputs.build import build_block
from geomosaic.inputs.control_points import read_control
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import check_units, read_exterior
from geomosaic.inputs.summary import list_missing_inputs
from geomosaic.inputs.tables import read_table
from geomosaic.inputs.vertical_datums import frame_description, positions_crs, undeclared_heights_error
from geomosaic.project.drafts import new_project
from geomosaic.project.load import load_project
from geomosaic.surface.model import undulation

ROWS = [("DSC_01.tif", 1.5, -2.0, 300.25, 0.5, -0.25, 91.0), ("DSC_02.tif", 11.5, -2.0, 301.0, 0.0, 0.125, 90.0)]
HEADER = ["image", "x", "y", "z", "omega", "phi", "kappa"]


def write(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("mark", [",", ";", "\t", " ", "   "])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
@pytest.mark.parametrize("quote", ["", '"', "'"])
def test_orientations_come_out_as_written_whatever_the_delimiter(tmp_path, mark, ending, quote):
    lines = [mark.join(HEADER)] + [mark.join([f"{quote}{r[0]}{quote}", *map(repr, r[1:])]) for r in ROWS]
    table = read_exterior(write(tmp_path / "e.csv", ending.join(lines), "utf-8-sig"), "opk")
    for name, x, y, z, omega, phi, kappa in ROWS:
        row = table.row(name)
        assert row.position == (x, y, z)
        assert row.angles == {"omega": omega, "phi": phi, "kappa": kappa}


def test_blanks_in_quotes_comments_and_other_names_of_columns(tmp_path):
    text = (
        "# exported on a Monday\n\n"
        "filename latitude longitude altitude roll pitch yaw camera\n"
        '100_18.tif 24.5 120.25 186.5 0.0 30.0 92.9 "dji fc6310r 5472 3648"\n'
        "# a comment between\n"
        "100_36.tif 24.75 120.5 186.75 0.0 30.0 -175.8 'a b'\n"
    )
    table = read_exterior(write(tmp_path / "e.csv", text), "rpy")
    assert table.row("100_18").position == (120.25, 24.5, 186.5)
    assert table.row("/some/where/100_36.TIF").angles["yaw"] == -175.8


def test_a_header_may_start_with_a_hash(tmp_path):
    table = read_table(write(tmp_path / "t.csv", "#Label,X/Easting,z\nA,1,2\n"), "table", "")
    assert table.columns == ("image", "x/easting", "z")


def test_matrix_system_reads_nine_numbers(tmp_path):
    names = [f"r{i}{j}" for i in "123" for j in "123"]
    text = ",".join(["image", "x", "y", "z", *names]) + "\na,0,0,9," + ",".join(str(v) for v in range(9))
    assert list(read_exterior(write(tmp_path / "m.csv", text), "matrix").row("a.jpg").angles.values()) == list(range(9))


@pytest.mark.parametrize(
    ("body", "line", "words"),
    [
        ("a.tif,1,2,3,4,5\n", 2, "6 values for 7 columns"),
        ("a.tif,1,2,3,4,5,6\nb.tif,1,2,3,x,5,6\n", 3, "'omega' has 'x'"),
        ("a.tif,1,2,nan,4,5,6\n", 2, "'z' has 'nan'"),
        ("a.tif,1,2,,4,5,6\n", 2, "'z' has ''"),
        (",1,2,3,4,5,6\n", 2, "'image' is empty"),
        ("a.tif,1,2,3,4,5,6\nb.tif,1,2,3,4,5,6\na.jpg,1,2,3,4,5,6\n", 4, "has a row already, on line 2"),
        ("a.tif,1,5,2,3,4,5,6\n", 2, "8 values for 7 columns"),
    ],
)
def test_errors_name_file_and_line(tmp_path, body, line, words):
    file = write(tmp_path / "e.csv", ",".join(HEADER) + "\n" + body)
    with pytest.raises(InputError, match=words) as caught:
        read_exterior(file, "opk")
    assert caught.value.where == f"{file}, line {line}"
    assert caught.value.hint or "already" in words or "empty" in words


def test_decimal_commas_are_refused_with_a_hint(tmp_path):
    file = write(tmp_path / "e.csv", ";".join(HEADER) + "\na.tif;1,5;2;3;4;5;6\n")
    with pytest.raises(InputError, match="'1,5'") as caught:
        read_exterior(file, "opk")
    assert "decimal point" in str(caught.value.hint)


def test_the_table_of_simple_ortho_is_read_without_a_header(tmp_path):
    file = tmp_path / "camera_pos_ori.txt"
    file.write_text("05_0182_RGB -55094.5 -3727407.0 5258.3 -0.35 0.3 -179.1\n2 -1 -2 3 4 5 6\n")
    rows = read_exterior(file, "opk").rows
    assert rows["05_0182_RGB"].position == (-55094.5, -3727407.0, 5258.3)
    assert rows["2"].angles == {"omega": 4.0, "phi": 5.0, "kappa": 6.0}
    # The same under another name could have its angles in any order.
    other = file.rename(tmp_path / "table.txt")
    with pytest.raises(InputError, match="no header"):
        read_exterior(other, "opk")


def test_no_header_wrong_columns_and_no_table(tmp_path):
    with pytest.raises(InputError, match="no header") as caught:
        read_exterior(write(tmp_path / "n.txt", "a 1 2 3 4 5 6\n"), "opk")
    assert "image,x,y,z,omega,phi,kappa" in str(caught.value.hint)
    with pytest.raises(InputError, match="omega, phi, kappa") as caught:
        read_exterior(write(tmp_path / "r.csv", "image,x,y,z,roll,pitch,yaw\na,1,2,3,4,5,6\n"), "opk")
    assert "'rpy'" in str(caught.value.hint)
    with pytest.raises(InputError, match="does not exist"):
        read_exterior(tmp_path / "none.csv", "opk")
    with pytest.raises(InputError, match="not UTF-8"):
        read_exterior(write(tmp_path / "l.csv", "é", "latin-1"), "opk")
    with pytest.raises(InputError, match="`angles=opks` is no angle system of a table") as caught:
        read_exterior(tmp_path / "none.csv", "opks")
    assert "'opk'" in str(caught.value.hint)


def test_a_missing_row_suggests_what_was_meant(tmp_path):
    file = write(tmp_path / "e.csv", ",".join(HEADER) + "\nDSC_01,1,2,3,4,5,6\n")
    with pytest.raises(InputError, match=r"no row for DSC_O1.tif") as caught:
        read_exterior(file, "opk").row("DSC_O1.tif")
    assert "did you mean 'DSC_01'" in str(caught.value.hint)


def test_names_match_with_or_without_extension_and_never_by_prefix():
    rows = {"IMG_1": 1, "IMG_10.tif": 2, "sub/IMG_3.jpg": 3, "v1.2": 4}
    assert [find_by_name(rows, n) for n in ("IMG_1.tif", "IMG_10.TIF", "IMG_3", "v1.2", "v1.tif", "IMG_")] == [
        1, 2, 3, 4, None, None,
    ]  # fmt: skip
    assert stem("a\\b\\c.tif") == "c"


def test_names_match_however_accents_are_stored():
    parted, whole = "flug/O\u0308st 1.jpg", "\u00d6st 1.jpg"
    assert find_by_name({whole: 1}, parted) == 1
    assert find_by_name({"O\u0308st 1": 1}, whole) == 1


def test_control_points_of_a_project_are_read(tmp_path):
    text = (
        "id,x,y,z,image,col,row,sigma_px,role\n"
        "P1,1,2,3,a.tif,10.5,20.25,0.5,control\nP1,1,2,3,b,1,2,,check\nP2,5,6,7,elsewhere.tif,1,1,,\n"
    )
    points = read_control(write(tmp_path / "g.csv", text), ["a.tif", "b.tif"])
    assert [(p.id, p.image, p.colrow, p.sigma_px, p.role) for p in points] == [
        ("P1", "a.tif", (10.5, 20.25), 0.5, "control"),
        ("P1", "b.tif", (1.0, 2.0), 1.0, "check"),
    ]
    for bad, words in (
        ("P1,1,2,3,a,1,1\nP1,1,2,4,b,1,1\n", "other coordinates than on line 2"),
        ("P1,1,2,3,a,1,1\nP1,1,2,3,a.tif,2,1\n", "measured in a.tif already, on line 2"),
    ):
        with pytest.raises(InputError, match=words) as caught:
            read_control(write(tmp_path / "g.csv", "id,x,y,z,image,col,row\n" + bad), ["a.tif", "b.tif"])
        assert str(caught.value.where).endswith("line 3")


def test_deviations_of_control_points_can_be(tmp_path):
    head = "id,x,y,z,image,col,row,sigma_xy,sigma_px\n"
    for bad, words in (("-1,0.5", "sigma_xy is -1"), ("0.1,-2", "sigma_px is -2"), ("0.1,0", "sigma_px is 0")):
        with pytest.raises(InputError, match=words) as caught:
            read_control(write(tmp_path / "g.csv", f"{head}P1,1,2,3,a,1,1,{bad}\n"), ["a.tif"])
        assert str(caught.value.where).endswith("line 2")
        assert caught.value.hint
    (point,) = read_control(write(tmp_path / "g.csv", f"{head}P1,1,2,3,a,1,1,0,\n"), ["a.tif"])
    assert (point.sigma_xy, point.sigma_px) == (0.0, 1.0)


def test_control_measured_in_other_photos_only_is_reported(tmp_path):
    """As if there were none; a table whose names are spelt otherwise would judge nothing in silence."""
    file = write(tmp_path / "g.csv", "id,x,y,z,image,col,row\nP1,1,2,3,scan_1.tif,1,1\n")
    with pytest.warns(GeomosaicWarning, match=r"g.csv: no point is measured in an image.*'scan_1.tif'"):
        assert read_control(file, ["photo_1.tif"]) == ()


PROJECT = """
format = 1
[project]
name = "trial"
images = ["photos/*.tif"]
[sensor]
name = "frame"
camera = "camera.toml"
treatment = "planar"
[exterior]
file = "exterior.csv"
crs = "EPSG:32633"
heights = "egm96"
[dem]
file = "../dem.tif"
[output]
resolution = 0.5
creation = { COMPRESS = "ZSTD", LEVEL = 9 }
"""


def make_project(tmp_path: Path, text: str = PROJECT) -> Path:
    (tmp_path / "photos").mkdir(exist_ok=True)
    for name in ("b.tif", "a.tif", ".hidden.tif"):
        (tmp_path / "photos" / name).touch()
    return write(tmp_path / "project.toml", text)


def test_a_project_resolves_paths_against_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    project = load_project(make_project(tmp_path))
    inputs = project.inputs
    assert [path.name for path in inputs.images] == ["a.tif", "b.tif"]
    assert inputs.camera == tmp_path / "camera.toml"
    assert inputs.dem == tmp_path / ".." / "dem.tif"
    assert inputs.options == {"treatment": "planar"}
    assert inputs.heights == "egm96"
    assert project.output == tmp_path / "output"
    assert project.settings.output.creation == {"COMPRESS": "ZSTD", "LEVEL": 9}
    assert project.options.balanced


def test_all_errors_of_a_project_come_at_once_with_lines(tmp_path):
    text = PROJECT.replace("resolution = 0.5", "resolution = -1\nresampling = 'bilinaer'\nresamplign = 'cubic'")
    with pytest.raises(InputError, match="3 errors") as caught:
        load_project(make_project(tmp_path, text + "\n[mosaic]\nbalance = 'perhaps'\n".replace("'perhaps'", "true")))
    lines = text.splitlines()
    for key, words in (
        ("resolution =", "-1 is out of range: give a number above 0"),
        ("resamplign", "did you mean 'resampling'?"),
        ("resampling", "'bilinaer' is not known here"),
    ):
        at = next(i for i, line in enumerate(lines, 1) if line.startswith(key))
        assert any(f"line {at}:" in part and words in part for part in caught.value.what.splitlines()), (
            caught.value.what
        )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("format = 1", ""), "no 'format'"),
        (("format = 1", "format = 2"), "format"),
        (("[dem]", "[dme]"), "did you mean 'dem'"),
        (('file = "../dem.tif"', ""), "one of file, height"),
        (("format = 1", "format = = 1"), "not valid TOML.*line 2"),
        (("photos/*.tif", "pictures/*.tif"), "matches no file"),
        (("photos/*.tif", "**tif"), "no pattern of paths"),
        (("photos/*.tif", "photos/c.tif"), "does not exist"),
        (("../dem.tif", "/vsicurl/http://example.org/dem.tif"), "not the path of a file"),
        (('name = "trial"', 'name = "a/b"'), "name"),
        (('name = "frame"', 'nmae = "frame"'), r"\[sensor\] nmae: unknown key; did you mean 'name'"),
        (("[sensor]", "[sensro]"), "did you mean 'sensor'"),
        (("resolution = 0.5", "resolution = 'fine'"), r"\[output\] resolution: 'fine' is not a number: give a number"),
    ],
)
def test_bad_project_files_are_refused_by_key(tmp_path, change, words):
    with pytest.raises(InputError, match=f"(?s){words}"):
        load_project(make_project(tmp_path, PROJECT.replace(*change)))


def test_radians_and_gons_are_suspected_and_declaring_settles_it(tmp_path):
    """Strips flown east and west: the direction of flight alone cannot tell 3.1 rad from 3.1 degrees."""
    degrees = [(0.8, -1.9, 2.0), (1.2, 0.4, -1.5), (-0.3, 2.2, 178.5), (0.6, -1.0, -177.0)]
    places = [(0, 0), (300, 5), (305, 400), (2, 395)]

    def table(factor: float):
        rows = [
            f"{i}," + ",".join(map(repr, (*place, 1000, factor * o, factor * p, factor * k)))
            for i, (place, (o, p, k)) in enumerate(zip(places, degrees, strict=True))
        ]
        return read_exterior(write(tmp_path / "e.csv", "\n".join([",".join(HEADER), *rows])), "opk")

    check_units(table(1.0), None)
    check_units(table(math.pi / 180), "rad")
    with pytest.raises(InputError, match="radians") as caught:
        check_units(table(math.pi / 180), None)
    assert "angle_unit" in str(caught.value.hint)
    with pytest.warns(GeomosaicWarning, match="radians"):
        check_units(table(math.pi / 180), "deg")
    with pytest.raises(InputError, match="no angle unit"):
        check_units(table(1.0), "grad")


def test_frames_are_said_with_unit_and_heights():
    crs = positions_crs("EPSG:32633", "egm96")
    assert height_name(crs).startswith("EGM96")
    assert frame_description(crs) == "WGS 84 / UTM zone 33N (EPSG:32633), metre; heights: EGM96 height"
    assert frame_description(parse_crs("EPSG:32633")).endswith("heights: undeclared")


def test_undeclared_heights_name_metres_pixels_and_option():
    # EGM96 at 48.14 N, 11.58 E lies 45.5 m above the ellipsoid (libraries' own figure: 500 m become 454.47).
    crs = parse_crs("EPSG:4326")
    assert math.isclose(undulation(crs, 11.58, 48.14), 45.53, abs_tol=0.02)
    error = undeclared_heights_error("the positions", "e.csv", "`heights`", crs, (11.58, 48.14), 0.5)
    assert isinstance(error, HeightDatumError)
    assert "45.5 m" in error.what
    assert "22.8 px" in error.what
    assert "`heights`" in str(error.hint)


def test_one_photo_of_a_table_in_radians_is_found_out(sample, tmp_path):
    """One image tells nothing of the unit; the rest of its table does."""
    from geomosaic.inputs.declarations import Block
    from geomosaic.inputs.images import photos_of

    lines = (sample / "exterior.csv").read_text().splitlines()
    turned = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        turned.append(",".join([*cells[:4], *(repr(math.radians(float(cell))) for cell in cells[4:7])]))
    table = tmp_path / "exterior.csv"
    table.write_text("\n".join(turned) + "\n")
    photo = sorted((sample / "photos").glob("*.jpg"))[0]
    inputs = Block(images=(photo,), sensor="frame", exterior=table, crs="EPSG:32633", heights="egm96")
    with pytest.raises(InputError, match="radians"):
        photos_of(inputs)


def test_photos_with_a_camera_of_their_own_are_drafted_and_built_with_it(sample, tmp_path):
    """Alike ones stand in one table; where each has its own, none is missing."""
    (tmp_path / "other.toml").write_text((sample / "camera.toml").read_text().replace("= 45.2", "= 50.0"))
    photos = [sample / "photos" / f"strip1_0{number}.jpg" for number in (1, 2, 3)]
    own = {path.name: {"camera": str(tmp_path / "other.toml")} for path in photos[1:]}
    known = {"exterior": sample / "exterior.csv", "crs": "EPSG:32633", "heights": "egm96", "height": 450.0}
    block = Block(tuple(photos), "frame", camera=sample / "camera.toml", image_options=own, trusted=True, **known)
    made = new_project(tmp_path / "p.toml", block)
    assert made.needed == []
    assert made.text.count("[[images]]") == 1
    models = [scene.model for scene in build_block(load_project(tmp_path / "p.toml").inputs, ground=False).scenes]
    assert [round(model.camera.focal[0] * 36.0 / 1200, 6) for model in models] == [45.2, 50.0, 50.0]
    every = {path.name: {"camera": str(tmp_path / "other.toml")} for path in photos}
    assert not any("camera" in text for text in list_missing_inputs(replace(block, camera=None, image_options=every)))
    with pytest.raises(InputError, match="no image of the block"):
        replace(block, image_options={"strip1_09.jpg": {}})
