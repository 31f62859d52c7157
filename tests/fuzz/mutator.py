"""Seeded mutations of files, and a child process of limited memory and time that reads them.

`python tests/fuzz/mutator.py COUNT KIND ...`, with `tests/rigs` on PYTHONPATH, reads COUNT mutations of each kind and
prints those whose outcome is neither a value nor an error that tells what to do; `--show KIND NUMBER FILE` writes one
of them to a file.
"""

from __future__ import annotations

import random
import re
import signal
import sys
import time
import traceback
from pathlib import Path
from types import FrameType

MEMORY = 3 << 30
"""Bytes of address space; NumPy, GDAL and their threads reserve half of it."""
LONGEST = 10.0
"""Seconds for one file, many times what the slowest takes."""

NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"", b"0", b"-1", b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e999", b"1e-320", b"400000", b"10000",
    b"2147483648", b"1e18", b"0x10", b"1,5", b"1_0", b"\xd9\xa3", b"9" * 400, b"1" * 5000, b"99999999999999999999",
)  # fmt: skip
VALUE = re.compile(NUMBER.pattern + rb"|\"[^\"\n]*\"|'[^'\n]*'|\b(?:true|false)\b")
VALUES = (b"[]", b"{}", b"[[1]]", b"[1, 2, 3, 4]", b"true", b'"x"', b'""', b"-5", b"1" * 400, b"{a = 1}", b'{"a": []}')
"""Of other types than what stands there, for JSON and TOML."""
PIECES = (
    b"", b"\0", b'"', b"'", b",", b";", b"\t", b"\n", b"\r", b"<", b">", b"&a;", b"{", b"}", b"[", b"]", b"=", b"#",
    b"null", b"true", b"\xff\xfe", b"\xc3\x28", b"\xed\xa0\x80", "é".encode(), b"x" * 140_000, b"[" * 3000,
    b"<a>" * 300, b'"' + b"x" * 140_000 + b'"', b"../../../etc/hostname", b"http://localhost:9/a",
)  # fmt: skip


def mutated(data: bytes, kind: str, number: int) -> bytes:
    """Bytes of a file with one to three mutations, which kind and number determine."""
    chance = random.Random(f"{kind} {number}")
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        data = chance.choice((_bits, _noise, _cut, _piece, _piece, _number, _number, _value, _value, _lines, _end))(
            data, chance
        )
    return data


def _span(data: bytes, chance: random.Random, most: int = 40) -> tuple[int, int]:
    start = chance.randrange(len(data) + 1)
    return start, min(start + chance.randrange(most), len(data))


def _bits(data: bytes, chance: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 8)) if data else 0):
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _noise(data: bytes, chance: random.Random) -> bytes:
    start, end = _span(data, chance)
    return data[:start] + chance.randbytes(end - start) + data[end:]


def _cut(data: bytes, chance: random.Random) -> bytes:
    start, end = _span(data, chance, 400)
    return data[:start] + data[end:]


def _piece(data: bytes, chance: random.Random) -> bytes:
    start, end = _span(data, chance)
    return data[:start] + chance.choice(PIECES) + data[end:]


def _number(data: bytes, chance: random.Random) -> bytes:
    places = list(NUMBER.finditer(data))
    if not places:
        return _noise(data, chance)
    place = chance.choice(places)
    return data[: place.start()] + chance.choice(NUMBERS) + data[place.end() :]


def _value(data: bytes, chance: random.Random) -> bytes:
    places = list(VALUE.finditer(data))
    if not places:
        return _noise(data, chance)
    place = chance.choice(places)
    return data[: place.start()] + chance.choice(VALUES) + data[place.end() :]


def _lines(data: bytes, chance: random.Random) -> bytes:
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    at = chance.randrange(len(lines))
    many = min(3000, 1_000_000 // len(lines[at]))  # a whole file may be one line
    return b"".join([*lines[:at], *lines[at : at + 1] * chance.choice((0, 2, many)), *lines[at + 1 :]])


def _end(data: bytes, chance: random.Random) -> bytes:
    return data[: chance.randrange(len(data) + 1)]


def _limit() -> None:
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _stop(number: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"more than {LONGEST:g} s")


def _place(error: BaseException) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(place.filename).name}:{place.lineno}"


def main(words: list[str]) -> int:
    """Command line of the module."""
    from readers import outcome, sound

    if words[0] == "--show":
        Path(words[3]).write_bytes(mutated(sound(words[1])[1], words[1], int(words[2])))
        return 0
    _limit()
    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, _stop)
    failed = 0
    for kind in words[1:]:
        data = sound(kind)[1]
        for number in range(int(words[0])):
            # Said before: a crash of a library leaves this line as the last.
            print(f"reads {kind}, mutation {number}", flush=True)
            start, fault = time.monotonic(), ""
            try:
                if hasattr(signal, "SIGALRM"):
                    signal.setitimer(signal.ITIMER_REAL, LONGEST)
                error = outcome(kind, mutated(data, kind, number))
                if error is not None and not (error.what and error.hint):
                    fault = f"no hint, {_place(error)}: {str(error)[:200]}"
                elif error is not None and len(str(error)) > 4000:
                    fault = f"a message of {len(str(error))} characters: {str(error)[:200]}"
            except Exception as error:
                fault = f"{type(error).__name__}, {_place(error)}: {str(error)[:200]}"
            finally:
                if hasattr(signal, "SIGALRM"):
                    signal.setitimer(signal.ITIMER_REAL, 0.0)
            if fault:
                failed += 1
                print(f"FAULT {kind}, mutation {number}, {time.monotonic() - start:.1f} s: {fault}", flush=True)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
