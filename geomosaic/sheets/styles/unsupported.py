"""Unsupported parts of a foreign style, each told once."""

from __future__ import annotations

from collections.abc import Iterable


class Told:
    """A list of remarks."""

    def __init__(self) -> None:
        self.remarks: dict[str, None] = {}

    def say(self, what: str) -> None:
        """Remember something."""
        self.remarks[what] = None


def dashes(parts: Iterable[float], told: Told) -> tuple[float, ...]:
    """Lengths of stroke and gap; none of what is no such thing."""
    found = tuple(parts)
    if not any(found):  # a line without gaps
        return ()
    if all(part > 0 for part in found):
        return found
    told.say(f"dashes {', '.join(f'{part:g}' for part in found)}, drawn whole")
    return ()


def mixed(color: str, opacity: float) -> str:
    """A colour that is opaque, mixed with white: text has no opacity."""
    values = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    return "#" + "".join(f"{round(255 + opacity * (v - 255)):02x}" for v in values)
