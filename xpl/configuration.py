"""Configuration of an environment, checked against env.yml."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from xpl import _spec as spec
from xpl.embodiment import UnknownEmbodimentError, get_embodiment
from xpl.episode import Setup

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl.manifest import EnvManifest

_CHANGEABLE = ("task", spec.Obs.PRIVILEGED, "max_steps", "cameras", "setting")
"""Keys that a reset may change."""


@dataclass(frozen=True)
class EnvConfiguration:
    """The keys of a configuration, with their defaults (see `xpl.environment.EnvironmentBase`)."""

    task: str
    embodiment: str
    action_type: str
    num_envs: int = 1
    max_steps: int | None = None
    cameras: bool | Sequence[int] = True
    privileged: bool = False
    seed: int = 0
    setting: str | None = None

    @classmethod
    def read(cls, config: Config, manifest: EnvManifest) -> EnvConfiguration:
        """Read a configuration.

        Raises:
            ValueError: a key is unknown, or task or embodiment is missing.
        """
        values = _check_keys(config, [entry.name for entry in fields(cls)], "configuration key")
        values.setdefault(spec.Deploy.ACTION_TYPE, manifest.action_types[0])
        missing = [name for name in ("task", "embodiment") if not values.get(name)]
        if missing:
            offered = ", ".join(manifest.tasks)
            raise ValueError(f"the configuration lacks {' and '.join(missing)}; tasks are {offered}")
        return cls(**values)

    def with_options(self, options: Mapping[str, Any]) -> EnvConfiguration:
        """Return the configuration with the options of a reset.

        Raises:
            ValueError: an option is unknown.
        """
        return replace(self, **_check_keys(options, _CHANGEABLE, "reset option"))

    def setup(self, manifest: EnvManifest) -> Setup:
        """Return the checked setup of an environment.

        Raises:
            ValueError: env.yml does not offer it.
        """
        one_of("task", self.task, manifest.tasks)
        try:
            robot = get_embodiment(self.embodiment)
        except UnknownEmbodimentError as error:
            raise ValueError(str(error)) from None
        task = manifest.tasks[self.task]
        setting = manifest.settings[0] if self.setting is None else self.setting
        one_of("embodiment", robot.name, [get_embodiment(name).name for name in manifest.embodiments])
        one_of(spec.Deploy.ACTION_TYPE, self.action_type, manifest.action_types)
        one_of("setting", setting, manifest.settings)
        if task.arms and len(robot.arms) not in task.arms:
            counts = " or ".join(map(str, task.arms))
            raise ValueError(f"task {self.task} is for {counts} arms; {robot.name} has {len(robot.arms)}")
        reason = task.unsupported.get(robot.name)
        if reason is not None:
            raise ValueError(f"task {self.task} is not offered with {robot.name}: {reason}")
        if self.num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, got {self.num_envs}")
        if self.max_steps is not None and self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1 or None, got {self.max_steps}")
        return Setup(
            task=self.task,
            embodiment=robot,
            action_type=self.action_type,
            max_steps=self.max_steps or task.max_steps,
            cameras=_cameras(self.cameras),
            privileged=self.privileged,
            setting=setting,
            manifest=manifest,
        )


def one_of(what: str, value: Any, offered: Any) -> None:
    """Check that a value is one of those offered.

    Args:
        what: name of the value in the error.
        value: the value.
        offered: the valid values.

    Raises:
        ValueError: lists the valid values, and names the nearest.
    """
    if value not in offered:
        near = difflib.get_close_matches(str(value), [str(name) for name in offered], n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"unknown {what} {value!r}: this environment offers {', '.join(map(str, offered))}{hint}")


def _cameras(value: bool | Sequence[int]) -> bool | tuple[int, int]:  # noqa: FBT001 - a value of the configuration
    if isinstance(value, bool):
        return value
    if len(value) != 2 or min(value) < 1:
        raise ValueError(f"cameras must be true, false or [height, width] in pixels, got {value!r}")
    return int(value[0]), int(value[1])


def _check_keys(values: Mapping[str, Any], names: Sequence[str], what: str) -> dict[str, Any]:
    for key in values:
        one_of(what, key, names)
    return dict(values)
