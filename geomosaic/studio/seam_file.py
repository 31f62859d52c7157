"""File of seams that the page edits: the drawn shares of a project, or those of its mosaic until there are any."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import shapely
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.jobs.manifest import Layout
from geomosaic.mosaicking.seams.cutlines import IMAGE, LAYER
from geomosaic.mosaicking.seams.partition import canonical
from geomosaic.project.load import Project
from geomosaic.raster.attributes import Field
from geomosaic.raster.geopackage import (
    Feature,
    FeatureChange,
    FeatureTable,
    edit_features,
    feature_layers,
    read_features,
)
from geomosaic.raster.info import inspect
from geomosaic.raster.vector import Layer, read_layer, write_layers
from geomosaic.studio.history import TextEdit, text_of
from geomosaic.studio.toml_edit import with_value
from geomosaic.whole_files import MOST_ROWS, relative_path

# Of a pixel, as in `seam_polygons`: far below what pixels can show.
_STEP = 1e-6
# Share of the covered area by which drawn shares may differ from those of the mosaic and still stand for all of them.
_SAME = 1e-6
_NAMES = tuple(f"seams{number}.gpkg" for number in ("", *(f"-{n}" for n in range(2, 100))))


@dataclass(frozen=True)
class SeamFile:
    """Shares of all images as they are saved, and where an edit goes.

    Attributes
    ----------
    project : Project
    crs : CRS
        Of the mosaic.
    step : float
        Map units, of which vertices are multiples.
    pixel : float
        Size of a pixel in map units.
    names : tuple of str
        Of the images, in the order of the mosaic's labels.
    outlines : tuple of geometry
        Footprints.
    shares : tuple of geometry
        Canonical; empty for images that show nothing.
    path : Path
        GeoPackage that edits go to.
    drawn : FeatureTable, optional
        Its rows; None while the seams are the mosaic's own, and the first edit makes the file.
    layer : str
        Its layer.
    """

    project: Project
    crs: CRS
    step: float
    pixel: float
    names: tuple[str, ...]
    outlines: tuple[Any, ...]
    shares: tuple[Any, ...]
    path: Path
    drawn: FeatureTable | None
    layer: str = LAYER

    @classmethod
    def of(cls, project: Project) -> SeamFile:
        """File of a project whose mosaic has seams.

        Raises
        ------
        InputError
            There is no mosaic, or it has no seams.
        """
        layout, options = Layout(project), project.options
        if options.merge.rule is not None:
            raise InputError(
                f"the mosaic is made by the rule '{options.merge.rule}' and has no seams",
                where="[mosaic] rule",
                hint="take the rule out of the project file",
            )
        if not layout.mosaic.is_file() or not layout.vectors.is_file():
            raise InputError("there is no mosaic yet", hint="run the step 'mosaic' under Steps")
        footprints, made = read_layer(layout.vectors, "footprints"), read_layer(layout.vectors, LAYER)
        names = tuple(map(str, footprints[IMAGE]))
        strange = [name for name in names if name not in {path.name for path in project.images}]
        if strange:
            raise InputError(
                f"the mosaic has the image '{strange[0]}', and the project has not",
                hint="run the step 'mosaic' under Steps",
            )
        info = inspect(layout.mosaic)
        assert info.crs is not None
        pixel = abs(info.transform.a) if info.transform is not None else 1.0
        step = _STEP * pixel
        found = cls(
            project, horizontal(info.crs), step, pixel, names, tuple(footprints.geometry),
            _by_image(names, made[IMAGE], made.geometry, step), _free_name(project.folder), None,
        )  # fmt: skip
        return found._drawn() or found

    @property
    def excluded(self) -> frozenset[str]:
        """Images that are to show nothing."""
        return frozenset(self.project.options.seamlines.exclude)

    def number(self, name: object) -> int:
        """Number of an image that may get ground.

        Raises
        ------
        InputError
            No image of the mosaic, or one that the project excludes.
        """
        if name not in self.names:
            raise InputError("the mosaic has no such image", where=str(name)[:80], hint="choose one of the list")
        if name in self.excluded:
            raise InputError(
                f"the project excludes '{name}'", where="[mosaic] exclude", hint="take it out of that list first"
            )
        return self.names.index(str(name))

    def _drawn(self) -> SeamFile | None:
        """The same with the shares that were drawn; None where these are not all, or lie in a file of another kind."""
        path = self.project.options.seamlines.cutlines
        if path is None or path.suffix.lower() != ".gpkg" or not path.is_file():
            return None
        layers = feature_layers(path)
        layer = LAYER if LAYER in layers or len(layers) != 1 else layers[0]
        table = read_features(path, layer, MOST_ROWS)
        rows = table.features.values()
        whole = all(row.geometry is not None and row.values.get(IMAGE) in self.names for row in rows)
        if not whole or table.crs is None or horizontal(table.crs) != self.crs:
            return None
        shares = _by_image(self.names, [row.values[IMAGE] for row in rows], [row.geometry for row in rows], self.step)
        everything = shapely.union_all(list(self.shares))
        left = everything.difference(shapely.union_all(list(shares)))
        if left.area > _SAME * everything.area:
            return None
        return replace(self, shares=shares, path=path, drawn=table, layer=layer)

    def edit(self, title: str, after: Sequence[Any]) -> SeamEdit:
        """Edit that makes other shares of these.

        Parameters
        ----------
        title : str
            What is done, in words.
        after : sequence of geometry
            Shares of all images.
        """
        changed = [i for i, (one, other) in enumerate(zip(self.shares, after, strict=True)) if one is not other]
        if self.drawn is not None:
            return SeamEdit(title, self.path, self.layer, tuple(self._changes(self.drawn, changed, after)))
        shown = [i for i, share in enumerate(self.shares) if not share.is_empty]
        shapes = [_many(self.shares[i]) for i in shown]
        labels, images = [i + 1 for i in shown], [self.names[i] for i in shown]
        made = Layer(self.crs, "MultiPolygon", shapes, {"label": labels, IMAGE: images})
        fields = Field("label", "integer"), Field(IMAGE, "text")
        rows = {
            row: Feature(shape, {"label": label, IMAGE: image})
            for row, (shape, label, image) in enumerate(zip(shapes, labels, images, strict=True), start=1)
        }
        table = FeatureTable("MULTIPOLYGON", False, self.crs, fields, rows)
        text = text_of(self.project.path) or ""
        named = with_value(text, ("mosaic",), "cutlines", relative_path(self.path, self.project.folder))
        own = TextEdit(title, {self.project.path: text}, {self.project.path: named})
        return SeamEdit(title, self.path, LAYER, tuple(self._changes(table, changed, after)), made, own)

    def _changes(self, table: FeatureTable, changed: Sequence[int], after: Sequence[Any]) -> list[FeatureChange]:
        """Changes of rows: the first row of an image gets its whole share, further ones go."""
        found, following = [], max(table.features, default=0) + 1
        for i in changed:
            rows = [(key, row) for key, row in table.features.items() if row.values.get(IMAGE) == self.names[i]]
            parts = _rows_of(after[i], table.kind)
            values = rows[0][1].values if rows else self._values(table, i)
            for k in range(max(len(rows), len(parts))):
                key, before = rows[k] if k < len(rows) else (following, None)
                following += before is None
                own = values if before is None else before.values
                found.append(FeatureChange(key, before, Feature(parts[k], own) if k < len(parts) else None))
        return found

    def _values(self, table: FeatureTable, number: int) -> dict[str, Any]:
        """Attributes of the first row of an image."""
        known: dict[str, Any] = {"label": number + 1, IMAGE: self.names[number]}
        return {field.name: known.get(field.name) for field in table.fields}


@dataclass(frozen=True)
class SeamEdit:
    """Edit of shares in a GeoPackage; the first one makes the file, and names it in the project.

    Attributes
    ----------
    title : str
    path : Path
    layer : str
    changes : tuple of FeatureChange
    made : Layer, optional
        Rows of the file before the changes, where it is made.
    named : TextEdit, optional
        Of the project file, where the file is made.
    """

    title: str
    path: Path
    layer: str
    changes: tuple[FeatureChange, ...]
    made: Layer | None = None
    named: TextEdit | None = None

    def apply(self) -> None:
        """Make the changes."""
        if self.made is None or self.named is None:
            edit_features(self.path, self.layer, self.changes)
            return
        write_layers(self.path, {self.layer: self.made})
        try:
            edit_features(self.path, self.layer, self.changes)
            self.named.apply()
        except BaseException:
            self.path.unlink(missing_ok=True)
            raise

    def revert(self) -> None:
        """Take the changes back."""
        back = [change.reverse for change in self.changes]
        if self.named is None:
            edit_features(self.path, self.layer, back)
            return
        self.named.revert()
        try:
            edit_features(self.path, self.layer, back)
        except BaseException:
            self.named.apply()
            raise
        self.path.unlink(missing_ok=True)


def _by_image(names: Sequence[str], images: Sequence[Any], shapes: Sequence[Any], step: float) -> tuple[Any, ...]:
    """Canonical share of each image; rows of one image are joined."""
    own: dict[str, list[Any]] = {}
    for image, shape in zip(images, shapes, strict=True):
        own.setdefault(str(image), []).append(shapely.force_2d(shape))
    return tuple(canonical(shapely.union_all(own[name]), step) if name in own else shapely.Polygon() for name in names)


def _many(share: Any) -> Any:
    return shapely.MultiPolygon([share]) if share.geom_type == "Polygon" else share


def _rows_of(share: Any, kind: str) -> list[Any]:
    """Share as the geometries of its rows: parts alone in a layer of single polygons."""
    if share.is_empty:
        return []
    return list(shapely.get_parts(share)) if kind == "POLYGON" else [_many(share)]


def _free_name(folder: Path) -> Path:
    return next((folder / name for name in _NAMES if not (folder / name).exists()), folder / _NAMES[0])
