"""What is known of a raster that is put on a sheet: the project's report and the STAC item, found beside it."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.project.tables import read_text


def read_records(raster: Path, report: Path | None = None) -> dict[str, Any] | None:
    """Read the report, and the STAC item beside the raster.

    A report is that of `report`, or `report.json` beside the raster where it lists the raster among its outputs. The
    item is `NAME.stac.json` beside `NAME.tif`. Records that tell of a file of another size are left out, with a note.

    Returns
    -------
    dict or None
        What the report has; with the item under `stac`, and the names of what was read under `read`. None where there
        is neither.

    Raises
    ------
    InputError
        `report` is no report of a project.
    """
    found: dict[str, Any] = {}
    read: list[str] = []
    if report is not None:
        found.update(_report(report))
        read.append(report.name)
    else:
        near = raster.parent / "report.json"
        facts = _json(near) if raster.is_file() else None
        sizes = [out.get("bytes") for out in (facts or {}).get("outputs", ()) if Path(out["path"]).name == raster.name]
        if facts is not None and _same(raster, sizes, near):
            found.update(facts)
            read.append(near.name)
    item = raster.with_suffix(".stac.json")
    facts = _json(item) if raster.is_file() else None
    if facts is not None:
        assets = facts.get("assets", {}).values()
        sizes = [a.get("file:size") for a in assets if Path(str(a.get("href"))).name == raster.name]
        if _same(raster, sizes, item):
            found["stac"] = facts
            read.append(item.name)
    return {**found, "read": read} if read else None


def _same(raster: Path, sizes: list[Any], where: Path) -> bool:
    """Whether a record tells of this file."""
    if not sizes:
        return False
    if raster.stat().st_size in sizes:
        return True
    warnings.warn(
        f"{where} tells of another {raster.name} (its size differs): not used", GeomosaicWarning, stacklevel=3
    )
    return False


def _json(path: Path) -> dict[str, Any] | None:
    """Contents of a file of JSON; None where it is not there or is something else."""
    try:
        facts = json.loads(read_text(path, "record", 256 << 20)) if path.is_file() else None
    except (InputError, json.JSONDecodeError):
        return None
    return facts if isinstance(facts, dict) else None


def _report(path: Path) -> Mapping[str, Any]:
    try:
        facts = json.loads(read_text(path, "report", 256 << 20))
    except json.JSONDecodeError as error:
        raise InputError(f"the report is not JSON: {error}", where=str(path), mend="give report.json") from None
    if not isinstance(facts, dict) or not {"orient", "mosaic", "check"} & set(facts):
        raise InputError(
            "this is no report of a project", where=str(path), mend="give the report.json beside the mosaic"
        )
    return facts
