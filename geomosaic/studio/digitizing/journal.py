"""Journal of digitizing: what is drawn and not yet in a GeoPackage is on the disk with every vertex."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import shapely

from geomosaic.errors import OutputError
from geomosaic.raster.geopackage import Feature, FeatureChange
from geomosaic.whole_files import sync, write_atomic

# Bytes after which the journal is written anew, without what is in the GeoPackages.
_LARGE = 4 << 20
# Sketches of pages that are kept.
_SKETCHES = 8


@dataclass(frozen=True)
class PendingEdit:
    """Edit of a layer that is not in its GeoPackage yet.

    Attributes
    ----------
    number : int
        In the journal.
    title : str
    path : Path
    layer : str
    changes : tuple of FeatureChange
    """

    number: int
    title: str
    path: Path
    layer: str
    changes: tuple[FeatureChange, ...]


class FeatureJournal:
    """File of lines, each on the disk before the page is answered; a torn last line is of nothing that was answered.

    Attributes
    ----------
    pending : list of PendingEdit
        In their order.
    sketches : dict
        What each page was drawing, by the page's own name.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._number = 0
        self.pending: list[PendingEdit] = []
        self.sketches: dict[str, Any] = {}
        for line in path.read_text("utf-8", errors="replace").splitlines() if path.is_file() else ():
            try:
                self._take(json.loads(line))
            except (ValueError, KeyError, TypeError, shapely.errors.ShapelyError):
                continue

    def begin(self, title: str, path: Path, layer: str, changes: tuple[FeatureChange, ...]) -> PendingEdit:
        """Keep an edit until `end`.

        Raises
        ------
        OutputError
            It cannot be written.
        """
        edit = PendingEdit(self._number + 1, title, path, layer, changes)
        self._append(_edit_line(edit))
        self._number = edit.number
        self.pending.append(edit)
        return edit

    def change(self, edit: PendingEdit, changes: tuple[FeatureChange, ...]) -> PendingEdit:
        """Keep other changes in place of an edit's."""
        other = replace(edit, changes=changes)
        self._append(_edit_line(other))
        self.pending[self.pending.index(edit)] = other
        return other

    def end(self, edit: PendingEdit) -> None:
        """Let go of an edit that is in its GeoPackage, or is given up."""
        self.pending.remove(edit)
        self._shorten({"ended": edit.number})

    def sketch(self, page: str, drawn: Mapping[str, Any] | None) -> None:
        """Keep what a page is drawing; None where it draws nothing.

        Parameters
        ----------
        page : str
        drawn : mapping or None
            JSON values.
        """
        if drawn is None and page not in self.sketches:
            return
        if drawn is None:
            del self.sketches[page]
            self._shorten({"sketch": page, "drawn": None})
            return
        self._append({"sketch": page, "drawn": dict(drawn)})
        self.sketches[page] = dict(drawn)
        while len(self.sketches) > _SKETCHES:
            del self.sketches[next(iter(self.sketches))]

    def _take(self, line: Mapping[str, Any]) -> None:
        if "sketch" in line:
            self.sketches.pop(line["sketch"], None)
            if line["drawn"] is not None:
                self.sketches[line["sketch"]] = line["drawn"]
        elif "ended" in line:
            self.pending = [edit for edit in self.pending if edit.number != line["ended"]]
        else:
            changes = tuple(
                FeatureChange(one["id"], *map(_feature, (one["before"], one["after"]))) for one in line["changes"]
            )
            edit = PendingEdit(int(line["edit"]), line["title"], Path(line["path"]), line["layer"], changes)
            self._number = max(self._number, edit.number)
            self.pending = [one for one in self.pending if one.number != edit.number]
            self.pending.append(edit)
            self.pending.sort(key=lambda one: one.number)

    def _shorten(self, line: Mapping[str, Any]) -> None:
        """Note that something is no longer needed; where nothing is, the journal starts anew."""
        idle = not self.pending and not self.sketches
        if not idle and self._path.is_file() and self._path.stat().st_size < _LARGE:
            with suppress(OutputError):
                self._append(line)
            return
        kept = [
            *map(_edit_line, self.pending),
            *({"sketch": page, "drawn": one} for page, one in self.sketches.items()),
        ]
        with suppress(OutputError):  # what stands there still is made again to no effect
            write_atomic(self._path, "".join(f"{json.dumps(one)}\n" for one in kept))

    def _append(self, line: Mapping[str, Any]) -> None:
        data = f"{json.dumps(line)}\n".encode()
        try:
            new = not self._path.exists()
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("ab", buffering=0) as file:
                before = file.seek(0, os.SEEK_END)
                try:
                    if file.write(data) != len(data):
                        raise OSError(28, "the disk is full")
                    os.fsync(file.fileno())
                except OSError:
                    file.truncate(before)
                    raise
            if new:
                sync(self._path.parent)
        except OSError as error:
            raise OutputError(
                f"nothing can be saved: {error.strerror}",
                where=self._path.name,
                hint="check the space on the disk and the rights of the project's folder; the page keeps what is drawn",
            ) from error


def _edit_line(edit: PendingEdit) -> dict[str, Any]:
    changes = [{"id": one.id, "before": _written(one.before), "after": _written(one.after)} for one in edit.changes]
    return {"edit": edit.number, "title": edit.title, "path": str(edit.path), "layer": edit.layer, "changes": changes}


def _written(feature: Feature | None) -> dict[str, Any] | None:
    if feature is None:
        return None
    geometry = None if feature.geometry is None else shapely.to_wkb(feature.geometry, hex=True, flavor="iso")
    return {"geometry": geometry, "values": dict(feature.values)}


def _feature(written: Mapping[str, Any] | None) -> Feature | None:
    if written is None:
        return None
    return Feature(None if written["geometry"] is None else shapely.from_wkb(written["geometry"]), written["values"])
