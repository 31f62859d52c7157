"""Layout of a sheet: the keys of `layout.toml` and their defaults."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from geomosaic.enhancement.picture import EnhancePart
from geomosaic.errors import InputError, warn
from geomosaic.geo.local_frames import MapPlace
from geomosaic.geo.magnetic_declination import FIRST, LAST, NAME, WEAKEST, decimal_year, magnetic_field
from geomosaic.options.check import check_idle, parse_color
from geomosaic.options.declaration import option

# Characters; more than a margin holds. Each is measured, again and again where it is to be broken into lines.
LONGEST_TEXT = 2000

# Millimetres; the longest side of the largest sheet, and more.
_FARTHEST = 2000.0


@dataclass(frozen=True)
class Element:
    """Element of the page that can be moved, with the key of its position.

    Attributes
    ----------
    table, key : str
    title : str, its name in messages
    """

    table: str
    key: str
    title: str

    @property
    def where(self) -> str:
        """Place of the key in a layout."""
        return f"[{self.table}] {self.key}"


ELEMENTS = {
    "title": Element("sheet", "title_position", "title"),
    "number": Element("sheet", "number_position", "sheet number"),
    "logo": Element("sheet", "logo_position", "logo"),
    "legend": Element("legend", "position", "legend"),
    "scalebar": Element("scalebar", "position", "scale bar"),
    "north": Element("north", "position", "north arrows"),
    "notes": Element("notes", "position", "notes"),
}


def _position() -> Any:
    """Key for the upper left corner of an element: mm from the left and from the upper edge of the paper."""
    return option(None, least=0.0, most=_FARTHEST)


_GRID_STYLES = ("lines", "crosses", "ticks", "none")


@dataclass(frozen=True)
class SheetPart:
    """`[sheet]`: names and paper."""

    title: str = ""
    subtitle: str = ""
    series: str = ""
    number: str = ""
    name: str = ""
    logo: str = ""  # PNG or JPEG left of the title
    title_position: tuple[float, float] | None = _position()
    number_position: tuple[float, float] | None = _position()
    logo_position: tuple[float, float] | None = _position()
    head: str = option("auto", choices=("auto", "none"))  # strip above the map for what has no position
    fonts: tuple[str, ...] = ()  # TrueType files for characters that DejaVu Sans lacks
    paper: str = ""
    orientation: str = option("auto", choices=("auto", "portrait", "landscape"))
    margin: float = option(10.0, least=0.0, most=200.0)
    bleed: float = option(0.0, least=0.0, most=50.0)  # mm of paper beyond the trim, with crop marks
    panel: str = option("auto", choices=("auto", "right", "bottom", "none"))
    dpi: int = option(300, least=72, most=2400)


@dataclass(frozen=True)
class MapPart:
    """`[map]`: scale and area."""

    scale: float | None = option(None, least=1.0)
    bounds: tuple[float, float, float, float] | None = None
    centre: tuple[float, float] | None = None
    background: str = option("#ffffff", parse=parse_color)


@dataclass(frozen=True)
class GridPart:
    """`[grid]`: the map grid, by default that of the map's own CRS."""

    style: str = option("lines", choices=_GRID_STYLES)
    crs: str = ""
    interval: float | None = option(None, above=0.0)
    color: str = option("#000000", parse=parse_color)
    width: float = option(0.1, above=0.0, most=5.0)
    labels: bool = True
    size: float = option(6.0, above=0.0, most=10.0)  # two rows have room between neatline and border


@dataclass(frozen=True)
class GraticulePart(GridPart):
    """`[graticule]`: a second grid, by default longitude and latitude."""

    style: str = option("ticks", choices=_GRID_STYLES)
    color: str = option("#1f5fae", parse=parse_color)


@dataclass(frozen=True)
class ScaleBarPart:
    """`[scalebar]`."""

    show: bool = True
    length: float | None = option(None, above=0.0)  # metres on the ground
    feet: bool = False
    position: tuple[float, float] | None = _position()


@dataclass(frozen=True)
class NorthPart:
    """`[north]`: the arrows; magnetic north where it is declared, or a date is given at which the model has it."""

    show: bool = True
    magnetic: float | None = option(None, least=-180.0, most=180.0)  # declination in degrees, east positive
    magnetic_date: str = ""
    annual_change: float | None = option(None, least=-10.0, most=10.0)  # degrees, east positive
    position: tuple[float, float] | None = _position()


@dataclass(frozen=True)
class LegendPart:
    """`[legend]`."""

    show: bool = True
    title: str = "Legend"
    position: tuple[float, float] | None = _position()
    width: float = option(58.0, least=20.0, most=_FARTHEST, needs=("position",))  # mm at which lines are broken


@dataclass(frozen=True)
class NotesPart:
    """`[notes]`: what stands in the margin; what is empty is taken from the records of the raster, if there."""

    sources: str = ""
    photography: str = ""  # date of the photos
    accuracy: str = ""
    credits: str = ""
    publisher: str = ""
    edition: str = ""
    records: bool = True  # look for the report and the STAC item beside the raster
    position: tuple[float, float] | None = _position()
    width: float = option(58.0, least=20.0, most=_FARTHEST, needs=("position",))  # mm at which lines are broken


@dataclass(frozen=True)
class ContoursPart:
    """`[contours]`."""

    dem: str = ""
    heights: str = ""  # vertical datum of the DEM, where the file does not say it
    interval: float | None = option(None, above=0.0)
    index: int = option(5, least=1, most=100)
    tolerance: float | None = option(None, least=0.0)
    color: str = option("#9a5b22", parse=parse_color)
    width: float = option(0.12, above=0.0, most=5.0)
    index_width: float = option(0.25, above=0.0, most=5.0)
    labels: bool = True
    size: float = option(5.5, above=0.0, most=72.0)
    spots: bool = True  # spot heights on summits and in hollows
    spot_prominence: float | None = option(None, above=0.0)  # metres; the interval by default
    spot_spacing: float = option(20.0, least=0.0, most=1000.0)  # mm on paper


@dataclass(frozen=True)
class LayerPart:
    """`[[layer]]`: one vector file on the map; later ones lie above."""

    file: str
    layer: str = ""
    style: str = ""
    title: str = ""
    color: str | None = option(None, parse=parse_color)  # in place of those of the style
    width: float | None = option(None, above=0.0, most=20.0)
    label: str = ""  # column of the names


@dataclass(frozen=True)
class Layout:
    """A whole layout; `Layout()` is the default one."""

    sheet: SheetPart = field(default_factory=SheetPart)
    map: MapPart = field(default_factory=MapPart)
    enhance: EnhancePart = field(default_factory=EnhancePart)
    grid: GridPart = field(default_factory=GridPart)
    graticule: GraticulePart = field(default_factory=GraticulePart)
    scalebar: ScaleBarPart = field(default_factory=ScaleBarPart)
    north: NorthPart = field(default_factory=NorthPart)
    legend: LegendPart = field(default_factory=LegendPart)
    notes: NotesPart = field(default_factory=NotesPart)
    contours: ContoursPart = field(default_factory=ContoursPart)
    layer: tuple[LayerPart, ...] = ()

    def position_of(self, element: str) -> tuple[float, float] | None:
        """Position of an element by its name in `ELEMENTS`; None where it stands in its usual place."""
        found: tuple[float, float] | None = getattr(getattr(self, ELEMENTS[element].table), ELEMENTS[element].key)
        return found


_WHERE = "[north] magnetic_date"


@dataclass(frozen=True)
class Declination:
    """Magnetic north against true north.

    Attributes
    ----------
    degrees : float, east positive
    date : str, as the layout has it
    annual_change : float or None, degrees, east positive
    sigma : float or None, standard deviation in degrees where it is that of the model; None where it was declared
    """

    degrees: float
    date: str = ""
    annual_change: float | None = None
    sigma: float | None = None


def declination(part: NorthPart, place: MapPlace | None) -> Declination | None:
    """Declination at the middle of a sheet; None if the layout has neither a declination nor a date.

    Parameters
    ----------
    part : NorthPart
    place : MapPlace or None, None in a local frame, which has no north

    Raises
    ------
    InputError
        The date is none, or one that the model does not cover.
    """
    if not part.show or place is None:
        return None
    if part.magnetic is not None:
        return Declination(part.magnetic, part.magnetic_date, part.annual_change)
    if not part.magnetic_date:
        return None
    year = decimal_year(part.magnetic_date, _WHERE)
    if not FIRST <= year <= LAST:
        raise InputError(
            f"the magnetic model {NAME} holds from {FIRST:.0f} to {LAST:.0f}, not in {part.magnetic_date}",
            where=_WHERE,
            hint="give [north] magnetic, the declination in degrees, or leave the date out",
        )
    field = magnetic_field(place.longitude, place.latitude, 0.0, year)
    if field.horizontal < WEAKEST:
        warn(
            f"no magnetic north is drawn: near the magnetic pole ({field.horizontal:.0f} nT along the ground) a "
            "compass does not point"
        )
        return None
    return Declination(field.declination, part.magnetic_date, field.annual_change, field.sigma)


def check_layout(layout: Layout) -> None:
    """Check of a layout as a whole: keys that would do nothing beside the others, and the lengths of its texts.

    Parameters
    ----------
    layout : Layout

    Raises
    ------
    InputError
        Names the table and the key.
    """
    for item in fields(layout):
        part = getattr(layout, item.name)
        if is_dataclass(part):
            try:
                check_idle(part)
            except InputError as error:
                raise InputError(error.what, where=f"[{item.name}]", hint=error.hint) from None
    _check_texts(layout)


def _check_texts(part: Any, where: str | None = None) -> None:
    """Check of the length of all texts of a layout."""
    for item in fields(part):
        value = getattr(part, item.name)
        for one in value if isinstance(value, tuple) else (value,):
            if is_dataclass(one):
                _check_texts(one, f"[{item.name}]")
            elif isinstance(one, str) and len(one) > LONGEST_TEXT:
                raise InputError(
                    f"{item.name} has {len(one):,} characters, and a sheet takes {LONGEST_TEXT:,}",
                    where=where,
                    hint="shorten it",
                )
