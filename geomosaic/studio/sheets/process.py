"""Process that draws sheets for the studio: `python -m geomosaic.studio.sheets.process`.

It reads requests from standard input and writes what happens to standard output, a JSON object a line. It stays between
sheets, since loading the libraries takes longer than a preview, and ends where nobody asks any longer.
"""

from __future__ import annotations

import json
import signal
import sys
import time
import warnings
from pathlib import Path
from typing import Any

from geomosaic.errors import GeomosaicError, GeomosaicWarning
from geomosaic.sheets.inputs import sheet
from geomosaic.sheets.make import SheetResult


def main() -> None:
    """Sheets, one after the other, as they are asked for."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the terminal is for the studio
    for line in sys.stdin:
        started = time.perf_counter()
        answer = {"kind": "ended", **_drawn(json.loads(line))}
        _say({**answer, "seconds": time.perf_counter() - started})


def _say(values: dict[str, Any]) -> None:
    print(json.dumps(values), flush=True)


def _drawn(request: dict[str, Any]) -> dict[str, Any]:
    """Facts of a sheet that was drawn, or what was wrong; notes on it either way."""
    notes: list[str] = []

    def record(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        text = str(message).replace(request["folder"], "")
        if issubclass(category, GeomosaicWarning) and text not in notes:
            notes.append(text)

    def progress(done: int, total: int, stage: str) -> None:
        _say({"kind": "progress", "done": done, "total": total, "stage": stage})

    options = {"layout": Path(request["layout"])} | ({} if request.get("dpi") is None else {"dpi": request["dpi"]})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", GeomosaicWarning)
        warnings.showwarning = record
        try:
            made = sheet(
                request["raster"],
                request["output"],
                overwrite=bool(request.get("overwrite")),
                progress=progress,
                **options,
            )
        except GeomosaicError as error:
            where = (error.where or "").replace(request["folder"], "")
            return {"what": error.what, "where": where, "hint": error.hint, "notes": notes}
        except MemoryError:
            return {"what": "out of memory", "where": "", "hint": "lower [sheet] dpi", "notes": notes}
        except Exception as error:
            what = f"unexpected {type(error).__name__}: {error}"
            return {"what": what, "where": "", "hint": "this is a fault of geomosaic: please report it", "notes": notes}
    return {"sheet": _facts(made), "notes": notes}


def _facts(made: SheetResult) -> dict[str, Any]:
    page = made.page
    return {
        "width": page.width,
        "height": page.height,
        "paper": list(page.paper),
        "neatline": list(page.neatline),
        "scale": page.scale,
        "elements": {name: list(box) for name, box in made.elements.items()},
        "layers": dict(made.layers),
    }


if __name__ == "__main__":
    main()
