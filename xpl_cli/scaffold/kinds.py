"""Kinds of adapters: the framework that one is built on, the options that fit, and the Python that it needs.

A kind is part of the template: an entry of `kinds.yml`, and a folder with its own files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import robots
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import UnknownNameError, UserError, one_of
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Sequence

    from xpl.contract import Entry

DEFAULT = "minimal"
"""The default kind."""

TOOLS_OWN = "none"
"""Environment manager of packages that run in the Python of xpl."""

_CAMERA = re.compile(r"(?P<name>[a-z_]+)(:(?P<width>[1-9]\d{0,4})x(?P<height>[1-9]\d{0,4}))?")
_VERSION = re.compile(r"[<>=!~]{0,2}\s*3(\.\d+){0,2}(\s*,\s*[<>=!~]{1,2}\s*3(\.\d+){0,2})*")
_PATH, _UV = "path", "uv"


@dataclass(frozen=True)
class PythonRequirements:
    """Requirements of a kind on its Python environment.

    Attributes:
        requirements: packages.
        python: version, None for any.
        only_if_asked: whether xpl's own Python satisfies them.
    """

    requirements: Sequence[str] = ()
    python: str | None = None
    only_if_asked: bool = False


@dataclass(frozen=True)
class DeploySetting:
    """A line of deploy.yml."""

    value: object
    description: str


@dataclass(frozen=True)
class AdapterKind:
    """One kind.

    Attributes:
        about: what the adapter is built on, in one line.
        refuses: options that do not fit, with the reason.
        block: whether its conversions can be compiled from a model_io block.
        environment: of its own Python.
        evaluation_only: whether it has no training scripts.
        optional: inputs besides those that the author names.
        settings: further lines of deploy.yml, by key.
    """

    about: str
    refuses: Mapping[str, str] = field(default_factory=dict)
    block: bool = False
    environment: PythonRequirements = PythonRequirements()
    evaluation_only: bool = False
    optional: tuple[str, ...] = ()
    settings: Mapping[str, DeploySetting] = field(default_factory=dict)

    def python(self, requested: str) -> dict[str, str | Sequence[str]]:
        """Return the manifest's `environment`.

        Args:
            requested: version or path of the policy's own Python; "" for the kind's default.
        """
        if _is_path(requested):
            return {"manager": _PATH, "python": requested}
        needs = self.environment
        if not requested and (not needs.requirements or needs.only_if_asked):
            return {"manager": TOOLS_OWN}
        environment: dict[str, str | Sequence[str]] = {"manager": _UV}
        if version := requested or needs.python:
            environment["python"] = version
        if needs.requirements:
            environment["requirements"] = needs.requirements
        return environment


@dataclass(frozen=True)
class CameraOption:
    """A camera that a policy reads, with its least image size in pixels; None for any size."""

    name: str
    width: int | None = None
    height: int | None = None


def kinds() -> dict[str, AdapterKind]:
    """Return the kinds of adapters by name."""
    path = content_folder("templates") / "policy" / "kinds.yml"
    return {name: _parse_kind(entry) for name, entry in spec.read_yaml(path).items()}


def _parse_kind(entry: Entry) -> AdapterKind:
    lines = {key: DeploySetting(**line) for key, line in entry.get("settings", {}).items()}
    return AdapterKind(
        **{**entry, "environment": PythonRequirements(**entry.get("environment", {})), "settings": lines}
    )


def check_kind(kind: str) -> None:
    """Check that a kind exists.

    Raises:
        UnknownNameError: with the nearest name.
    """
    one_of("--kind", kind, kinds())


def check_fits(kind: str, option: str) -> None:
    """Check that an option fits a kind.

    Raises:
        UserError: with the reason, and the kinds that take the option.
    """
    all_kinds = kinds()
    reason = all_kinds[kind].refuses.get(option)
    if reason is not None:
        takes = ", ".join(name for name, other in all_kinds.items() if option not in other.refuses)
        raise UserError(f"--{option} does not fit --kind {kind}: {reason}", hint=f"kinds that take --{option}: {takes}")


def camera(text: str) -> CameraOption:
    """Parse a camera: `cam_head`, or `cam_head:640x480`.

    Raises:
        UserError: the text is neither.
    """
    match = _CAMERA.fullmatch(text)
    if match is None:
        raise UserError(f"--cameras takes names such as cam_head, or cam_head:640x480 (width x height); got {text!r}")
    if match["width"] is None:
        return CameraOption(match["name"])
    return CameraOption(match["name"], int(match["width"]), int(match["height"]))


def check_cameras(texts: Sequence[str], embodiment: str) -> None:
    """Check that a robot has these cameras, each named once.

    Raises:
        UserError: with the cameras that it has.
    """
    arms = len(robots.entries()[embodiment]["arms"])
    offered = _cameras()
    allowed = [*offered["by_arms"][arms], *offered["optional"]]
    names = [camera(text).name for text in texts]
    for name in names:
        if name not in allowed:
            count = f"{arms} arm{'s' if arms > 1 else ''}"
            message = f"--cameras: {embodiment} has {count}, and the cameras {', '.join(allowed)}; got {name!r}"
            raise UnknownNameError(message, name, allowed)
    if len(set(names)) != len(names):
        raise UserError(f"--cameras names a camera twice: {', '.join(names)}")


def check_ensembling(decay: float | None, chunk: int) -> None:
    """Check the decay of temporal ensembling, and that chunks overlap.

    Raises:
        UserError: the decay is negative or not finite, or chunks have one action.
    """
    if decay is None:
        return
    if not 0 <= decay < math.inf:
        raise UserError(f"--ensembling takes a decay of 0 or more, such as ACT's 0.01; got {decay}")
    if chunk == 1:
        raise UserError(
            "--ensembling averages overlapping chunks; chunks of one action do not overlap", hint="--chunk 16"
        )


def inputs(kind: AdapterKind, texts: Sequence[str], embodiment: str, action_type: str) -> dict[str, list[str]]:
    """Return the scaffold's `inputs`: `required`, `optional`, `unused`."""
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
    """Check that an answer is a Python version, or the path of an interpreter.

    Raises:
        UserError: the answer is neither.
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
