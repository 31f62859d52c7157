"""Canvas of a page in mm: lines, areas, markers, pictures and texts, with the fonts of a sheet."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sheets.svg import COLOR, OUTLINE, PaintedOutline
from geomosaic.types import AnyArray, ByteArray, FloatArray

if TYPE_CHECKING:
    from geomosaic.sheets.label_placement import LabelPart
    from geomosaic.sheets.page import Box


_FAMILY = "DejaVu Sans"
# Height of capitals and figures of DejaVu Sans in parts of the text size.
CAP = 0.729

# Families of the sheet that is drawn, asked in turn for characters that the first has not.
_MORE: ContextVar[tuple[str, ...]] = ContextVar("fonts", default=())


def _families() -> tuple[str, ...]:
    """Names of the fonts in use, the first one first."""
    return (_FAMILY, *_MORE.get())


def _register_fonts(paths: Sequence[str]) -> None:
    """Use font files (TrueType) for characters that DejaVu Sans lacks, here and in what is called from here."""
    from matplotlib.font_manager import fontManager, get_font

    names = []
    for path in paths:
        try:
            if not Path(path).is_file():
                raise OSError("there is no such file")
            font: Any = get_font(path)
            fontManager.addfont(path)
        except (OSError, RuntimeError, ValueError) as error:
            raise InputError(f"the font cannot be read ({error})", where=path, hint="give a TrueType font") from None
        names.append(str(font.family_name))
    _MORE.set(tuple(names))


def _properties(bold: bool, italic: bool) -> Any:
    """Matplotlib's description of the fonts in use."""
    from matplotlib.font_manager import FontProperties

    return FontProperties(
        family=list(_families()), weight="bold" if bold else "normal", style="oblique" if italic else "normal"
    )


def missing_glyphs(texts: Iterable[str]) -> str:
    """Characters that no font in use has a glyph for, each once, in the order in which they come.

    Parameters
    ----------
    texts : iterable of str
    """
    from matplotlib.font_manager import FontProperties, findfont, get_font

    known: set[int] = set()
    for family in _families():
        known |= set(get_font(findfont(FontProperties(family=family))).get_charmap())
    found = dict.fromkeys(c for text in texts for c in text if ord(c) not in known and c.isprintable())
    return "".join(found)


# Millimetres in a point.
POINT = 25.4 / 72.0

# Characters that would break a line, or have no form: one line of text has blanks in their place.
_BREAKS = dict.fromkeys((*range(32), 0x7F, 0x85, 0x2028, 0x2029), " ")


def text_size(text: str, size: float, bold: bool = False, italic: bool = False) -> tuple[float, float]:
    """Width and height in mm of one line of text at a size in points; the height is that of capitals.

    Parameters
    ----------
    text : str
    size : float, points
    bold, italic : bool
    """
    return _text_size(text, size, bold, italic, _families())


# While texts are fitted and placed the same ones are asked for again and again, and each costs a shaped outline.
@lru_cache(maxsize=4096)
def _text_size(text: str, size: float, bold: bool, italic: bool, fonts: tuple[str, ...]) -> tuple[float, float]:
    if not text.strip():
        return 0.0, size * CAP * POINT
    # Control points of the outline's curves reach a little beyond it, which is on the safe side.
    return float(outline(text, size, bold, italic).vertices[:, 0].max()) * POINT, size * CAP * POINT


def advances(letters: Sequence[str], size: float, bold: bool = False, italic: bool = False) -> list[float]:
    """How far each letter takes the pen, in mm: to the next one, kerned.

    Parameters
    ----------
    letters : sequence of str
    size : float, points
    bold, italic : bool
    """

    def wide(text: str) -> float:
        return _advance(text, size, bold, italic)

    inner = [wide(letter + after) - wide(after) for letter, after in itertools.pairwise(letters)]
    return [*inner, *map(wide, letters[-1:])]


def _advance(text: str, size: float, bold: bool, italic: bool) -> float:
    """Width with the room that the font leaves before what comes next, mm."""
    return text_size(text + "|", size, bold, italic)[0] - text_size("|", size, bold, italic)[0]


def outline(text: str, size: float, bold: bool, italic: bool) -> Any:
    """Matplotlib's path of one line of text from the left end of its baseline, in points.

    Parameters
    ----------
    text : str
    size : float, points
    bold, italic : bool
    """
    from matplotlib.textpath import TextPath

    return TextPath((0, 0), text.translate(_BREAKS).replace("$", r"\$"), size=size, prop=_properties(bold, italic))


@contextmanager
def drawing(fonts: Sequence[str] = ()) -> Iterator[None]:
    """Context in which matplotlib has its own defaults, whatever the user's settings, and the fonts of the sheet.

    Parameters
    ----------
    fonts : sequence of str, files with characters that the font of the sheet lacks
    """
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        # Fonts are embedded as TrueType (type 42), so that text stays text; lines keep all their vertices. In PDFs too
        # Matplotlib 3.11 divides the characters of a font by the type for PostScript: by its default a font that has
        # signs beyond U+00FF, such as the narrow space of coordinates, would be cut to size and embedded twice.
        matplotlib.rcParams.update(
            {"pdf.fonttype": 42, "ps.fonttype": 42, "font.family": _FAMILY, "pdf.compression": 6,
             "path.simplify": False, "text.hinting": "none"}
        )  # fmt: skip
        _register_fonts(fonts)
        try:
            yield
        finally:
            _register_fonts(())


class _Font(NamedTuple):
    """Size in points and style of a text."""

    size: float
    bold: bool
    italic: bool


class SymbolLook(NamedTuple):
    """Size in mm, colours, width in mm of the outline, and opacity of a pictorial symbol."""

    size: float
    color: str
    outline: str
    outline_width: float
    opacity: float


class Canvas:
    """A page.

    Parameters
    ----------
    box : Box, part of the page that is drawn, in mm; (0, 0, width, height) for all of it
    """

    def __init__(self, box: Box) -> None:
        from matplotlib.figure import Figure

        self.box = box
        width, height = box[2] - box[0], box[3] - box[1]
        self.figure = Figure(figsize=(width / 25.4, height / 25.4), facecolor="white")
        self.axes: Any = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self.axes.set_axis_off()
        self.axes.set_xlim(box[0], box[2])
        self.axes.set_ylim(box[1], box[3])
        self._order = 1.0
        self._clip: Any = None

    @contextmanager
    def clipped(self, box: Box, ring: FloatArray | None = None) -> Iterator[None]:
        """Draw only inside a rectangle, or inside a ring (N, 2)."""
        from matplotlib.patches import Polygon, Rectangle

        if ring is not None:
            self._clip = Polygon(ring, closed=True, transform=self.axes.transData)
        else:
            self._clip = Rectangle((box[0], box[1]), box[2] - box[0], box[3] - box[1], transform=self.axes.transData)
        yield
        self._clip = None

    def _add(self, artist: Any) -> None:
        """Draw above everything that is there."""
        self._order += 1.0
        artist.set_zorder(self._order)
        artist.set_clip_on(self._clip is not None)
        if self._clip is not None:
            artist.set_clip_path(self._clip)

    def lines(
        self,
        paths: Sequence[Any],
        color: str,
        width: float,
        *,
        dash: Sequence[float] = (),
        opacity: float = 1.0,
        cap: str = "butt",
    ) -> None:
        """Lines through points (N, 2); width and dashes in mm.

        Parameters
        ----------
        paths : sequence of object
            Arrays (N, 2) in millimetres on the page.
        color : str
        width : float
            Millimetres.
        dash : sequence of float
            Lengths of dashes and gaps in millimetres.
        opacity : float
            0 to 1.
        cap : str
            Ends of the lines.
        """
        from matplotlib.collections import LineCollection

        if not paths:
            return
        style: Any = "solid"
        if dash:
            # Matplotlib counts dashes in line widths.
            style = (0.0, [part / width for part in (dash if len(dash) % 2 == 0 else (*dash, *dash))])
        collection = LineCollection(
            list(paths), colors=color, linewidths=width / POINT, linestyles=[style], alpha=opacity, capstyle=cap,
            joinstyle="round", antialiaseds=True,
        )  # fmt: skip
        self.axes.add_collection(collection, autolim=False)
        self._add(collection)

    def area(
        self,
        rings: Sequence[FloatArray],
        fill: str | None,
        *,
        opacity: float = 1.0,
        edge: str | None = None,
        width: float = 0.0,
    ) -> None:
        """One area of rings (N, 2), closed; holes run against the outer ring. Edge width in mm.

        Parameters
        ----------
        rings : sequence of array
            Arrays (N, 2) in millimetres, closed.
        fill : str or None
        opacity : float
            0 to 1.
        edge : str, optional
            Colour of the edge.
        width : float
            Of the edge, millimetres.
        """
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path as Shape

        shape = Shape.make_compound_path(*(Shape(ring, closed=True) for ring in rings))
        patch = PathPatch(
            shape, facecolor=fill or "none", alpha=opacity, edgecolor=edge or "none", linewidth=width / POINT,
            joinstyle="miter",
        )  # fmt: skip
        self.axes.add_patch(patch)
        self._add(patch)

    def rectangle(self, box: Box, *, fill: str | None = None, edge: str | None = None, width: float = 0.0) -> None:
        """A rectangle.

        Parameters
        ----------
        box : Box
            Left, bottom, right, top in millimetres.
        fill, edge : str, optional
            Colours.
        width : float
            Of the edge, millimetres.
        """
        ring = np.array([(box[0], box[1]), (box[2], box[1]), (box[2], box[3]), (box[0], box[3]), (box[0], box[1])])
        self.area([ring], fill, edge=edge, width=width)

    def markers(
        self, xy: FloatArray, shape: str, size: float, fill: str, edge: str, edge_width: float, opacity: float = 1.0
    ) -> None:
        """Symbols at points (N, 2); size in mm.

        Parameters
        ----------
        xy : array (N, 2)
            Millimetres on the page.
        shape : str
        size : float
            Millimetres.
        fill, edge : str
            Colours.
        edge_width : float
            Millimetres.
        opacity : float
            0 to 1.
        """
        if not len(xy):
            return
        form = {
            "circle": "o", "square": "s", "triangle": "^", "diamond": "D", "cross": "x", "plus": "+", "star": "*",
        }[shape]  # fmt: skip
        thin = shape in ("cross", "plus")
        (drawn,) = self.axes.plot(
            xy[:, 0], xy[:, 1], linestyle="none", marker=form, markersize=size / POINT, markerfacecolor=fill,
            markeredgecolor=fill if thin else edge,
            markeredgewidth=max(edge_width, 0.2 * size if thin else 0.0) / POINT, scalex=False, scaley=False,
            alpha=opacity,
        )  # fmt: skip
        self._add(drawn)

    def pictograms(
        self,
        xy: FloatArray,
        outlines: Sequence[PaintedOutline],
        look: SymbolLook,
        angles: FloatArray | None = None,
    ) -> None:
        """Pictorial symbols with their middles at points.

        Parameters
        ----------
        xy : array (N, 2)
            Millimetres on the page.
        outlines : sequence of PaintedOutline
            Of the symbol, the lowest first.
        look : SymbolLook
        angles : array (N,), optional
            Degrees by which each is turned, anticlockwise.
        """
        from matplotlib.collections import PathCollection
        from matplotlib.path import Path as Shape
        from matplotlib.transforms import Affine2D

        if not len(xy):
            return
        turns = [Affine2D().scale(look.size).rotate_deg(angle) for angle in ([0.0] if angles is None else angles)]
        onto_page = Affine2D().scale(1 / 25.4) + self.figure.dpi_scale_trans
        colors = {COLOR: look.color, OUTLINE: look.outline}

        def draw(one: PaintedOutline, color: str, width: float, **looks: Any) -> None:
            path = Shape(one.points, one.codes.astype(np.uint8))
            drawn = PathCollection(
                [turn.transform_path(path) for turn in turns], offsets=xy, offset_transform=self.axes.transData,
                linewidths=width / POINT, alpha=one.opacity * look.opacity, edgecolors=color, **looks,
            )  # fmt: skip
            drawn.set_transform(onto_page)
            self.axes.add_collection(drawn, autolim=False)
            self._add(drawn)

        # The outline of the whole symbol first: it lies over no part of it.
        for one in outlines if look.outline_width > 0 else ():
            width = (one.width or 0.0) * look.size + 2 * look.outline_width
            face = look.outline if one.width is None else "none"
            draw(one, look.outline, width, facecolors=face, joinstyle="round", capstyle="round")
        for one in outlines:
            color = colors.get(one.color, one.color)
            if one.width is None:
                draw(one, "none", 0.0, facecolors=color)
            else:
                cap: Any = "projecting" if one.cap == "square" else one.cap
                draw(one, color, one.width * look.size, facecolors="none", joinstyle=one.join, capstyle=cap)

    def picture(self, pixels: ByteArray, box: Box) -> None:
        """Pixels (rows, cols, 4) that fill a rectangle exactly."""
        from matplotlib.image import AxesImage

        image = AxesImage(self.axes, extent=(box[0], box[2], box[1], box[3]), interpolation="none", origin="upper")
        image.set_data(pixels)
        self.axes.add_image(image)
        self._add(image)

    def text(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        *,
        align: str = "left",
        angle: float = 0.0,
        color: str = "#000000",
        bold: bool = False,
        italic: bool = False,
    ) -> None:
        """One line of text: its baseline's left end, middle or right end at (x, y).

        Parameters
        ----------
        x, y : float
            Millimetres on the page, of the baseline's left end, middle or right end.
        text : str
        size : float
            Height of the font in points.
        align : str
            'left', 'center' or 'right'.
        angle : float
            Degrees, anticlockwise.
        color : str
        bold, italic : bool
        """
        if not text:
            return
        width, _ = text_size(text, size, bold, italic)
        back = {"left": 0.0, "center": width / 2, "right": width}[align]
        x, y = x - back * math.cos(math.radians(angle)), y - back * math.sin(math.radians(angle))
        self._text((x, y, angle), text, _Font(size, bold, italic), color)

    def pieces(
        self, pieces: Sequence[LabelPart], size: float, *, color: str = "#000000", bold: bool = False,
        italic: bool = False, halo: str | None = None, halo_width: float = 0.5, bridge: bool = False,
    ) -> None:  # fmt: skip
        """A text in pieces, the middle of the capitals of each at its position; a `bridge` of halo fills the text.

        Parameters
        ----------
        pieces : sequence of LabelPart
            Text, x and y in millimetres and angle in degrees of each piece.
        size : float
            Points.
        color : str
        bold, italic : bool
        halo : str, optional
            Colour around the letters.
        halo_width : float
            Millimetres.
        bridge : bool
            Fill the text with the halo.
        """
        drop = size * CAP * POINT / 2
        placed = []
        for piece in pieces:
            c, s = math.cos(math.radians(piece.spot.angle)), math.sin(math.radians(piece.spot.angle))
            back = piece.width / 2
            foot = (piece.spot.x - back * c + drop * s, piece.spot.y - back * s - drop * c)
            placed.append((piece.text, (*foot, piece.spot.angle)))
        # All halos first: none lies over a letter.
        font = _Font(size, bold, italic)
        if halo and halo_width > 0:
            for text, place in placed:
                self._halo(place, text, font, halo, halo_width, bridge)
        for text, place in placed:
            if text.strip():
                self._text(place, text, font, color)

    def _text(self, place: tuple[float, float, float], text: str, font: _Font, color: str) -> None:
        """One line of text from x, y in mm of its baseline's left end, at an angle in degrees."""
        x, y, angle = place
        drawn = self.axes.text(
            x, y, text.translate(_BREAKS), fontproperties=_properties(font.bold, font.italic), fontsize=font.size,
            color=color, rotation=angle, rotation_mode="anchor", ha="left", va="baseline", parse_math=False,
        )  # fmt: skip
        self._add(drawn)

    def _halo(
        self, place: tuple[float, float, float], text: str, font: _Font, color: str, width: float, bridge: bool = False
    ) -> None:
        """Outline of a text, `width` mm wide to each side; place as in `_text`."""
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path as Shape
        from matplotlib.transforms import Affine2D

        x, y, angle = place
        onto_page = Affine2D().scale(POINT).rotate_deg(angle).translate(x, y)
        shapes = [outline(text, *font)] if text.strip() else []
        if bridge:
            # Without it a line below, between the letters, would look like one more letter.
            end, low, high = _advance(text, *font) / POINT, 0.3 * font.size * CAP, 0.7 * font.size * CAP
            shapes.append(Shape([(0, low), (end, low), (end, high), (0, high), (0, low)], closed=True))
        for shape in shapes:
            patch = PathPatch(
                onto_page.transform_path(shape), facecolor=color, edgecolor=color, linewidth=2 * width / POINT,
                joinstyle="round",
            )  # fmt: skip
            self.axes.add_patch(patch)
            self._add(patch)

    def centred(self, x: float, y: float, text: str, size: float, *, angle: float = 0.0, **looks: Any) -> None:
        """One line of text with the middle of its capitals at (x, y)."""
        drop = size * CAP * POINT / 2
        a = math.radians(angle)
        self.text(x + drop * math.sin(a), y - drop * math.cos(a), text, size, align="center", angle=angle, **looks)

    def pixels(self, dpi: float) -> AnyArray:
        """Draw as pixels: uint8 array (rows, cols, 3), the first at the upper left corner of the box."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        left, bottom, right, top = self.box
        # The right and lower sides move by up to half a pixel, so that the scale stays exact.
        size = [max(1, round((b - a) * dpi / 25.4)) for a, b in ((left, right), (bottom, top))]
        self.figure.set_dpi(dpi)
        # A little more: matplotlib cuts off the fraction.
        self.figure.set_size_inches((size[0] + 1e-6) / dpi, (size[1] + 1e-6) / dpi)
        self.axes.set_xlim(left, left + size[0] * 25.4 / dpi)
        self.axes.set_ylim(top - size[1] * 25.4 / dpi, top)
        agg: Any = FigureCanvasAgg(self.figure)
        agg.draw()
        return np.ascontiguousarray(np.asarray(agg.buffer_rgba())[..., :3])

    def save_pdf(self, path: Path, title: str) -> None:
        """Write a PDF without dates."""
        from matplotlib.backends.backend_pdf import FigureCanvasPdf

        pdf: Any = FigureCanvasPdf(self.figure)
        pdf.print_pdf(
            str(path), metadata={"Title": title, "Creator": "geomosaic", "CreationDate": None, "ModDate": None}
        )
