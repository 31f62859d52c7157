"""History of edits: files saved whole, and one undo and redo for all of them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

from geomosaic.errors import InputError
from geomosaic.whole_files import read_text, write_atomic

# Edits that can be undone.
_LONGEST = 500
_NOTHING_TO_UNDO = "there is nothing to undo", "edits before the studio was started stay"
_NOTHING_TO_REDO = "there is nothing to do again", "an edit ends what was taken back before it"


class Edit(Protocol):
    """Change of files that can be made, taken back and made again, each whole or not at all."""

    @property
    def title(self) -> str:
        """What is done, in words: 'point 12 measured'."""
        ...

    def apply(self) -> None:
        """Make the change; an InputError where a file is not as it was before it."""

    def revert(self) -> None:
        """Take it back; an InputError where a file is not as it was after it."""


@dataclass(frozen=True)
class TextEdit:
    """Texts before and after one edit.

    Attributes
    ----------
    title : str
        What was done, in words: 'point 12 measured'.
    before, after : dict
        Text by path; None where there is no file.
    """

    title: str
    before: Mapping[Path, str | None]
    after: Mapping[Path, str | None]

    def apply(self) -> None:
        """Write the texts after."""
        _replace(self.before, self.after)

    def revert(self) -> None:
        """Write the texts before."""
        _replace(self.after, self.before)


class History:
    """Edits in their order, each saved whole or not at all.

    Nothing is written over what another program has saved meanwhile.
    """

    def __init__(self) -> None:
        self._done: list[Edit] = []
        self._undone: list[Edit] = []
        # Whoever reads a file, changes what it says and saves it holds this, so that no edit is lost between.
        self.lock = threading.RLock()

    def save(self, title: str, before: Mapping[Path, str | None], after: Mapping[Path, str | None]) -> None:
        """Save an edit of texts.

        Parameters
        ----------
        title : str
            What was done, in words.
        before : mapping
            Text of each file as it was read for the edit; None where there was none.
        after : mapping
            Its new text; None removes it.

        Raises
        ------
        InputError
            Another program has changed a file since it was read.
        OutputError
            The disk is full, or the folder cannot be written: then the files are as they were.
        """
        self.make(TextEdit(title, dict(before), dict(after)))

    def make(self, edit: Edit) -> None:
        """Make an edit; what was taken back before it is forgotten.

        Raises
        ------
        InputError, OutputError
            As the edit does; then it is not made.
        """
        with self.lock:
            edit.apply()
            self._done.append(edit)
            del self._done[:-_LONGEST]
            self._undone.clear()

    def undo(self) -> str:
        """Take the last edit back.

        Returns
        -------
        str
            Its title.

        Raises
        ------
        InputError
            There is none, or another program has changed a file since.
        """
        return self._move(self._done, self._undone, lambda edit: edit.revert(), _NOTHING_TO_UNDO)

    def redo(self) -> str:
        """Make the edit again that was taken back last.

        Returns
        -------
        str
            Its title.

        Raises
        ------
        InputError
            There is none, or another program has changed a file since.
        """
        return self._move(self._undone, self._done, lambda edit: edit.apply(), _NOTHING_TO_REDO)

    def _move(
        self, source: list[Edit], target: list[Edit], change: Callable[[Edit], None], nothing: tuple[str, str]
    ) -> str:
        """Make a change by the last edit of one stack, which goes to the other."""
        with self.lock:
            if not source:
                raise InputError(nothing[0], hint=nothing[1])
            change(source[-1])
            target.append(source.pop())
            return target[-1].title

    @property
    def titles(self) -> dict[str, str | None]:
        """Titles of the edits that `undo` and `redo` are about."""
        with self.lock:
            return {
                "undo": self._done[-1].title if self._done else None,
                "redo": self._undone[-1].title if self._undone else None,
            }


def text_of(path: Path) -> str | None:
    """Text of a file, None where there is none.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        It cannot be read.
    """
    return read_text(path, "file") if path.exists() else None


def _replace(before: Mapping[Path, str | None], after: Mapping[Path, str | None]) -> None:
    """Write texts in place of others, all or none."""
    for path, text in before.items():
        _check(path, text)
    written: list[Path] = []
    try:
        for path, text in after.items():
            _write(path, text, partial(_check, path, before.get(path)))
            written.append(path)
    except BaseException:
        for path in written:
            _write(path, before.get(path))
        raise


def _check(path: Path, text: str | None) -> None:
    """Check that a file has a text, or is not there."""
    if text_of(path) != text:
        raise InputError(
            "another program has changed this file meanwhile: nothing was saved",
            where=path.name,
            hint="look at what it says now, and repeat the edit",
        )


def _write(path: Path, text: str | None, check: Callable[[], None] = lambda: None) -> None:
    """Write a text, or remove the file, after a last check."""
    if text is None:
        check()
        path.unlink(missing_ok=True)
    else:
        write_atomic(path, text, check=check)
