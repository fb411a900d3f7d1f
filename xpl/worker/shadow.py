"""Shadow mode: an adapter without its model, so that everything around the model runs anywhere.

`load` is skipped, and `predict` is a fixed function of what `encode` returned. Packing, batches, episode state and the
structure of actions are the adapter's own; the values of its actions are not.

The function is chosen so that mistakes show in what it answers:

- it answers one environment at a time, so that the others of a batch cannot matter;
- every number and every text counts, however small the change: a hash of them moves each value a little;
- it is smooth: averages over the parts of an array move the values a lot, so that an image that was compressed gives
  nearly the same actions, and one with red and blue exchanged does not;
- where the inputs hold NaN the answer does, as a model's would.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from xpl import _spec as spec
from xpl import checkpoint
from xpl.action import action_dim
from xpl.decoding import decode_rows
from xpl.policy import Observation, Policy
from xpl.wire.arrays import ArrayError, as_array, data_of
from xpl.worker.lacking import StandInError

if TYPE_CHECKING:
    from xpl.convert import Interface

_STEPS = 4  # of a chunk, where nothing declares how many
_PARTS = 12  # of an array that are averaged; a multiple of the channels that images have, 3 and 4
_DEPTH = 32
_SMOOTH, _HASH = 0.4, 1e-3  # shares of a value's range
_REACH = 0.2  # rad or m around the middle: a motion that a robot can follow
_TILT = 0.3  # of a quaternion's imaginary parts; the real one stays near 1


class ShadowError(StandInError):
    """The adapter asks for something that only its model has, so that shadow mode proves nothing about it."""

    kind = "shadow"


class UndividedError(ShadowError):
    """The adapter has no part that is the model's alone."""

    kind = "whole"


class NotLoadedError(ShadowError, AttributeError):
    """An attribute is not there, because `load`, which would set it, was skipped."""


def shadow_of(model_class: type) -> type[Policy]:
    """Return a class that is the adapter's, but for `load` and `predict`.

    Raises:
        UndividedError: if the adapter does not keep its model apart from what is around it.
    """
    if not issubclass(model_class, Policy):
        raise UndividedError(
            f"shadow mode needs an adapter that derives from xpl.Policy; {model_class.__name__} does not, and its "
            "model cannot be told from what is around it"
        )
    if model_class.predict is Policy.predict:
        raise UndividedError(f"shadow mode needs an adapter with predict; {model_class.__name__} lacks it")
    kind: Any = type(model_class)  # a metaclass of the adapter's, if it has one
    shadow: type[Policy] = kind(model_class.__name__, (_Shadow, model_class), {"__module__": model_class.__module__})
    return shadow


class _Shadow(Policy):
    """What stands before the adapter's class in the order of resolution."""

    def __init__(self, config: Mapping[str, Any]) -> None:
        manifest = config.get("manifest") or {}
        declared = manifest.get("shadow") or {}
        if not self._encodes and manifest.get("native") is None:
            name = type(self).__name__
            raise UndividedError(f"shadow mode needs an adapter with encode, or a block native; {name} has neither")
        self._shadow_weights: tuple[Any, np.ndarray] = ((), np.empty(0))
        super().__init__(config)
        width = action_dim(self.embodiment, self.action_type)
        steps = self.chunk if self.interface is None else self.interface.action.steps
        self._shadow_shape: tuple[int, int] = tuple(declared.get("shape") or (steps or _STEPS, width))
        self._shadow_converts = "shape" not in declared
        self._shadow_range = _ranges(self, self._shadow_shape[1], declared.get("range"))

    def load(self, config: Mapping[str, Any]) -> None:
        """Load nothing."""

    def encode(self, obs: Observation, env: int) -> Any:
        """Return what the adapter's `encode` does.

        Raises:
            ShadowError: if that is the observation itself: what is read of it shows in `predict` only.
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
                    f"encode passes on {name} as it came, so that only predict, which shadow mode replaces, knows what "
                    "the model is given: read the values in encode"
                )
        return inputs

    def predict(self, inputs: Any, envs: list[int]) -> Any:
        """Return a chunk for each environment, (H, D) float32, that depends on its inputs alone."""
        if isinstance(inputs, Mapping):  # a block native batches them by name
            inputs = [{name: values[row] for name, values in inputs.items()} for row in range(len(envs))]
        answers = [self._answer(value) for value in inputs]
        if self.interface is None or not self._shadow_converts:
            return answers
        return [self._in_native_words(self.interface, answer, env) for answer, env in zip(answers, envs)]

    def reset_env(self, env: int) -> None:
        """Let the adapter forget native state, as far as there is any."""
        with contextlib.suppress(NotLoadedError):  # what belongs to the model
            super().reset_env(env)

    def __getattr__(self, name: str) -> Any:
        """Say what is missing where an adapter's method asks for its model."""
        inherited: Callable[[str], Any] | None = getattr(super(), "__getattr__", None)
        if inherited is not None:
            return inherited(name)
        raise NotLoadedError(f"{type(self).__name__} has no {name!r}: shadow mode skips load, which may set it")

    @property
    def _encodes(self) -> bool:
        return super(_Shadow, type(self)).encode is not Policy.encode

    def _compiled(self, native: Mapping[str, Any] | None) -> Interface | None:
        """Compile a block native with plain values where it is open, or where statistics are not there."""
        if native is None:
            return None
        from xpl.convert.gaps import absent, filled

        lacking = absent(native, checkpoint.folders(self.config, self.policy_dir))
        return super()._compiled(filled(native, self.embodiment, self.action_type, lacking))

    def _in_native_words(self, interface: Interface, answer: np.ndarray, env: int) -> np.ndarray:
        """Return the chunk that a model would answer for these absolute actions (H, D) of the standard."""
        known = self._environments[env]
        steps = decode_rows(answer, self.embodiment, self.action_type)
        state = known.frames[-1].obs[spec.Obs.STATE]
        return interface.action.encode(steps, state, dict(known.commands.value or {}))

    def _answer(self, inputs: Any) -> np.ndarray:
        digest, layout, features = hashlib.sha256(), [], []
        for path, leaf in _leaves(inputs, "", 0):
            parts = _averages(leaf)
            digest.update(f"{path} {leaf.dtype.str} {leaf.shape} ".encode())
            digest.update(data_of(leaf))
            layout.append((path, len(parts)))
            features += parts
        if not features:
            raise ShadowError("encode returns nothing that a model could read")
        weights = self._weights(tuple(layout), len(features))
        noise = np.random.default_rng(int.from_bytes(digest.digest(), "little")).uniform(-1, 1, self._shadow_shape)
        smooth = np.tensordot(np.array(features), weights, 1) / np.sqrt(len(features))
        low, high = self._shadow_range
        shares: np.ndarray = 0.5 + _SMOOTH * np.tanh(smooth) + _HASH * noise
        chunk: np.ndarray = (low + (high - low) * shares).astype(np.float32)
        return chunk

    def _weights(self, layout: tuple[Any, ...], count: int) -> np.ndarray:
        """Return how much each feature moves each value, (count, H, D); the inputs of a model keep their layout."""
        if self._shadow_weights[0] != layout:
            seed = int.from_bytes(hashlib.sha256(repr(layout).encode()).digest(), "little")
            weights = np.random.default_rng(seed).standard_normal((count, *self._shadow_shape))
            self._shadow_weights = (layout, weights)
        return self._shadow_weights[1]


# -- what a model would see ------------------------------------------------------------------------------------------


def _leaves(value: Any, path: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield every array, number and text of a value with its place; numbers by value, whatever holds them."""
    if depth > _DEPTH:
        raise ShadowError(f"encode returns a value that is nested more than {_DEPTH} deep, or holds itself")
    items = _items(value)
    if items is not None:
        for key, item in items:
            yield from _leaves(item, f"{path}/{key}", depth + 1)
    elif value is None:
        yield path, np.zeros(1, np.uint8)
    elif isinstance(value, (str, bytes)):
        data = value.encode(errors="surrogatepass") if isinstance(value, str) else value
        yield path, np.frombuffer(hashlib.sha256(data).digest(), np.uint8)
    else:
        yield path, _canonical(_array(value))


def _items(value: Any) -> list[tuple[Any, Any]] | None:
    """Return what a container holds, in an order of its own; None for what is none, and for a list of numbers."""
    if isinstance(value, Mapping):
        return [(repr(key), value[key]) for key in sorted(value, key=repr)]
    if isinstance(value, AbstractSet):
        return list(enumerate(sorted(value, key=repr)))
    if isinstance(value, (list, tuple)):
        return None if _are_numbers(value) else list(enumerate(value))
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [(entry.name, getattr(value, entry.name)) for entry in dataclasses.fields(value)]
    return None


def _are_numbers(value: Sequence[Any]) -> bool:
    """Tell whether a list is as good as an array."""
    if not value or not isinstance(value[0], (bool, int, float, list, tuple)):
        return False
    try:
        return np.array(value).dtype.kind in "biuf"
    except ValueError:  # ragged
        return False


def _array(value: Any) -> np.ndarray:
    try:
        # Also what offers itself as an array: images, arrays of other libraries.
        return as_array(value if hasattr(value, "detach") and not isinstance(value, type) else np.asarray(value))
    except (ArrayError, OverflowError):
        kind = f"{type(value).__module__}.{type(value).__qualname__}"
        raise ShadowError(
            f"encode returns a {kind}: shadow mode reads arrays, tensors, numbers, text, maps and lists"
        ) from None


def _canonical(array: np.ndarray) -> np.ndarray:
    """Return the array in one of few types, so that equal numbers count equally."""
    if array.dtype.kind == "f":
        array = array.astype("<f4")
    elif array.dtype.kind in "bu" and array.dtype.itemsize == 1:
        array = array.view(np.uint8)
    elif array.dtype.kind in "iu":
        array = array.astype("<i8")
    elif array.dtype.kind == "c":
        array = np.stack([array.real, array.imag]).astype("<f4")
    else:
        return np.frombuffer(hashlib.sha256(data_of(array)).digest(), np.uint8)
    return np.ascontiguousarray(array)


def _averages(leaf: np.ndarray) -> list[float]:
    """Return averages over parts of an array: every twelfth value, for channels that lie together, and twelfths."""
    flat = leaf.reshape(-1)
    if not flat.size:
        return [0.0]
    if flat.size <= _PARTS:
        parts: Sequence[np.ndarray] = [flat[index : index + 1] for index in range(flat.size)]
    else:
        parts = [*(flat[first::_PARTS] for first in range(_PARTS)), *np.array_split(flat, _PARTS)]
    means = [float(part.mean(dtype=np.float64)) for part in parts]
    if leaf.dtype == np.uint8:
        return [mean / 128.0 - 1.0 for mean in means]
    return [float(np.arcsinh(mean)) if np.isfinite(mean) else np.nan for mean in means]


# -- what a model would answer -----------------------------------------------------------------------------------------


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


def _maps(value: Any, depth: int) -> Iterator[Mapping[Any, Any]]:
    if depth > _DEPTH:
        return
    if isinstance(value, Mapping):
        yield value
        for item in value.values():
            yield from _maps(item, depth + 1)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _maps(item, depth + 1)


def _is_copy(value: Mapping[Any, Any], given: Any) -> bool:
    """Tell whether a map is a map of the observation, or holds all that this one does."""
    if value is given:
        return True
    return isinstance(given, Mapping) and len(given) > 1 and all(value.get(key) is given[key] for key in given)
