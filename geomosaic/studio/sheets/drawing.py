"""Processes that draw the sheets of a studio, and the previews that are kept."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

# Previews that are kept in memory.
_KEPT = 12
_GONE = {
    "what": "the process that draws ended without a word", "where": "",
    "hint": "there may be too little memory: lower [sheet] dpi", "notes": [],
}  # fmt: skip


class SheetProcess:
    """Process that draws sheets, one after the other; it is started with the first."""

    def __init__(self) -> None:
        self._process: asyncio.subprocess.Process | None = None
        self._lock = asyncio.Lock()

    async def draw(
        self, request: dict[str, Any], progress: Callable[[dict[str, Any]], None] = lambda _: None
    ) -> dict[str, Any]:
        """Draw a sheet.

        Parameters
        ----------
        request : dict
            `raster`, `layout`, `output`, `folder` (left out of messages), and where wanted `dpi` and `overwrite`.
        progress : callable, optional
            Takes `stage`, `done` and `total`.

        Returns
        -------
        dict
            `sheet`, or `what`, `where` and `hint`; `notes` and `seconds`.
        """
        async with self._lock:
            process = self._process
            if process is None or process.returncode is not None:
                process = self._process = await asyncio.create_subprocess_exec(
                    sys.executable, "-m", "geomosaic.studio.sheets.process",
                    stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, limit=1 << 22,
                )  # fmt: skip
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(json.dumps(request).encode() + b"\n")
            while line := await process.stdout.readline():
                said: dict[str, Any] = json.loads(line)
                if said.pop("kind") == "ended":
                    return said
                progress(said)
            await process.wait()
            return dict(_GONE)

    async def end(self) -> None:
        """End the process, whatever it draws."""
        if self._process is not None and self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
            await self._process.wait()


class Previews:
    """Previews of sheets by what they show.

    Parameters
    ----------
    folder : Path
        For pictures while they are drawn.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process = SheetProcess()
        self._kept: OrderedDict[str, tuple[dict[str, Any], bytes]] = OrderedDict()
        self._lock = asyncio.Lock()

    async def preview(self, key: str, request: dict[str, Any]) -> dict[str, Any]:
        """Facts of a sheet, as from `SheetProcess.draw`; its picture is kept under the key.

        Parameters
        ----------
        key : str
            Digest of all that the sheet shows.
        request : dict
            `raster`, `layout`, `folder`, `dpi`.
        """
        async with self._lock:
            if key not in self._kept:
                self._folder.mkdir(parents=True, exist_ok=True)
                output = self._folder / f"preview-{key}.png"
                try:
                    said = await self._process.draw({**request, "output": str(output), "overwrite": True})
                    if "sheet" not in said:
                        return said  # what is wrong may lie in files that the key does not know
                    self._kept[key] = said, await asyncio.to_thread(output.read_bytes)
                finally:
                    output.unlink(missing_ok=True)
                while len(self._kept) > _KEPT:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(key)
            return self._kept[key][0]

    def picture(self, key: str) -> bytes | None:
        """PNG of a preview; None where it is not kept any longer."""
        return self._kept[key][1] if key in self._kept else None

    async def end(self) -> None:
        """End the process."""
        await self._process.end()
