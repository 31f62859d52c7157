"""Results as a page people read, made from the JSON that programs read."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def page(jobs: Mapping[str, Mapping[str, Any]]) -> str:
    """All jobs as Markdown."""
    lines = [
        "# Benchmarks",
        "",
        "Whole processes, start-up included; the tools of a job ran in turn (A B C, A B C). Wall is the median over",
        "the rounds, ratios are medians of ratios within a round. *floor* reads and writes the same finished raster",
        "through GDAL and does nothing else; *floor: inputs + output* reads every input and writes the output once.",
        "*T1 / (2 T2)*: time with one thread on one core over twice that on two, start-up included.",
        "Made by `python -m benchmarks`.",
    ]
    for name, job in jobs.items():
        lines += ["", f"## {name}: {job['title']}", "", _where(job), "", *_times(job)]
        if job["accuracy"]:
            lines += ["", *_accuracy(job["accuracy"])]
        if job.get("quality"):
            lines += ["", *_quality(job["quality"])]
        lines += ["", *_targets(job["targets"])]
    return "\n".join(lines) + "\n"


def _where(job: Mapping[str, Any]) -> str:
    machine, cores = job["machine"], job["cores_per_round"]
    versions = ", ".join(f"{name} {number}" for name, number in job["versions"].items())
    trust = "" if job["trusted"] else " **(T) the machine gave less than its cores: times are not to be trusted.**"
    output = f" Output {job['facts']['output']}." if "output" in job["facts"] else ""
    absent = job["facts"].get("absent")
    if absent:
        output += f" Not on this machine: {', '.join(absent)}."
    if job.get("note"):
        output += f" {job['note']}"
    return (
        f"{job['date']}; {machine.get('processor')}, {machine.get('cores')} cores; effective cores in "
        f"{len(cores)} rounds {min(cores):.2f} to {max(cores):.2f}; {versions}.{output}{trust}"
    )


def _times(job: Mapping[str, Any]) -> list[str]:
    tools, ratios = job["tools"], job["wall_ratios"]
    bases = [name for name in tools if name.startswith(("floor", "orthority", "rio", "GDAL"))]
    scaled = any(t.get("efficiency") for t in tools.values())
    head = ["tool", "n", "wall s (min-max)", "Mpix/s", "CPU s", "peak MB", *(f"x {base}" for base in bases)]
    head += ["T1 / (2 T2)"] * scaled
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, t in tools.items():
        low, high = t["wall_range_s"]
        speed = f"{job['megapixels'] / t['wall_s']:.1f}" if job["megapixels"] else ""
        against = ["1" if base == name else f"{ratios[name][base]:.2f}" for base in bases]
        wall = f"{t['wall_s']:.2f} ({low:.2f}-{high:.2f})"
        cells = [name, str(t["runs"]), wall, speed, f"{t['cpu_s']:.2f}", f"{t['peak_mb']:.0f}", *against]
        cells += [f"{t['efficiency']:.2f}" if t.get("efficiency") else ""] * scaled
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _accuracy(found: Mapping[str, Mapping[str, Any]]) -> list[str]:
    grey = any("max_grey" in e for e in found.values())
    head = [
        "geometry",
        "held against",
        "pixels",
        "RMS px",
        "largest px",
        *(["mean grey", "largest grey"] if grey else []),
    ]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, e in found.items():
        cells = [name, e["treatment"], str(e["pixels"]), f"{e['rms_px']:.4f}", f"{e['max_px']:.4f}"]
        if grey:
            cells += [f"{e['mean_grey']:.4f}", str(e["max_grey"])]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _quality(found: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Any measures, as columns: a table for all rows in turn that have the same."""
    lines: list[str] = []
    heads: list[str] = []
    for name, e in found.items():
        if list(e) != heads:
            heads = list(e)
            titles = " | ".join(head.replace("_", " ") for head in heads)
            lines += [*([""] * bool(lines)), f"| quality | {titles} |", "|" + "---|" * (len(heads) + 1)]
        cells = [str(e[head]) if isinstance(e[head], int | str) else f"{e[head]:.4g}" for head in heads]
        lines.append("| " + " | ".join([name, *cells]) + " |")
    return lines


def _targets(targets: list[Mapping[str, Any]]) -> list[str]:
    lines = ["| wanted | | limit | measured | |", "|---|---|---|---|---|"]
    for t in targets:
        value = "" if t["value"] is None else f"{t['value']:.4g}"
        lines.append(f"| {t['what']} | {t['sense']} | {t['limit']:g} | {value} | {t['verdict']} |")
    return lines
