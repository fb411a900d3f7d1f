"""Mapping files: which column of a dataset is which part of the standard, and under which conventions.

A mapping has a `model_io` block, whose `input` is the name of a column or camera, and keys that only datasets need: the
columns of the action, and by how many steps they lag. Source: spec/mappings/, spec/v1/mapping.schema.json.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl import _spec as sdk
from xpl.convert.actions import ActionOutput
from xpl.convert.gaps import refuse_gaps
from xpl.convert.images import ImageInput
from xpl.convert.vectors import ModelVector
from xpl.embodiment import UnknownEmbodimentError, get_embodiment
from xpl.errors import ConversionError
from xpl_cli.basics import files
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from xpl.embodiment import Embodiment

_SCHEMA: Final = "mapping"
_MOST: Final = 1 << 20
_PLAIN_STEPS: Final = ("mirror", "rotate")


@dataclass(frozen=True)
class DatasetMapping:
    """A mapping, compiled for its robot.

    Attributes:
        name: of the file.
        embodiment: the robot.
        rate_hz: steps per second; None where the mapping does not give it.
        images: the conversion of each camera, by the dataset's camera name.
        states: the parts of each state column, by the dataset's column name.
        action: the parts of the action.
        columns: columns of the action, concatenated in this order.
        shift: steps by which the action's columns lag.
    """

    name: str
    embodiment: Embodiment
    rate_hz: float | None
    images: Mapping[str, ImageInput]
    states: Mapping[str, ModelVector]
    action: ActionOutput
    columns: tuple[str, ...]
    shift: int


def names() -> list[str]:
    """Return the names of the bundled mappings."""
    return sorted(path.stem for path in _folder().glob("*.yml"))


def digest(name: str) -> str:
    """Return the SHA-256 of a mapping's content."""
    return hashlib.sha256(json.dumps(_read(_path(name), name), sort_keys=True).encode()).hexdigest()


def load(name: str) -> DatasetMapping:
    """Load a bundled mapping by its name, or a mapping file by its path.

    Raises:
        DataError: the mapping does not exist, or is invalid; the message says where.
    """
    path = _path(name)
    entry = _read(path, name)
    where = path.name
    try:
        embodiment = get_embodiment(entry["robot"])
        refuse_gaps(entry["model_io"])
        model_io = entry["model_io"]
        images = {one["input"]: ImageInput(one) for one in model_io.get("images", ())}
        states = {
            one["input"]: ModelVector(one, embodiment, [path.parent], f"state {one['input']}")
            for one in model_io.get("state", ())
        }
        action = ActionOutput(model_io["action"], embodiment, entry[sdk.Deploy.ACTION_TYPE], [path.parent])
    except (ConversionError, UnknownEmbodimentError) as error:
        raise DataError(f"{where}: {error}", code=ExitCode.USAGE) from None
    for one in model_io.get("images", ()):
        wrong = [kind for step in one.get("steps", ()) for kind in step if kind not in _PLAIN_STEPS]
        if wrong or len(one["cameras"]) != 1 or one["layout"] != "hwc" or one["dtype"] != "uint8":
            raise DataError(
                f"{where}: the camera {one['input']} maps to one camera in hwc and uint8, only mirrored or rotated",
                code=ExitCode.USAGE,
            )
    action_entry = entry["action"]
    rate = entry.get("rate_hz")
    return DatasetMapping(
        where,
        embodiment,
        rate,
        images,
        states,
        action,
        tuple(map(str, action_entry["columns"])),
        int(action_entry.get("shift", 0)),
    )


def _read(path: Path, name: str) -> dict[str, Any]:
    from xpl_cli.standard.validate import validate_yaml

    try:
        content = files.read_regular(path, _MOST)
    except FileNotFoundError:
        raise DataError(
            f"there is no mapping {name!r}: bundled are {', '.join(names())}; the path of a file works too",
            code=ExitCode.NOT_FOUND,
        ) from None
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}") from None
    document, problems = validate_yaml(content, str(path), _SCHEMA)
    if problems:
        raise DataError(str(problems[0]), hint=f"`xpl spec show {_SCHEMA}` has the keys", code=ExitCode.USAGE)
    mapping: dict[str, Any] = document
    return mapping


def _path(name: str) -> Path:
    return _folder() / f"{name}.yml" if name in names() else Path(name)


def _folder() -> Path:
    return content_folder("spec") / "mappings"
