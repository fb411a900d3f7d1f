"""Shadow mode: an adapter without its model, so that everything around the model runs anywhere.

`load` is skipped, and `predict` is a fixed function of the result of `encode` (`xpl.worker.shadow_answers`). Packing,
batches, episode state and the structure of actions are the adapter's own; the values of its actions are not. The
function answers each environment by itself, so the others of a batch have no effect.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl import _spec as spec
from xpl import checkpoint
from xpl.action import action_dim
from xpl.decoding import decode_rows
from xpl.manifest import Manifest
from xpl.policy import Policy
from xpl.worker.loading import load_model_class
from xpl.worker.missing_requirements import ShadowError
from xpl.worker.shadow_answers import ShadowAnswers

if TYPE_CHECKING:
    from xpl.contract import Config, Entry, Observation
    from xpl.convert import Interface

_STEPS = 4  # of a chunk whose length is not declared
_DEPTH = 32
_REACH = 0.2  # rad or m around the middle: a motion that a robot can follow
_SDK = re.compile(r"^\s*(?:from|import)\s+xpl\b", re.MULTILINE)
_TILT = 0.3  # of a quaternion's imaginary parts; the real one stays near 1


class NoShadowError(ShadowError):
    """The adapter does not separate its model from the code around it."""

    kind = "whole"


class NotLoadedError(ShadowError, AttributeError):
    """An attribute is missing because `load`, which would set it, was skipped."""


def load_shadow_class(policy_dir: Path, class_name: str) -> type[Policy]:
    """Return the shadow of the class in an adapter's model.py, which is imported.

    Raises:
        NoShadowError: the adapter does not separate its model from the code around it. For an adapter without the SDK
            it is raised before any import, so that a missing library does not hide it.
        LoadError: there is no model.py or no such class in it.
    """
    texts = [path.read_text(encoding="utf-8", errors="replace") for path in policy_dir.glob("*.py")]
    if texts and not any(map(_SDK.search, texts)):
        raise NoShadowError("an adapter that does not derive from xpl.Policy has no shadow")
    return shadow_of(load_model_class(policy_dir, class_name))


def shadow_of(model_class: type) -> type[Policy]:
    """Return a subclass of the adapter's class with other `load` and `predict`.

    Raises:
        NoShadowError: the adapter does not separate its model from the code around it.
    """
    if not issubclass(model_class, Policy):
        raise NoShadowError(
            f"shadow mode needs an adapter that derives from xpl.Policy; {model_class.__name__} does not, and its "
            "model cannot be separated from the code around it"
        )
    if model_class.predict is Policy.predict:
        raise NoShadowError(f"shadow mode needs an adapter with predict; {model_class.__name__} lacks it")
    kind: Any = type(model_class)  # a metaclass of the adapter's, if it has one
    shadow: type[Policy] = kind(model_class.__name__, (_Shadow, model_class), {"__module__": model_class.__module__})
    return shadow


class _Shadow(Policy):
    """Mixin that precedes the adapter's class in the method resolution order."""

    def __init__(self, config: Config) -> None:
        manifest = Manifest.parse(config.get("manifest"))
        declared = manifest.shadow
        if not self._encodes and manifest.model_io is None:
            name = type(self).__name__
            raise NoShadowError(f"shadow mode needs an adapter with encode, or a block model_io; {name} has neither")
        super().__init__(config)
        width = action_dim(self.embodiment, self.action_type)
        steps = self.chunk if self.interface is None else self.interface.action.steps
        shape = (steps or _STEPS, width)
        if declared.shape:
            shape = (declared.shape[0], declared.shape[1])
        self._shadow_converts = not declared.shape
        self._shadow_answers = ShadowAnswers(shape, *_ranges(self, shape[1], declared.range or None))

    def load(self, config: Config) -> None:
        """Load nothing."""

    def encode(self, obs: Observation, env: int) -> Any:
        """Return the result of the adapter's `encode`.

        Raises:
            ShadowError: the result has the observation itself, which only `predict` would read.
        """
        inputs = super().encode(obs, env)
        unread = {
            "the observation": obs,
            **{f"obs[{key!r}]": obs.get(key) for key in (spec.Obs.STATE, spec.Obs.VISION)},
        }
        for part in _maps(inputs, 0):
            name = next((name for name, given in unread.items() if _is_copy(part, given)), None)
            if name is not None:
                raise ShadowError(
                    f"encode returns {name} unchanged, so that only predict, which shadow mode replaces, reads the "
                    "model's inputs from it: read the values in encode"
                )
        return inputs

    def predict(self, inputs: Any, envs: list[int]) -> Any:
        """Return a chunk for each environment, (H, D) float32, that depends on its inputs alone."""
        if isinstance(inputs, Mapping):  # a block model_io batches them by name
            inputs = [{name: values[row] for name, values in inputs.items()} for row in range(len(envs))]
        answers = [self._shadow_answers.of(value) for value in inputs]
        if self.interface is None or not self._shadow_converts:
            return answers
        return [self._in_model_terms(self.interface, answer, env) for answer, env in zip(answers, envs)]

    def reset_env(self, env: int) -> None:
        """Call the adapter's `reset_env`, except for parts of the model."""
        with contextlib.suppress(NotLoadedError):  # parts of the model
            super().reset_env(env)

    def __getattr__(self, name: str) -> Any:
        """Raise a clear error if an adapter's method uses its model."""
        inherited: Callable[[str], Any] | None = getattr(super(), "__getattr__", None)
        if inherited is not None:
            return inherited(name)
        raise NotLoadedError(f"{type(self).__name__} has no {name!r}: shadow mode skips load, which may set it")

    @property
    def _encodes(self) -> bool:
        return super(_Shadow, type(self)).encode is not Policy.encode

    def _compile_interface(self, model_io: Entry | None) -> Interface | None:
        """Compile a block model_io with placeholders for unknown values and without missing statistics."""
        if model_io is None:
            return None
        from xpl.convert.gaps import fill_gaps, missing_files

        lacking = missing_files(model_io, checkpoint.folders(self.config, self.policy_dir))
        return super()._compile_interface(fill_gaps(model_io, self.embodiment, self.action_type, lacking))

    def _in_model_terms(self, interface: Interface, answer: np.ndarray, env: int) -> np.ndarray:
        """Return the model output of absolute actions (H, D) of the standard."""
        known = self._environments[env]
        steps = decode_rows(answer, self.embodiment, self.action_type)
        state = known.frames[-1].obs[spec.Obs.STATE]
        return interface.action.encode(steps, state, dict(known.commands.value or {}))


# -- ranges of the answers ---------------------------------------------------------------------------------------------


def _ranges(policy: Policy, width: int, declared: Sequence[float] | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest and the largest value of each column, (D,) each."""
    if declared is not None:
        return np.full(width, float(declared[0])), np.full(width, float(declared[1]))
    if width != action_dim(policy.embodiment, policy.action_type):
        return np.zeros(width), np.ones(width)
    joints = policy.action_type == spec.ACTION_TYPES[0]
    lows, highs = [], []
    for arm in policy.embodiment.arms:
        if joints:
            middle = np.zeros(arm.dof) if arm.home is None else arm.home
            low, high = middle - _REACH, middle + _REACH
            lows.append(low if arm.lower is None else np.maximum(low, arm.lower))
            highs.append(high if arm.upper is None else np.minimum(high, arm.upper))
        else:
            imaginary = spec.POSE_DIM - spec.POSITION_DIM - 1
            lows.append(np.array([-_REACH] * spec.POSITION_DIM + [1.0 - _REACH] + [-_TILT] * imaginary))
            highs.append(np.array([_REACH] * spec.POSITION_DIM + [1.0] + [_TILT] * imaginary))
        lows.append(np.full(arm.ee_dim, float(spec.GRIPPER_CLOSED)))
        highs.append(np.full(arm.ee_dim, float(spec.GRIPPER_OPEN)))
    return np.concatenate(lows), np.concatenate(highs)


def _maps(value: object, depth: int) -> Iterator[Mapping[Any, Any]]:
    if depth > _DEPTH:
        return
    if isinstance(value, Mapping):
        yield value
        for item in value.values():
            yield from _maps(item, depth + 1)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _maps(item, depth + 1)


def _is_copy(value: Mapping[Any, Any], given: object) -> bool:
    """Return whether a map is a map of the observation, or has all of its values."""
    if value is given:
        return True
    return isinstance(given, Mapping) and len(given) > 1 and all(value.get(key) is given[key] for key in given)
