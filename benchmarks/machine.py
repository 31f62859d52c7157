"""What the machine is worth at this moment."""

from __future__ import annotations

import hashlib
import os
import platform
import threading
import time
from pathlib import Path

ENOUGH = 1.8
"""Effective cores below which a round on two threads is not to be trusted."""

_best = 0.0


def _spin(seconds: float, out: list[float]) -> None:
    """Hash without the interpreter's lock for a while; rate in blocks a second."""
    block, done, started = bytes(1 << 18), 0, time.perf_counter()
    while time.perf_counter() - started < seconds:
        hashlib.sha256(block).digest()
        done += 1
    out.append(done / (time.perf_counter() - started))


def effective_cores(seconds: float = 0.3) -> float:
    """Rate of two threads together over the best rate that one has shown in this run."""
    global _best
    alone: list[float] = []
    _spin(seconds / 2, alone)
    both: list[float] = []
    threads = [threading.Thread(target=_spin, args=(seconds, both)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    _best = max(_best, alone[0], *both)
    return sum(both) / _best


def description() -> dict[str, object]:
    """Processor, cores, memory, system."""
    facts: dict[str, object] = {"system": platform.platform(), "cores": os.cpu_count()}
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        facts["processor"] = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        facts["memory_gb"] = round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1)
    except (OSError, StopIteration, ValueError):
        facts["processor"] = platform.processor()
    return facts
