"""What of a foreign style was not understood, each once."""

from __future__ import annotations


class Told:
    """A list of remarks."""

    def __init__(self) -> None:
        self.remarks: dict[str, None] = {}

    def say(self, what: str) -> None:
        """Remember something."""
        self.remarks[what] = None


def mixed(color: str, opacity: float) -> str:
    """A colour that is opaque, mixed with white: text has no opacity."""
    values = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    return "#" + "".join(f"{round(255 + opacity * (v - 255)):02x}" for v in values)
