"""Sheets read back from their PDF by PDFium: text with its place, paths, and what the viewport says of the map."""

from __future__ import annotations

import ctypes
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

MM = 25.4 / 72.0


@dataclass(frozen=True)
class Line:
    """A run of characters: text, their boxes (N, 4) in mm, and whether it stands upright."""

    text: str
    boxes: np.ndarray

    @property
    def box(self) -> np.ndarray:
        """Left, bottom, right, top in mm."""
        return np.concatenate([self.boxes[:, :2].min(axis=0), self.boxes[:, 2:].max(axis=0)])


class SheetPdf:
    """One page. Lengths are mm from the lower left corner of the trim."""

    def __init__(self, path: Path) -> None:
        import pypdfium2

        self.path, self.data = path, path.read_bytes()
        self._document = pypdfium2.PdfDocument(str(path))
        self._page = self._document[0]
        self.media = np.array(self._page.get_mediabox()) * MM
        self.trim = np.array(self._page.get_trimbox()) * MM
        self.bleed = np.array(self._page.get_bleedbox()) * MM
        self.texts = self._page.get_textpage()
        self.text = self.texts.get_text_range().replace("\u202f", " ")

    def _moved(self, box: np.ndarray) -> np.ndarray:
        return box - np.tile(self.trim[:2], 2)

    def characters(self) -> tuple[list[str], np.ndarray]:
        """Characters with ink, and their boxes (N, 4): of the glyphs, not of the lines."""
        found, boxes = [], []
        for index in range(self.texts.count_chars()):
            letter = self.texts.get_text_range(index, 1)
            if letter.strip():
                found.append(letter)
                boxes.append(self._moved(np.array(self.texts.get_charbox(index)) * MM))
        return found, np.array(boxes)

    def lines(self) -> list[Line]:
        """Texts as they were written: characters that follow each other closely."""
        letters, boxes = self.characters()
        found: list[Line] = []
        start = 0
        for k in range(1, len(letters) + 1):
            if k == len(letters) or _apart(boxes[k - 1], boxes[k]) > 1.6:
                found.append(Line("".join(letters[start:k]), boxes[start:k]))
                start = k
        return found

    def paths(self, sides: range = range(1, 1 << 30)) -> np.ndarray:
        """Boxes (N, 4) of the paths with so many points, as far as they are printed, widths of lines included."""
        import pypdfium2.raw as raw

        found = []
        for item in self._page.get_objects(max_depth=4):
            if item.type == raw.FPDF_PAGEOBJ_PATH and raw.FPDFPath_CountSegments(item.raw) in sides:
                box = [ctypes.c_float() for _ in range(4)]
                if raw.FPDFPageObj_GetBounds(item.raw, *box):
                    found.append(self._moved(np.array([v.value for v in box]) * MM))
        return np.array(found)

    def map_box(self) -> np.ndarray:
        """Left, bottom, right, top of the viewport, mm."""
        return self._moved(self._numbers(b"/BBox") * MM)

    def _numbers(self, key: bytes) -> np.ndarray:
        start = self.data.rindex(b" obj", 0, self.data.rindex(b"/Type /Viewport"))
        found = re.search(key + rb" \[ ([^\]]*)\]", self.data[start:])
        assert found, key
        return np.array([float(v) for v in found[1].split()])

    def viewport(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Box of the map (4,) in mm, its corners as parts of it (4, 2), and their longitude and latitude (4, 2)."""
        degrees = self._numbers(b"/GPTS").reshape(-1, 2)[:, ::-1]
        return self.map_box(), self._numbers(b"/LPTS").reshape(-1, 2), degrees

    def picture(self) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (rows, cols, 3) of the one picture, and its box in mm."""
        import pypdfium2.raw as raw

        (item,) = self._page.get_objects(filter=[raw.FPDF_PAGEOBJ_IMAGE])
        image = np.asarray(item.get_bitmap().to_pil().convert("RGB"))
        return image, self._moved(np.array(item.get_bounds()) * MM)

    def title(self) -> str:
        """Title of the document."""
        return str(self._document.get_metadata_dict()["Title"])

    def fonts_embedded(self) -> bool:
        """Whether every font that is described is in the file."""
        return self.data.count(b"/FontFile2") == self.data.count(b"/Type /FontDescriptor") > 0


def _apart(first: np.ndarray, second: np.ndarray) -> float:
    """Gap between two boxes, mm."""
    return float(np.maximum(np.maximum(first[:2], second[:2]) - np.minimum(first[2:], second[2:]), 0.0).max())


def overlaps(letters: list[str], boxes: np.ndarray, share: float = 0.08) -> list[str]:
    """Pairs of characters of different texts whose ink boxes have more than a share of the smaller one in common."""
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    found = []
    for k in range(len(boxes)):
        low = np.maximum(boxes[k, :2], boxes[k + 4 :, :2])
        high = np.minimum(boxes[k, 2:], boxes[k + 4 :, 2:])
        common = np.prod(np.clip(high - low, 0, None), axis=1)
        for other in np.flatnonzero(common > share * np.minimum(area[k], area[k + 4 :])) + k + 4:
            near = "".join(letters[max(0, k - 6) : k + 7])
            found.append(f"'{near}' and '{''.join(letters[max(0, other - 6) : other + 7])}' at {boxes[k].round(1)}")
    return found


def crossing(boxes: np.ndarray, frame: np.ndarray, hair: float = 0.05) -> np.ndarray:
    """Numbers of the boxes that lie across a side of a rectangle."""
    inside = (boxes[:, :2] >= frame[:2] - hair).all(axis=1) & (boxes[:, 2:] <= frame[2:] + hair).all(axis=1)
    outside = (boxes[:, :2] > frame[2:] - hair).any(axis=1) | (boxes[:, 2:] < frame[:2] + hair).any(axis=1)
    crossed: np.ndarray = np.flatnonzero(~inside & ~outside)
    return crossed
