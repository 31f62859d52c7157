"""When the images of a mosaic were taken, as a span of time that holds whatever is not known."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

EARLIEST = datetime(1826, 1, 1, tzinfo=UTC)
"""Before the first photograph."""
BEHIND, AHEAD = timedelta(hours=12), timedelta(hours=14)
"""How far clocks of the world are behind UTC and ahead of it at most."""


def time_span(acquired: Sequence[str], images: Sequence[Path]) -> tuple[datetime, datetime, str]:
    """First and last moment at which images can have been taken, and how that is known.

    The time of a file is none of acquisition. It only ends the span where an image does not say when it was taken:
    that was before its file was written.

    Parameters
    ----------
    acquired : sequence of str
        By image in ISO 8601, with or without zone; empty where not known.
    images : sequence of Path
        The files. SOURCE_DATE_EPOCH takes the place of their times.

    Returns
    -------
    first, last : datetime
        UTC.
    known : str
        "taken"; "taken, zone unknown", with the span of every zone; or "not known", from before the first photograph.
    """
    times = [datetime.fromisoformat(text) for text in acquired if text]
    first = [time if time.tzinfo else time.replace(tzinfo=UTC) - AHEAD for time in times]
    last = [time if time.tzinfo else time.replace(tzinfo=UTC) + BEHIND for time in times]
    if not times or len(times) < len(images):
        return min([EARLIEST, *first]).astimezone(UTC), max([_written(images), *last]).astimezone(UTC), "not known"
    known = "taken" if all(time.tzinfo for time in times) else "taken, zone unknown"
    return min(first).astimezone(UTC), max(last).astimezone(UTC), known


def _written(images: Sequence[Path]) -> datetime:
    """Time of the newest file, whole seconds."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return datetime.fromtimestamp(int(epoch) if epoch else max(int(image.stat().st_mtime) for image in images), UTC)
