"""Kinds of adapters: what one is built on, which options fit it, and which Python it needs.

A kind is data of the template: an entry of `kinds.yml`, and a folder with the files in which it differs from others.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import robots
from xpl_cli.basics.content import room
from xpl_cli.basics.errors import UnknownNameError, UserError, one_of
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Entry

DEFAULT = "minimal"
"""The kind that is usual."""

TOOLS_OWN = "none"
"""Manager of packages that run in the Python of the tool."""

_CAMERA = re.compile(r"(?P<name>[a-z_]+)(:(?P<width>[1-9]\d{0,4})x(?P<height>[1-9]\d{0,4}))?")
_VERSION = re.compile(r"[<>=!~]{0,2}\s*3(\.\d+){0,2}(\s*,\s*[<>=!~]{1,2}\s*3(\.\d+){0,2})*")
_PATH, _UV = "path", "uv"


@dataclass(frozen=True)
class Needs:
    """What a kind needs of its Python.

    Attributes:
        requirements: packages.
        python: version, None for any.
        only_if_asked: whether the tool's own Python has them.
    """

    requirements: Sequence[str] = ()
    python: str | None = None
    only_if_asked: bool = False


@dataclass(frozen=True)
class Setting:
    """A line of deploy.yml."""

    value: object
    description: str


@dataclass(frozen=True)
class Kind:
    """One kind.

    Attributes:
        about: what the adapter is built on, in one line.
        refuses: option that does not fit to the reason.
        block: whether its conversions can be compiled from a model_io block.
        environment: of its own Python.
        evaluation_only: nothing is trained here.
        optional: inputs besides those that the author names.
        settings: lines of deploy.yml by key, over and above what the standard asks for.
    """

    about: str
    refuses: Mapping[str, str] = field(default_factory=dict)
    block: bool = False
    environment: Needs = Needs()
    evaluation_only: bool = False
    optional: tuple[str, ...] = ()
    settings: Mapping[str, Setting] = field(default_factory=dict)

    def python(self, given: str) -> dict[str, str | Sequence[str]]:
        """Return the environment of the manifest.

        Args:
            given: version or path of the policy's own Python; "" leaves it to the kind.
        """
        if _is_path(given):
            return {"manager": _PATH, "python": given}
        needs = self.environment
        if not given and (not needs.requirements or needs.only_if_asked):
            return {"manager": TOOLS_OWN}
        found: dict[str, str | Sequence[str]] = {"manager": _UV}
        if version := given or needs.python:
            found["python"] = version
        if needs.requirements:
            found["requirements"] = needs.requirements
        return found


@dataclass(frozen=True)
class Camera:
    """A camera that a policy reads, with the smallest image that will do, in pixels; None for any."""

    name: str
    width: int | None = None
    height: int | None = None


def kinds() -> dict[str, Kind]:
    """Return the kinds of adapters that there are."""
    path = room("templates") / "policy" / "kinds.yml"
    return {name: _parsed(told) for name, told in spec.read_yaml(path).items()}


def _parsed(told: Entry) -> Kind:
    lines = {key: Setting(**line) for key, line in told.get("settings", {}).items()}
    return Kind(**{**told, "environment": Needs(**told.get("environment", {})), "settings": lines})


def check_kind(kind: str) -> None:
    """Check that there is such a kind.

    Raises:
        UnknownNameError: with the nearest one.
    """
    one_of("--kind", kind, kinds())


def check_fits(kind: str, option: str) -> None:
    """Check that an option fits a kind.

    Raises:
        UserError: with the reason, and the kinds that take the option.
    """
    known = kinds()
    reason = known[kind].refuses.get(option)
    if reason is not None:
        takes = ", ".join(name for name, other in known.items() if option not in other.refuses)
        raise UserError(f"--{option} does not fit --kind {kind}: {reason}", hint=f"kinds that take --{option}: {takes}")


def camera(text: str) -> Camera:
    """Return a camera from its text: `cam_head`, or `cam_head:640x480`.

    Raises:
        UserError: if it is neither.
    """
    found = _CAMERA.fullmatch(text)
    if found is None:
        raise UserError(f"--cameras takes names such as cam_head, or cam_head:640x480 (width x height); got {text!r}")
    if found["width"] is None:
        return Camera(found["name"])
    return Camera(found["name"], int(found["width"]), int(found["height"]))


def check_cameras(texts: Sequence[str], embodiment: str) -> None:
    """Check that a robot has these cameras, each named once.

    Raises:
        UserError: with the cameras that it has.
    """
    arms = len(robots.entries()[embodiment]["arms"])
    offered = _cameras()
    known = [*offered["by_arms"][arms], *offered["optional"]]
    names = [camera(text).name for text in texts]
    for name in names:
        if name not in known:
            count = f"{arms} arm{'s' if arms > 1 else ''}"
            told = f"--cameras: {embodiment} has {count}, so that its cameras are {', '.join(known)}; got {name!r}"
            raise UnknownNameError(told, name, known)
    if len(set(names)) != len(names):
        raise UserError(f"--cameras names a camera twice: {', '.join(names)}")


def check_ensembling(decay: float | None, chunk: int) -> None:
    """Check a decay of temporal ensembling, and that there is something to average.

    Raises:
        UserError: if it is negative or no number, or no two chunks overlap.
    """
    if decay is None:
        return
    if not 0 <= decay < math.inf:
        raise UserError(f"--ensembling takes a decay of 0 or more, such as ACT's 0.01; got {decay}")
    if chunk == 1:
        raise UserError("--ensembling averages chunks that overlap, and chunks of one step do not", hint="--chunk 16")


def inputs(kind: Kind, texts: Sequence[str], embodiment: str, action_type: str) -> dict[str, list[str]]:
    """Return what an adapter reads and ignores before its author has changed it: `required`, `optional`, `unused`."""
    states = spec.data("conventions")["action"]["types"][action_type]
    arms = len(robots.entries()[embodiment]["arms"])
    read = [f"{sdk.Obs.VISION}.{camera(text).name}" for text in texts]
    usual = [sdk.Obs.INSTRUCTION, *(f"{sdk.Obs.VISION}.{name}" for name in _cameras()["by_arms"][arms])]
    return {
        "required": [*(f"{sdk.Obs.STATE}.{key}" for key in states), *read],
        "optional": list(kind.optional),
        "unused": [name for name in usual if name not in (*read, *kind.optional)],
    }


def check_python(python: str) -> None:
    """Check that an answer is a version of Python, or the path of an interpreter.

    Raises:
        UserError: if it is neither.
    """
    if python and not _is_path(python) and not _VERSION.fullmatch(python):
        raise UserError(
            f"--python takes a version such as 3.10, or the path of an interpreter; got {python!r}",
            hint=f"a path has a slash: ./{python}",
        )


def _cameras() -> dict[str, Any]:
    cameras: dict[str, Any] = spec.data("conventions")["cameras"]
    return cameras


def _is_path(python: str) -> bool:
    return "/" in python or python.startswith("~")
