"""Features of GeoPackages with the edits that these do not have yet, and the saving of edits through the journal."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from geomosaic.errors import GeomosaicError, InputError, OutputError
from geomosaic.raster.geopackage import (
    FeatureChange,
    FeatureConflict,
    FeatureTable,
    edit_features,
    next_ids,
    read_features,
    same_feature,
)
from geomosaic.studio.digitizing.journal import FeatureJournal, PendingEdit

# Features of a layer that the page shows.
MOST = 20_000
# Seconds until an edit that could not be saved is tried again.
_AGAIN = 2.0


class FeatureStore:
    """Layers of a project, edited one edit at a time.

    Attributes
    ----------
    waiting : tuple
        Number of each edit that waits, and why; read without a lock, while a file is being written too.
    """

    def __init__(self, journal: Path) -> None:
        self._journal = FeatureJournal(journal)
        self._lock = threading.RLock()
        self._reasons: dict[int, GeomosaicError] = {}
        self._timer: threading.Timer | None = None
        self.waiting: tuple[tuple[int, str | None], ...] = ()

    @property
    def sketches(self) -> dict[str, Any]:
        """What pages were drawing, by the page's own name."""
        return dict(self._journal.sketches)

    @property
    def pending(self) -> list[dict[str, Any]]:
        """Edits that are in the journal and not in their GeoPackage, and why: `conflict` where a choice is needed."""
        with self._lock:
            found = [(edit, self._reasons.get(edit.number)) for edit in self._journal.pending]
        return [
            {
                "number": edit.number, "title": edit.title, "file": edit.path.name, "layer": edit.layer,
                "why": None if error is None else error.what, "hint": None if error is None else error.hint,
                "conflict": isinstance(error, InputError),
            }
            for edit, error in found
        ]  # fmt: skip

    def sketch(self, page: str, drawn: dict[str, Any] | None) -> None:
        """Keep what a page is drawing."""
        with self._lock:
            self._journal.sketch(page, drawn)

    def table(self, path: Path, layer: str) -> FeatureTable:
        """Layer with the edits that wait."""
        with self._lock:
            table = read_features(path, layer, MOST)
            features = dict(table.features)
            for edit in self._journal.pending:
                for change in edit.changes if (edit.path, edit.layer) == (path, layer) else ():
                    if same_feature(features.get(change.id), change.before):
                        features.pop(change.id, None)
                        if change.after is not None:
                            features[change.id] = change.after
            return replace(table, features=features)

    def free_ids(self, path: Path, layer: str, count: int) -> list[int]:
        """Row numbers for new features."""
        with self._lock:
            waiting = [
                change.id
                for edit in self._journal.pending
                for change in edit.changes
                if (edit.path, edit.layer) == (path, layer)
            ]
            first = max([next_ids(path, layer, 1)[0], *(number + 1 for number in waiting)])
            return list(range(first, first + count))

    def save(self, title: str, path: Path, layer: str, changes: Sequence[FeatureChange]) -> None:
        """Save an edit: in the journal, and in the GeoPackage unless that cannot be written now.

        Raises
        ------
        FeatureConflict
            A feature is not as it was before.
        InputError
            The layer does not allow it.
        OutputError
            The journal cannot be written.
        """
        with self._lock:
            features = self.table(path, layer).features
            conflicting = [one.id for one in changes if not same_feature(features.get(one.id), one.before)]
            if conflicting:
                raise FeatureConflict(conflicting, f"{path.name}, layer {layer}")
            edit = self._journal.begin(title, path, layer, tuple(changes))
            self.flush()
            error = self._reasons.get(edit.number)
            if isinstance(error, InputError):
                self._forget(edit)
                self._note_waiting()
                raise error

    def flush(self) -> None:
        """Bring the edits that wait into their GeoPackages, in their order, as far as that goes."""
        with self._lock:
            blocked: set[Path] = set()
            for edit in list(self._journal.pending):
                if edit.path in blocked:
                    continue
                try:
                    self._write(edit)
                except GeomosaicError as error:
                    self._reasons[edit.number] = error
                    blocked.add(edit.path)
                else:
                    self._forget(edit)
            self._note_waiting()
            again = any(isinstance(self._reasons.get(edit.number), OutputError) for edit in self._journal.pending)
            if again and (
                self._timer is None or not self._timer.is_alive() or self._timer is threading.current_thread()
            ):
                self._timer = threading.Timer(_AGAIN, self.flush)
                self._timer.daemon = True
                self._timer.start()

    def settle(self, number: int, *, over: bool) -> None:
        """Settle an edit that contradicts what another program has saved.

        Parameters
        ----------
        number : int
        over : bool
            Save it over that; else it is dropped.
        """
        with self._lock:
            edit = next((one for one in self._journal.pending if one.number == number), None)
            if edit is None:
                raise InputError("this edit does not wait any more", hint="look at the layer")
            if over:
                now = read_features(edit.path, edit.layer, MOST).features
                self._journal.change(edit, tuple(replace(one, before=now.get(one.id)) for one in edit.changes))
            else:
                self._forget(edit)
            self.flush()

    def _write(self, edit: PendingEdit) -> None:
        try:
            edit_features(edit.path, edit.layer, edit.changes)
        except FeatureConflict as error:
            new = [one.id for one in edit.changes if one.before is None]
            if not set(error.ids) <= set(new):
                raise
            # Another program has taken the number of a new feature meanwhile: it gets another.
            free = dict(zip(error.ids, self.free_ids(edit.path, edit.layer, len(error.ids)), strict=True))
            changes = tuple(replace(one, id=free.get(one.id, one.id)) for one in edit.changes)
            self._write(self._journal.change(edit, changes))

    def _note_waiting(self) -> None:
        reasons = ((edit.number, self._reasons.get(edit.number)) for edit in self._journal.pending)
        self.waiting = tuple((number, error.what if error else None) for number, error in reasons)

    def _forget(self, edit: PendingEdit) -> None:
        self._reasons.pop(edit.number, None)
        self._journal.end(next(one for one in self._journal.pending if one.number == edit.number))


@dataclass(frozen=True, eq=False)
class FeatureEdit:
    """Edit of a layer in the history, see `geomosaic.studio.history.Edit`."""

    store: FeatureStore
    title: str
    path: Path
    layer: str
    changes: tuple[FeatureChange, ...]

    def apply(self) -> None:
        """Save the features after the edit."""
        self.store.save(self.title, self.path, self.layer, self.changes)

    def revert(self) -> None:
        """Save the features before it."""
        self.store.save(f"undo: {self.title}", self.path, self.layer, tuple(one.reverse for one in self.changes))
