"""Write docs/options.md: tables of all declared options, for the command line, project files and the library."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.options.control import (
    CheckOptions,
    ControlOptions,
    DrawOptions,
    FitOptions,
    LocateOptions,
    RegistrationOptions,
    RpcOptions,
    SearchOptions,
    TieOptions,
    VectorOptions,
)
from geomosaic.options.declaration import GROUPS, Declared, declared
from geomosaic.options.inputs import Area, BlockInputs, EdgeOptions, QualityLimits
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.planning import (
    ControlNeedOptions,
    CoverageOptions,
    FlightOptions,
    ProcessingOptions,
    ProductOptions,
    TableOptions,
)
from geomosaic.options.sheet import (
    ContourOptions,
    EnhanceOptions,
    PanOptions,
    SchemeOptions,
    SeriesOptions,
    SheetOptions,
    WaterOptions,
)
from geomosaic.options.terrain import DtmOptions
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.options.vector_edges import VectorEdgeOptions

PAGE = Path(__file__).with_name("options.md")
HEAD = """# Options

All options of orthos and mosaics, of their inputs and extents, of what is measured with control points, and of map
sheets. Each is declared once, in `geomosaic/options/`; the flags of the command line, the keys of project files, the
keywords of the library and this page (`python docs/make_options_page.py`) come from there.
The name is the keyword of the library: `geomosaic.mosaic(files, output, blend="multiband", feather="5m")`.

An option that would do nothing beside the others is an error, on the command line, in project files and in the library;
the last column says when. An option that is set to its default counts as not given, and is never refused.
"""


PARTS = (
    ("", (BlockInputs, Area, MosaicOptions, QualityLimits)),
    ("Control points and fits: ", (ControlOptions, FitOptions, VectorOptions)),
    ("Tie points: ", (TiePointOptions,)),
    ("Co-registration: ", (RegistrationOptions,)),
    ("Block adjustment: ", (AdjustmentOptions,)),
    ("Edge matching: ", (EdgeOptions,)),
    ("Monoplotting: ", (LocateOptions, DrawOptions)),
    ("Fiducial marks: ", (SearchOptions,)),
    ("RPCs: ", (TieOptions, RpcOptions)),
    ("Check points: ", (CheckOptions,)),
    ("Contours: ", (ContourOptions,)),
    ("Edge matching of vectors: ", (VectorEdgeOptions,)),
    ("Terrain models: ", (DtmOptions,)),
    ("Water: ", (WaterOptions,)),
    ("Pictures for print: ", (EnhanceOptions, PanOptions)),
    ("Map sheets: ", (SheetOptions,)),
    ("Series of sheets: ", (SchemeOptions, SeriesOptions)),
    ("Plan of a flight: ", (FlightOptions,)),
    ("Plan of an area: ", (CoverageOptions,)),
    ("Plan of control points: ", (ControlNeedOptions,)),
    ("Plan of a product: ", (ProductOptions,)),
    ("Plan by tables: ", (TableOptions,)),
    ("Plan a run: ", (ProcessingOptions,)),
)
"""What a heading starts with, and the options below it."""
NAMES = {one.name for _, kinds in PARTS for kind in kinds for one in declared(kind)}


def page() -> str:
    """Text of the page."""
    parts = [HEAD]
    for title, kinds in PARTS:
        options = {one.name: one for kind in kinds for one in declared(kind) if one.option.help}
        for group in GROUPS:
            rows = [row(one, options, project=not title) for one in options.values() if one.option.group == group]
            if rows:
                head = "| name | flag | project file | meaning | default | goes with |\n|---|---|---|---|---|---|"
                parts.append(f"## {f'{title}{group}'.capitalize()}\n\n{head}\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)


def row(one: Declared, others: Mapping[str, Declared], *, project: bool) -> str:
    """Row of one option beside the others of its page; what a project has is a key of its file."""
    option = one.option
    key = f"`[{option.section}] {one.key}`" if option.section and project else ""
    choices = f" One of {', '.join(option.choices)}." if option.choices else ""
    default = option.default or (
        f"`{one.default}`" if isinstance(one.default, str | int | float) and one.default != "" else "none"
    )
    # Conditions on options that are not among the others say nothing there; those on arguments, such as `output`, do.
    foreign = NAMES - others.keys()
    needs, idle = (
        [other for other in names if other.partition("=")[0] not in foreign]
        for names in (option.needs, option.idle_with)
    )
    rules = [f"only with {' or '.join(f'`{other}`' for other in needs)}"] if needs else []
    rules += [f"not with {', '.join(f'`{other}`' for other in idle)}"] if idle else []
    flag = f"`{one.flag}`" if one.flag else ""
    cells = (f"`{one.name}`", flag, key, option.help + choices, default, "; ".join(rules))
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
