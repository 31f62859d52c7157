"""The command: make the data, run the jobs, write the results."""

from __future__ import annotations

import argparse
import datetime
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks import blend, bundle, edit, gigapixel, global_parts, growth, jobs, match, scale, seam_layout
from benchmarks.jobs import Setting
from benchmarks.machine import description
from benchmarks.process import Programs, helper
from benchmarks.report import page
from benchmarks.rounds import tell

JOBS = {
    **jobs.JOBS, "blend": blend.blend, "growth": growth.growth, "edit": edit.edit, "bundle": bundle.bundle,
    "match": match.match, "footprints": global_parts.global_parts, "gigapixel": gigapixel.gigapixel,
    "scale": scale.scale, "seams": seam_layout.seam_layout,
}  # fmt: skip
HERE = Path(__file__).resolve().parent
RAM_DISK = Path("/dev/shm")


def parser() -> argparse.ArgumentParser:
    """Flags."""
    words = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    words.add_argument("jobs", nargs="*", metavar="JOB", help=f"{', '.join(JOBS)}; all unless given")
    words.add_argument("--rounds", type=int, default=3, help="runs of each tool (default 3)")
    words.add_argument("--small", action="store_true", help="small data: tries the machinery, shows no speed")
    words.add_argument("--work", type=Path, help="folder for data and outputs, about 11 GB (default a RAM disk)")
    words.add_argument("--peers", type=Path, help="environment of the other tools (default the PATH)")
    words.add_argument(
        "--out", type=Path, help="folder for results.md and results.json (default benchmarks/; --small: WORK)"
    )
    words.add_argument("--note", default="", help="what readers of the results should know of this run")
    words.add_argument("--clean", action="store_true", help="remove the data afterwards")
    return words


def main(arguments: list[str] | None = None) -> None:
    """Run."""
    words = parser().parse_args(arguments)
    unknown = [name for name in words.jobs if name not in JOBS]
    if unknown:
        parser().error(f"no job named {', '.join(unknown)}; there are {', '.join(JOBS)}")
    base = words.work or (RAM_DISK if RAM_DISK.is_dir() else Path(tempfile.gettempdir())) / "geomosaic-benchmarks"
    data = base.resolve() / ("small" if words.small else "full")
    work = data / "work"
    work.mkdir(parents=True, exist_ok=True)
    programs = Programs.found(words.peers.resolve() if words.peers else None)
    for name in ("rio", "oty"):
        if getattr(programs, name) is None:
            tell(f"`{name}` was not found: its rows are left out (see benchmarks/README.md)")
    tell(f"data in {data}")
    if set(words.jobs or JOBS) & {*jobs.JOBS, "edit"}:
        helper("data", str(data), *(["--small"] if words.small else []))
    setting = Setting(data, work, words.small, words.rounds, programs, sys.executable)
    out = words.out or (data if words.small else HERE)
    out.mkdir(parents=True, exist_ok=True)
    facts = {
        "date": datetime.date.today().isoformat(),
        "machine": description(),
        "versions": programs.versions(),
        "small": words.small,
        "note": words.note,
    }
    for name in words.jobs or JOBS:
        tell(name)
        done = {**JOBS[name](setting).plain(), **facts}
        everything = write(out, name, done)
        print(page({name: everything[name]}).split("\n\n", 2)[2])
    shutil.rmtree(data if words.clean else work)


def write(folder: Path, name: str, job: dict[str, Any]) -> dict[str, Any]:
    """Put a job's result beside those of other jobs."""
    path = folder / "results.json"
    before: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    everything = {key: job if key == name else before[key] for key in JOBS if key == name or key in before}
    path.write_text(json.dumps(everything, indent=1) + "\n")
    (folder / "results.md").write_text(page(everything))
    return everything


if __name__ == "__main__":
    if __package__ in (None, ""):
        raise SystemExit("run it as `python -m benchmarks` from the project's folder")
    main()
