"""Project files as read: checked, with their images; all errors are told at once, each with its line."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from geomosaic.errors import InputError, did_you_mean, listed, warn
from geomosaic.inputs.declarations import Block, leave_out
from geomosaic.inputs.summary import known_capabilities
from geomosaic.options.adjustment import AdjustmentOptions
from geomosaic.options.check import NAMES
from geomosaic.options.declaration import Declared, compose, declared, paths_of
from geomosaic.options.inputs import Area, QualityLimits
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.naming import keys_in_errors
from geomosaic.options.tie_points import TiePointOptions
from geomosaic.project.schema import ProjectFile
from geomosaic.stores.addresses import is_address
from geomosaic.stores.path import joined, split_pattern, to_path
from geomosaic.types import PathLike
from geomosaic.whole_files import read_text, read_toml

LARGEST = 16 << 20


@dataclass(frozen=True)
class Project:
    """Project file with its images, and the folder its relative paths start from.

    Attributes
    ----------
    path : Path
        Absolute.
    settings : ProjectFile
    images : tuple of Path
        The files the patterns match, in the order of the patterns, then of their names; those of [project] come first.
    groups : tuple of tuple of Path
        The images of each table [[images]].
    set_aside : tuple of Path
        Images that the project names and sets aside; they are not among `images` and `groups`.
    """

    path: Path
    settings: ProjectFile
    images: tuple[Path, ...]
    groups: tuple[tuple[Path, ...], ...] = ()
    set_aside: tuple[Path, ...] = ()

    @property
    def folder(self) -> Path:
        """Folder that relative paths start from."""
        return self.path.parent

    @property
    def name(self) -> str:
        """Name that outputs carry."""
        return self.settings.project.name

    @property
    def output(self) -> Path:
        """Folder of the outputs."""
        return joined(self.folder, self.settings.output.folder)

    @property
    def state(self) -> Path:
        """Folder of the manifest, the lock and the facts of the steps."""
        return self.folder / ".geomosaic" / self.path.stem

    def file(self, path: str | None) -> Path | None:
        """Path of the project file, resolved from its folder."""
        return None if path is None else joined(self.folder, path)

    def files(self, paths: Sequence[str]) -> tuple[Path, ...]:
        """Paths of the project file, resolved from its folder."""
        return tuple(joined(self.folder, path) for path in paths)

    @cached_property
    def options(self) -> MosaicOptions:
        """Options of the mosaic.

        Raises
        ------
        InputError
            An option would do nothing beside the others.
        """
        # Outputs of a project are its own to replace.
        values = {"overwrite": True, **self._values(MosaicOptions)}
        # The report shows the quality of seams; a mosaic by a rule has none.
        values.setdefault("seam_quality", None if values.get("rule") else True)
        return compose(MosaicOptions, values)

    @cached_property
    def area(self) -> Area:
        """Extent and pixel size of the mosaic."""
        return compose(Area, self._values(Area))

    @cached_property
    def quality(self) -> QualityLimits:
        """Limits that the mosaic is held against."""
        return compose(QualityLimits, self._values(QualityLimits))

    @cached_property
    def adjustment(self) -> AdjustmentOptions | None:
        """Options of the block adjustment; None where the project has none."""
        if self.settings.adjust is None and self.settings.match is None:
            return None
        options = compose(AdjustmentOptions, self._values(AdjustmentOptions))
        return options if self.matching is None else replace(options, ties=self.output / "tie_points.csv")

    @cached_property
    def matching(self) -> TiePointOptions | None:
        """Options of tie point matching; None where the project has none."""
        if self.settings.match is None:
            return None
        return compose(TiePointOptions, {**self._values(TiePointOptions), "cache": self.state / "match"})

    @property
    def found_control(self) -> tuple[Path, ...]:
        """Table of the control points that are found in a reference; empty where none are looked for."""
        looked_for = self.matching is not None and self.matching.reference is not None
        return (self.output / "reference_control.csv",) if looked_for else ()

    @property
    def controlled_blocks(self) -> tuple[Block, ...]:
        """Blocks with the control points that were found for them."""
        return tuple(replace(part, control=file) for part in self.blocks for file in self.found_control) or self.blocks

    @property
    def measurements(self) -> tuple[Path, ...]:
        """Files that the block adjustment reads besides those of its images; none without one."""
        # Most projects have none, and need no reader of other programs' files.
        if self.adjustment is None:
            return ()
        from geomosaic.interchange.formats import files_read

        return (*(file for path in paths_of(self.adjustment) for file in files_read(path)), *self.found_control)

    @property
    def roles(self) -> dict[str, Path]:
        """Files that the project names besides its images, by section and key."""
        found = {}
        for kind in (Block, TiePointOptions, AdjustmentOptions, MosaicOptions, QualityLimits):
            values = self._values(kind)
            for one in declared(kind):
                value = values.get(one.name)
                for path in value if isinstance(value, tuple) else (value,):
                    if isinstance(path, Path) or (one.option.files and isinstance(path, str)):
                        found[f"[{one.option.section}] {one.key}"] = to_path(path)
        return found

    @property
    def inputs(self) -> Block:
        """First block that the project describes; the only one unless images have sensors of their own."""
        return self.blocks[0]

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Blocks that the project describes: that of [sensor], then those of images with sensors of their own.

        Raises
        ------
        InputError
            An image stands in two tables.
        """
        tables = tuple(pair for pair in zip(self.settings.images, self.groups, strict=True) if pair[1])
        members = [image for _, images in tables for image in images]
        for image in members:
            if members.count(image) > 1:
                raise InputError(f"'{image.name}' stands in two tables", where="[[images]]", hint="leave it in one")
        apart = {image for table, images in tables if table.sensor is not None for image in images}
        rest = tuple(image for image in self.images if image not in apart)
        found = [self._block_apart(table, images) for table, images in tables if table.sensor is not None]
        if not rest:
            return _with_common_ground(found)
        own = {
            image.name: {**table.options, **({"camera": table.camera} if table.camera else {})}
            for table, images in tables
            if table.sensor is None
            for image in images
        }
        given = {"images": rest, "base": self.folder, "options": self.settings.sensor.options, "image_options": own}
        every = (compose(Block, {**given, **self._values(Block)}), *found)
        return _with_common_ground(every) if found else every

    def _block_apart(self, table: Any, images: tuple[Path, ...]) -> Block:
        """Block of images with a sensor of their own: of the rest they share ground, frame and [project] alone."""
        common, own = self.settings.model_dump(), table.model_dump(exclude_unset=True)
        # What [project] declares of its own images is not true of others.
        for name in ("declared_bands", "acquired", "cloud_cover", "clouds", "cloud_values"):
            common["project"].pop(name, None)
        # Bands of these images by number, or by name, take the place of those of the project by the other.
        for mine, other in (("bands", "band_names"), ("band_names", "bands")):
            if mine in own:
                common["project"].pop(other, None)
        frame = {key: common["exterior"].get(key) for key in ("crs", "heights")}
        sections = {
            "sensor": {**own, "name": table.sensor},
            "exterior": {**frame, **(own.get("exterior") or {})},
            "control": own.get("control"),
            "dem": common["dem"],
            "project": {**common["project"], **own},
        }
        given = {"images": images, "base": self.folder, "options": table.options}
        return compose(Block, {**given, **self._values(Block, sections)})

    def _values(self, kind: type[Any], sections: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Values of declared options, from their sections and keys; files are resolved."""
        sections = self.settings.model_dump() if sections is None else sections
        found = {one.name: (sections.get(one.option.section or "") or {}).get(one.key) for one in declared(kind)}
        return {one.name: self._resolved(one, found[one.name]) for one in declared(kind) if found[one.name] is not None}

    def _resolved(self, one: Declared, value: Any) -> Any:
        """Value of an option from what the file says."""
        if one.kind is Path:
            # A number may stand in place of a file.
            read = value if one.option.parse is None else one.option.parse(value)
            return self.file(str(read)) if isinstance(read, str | Path) else read
        if one.option.files and value.lower().endswith(one.option.files):
            return str(self.file(value))
        if one.kind == tuple[Path, ...]:
            return self.files(value)
        if one.kind == Mapping[str, str]:
            return {name: str(text) for name, text in value.items()}
        return value


def _with_common_ground(parts: Sequence[Block]) -> tuple[Block, ...]:
    """Blocks of which those whose own sensors use no heights leave the ground to the others."""
    planar = [known_capabilities(part.sensor).planar for part in parts]
    none: dict[str, Any] = {"dem": None, "height": None, "dem_from_tie_points": False, "dem_heights": None}
    return tuple(
        replace(part, **none) if flat and not all(planar) else part for part, flat in zip(parts, planar, strict=True)
    )


def load_project(path: PathLike) -> Project:
    """Project of a project file, checked, with its images.

    Parameters
    ----------
    path : path
        TOML file.

    Raises
    ------
    InputError
        Lists everything that is wrong, with lines; or an image or a pattern matches no file, or images lie where the
        outputs go.
    """
    file = Path(path).resolve()
    # The text too: errors name keys, whose lines are found in it.
    text = read_text(path, "project file", LARGEST)
    values = read_toml(path, "project file", LARGEST)
    if "format" not in values:
        raise InputError(
            "this is no project file: it has no 'format'", where=str(path), hint="write format = 1 on its first line"
        )
    try:
        settings = ProjectFile.model_validate(values)
    except ValidationError as error:
        raise _all_errors(error, str(path), text) from None
    project = Project(file, settings, ())
    written = {(project.output / part).resolve() for part in ("", "orthos", "georeferenced")}
    roles = project.roles
    others = {*written, *(role.resolve() for role in roles.values())}
    images = _find_images(file.parent, settings.project.images, f"{path}, [project] images", others)
    tables = (_find_images(file.parent, table.path, f"{path}, [[images]] path", others) for table in settings.images)
    groups = tuple(leave_out(each, roles) for each in tables)  # of what was listed; patterns have left them out
    every = tuple(dict.fromkeys((*leave_out(images, roles), *(image for group in groups for image in group))))
    if not every:
        raise InputError("no image is named", where=f"{path}, [project] images", hint="give paths or patterns")
    aside = _set_aside(settings.project.set_aside, every, str(path))
    every, *rest = (tuple(image for image in each if image not in aside) for each in (every, *groups))
    if not every:
        what = "every image is set aside"
        raise InputError(what, where=f"{path}, [project] set_aside", hint="take one back")
    if groups and settings.planar is not None:
        what = "[planar] places all photos together, and [[images]] sets some of them apart"
        raise InputError(what, where=str(path), hint="leave one of them out")
    solid = "adjust" if settings.adjust is not None else "match" if settings.match is not None else None
    if solid is not None and settings.planar is not None:
        what = f"[planar] places the photos in the plane, and [{solid}] orients them in space"
        raise InputError(what, where=str(path), hint="leave one of them out")
    if solid is None and getattr(settings.dem, "from_tie_points", False):
        what = "the ground is to be made of adjusted tie points, and nothing is adjusted"
        hint = "add a section [match], or [adjust] with `ties`; or give a DEM"
        raise InputError(what, where=f"{path}, [dem] from_tie_points", hint=hint)
    if settings.match is not None and getattr(settings.adjust, "ties", None) is not None:
        what = "[match] measures tie points in the images, and [adjust] names a table of them"
        raise InputError(what, where=f"{path}, [adjust] ties", hint="leave out `ties`, or the section [match]")
    project = replace(project, images=every, groups=tuple(rest), set_aside=aside)
    with keys_in_errors(str(path)):
        # Contradictions of options are told now, not in the middle of a run.
        _ = project.blocks, project.area, project.options, project.quality
    with keys_in_errors(str(path), "adjust"):
        _ = project.adjustment
    with keys_in_errors(str(path), "match"):
        _ = project.matching
    mixed = next((image for image in project.images if image.parent.resolve() in written), None)
    if mixed is not None:
        raise InputError(
            f"the output folder holds an image, {mixed.name}: what is written would mix with what is read",
            where=f"{path}, [output] folder",
            hint="give a folder of its own",
        )
    return project


def _set_aside(names: Sequence[str], images: Sequence[Path], path: str) -> tuple[Path, ...]:
    """Images of some names, in the order of the images."""
    known = [image.name for image in images]
    for name in names:
        if name not in known:
            hint = did_you_mean(name, known) or "give the names of image files, without folders"
            raise InputError(f"no image is called '{name}'", where=f"{path}, [project] set_aside", hint=hint)
    return tuple(image for image in images if image.name in names)


def is_pattern(name: str) -> bool:
    """Whether a name stands for all files that match it.

    Parameters
    ----------
    name : str
    """
    return any(mark in name for mark in "*?[")


def _find_images(folder: Path, patterns: list[str], where: str, others: Collection[Path] = ()) -> tuple[Path, ...]:
    """Image files that names and patterns stand for, each once; no pattern takes hidden files, or `others`."""
    found: dict[Path, None] = {}
    for pattern in patterns:
        if is_pattern(pattern):
            root, rest = _split_pattern(folder, pattern)
            try:
                matches = sorted(match for match in root.glob(rest) if match.is_file() and match.name[0] != ".")
            except (ValueError, NotImplementedError) as error:
                hint = "write a path with * and ?, and ** alone between slashes"
                raise InputError(f"'{pattern}' is no pattern of paths ({error})", where=where, hint=hint) from None
            if not matches:
                raise InputError(f"'{pattern}' matches no file in {root}", where=where, hint="check the pattern")
            matches = _images_among(pattern, matches, others)
        else:
            matches = [joined(folder, pattern)]
            if not matches[0].is_file():
                near = [entry.name for entry in matches[0].parent.glob("*")] if matches[0].parent.is_dir() else []
                hint = did_you_mean(matches[0].name, near)
                raise InputError(f"image '{pattern}' does not exist", where=where, hint=hint or "check the path")
        for match in matches:
            # GDAL, PROJ and every file that names an image take UTF-8 only.
            shown = str(match).encode(errors="backslashreplace").decode()
            if shown != str(match):
                raise InputError(
                    f"the name of image '{shown}' has bytes that are not UTF-8", where=where, hint="rename it"
                )
        found.update(dict.fromkeys(matches))
    return tuple(found)


def _split_pattern(folder: Path, pattern: str) -> tuple[Path, str]:
    """Folder that a pattern counts from, and the rest of it."""
    if is_address(pattern):
        return split_pattern(to_path(pattern))
    base = Path(pattern)
    return (Path(base.anchor), str(base.relative_to(base.anchor))) if base.is_absolute() else (folder, pattern)


def _images_among(pattern: str, matches: list[Path], others: Collection[Path]) -> list[Path]:
    """Matches of a pattern that are rasters without another role; all of them where there are none."""
    from geomosaic.raster.info import rasters_among

    free = [match for match in matches if not {match.resolve(), match.parent.resolve()} & set(others)]
    rasters, unknown = rasters_among(free)
    # Outputs come and go, and naming them at every run would be no news; a DEM or reference may be taken for a photo.
    known = [match.name for match in matches if match.resolve() in others]
    if rasters and known:
        text = (
            f"'{pattern}' matches {listed(known, 3)}, which the project names for another use: left out of the images"
        )
        warn(text)
    if rasters and unknown:
        names = listed((file.name for file in unknown), 3)
        text = f"'{pattern}' matches {names}, which cannot be read as a raster: left out of the images"
        warn(text)
    return rasters or matches


def _all_errors(error: ValidationError, path: str, text: str) -> InputError:
    """Error that lists all that pydantic found, with lines."""
    lines = []
    for item in error.errors(include_url=False):
        place = [str(part) for part in item["loc"]]
        problem = _problem(item, place)
        if item["type"] == "missing" and (misspelt := _misspelt(place, item["input"])):
            problem, place = f"unknown key; did you mean '{place[-1]}'?", [*place[:-1], misspelt]
        at = _line(text, place)
        lines.append(f"{f'line {at}: ' if at else ''}{_shown(place)}: {problem}")
    lines = [*dict.fromkeys(lines)]
    if len(lines) == 1:
        return InputError(lines[0], where=path, hint="correct it in the project file")
    return InputError(
        f"{len(lines)} errors\n    " + "\n    ".join(lines), where=path, hint="correct them in the project file"
    )


def _shown(place: list[str]) -> str:
    """Section and key of an error; of several tables of one name, such as [[images]], the line tells which."""
    if len(place) < 2:
        return place[0] if place else "file"
    if place[1].isdigit():
        return f"[[{place[0]}]] {'.'.join(place[2:])}".strip()
    return f"[{place[0]}] {'.'.join(place[1:])}"


def _misspelt(place: list[str], table: Any) -> str | None:
    """Key of a table that was probably meant to be the one that is missing."""
    unknown = [key for key in table if key not in _keys(place[:-1])] if isinstance(table, Mapping) else []
    return next((key for key in unknown if did_you_mean(key, [place[-1]])), None)


# First words of pydantic's names of errors about a type.
_TYPES: Mapping[str, type] = {"string": str, "float": float, "int": int, "bool": bool}
# Pydantic's names of errors about what holds several values.
_SHAPES: Mapping[str, str] = {
    "model_type": "a table", "model_attributes_type": "a table", "dict_type": "a table", "list_type": "a list",
}  # fmt: skip


def _problem(item: Mapping[str, Any], place: list[str]) -> str:
    """Problem of one key, worded as for options everywhere."""
    kind, shown = item["type"], item.get("input")
    if kind == "extra_forbidden":
        hint = did_you_mean(place[-1], _keys(place[:-1]))
        return f"unknown key; {hint}" if hint else "unknown key"
    if kind == "missing":
        return "is missing"
    if kind.partition("_")[0] in _TYPES and isinstance(shown, str | int | float):
        name = NAMES[_TYPES[kind.partition("_")[0]]]
        return f"'{str(shown)[:60]}' is not {name}: give {name}"
    if kind in _SHAPES:
        return f"is not {_SHAPES[kind]}: give {_SHAPES[kind]}"
    message = str(item["msg"]).removeprefix("Value error, ")
    plain = isinstance(shown, str | int | float) and kind != "value_error"
    return f"{message[:1].lower()}{message[1:]}" + (f" (it is {shown!r})"[:80] if plain else "")


def _keys(place: list[str]) -> list[str]:
    """Keys of a section."""
    model: Any = ProjectFile
    for part in place:
        field = model.model_fields.get(part)
        if field is None:
            return []
        kinds = [kind for kind in (field.annotation, *getattr(field.annotation, "__args__", ())) if _is_model(kind)]
        if not kinds:
            return []
        model = kinds[0]
    return list(model.model_fields)


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _line(text: str, place: list[str]) -> int | None:
    """Line of a key, or of its section, found in the text as written."""
    section: str | None = None
    section_line: int | None = None
    before = 0
    if len(place) > 1 and place[1].isdigit():  # of several tables of one name, after so many
        before, place = int(place[1]), [place[0], *place[2:]]
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[+\s*([\w.\-\"]+)\s*\]+", line)
        if header:
            section = header[1].strip('"')
            if place and section == place[0]:
                before -= 1
                if before < 0 and section_line is None:
                    section_line = number
            continue
        key = re.match(r"\s*(\"?)([\w\-]+)\1\s*[.=]", line)
        if not key:
            continue
        if (section is None and place[:1] == [key[2]]) or (
            len(place) > 1 and section == place[0] and section_line is not None and key[2] == place[1]
        ):
            return number
    return section_line
