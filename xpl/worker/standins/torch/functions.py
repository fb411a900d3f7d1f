"""Functions of torch, on tensors; what is given things gives a thing."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Sequence
from typing import Any, Callable

import numpy as np

from xpl.worker.standins.torch.arithmetic import raw
from xpl.worker.standins.torch.kinds import ALIASES, DTYPES, device, dtype
from xpl.worker.standins.torch.tensor import Tensor, _sizes

_FLOAT = DTYPES["float32"]
_RANDOM = {"generator": np.random.default_rng(0)}


def tensor(data: Any, dtype: dtype | None = None, device: Any = None, **_: Any) -> Tensor:
    """Return a copy of the data as a tensor; fractions are float32 unless an array says otherwise."""
    if isinstance(data, Tensor):
        return data.to(*([dtype] if dtype else []), *([device] if device else [])).clone()
    if isinstance(data, (list, tuple)):
        data = [raw(item) for item in data]
    array = np.array(data)
    if dtype is None and array.dtype == np.float64 and not isinstance(data, (np.ndarray, np.generic)):
        dtype = _FLOAT
    return Tensor(array, dtype, device)


def as_tensor(data: Any, dtype: dtype | None = None, device: Any = None) -> Tensor:
    """Return the data as a tensor."""
    if isinstance(data, np.ndarray) and dtype is None:
        return Tensor(data, None, device)
    return tensor(data, dtype, device)


def from_numpy(array: Any) -> Tensor:
    """Return a tensor of the same memory.

    Raises:
        TypeError: if it is no array of numbers that torch has.
        ValueError: if a stride is negative.
    """
    if not isinstance(array, np.ndarray):
        raise TypeError(f"expected np.ndarray (got {type(array).__name__})")
    if any(stride < 0 for stride in array.strides):
        raise ValueError(
            "At least one stride in the given numpy array is negative, and tensors with negative strides are not "
            "currently supported. (You can probably work around this by making a copy of your array  with "
            "array.copy().)"
        )
    return Tensor(array)


def _maker(function: Callable[[tuple[int, ...]], np.ndarray], *, is_noise: bool = False) -> Callable[..., Tensor]:
    def make(*shape: Any, dtype: Any = None, device: Any = None, size: Any = None, **_: Any) -> Tensor:
        return Tensor(
            function(_sizes((size,) if size is not None else shape)), dtype or _FLOAT, device, is_noise=is_noise
        )

    return make


def _normal(shape: tuple[int, ...]) -> np.ndarray:
    return _RANDOM["generator"].standard_normal(shape)


zeros = _maker(np.zeros)
ones = _maker(np.ones)
empty = _maker(np.zeros)
randn = _maker(_normal, is_noise=True)
rand = _maker(lambda shape: _RANDOM["generator"].uniform(size=shape), is_noise=True)


def _like(make: Callable[..., Tensor]) -> Callable[..., Tensor]:
    def made(other: Any, dtype: Any = None, device: Any = None, **_: Any) -> Tensor:
        return make(*other.shape, dtype=dtype or other.dtype, device=device or other.device)

    return made


zeros_like, ones_like, empty_like, randn_like, rand_like = map(_like, (zeros, ones, empty, randn, rand))


def full(shape: Any, value: Any, dtype: Any = None, device: Any = None, **_: Any) -> Tensor:
    """Return a tensor of one value."""
    array = np.full(_sizes((shape,)), value)
    return Tensor(array, dtype or (_FLOAT if array.dtype == np.float64 else None), device)


def full_like(other: Any, value: Any, **named: Any) -> Tensor:
    """Return a tensor of one value with the shape of another."""
    return full(other.shape, value, dtype=named.get("dtype") or other.dtype, device=other.device)


def arange(*limits: Any, dtype: Any = None, device: Any = None, **_: Any) -> Tensor:
    """Return equally spaced numbers."""
    array = np.arange(*limits)
    return Tensor(array, dtype or (_FLOAT if array.dtype == np.float64 else None), device)


def linspace(start: Any, end: Any, steps: int, dtype: Any = None, device: Any = None, **_: Any) -> Tensor:
    """Return equally spaced numbers."""
    return Tensor(np.linspace(start, end, steps), dtype or _FLOAT, device)


def eye(count: int, dtype: Any = None, device: Any = None, **_: Any) -> Tensor:
    """Return a unit matrix."""
    return Tensor(np.eye(count), dtype or _FLOAT, device)


def _joined(function: Callable[..., np.ndarray]) -> Callable[..., Any]:
    def join(tensors: Sequence[Any], dim: int = 0, **named: Any) -> Any:
        tensors = list(tensors)
        if any(not isinstance(item, Tensor) for item in tensors):
            found = next(item for item in tensors if not isinstance(item, Tensor))
            raise TypeError(f"expected Tensor as element 0 in argument 0, but got {type(found).__name__}")
        if not tensors:
            raise RuntimeError("expected a non-empty list of Tensors")
        try:
            return tensors[0].like(function([raw(item) for item in tensors], axis=named.get("axis", dim)))
        except ValueError as error:
            raise RuntimeError(str(error)) from None

    return join


stack, cat = _joined(np.stack), _joined(np.concatenate)


def where(condition: Any, first: Any = None, second: Any = None) -> Any:
    """Return elements of one or the other."""
    if first is None:
        return tuple(Tensor(found, DTYPES["int64"]) for found in np.where(raw(condition)))
    owner = first if isinstance(first, Tensor) else second if isinstance(second, Tensor) else condition
    return owner.like(np.where(raw(condition), raw(first), raw(second)).astype(owner.array.dtype))


def interpolate(input: Any, size: Any = None, scale_factor: Any = None, mode: str = "nearest", **_: Any) -> Any:
    """Return an image (B, C, H, W) in another size."""
    array = input.array
    if size is None:
        size = [int(length * scale_factor) for length in array.shape[2:]]
    height, width = _sizes((size,)) if not isinstance(size, int) else (size, size)

    def places(old: int, new: int) -> np.ndarray:
        return np.clip((np.arange(new) + 0.5) * old / new - 0.5, 0, old - 1)

    rows, columns = places(array.shape[2], height), places(array.shape[3], width)
    if mode in ("nearest", "nearest-exact"):
        return input.like(array[:, :, np.round(rows).astype(int)][:, :, :, np.round(columns).astype(int)])

    def blend(values: np.ndarray, where: np.ndarray, axis: int) -> Any:
        low = np.floor(where).astype(int)
        share = (where - low).reshape([-1 if place == axis else 1 for place in range(values.ndim)])
        high = np.minimum(low + 1, values.shape[axis] - 1)
        return values.take(low, axis) * (1 - share) + values.take(high, axis) * share

    return input.like(blend(blend(array.astype(np.float32), rows, 2), columns, 3).astype(np.float32), None)


def pad(input: Any, pad: Sequence[int], mode: str = "constant", value: Any = 0) -> Any:
    """Return a tensor with margins, the last axis first."""
    margins = [(0, 0)] * input.ndim
    for place in range(len(pad) // 2):
        margins[-1 - place] = (pad[2 * place], pad[2 * place + 1])
    if mode == "constant":
        return input.like(np.pad(input.array, margins, constant_values=value or 0))
    edges: Any = {"replicate": "edge", "circular": "wrap"}.get(mode, mode)
    return input.like(np.pad(input.array, margins, mode=edges))


def normalize(input: Any, p: float = 2.0, dim: int = 1, eps: float = 1e-12, **_: Any) -> Any:
    """Return a tensor whose rows have length 1."""
    return input / np.maximum(np.linalg.norm(input.array, p, dim, keepdims=True), eps)


class Guard(contextlib.ContextDecorator):
    """A context, a decorator, and a decorator with arguments, that changes nothing."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __new__(cls, *arguments: Any, **_: Any) -> Any:
        if len(arguments) == 1 and callable(arguments[0]) and not isinstance(arguments[0], (dtype, device)):
            return arguments[0]
        return super().__new__(cls)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        return None


class Generator:
    """A source of random numbers."""

    def __init__(self, device: Any = "cpu") -> None:
        self.device, self._seed = device, 0

    def manual_seed(self, seed: int) -> Generator:
        self._seed = int(seed)
        return self

    def seed(self) -> int:
        return self._seed

    initial_seed = seed


def manual_seed(seed: int) -> Generator:
    """Begin the random numbers anew."""
    _RANDOM["generator"] = np.random.default_rng(int(seed) % 2**32)
    return Generator().manual_seed(seed)


def _method(name: str) -> Callable[..., Any]:
    def function(first: Any, *others: Any, **named: Any) -> Any:
        named.pop("out", None)
        if "axis" in named:
            named["dim"] = named.pop("axis")
        if not isinstance(first, Tensor):
            first = tensor(first)
        return getattr(first, name)(*others, **named)

    return function


def of_things(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that gives a thing where it is given one without a value."""

    @functools.wraps(function)
    def either(*arguments: Any, **named: Any) -> Any:
        from xpl.worker.standins.given import Memory
        from xpl.worker.standins.origins import Origin, holds, value
        from xpl.worker.standins.things import Thing, called

        def settled(item: Any) -> Any:
            if isinstance(item, Thing):
                return value(item) if holds(item) else item
            if isinstance(item, (list, tuple)) and any(isinstance(part, Thing) for part in item):
                return type(item)([settled(part) for part in item])
            return item

        if any(
            isinstance(item, Thing) or (isinstance(item, (list, tuple)) and any(isinstance(p, Thing) for p in item))
            for item in arguments
        ):
            try:
                return function(*map(settled, arguments), **named)
            except Exception:  # noqa: BLE001 - shapes that only the real ones have
                return called(Thing(Origin(f"torch.{name}", Memory())), arguments, named)
        return function(*arguments, **named)

    return either


_PLAIN: dict[str, Any] = {
        **{
            name: _method(name)
            for name in (
                "abs exp log sin cos tan sqrt tanh floor ceil sign isnan isfinite isinf round sum mean prod any "
                "all max min std norm argmax clamp clip softmax sigmoid squeeze unsqueeze reshape permute "
                "transpose flatten cumsum split chunk unbind movedim swapaxes add sub mul div matmul pow eq ne lt "
                "le gt ge masked_fill numel is_floating_point repeat_interleave "
            ).split()
        },
        "tensor": tensor, "as_tensor": as_tensor, "asarray": as_tensor, "from_numpy": from_numpy, "stack": stack,
        "cat": cat, "concat": cat, "concatenate": cat, "where": where, "interpolate": interpolate, "pad": pad,
        "normalize": normalize, "zeros_like": zeros_like, "ones_like": ones_like, "full_like": full_like,
        "empty_like": empty_like, "randn_like": randn_like, "rand_like": rand_like,
        "bmm": _method("matmul"), "mm": _method("matmul"), "minimum": _method("min"), "maximum": _method("max"),
        "zeros": zeros, "ones": ones, "empty": empty, "randn": randn, "rand": rand, "full": full, "arange": arange,
        "linspace": linspace, "eye": eye,
}  # fmt: skip
FUNCTIONS: dict[str, Callable[..., Any]] = {name: of_things(name, function) for name, function in _PLAIN.items()}
KINDS = {**DTYPES, **{alias: DTYPES[name] for alias, name in ALIASES.items()}}
