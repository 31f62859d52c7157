"""Sheets of a workspace: its layouts, edits of them, previews and prints."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool

from geomosaic.digests import digest_of
from geomosaic.errors import GeomosaicError, InputError
from geomosaic.jobs.manifest import Layout as ProjectLayout
from geomosaic.raster.files import companion
from geomosaic.studio.sheets.drawing import Previews, SheetProcess
from geomosaic.studio.sheets.form import layout_form
from geomosaic.studio.sheets.layout_files import (
    LayoutFile,
    edited,
    layout_files,
    new_layout,
    problem,
    read,
    values_of,
)
from geomosaic.studio.workspace import Layer, Workspace, file_stamp

# Formats that are printed, and resolutions of previews.
FORMATS = ("pdf", "png", "tif")
_COARSEST, _FINEST = 72, 300
# Keys of layouts that name files.
_FILE_KEYS = ("logo", "fonts", "dem", "file", "style")


class SheetDesk:
    """Sheets of a workspace.

    Parameters
    ----------
    workspace : Workspace
    tell : callable
        Takes events for the pages.
    """

    def __init__(self, workspace: Workspace, tell: Callable[[dict[str, Any]], None]) -> None:
        self._workspace, self._tell = workspace, tell
        folder = workspace.path.parent / ".geomosaic" / workspace.path.stem
        self.previews = Previews(folder)
        self._printing = SheetProcess()
        self._print: dict[str, Any] | None = None
        self._serial = int(1000 * time.time())

    def overview(self) -> dict[str, Any]:
        """Layouts of the project, rasters that a sheet may show, the form of layouts and the last print."""
        return {
            "layouts": [{"id": one.id, "name": one.path.name} for one in self._files()],
            "rasters": [{"id": one.id, "name": one.name, "role": one.role} for one in self._rasters()],
            "form": layout_form(),
            "vectors": [path.name for path in self._vectors()],
            "print": self._print,
        }

    @property
    def printed(self) -> dict[str, Any] | None:
        """The print that is under way or ended last.

        `state`, `layout`, `output`, `file` (as seen from the project's folder), `stage`, `done`, `total`, notes;
        `serial` grows with every change: an answer and an event may reach the page in any order.
        """
        return self._print

    def state(self, layout: str) -> dict[str, Any]:
        """Values of a layout as they are written, and what is wrong with them.

        Parameters
        ----------
        layout : str
            Its id.
        """
        path = self._file(layout).path
        text = read(path)
        wrong = problem(text, path.name)
        try:
            values = values_of(text, path.name)
        except InputError:
            values = {}
        return {
            "id": layout, "name": path.name, "values": values, "error": _said(wrong, path.parent),
            "editable": bool(values) or wrong is None, "history": self._workspace.history.titles,
            "prints": [kind for kind, file in self._outputs(path).items() if file.is_file()],
        }  # fmt: skip

    def create(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Begin a layout.

        Parameters
        ----------
        values : mapping
            `name` of the file; `like`, the id of a layout that is copied.
        """
        folder, history = self._workspace.path.parent, self._workspace.history
        project = self._workspace.project()
        path, text = new_layout(folder, str(values.get("name", "")), "" if project is None else project.name)
        if values.get("like"):
            text = read(self._file(str(values["like"])).path)
        history.save(f"layout {path.name}", {path: None}, {path: text})
        return self.state(LayoutFile.of(path).id)

    def edit(self, layout: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """Change a layout; an edit that makes it wrong is refused.

        Parameters
        ----------
        layout : str
            Its id.
        values : mapping
            `edits`, see `edited`, and a `title` for the history.
        """
        path = self._file(layout).path
        edits = values.get("edits")
        if not isinstance(edits, list) or not all(isinstance(one, dict) for one in edits):
            raise InputError("`edits` is no list of edits", hint="load the page again")
        for one in edits:
            self._check_files(one)
        history = self._workspace.history
        with history.lock:
            before = read(path)
            text = before
            for one in edits:
                text = edited(text, one)
            wrong, known = problem(text, path.name), problem(before, path.name)
            if wrong is not None and str(wrong) != str(known):
                raise wrong
            if text != before:
                title = str(values.get("title") or f"{path.stem} changed")[:80]
                history.save(title, {path: before}, {path: text})
        return self.state(layout)

    async def preview(self, layout: str, raster: str, dpi: int) -> dict[str, Any]:
        """Sheet as the command line prints it, at the resolution of a screen.

        Parameters
        ----------
        layout, raster : str
            Ids.
        dpi : int

        Returns
        -------
        dict
            `sheet` with page and boxes of elements in mm, `key` of the picture and `notes`; or `error`.
        """
        dpi = min(max(dpi, _COARSEST), _FINEST)
        path, source = await run_in_threadpool(self._places, layout, raster)
        key = await run_in_threadpool(_digest, path, source, dpi)
        request = {"raster": str(source), "layout": str(path), "dpi": dpi, "folder": f"{path.parent}/"}
        said = await self.previews.preview(key, request)
        if "sheet" not in said:
            return {"error": {name: said[name] for name in ("what", "where", "hint")}, "notes": said["notes"]}
        return {**said, "key": key, "dpi": dpi, "error": None}

    async def start_print(self, layout: str, values: Mapping[str, Any]) -> Callable[[], Any]:
        """Begin a print; pages are told of its progress and its end.

        Parameters
        ----------
        layout : str
            Its id.
        values : mapping
            `raster` (id), `format` ('pdf', 'png', 'tif'), `overwrite`.

        Returns
        -------
        callable
            Coroutine function that draws.

        Raises
        ------
        InputError
            One is under way, or the format is none of these.
        """
        kind = str(values.get("format", "pdf"))
        if kind not in FORMATS:
            raise InputError(f"sheets are not printed as '{kind}'", where="format", hint=f"one of {', '.join(FORMATS)}")
        if self._print is not None and self._print["state"] == "running":
            raise InputError("a sheet is being printed", hint="wait until it ends")
        path, source = await run_in_threadpool(self._places, layout, str(values.get("raster", "")))
        output = self._outputs(path).get(kind)
        if output is None:
            raise InputError("the project file has errors", hint="mend them first: see Messages")
        if output.exists() and not values.get("overwrite"):
            raise InputError(
                f"there is a file {output.name} already", where=str(output), hint="replace it, or rename it first"
            )
        self._print = {
            "state": "running",
            "layout": layout,
            "output": str(output),
            "file": os.path.relpath(output, self._workspace.path.parent),
            "stage": "starting",
            "done": 0,
            "total": 0,
        }
        self._report({})
        request = {
            "raster": str(source), "layout": str(path), "output": str(output), "overwrite": True,
            "folder": f"{path.parent}/",
        }  # fmt: skip

        async def draw() -> None:
            said = await self._printing.draw(request, self._report)
            state = "done" if "sheet" in said else "failed"
            if self._print is not None and self._print["state"] == "running":
                said.pop("sheet", None)
                self._report({**said, "state": state})

        return draw

    async def stop_print(self) -> None:
        """Stop the print; what was there before it stays."""
        if self._print is not None and self._print["state"] == "running":
            self._report({"state": "stopped", "what": "stopped; no file was changed"})
            await self._printing.end()

    async def end(self) -> None:
        """End the processes."""
        await self.previews.end()
        await self._printing.end()

    def _report(self, more: Mapping[str, Any]) -> None:
        assert self._print is not None
        self._serial += 1
        self._print = {**self._print, **more, "serial": self._serial}
        self._tell({"kind": "print", "print": self._print})

    def _files(self) -> list[LayoutFile]:
        return layout_files(self._workspace.path.parent)

    def _file(self, layout: str) -> LayoutFile:
        found = next((one for one in self._files() if one.id == layout), None)
        if found is None:
            raise InputError("the layout is gone", hint="choose another one")
        return found

    def _rasters(self) -> list[Layer]:
        order = ("mosaic", "ortho", "reference")
        found = [one for one in self._workspace.layers() if one.role in order]
        return sorted(found, key=lambda one: order.index(one.role))

    def _vectors(self) -> list[Path]:
        folder = self._workspace.path.parent
        return sorted(path for kind in ("gpkg", "geojson", "shp", "gpx") for path in folder.glob(f"*.{kind}"))

    def _places(self, layout: str, raster: str) -> tuple[Path, Path]:
        """Paths of a layout and of the raster of its sheet."""
        source = next((one.path for one in self._rasters() if one.id == raster), None)
        if source is None:
            raise InputError(
                "the project has no such raster", hint="run the mosaic, or choose an ortho or the reference"
            )
        return self._file(layout).path, source

    def _check_files(self, edit: Mapping[str, Any]) -> None:
        """Check that an edit names files of the project's folder only."""
        folder = self._workspace.path.parent
        key = "file" if edit.get("layer") == "add" else str(edit.get("key", ""))
        value = edit.get("file") if edit.get("layer") == "add" else edit.get("value")
        for one in value if isinstance(value, list) else [value]:
            if key in _FILE_KEYS and isinstance(one, str) and not _within(folder, one):
                raise InputError(
                    f"'{one}' lies outside the project's folder", where=f"[{edit.get('table', 'layer')}] {key}",
                    hint="copy it into the folder, or write its path into the layout in an editor",
                )  # fmt: skip

    def _outputs(self, layout: Path) -> dict[str, Path]:
        """File of a print by its format; empty while errors of the project file hide where its outputs go."""
        project = self._workspace.project()
        return {} if project is None else {kind: ProjectLayout(project).sheet(layout, kind) for kind in FORMATS}


def _digest(layout: Path, raster: Path, dpi: int) -> str:
    """Digest of what a preview shows: the layout's text, and size and time of every file that it is drawn from."""
    text = read(layout)
    files = {raster, raster.with_name("report.json"), companion(raster, "", ".stac.json")}
    values = values_of(text, layout.name)
    for table in (*(part for part in values.values() if isinstance(part, dict)), *_layers(values)):
        named = [one for value in table.values() for one in (value if isinstance(value, list) else [value])]
        files |= {layout.parent / one for one in named if isinstance(one, str) and 0 < len(one) < 200}
    states = [(str(file), stamp) for file in sorted(files) if (stamp := file_stamp(file)) is not None]
    return digest_of(text, str(raster), dpi, states)[:24]


def _within(folder: Path, name: str) -> bool:
    try:
        return (folder / name).resolve().is_relative_to(folder)
    except (OSError, ValueError):
        return False


def _layers(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    layers = values.get("layer")
    return [one for one in layers if isinstance(one, dict)] if isinstance(layers, list) else []


def _said(error: GeomosaicError | None, folder: Path) -> dict[str, Any] | None:
    if error is None:
        return None
    return {"what": error.what, "where": (error.where or "").replace(f"{folder}/", ""), "hint": error.hint}
