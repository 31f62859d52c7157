"""Pictorial symbols: SVG read to exact outlines and nothing else, drawn at their size, on points and along lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import shapely

from geomosaic.errors import InputError
from geomosaic.sheets.drawing.canvas import Canvas, SymbolLook, drawing, outline
from geomosaic.sheets.drawing.labels import draw_swatch
from geomosaic.sheets.inputs import read_style
from geomosaic.sheets.line_patterns import pattern_places
from geomosaic.sheets.pictograms import GROUPS, PICTOGRAMS, pictogram
from geomosaic.sheets.style import BUILT_IN, parse_style
from geomosaic.sheets.svg import COLOR, OUTLINE, PaintedOutline, read_svg
from geomosaic.sheets.svg_path import flattened, path_outline

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100">'


def svg(body: str) -> tuple[PaintedOutline, ...]:
    return read_svg(f"{HEAD}{body}</svg>", "one.svg")


def area(outlines: Sequence[PaintedOutline]) -> shapely.Geometry:
    """What filled outlines cover, in parts of the symbol's side; rings that run against the first are holes."""
    rings = [ring for one in outlines for ring in flattened(one.points, one.codes, 64)]
    signed = [shapely.Polygon(ring) for ring in rings]
    outer = [ring for ring in signed if ring.exterior.is_ccw == signed[0].exterior.is_ccw]
    return shapely.union_all(outer).difference(shapely.union_all([ring for ring in signed if ring not in outer]))


@pytest.mark.parametrize(
    "body",
    [
        '<circle cx="40" cy="60" r="30"/>',
        '<ellipse cx="40" cy="60" rx="30" ry="30"/>',
        '<rect x="10" y="30" width="60" height="60" rx="30"/>',
        '<path d="M10 60A30 30 0 0 1 70 60 30,30 0 0 1 10,60z"/>',
        '<path d="M10 60a30 30 0 1160 0 30 30 0 01-60 0Z"/>',
        '<path d="M40 30A30 30 45 1 1 39.999 30Z"/>',
        '<g transform="translate(40 60) scale(.3)"><circle r="100"/></g>',
        '<circle r="60" transform="matrix(.5 0 0 .5 40 60)"/>',
        '<circle cx="60" cy="-40" r="30" transform="rotate(90)"/>',
        '<circle cx="10" cy="60" r="30" transform="rotate(180 25 60)"/>',
        '<circle cx="-20" cy="60" r="30" transform="skewX(0)translate(60)"/>',
    ],
)
def test_a_circle_is_a_circle_however_it_is_written(body: str) -> None:
    (one,) = svg(body)
    x, y = np.vstack(flattened(one.points, one.codes, 64)).T
    # The middle of the box is 0, y points up, and the side is 1.
    assert np.abs(np.hypot(x + 0.1, y + 0.1) - 0.3).max() < 0.3 * 3e-4
    assert area([one]).area == pytest.approx(math.pi * 0.09, rel=1e-3)


def test_curves_continue_smoothly_and_commands_repeat() -> None:
    points, codes = path_outline("m10-20 5 5 h5v-.5e1C1 2 3 4 5 6s7,8 9 10Q1 1 2 2t4 4zl1 1")
    expected = [
        (10, -20), (15, -15), (20, -15), (20, -20), (1, 2), (3, 4), (5, 6), (7, 8), (12, 14), (14, 16),
        (1, 1), (2, 2), (3, 3), (6, 6), (10, -20), (11, -19),
    ]  # fmt: skip
    assert points.tolist() == [list(map(float, point)) for point in expected]
    assert codes.tolist() == [1, 2, 2, 2, *[4] * 6, *[3] * 4, 79, 2]


def test_fill_rules_transforms_and_inherited_looks() -> None:
    ring = "M0 0H100V100H0ZM25 25H75V75H25Z"
    assert area(svg(f'<path fill-rule="evenodd" d="{ring}"/>')).area == pytest.approx(0.75)
    looks = 'fill="none" stroke="red" stroke-width="4" opacity=".5"'
    fill, stroke = svg(f'<g {looks}><path style="fill:#0F8" d="{ring}"/></g>')
    assert (fill.color, fill.width, fill.opacity) == ("#00ff88", None, 0.5)
    assert stroke.color == "#ff0000"
    assert stroke.width == pytest.approx(0.04)
    assert [one.color for one in svg('<path fill="currentColor" stroke="param(outline) #fff" d="M0 0H9V9Z"/>')] == [
        COLOR, OUTLINE,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<!DOCTYPE svg [<!ENTITY a SYSTEM "file:///etc/passwd">]>' + HEAD + "&a;</svg>", "declares entities"),
        (HEAD + '<image href="http://example.org/a.png"/></svg>', "'image' is no outline"),
        (HEAD + '<use href="other.svg#a"/></svg>', "'use' is no outline"),
        (HEAD + "<script>1</script></svg>", "'script' is no outline"),
        (HEAD + "<style>path { fill: red }</style></svg>", "'style' is no outline"),
        (HEAD + "<text>A</text></svg>", "'text' is no outline"),
        (HEAD + '<path fill="url(#a)" d="M0 0H9V9Z"/></svg>', "no plain colour"),
        (HEAD + '<path clip-path="url(#a)" d="M0 0H9V9Z"/></svg>', "'clip-path' is not drawn"),
        (HEAD + '<path d="L0 0H9V9Z"/></svg>', "starts with a move"),
        (HEAD + '<path d="M0 0H9V9Q1"/></svg>', "'Q' needs 4 numbers"),
        (HEAD + '<path d="M0 0 1e999 3"/></svg>', "larger than 1e"),
        (HEAD + "</svg>", "draws nothing"),
        (HEAD + "<g>" * 70 + '<path d="M0 0H9V9Z"/>' + "</g>" * 70 + "</svg>", "more than 64 deep"),
        (HEAD + f'<path d="M0 0{"h1v1" * 10_001}"/></svg>', "more than 20000 vertices"),
        ('<svg><path d="M0 0H9V9Z"/></svg>', "is no length"),
        ("<html/>", "no SVG but 'html'"),
        ("<svg", "no XML"),
    ],
)
def test_anything_but_outlines_is_refused_with_its_name(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as raised:
        read_svg(text, "one.svg")
    assert raised.value.hint


def test_the_own_set_is_whole_and_within_its_boxes() -> None:
    folder = files("geomosaic.sheets") / "symbols"
    assert {Path(item.name).stem for item in folder.iterdir()} == set(PICTOGRAMS)
    assert {name for group, names in GROUPS.items() if group != "along lines" for name in names} <= set(BUILT_IN)
    seen = set()
    for name in PICTOGRAMS:
        outlines = pictogram(name)
        for one in outlines:
            cap = "flat" if one.cap == "butt" else "round"
            for part in flattened(one.points, one.codes):
                inked = shapely.LineString(part).buffer((one.width or 0.0) / 2 + 1e-9, cap_style=cap)
                assert np.abs(inked.bounds).max() <= 0.53, name
        assert np.ptp(np.vstack([one.points for one in outlines]), axis=0).max() >= 0.5, name
        seen.add(b"".join(one.points.tobytes() for one in outlines))
    assert len(seen) == len(PICTOGRAMS)


def test_symbols_along_a_line_are_even_and_turn_with_it() -> None:
    xy, angles = pattern_places(np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 6.0)]), 5.0, 1.0)
    assert np.allclose(xy, [(16 / 6, 0), (8, 0), (10, 16 * 5 / 6 - 10)])
    assert np.allclose(angles, [0, 0, 90])
    turn = np.radians(np.linspace(0, 180, 2000))
    around, headings = pattern_places(20 * np.column_stack([np.cos(turn), np.sin(turn)]), 3.0, 1.5)
    off = headings - np.degrees(np.arctan2(around[:, 1], around[:, 0])) - 90
    assert np.abs((off + 180) % 360 - 180).max() < 0.05
    assert not len(pattern_places(np.array([(0.0, 0.0), (2.4, 0.0)]), 5.0, 1.0)[0])


SQUARE = svg('<path fill="#ff0000" d="M20 20H80V80H20Z"/>')
HALF = svg('<path fill="currentColor" d="M45 0H55V50H45Z"/>')


def test_symbols_are_drawn_at_their_size_with_their_outline_and_direction() -> None:
    """At 10 pixels to the mm: a red square of 3 mm with an outline of 0.5 mm; a bar to the left of a way down."""
    with drawing():
        canvas = Canvas((0.0, 0.0, 30.0, 10.0))
        canvas.pictograms(np.array([(5.0, 5.0)]), SQUARE, SymbolLook(5.0, "#000000", "#0000ff", 0.5, 1.0))
        look = SymbolLook(4.0, "#008000", "#ffffff", 0.0, 1.0)
        canvas.pictograms(np.array([(20.0, 5.0)]), HALF, look, np.array([-90.0]))
        pixels = canvas.pixels(254.0).astype(int)

    def box(color: tuple[int, int, int]) -> list[int]:
        rows, cols = np.nonzero(np.abs(pixels - color).max(axis=2) < 60)
        return [int(cols.min()), int(cols.max()) + 1, int(rows.min()), int(rows.max()) + 1]

    assert np.abs(np.array(box((255, 0, 0))) - [35, 65, 35, 65]).max() <= 1
    assert np.abs(np.array(box((0, 0, 255))) - [30, 70, 30, 70]).max() <= 1
    assert np.abs(np.array(box((0, 128, 0))) - [200, 220, 48, 52]).max() <= 1


@pytest.mark.parametrize(("name", "kinds"), [("church", {"point"}), ("stream", {"line"}), ("cliff", {"line"})])
def test_the_legend_shows_symbols_and_patterns(name: str, kinds: set[str]) -> None:
    plain = BUILT_IN[name if kinds == {"point"} else "water"].symbol
    with drawing():
        canvas = Canvas((0.0, 0.0, 12.0, 6.0))
        draw_swatch(canvas, BUILT_IN[name].symbol, kinds, (1.5, 1.7, 10.5, 4.3))
        shown = canvas.pixels(254.0)
    dark = (shown.min(axis=2) < 130).any(axis=1)
    if kinds == {"point"}:
        assert plain.marker is not None
        assert dark.sum() > 0.8 * 10 * plain.marker.size
    else:  # higher than the line alone
        line = BUILT_IN[name].symbol.line
        assert line is not None
        assert dark.sum() > 10 * line.width + 4


def test_styles_name_symbols_of_the_set_and_files_beside_them(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "kiosk.svg").write_text(HEAD + '<path d="M0 0H9V9Z"/></svg>')
    (tmp_path / "own" / "style.toml").write_text(
        'column = "kind"\n[[category]]\nvalue = "a"\nmarker = { shape = "kiosk.svg", size = 5.0 }\n'
        '[[category]]\nvalue = "b"\nmarker = { shape = "church" }\n'
        '[[category]]\nvalue = "c"\nline = { pattern = "kiosk.svg" }\n'
    )
    kiosk, church, way = read_style("own/style.toml", tmp_path).rules
    assert kiosk.marker is not None
    assert Path(kiosk.marker.shape) == tmp_path / "own" / "kiosk.svg"
    assert church.marker is not None
    assert church.marker.size == 3.6
    assert way.line is not None
    assert way.line.pattern == kiosk.marker.shape
    (tmp_path / "own" / "kiosk.svg").unlink()
    with pytest.raises(InputError, match="symbol") as raised:
        read_style("own/style.toml", tmp_path)
    assert "style.toml" in str(raised.value)
    with pytest.raises(InputError, match="'churhc'") as raised:
        parse_style({"marker": {"shape": "churhc"}}, "style.toml")
    assert "church" in str(raised.value.hint)
    with pytest.raises(InputError, match="no symbol for lines"):
        parse_style({"line": {"pattern": "circle"}}, "style.toml")


def test_scripts_from_right_to_left_are_turned_and_joined() -> None:
    """Alef of "אב" stands right of bet; joined, the letters of "عين" take less room than each by itself."""
    with drawing():
        alef, bet, both = (outline(text, 20.0, False, False).vertices for text in ("\u05d0", "\u05d1", "\u05d0\u05d1"))
        assert np.allclose(both[: len(bet)], bet)
        apart = both[len(bet) :] - alef
        assert np.allclose(apart, apart[0])
        assert apart[0, 0] > 0.8 * np.ptp(bet[:, 0])
        letters = "\u0639\u064a\u0646"
        alone = sum(float(np.ptp(outline(c, 20.0, False, False).vertices[:, 0])) for c in letters)
        assert float(np.ptp(outline(letters, 20.0, False, False).vertices[:, 0])) < 0.8 * alone
