"""Tensors on numpy: shapes, types, arithmetic and elements as torch has them."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from xpl.worker.standins.torch import arithmetic, kinds
from xpl.worker.standins.torch.arithmetic import raw
from xpl.worker.standins.torch.kinds import DTYPES, Size, device, dtype

_CPU = device("cpu")


class Extreme(NamedTuple):
    """What `max` and `min` of one axis give."""

    values: Any
    indices: Any


class _TensorType(type):
    def __instancecheck__(cls, instance: Any) -> bool:
        if type.__instancecheck__(cls, instance):
            return True
        from xpl.worker.standins.origins import holds, value
        from xpl.worker.standins.things import Thing

        if isinstance(instance, Thing) and holds(instance):
            try:
                return type.__instancecheck__(cls, value(instance))
            except Exception:  # noqa: BLE001 - what cannot be told is none
                return False
        return False


class Tensor(metaclass=_TensorType):
    """An array with torch's manners.

    Attributes:
        array: the numbers.
        dtype: their type.
        device: where they are said to be.
        is_noise: whether they were drawn, and say nothing of what a model was shown.
    """

    __array_ufunc__ = None
    requires_grad = False
    grad = None

    def __init__(self, data: Any = (), kind: dtype | None = None, place: Any = None, *, is_noise: bool = False) -> None:
        array = np.asarray(data)
        if kind is None:
            kind = kinds.of_array(array)
        self.array = array if array.dtype == kind.kept else array.astype(kind.kept)
        self.dtype, self.device, self.is_noise = kind, _CPU if place is None else device(place), is_noise

    def like(self, array: Any, kind: dtype | None = None) -> Tensor:
        """Return a tensor with other numbers on the same device; they keep the type, but for their kind."""
        array = np.asarray(array)
        if kind is None:
            same = array.dtype.kind == self.array.dtype.kind
            kind = self.dtype if same and (self.dtype.name == "bfloat16" or array.dtype == self.array.dtype) else None
        if kind is None and array.dtype not in (found.kept for found in DTYPES.values()):
            array = array.astype(np.float32)
        return Tensor(array, kind, self.device)

    # -- shape ---------------------------------------------------------------------------------------------------------

    @property
    def shape(self) -> Size:
        """Lengths of the axes."""
        return Size(self.array.shape)

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return self.array.ndim

    def size(self, axis: int | None = None) -> Any:
        return self.shape if axis is None else self.array.shape[axis]

    def dim(self) -> int:
        return self.array.ndim

    def numel(self) -> int:
        return int(self.array.size)

    def view(self, *shape: Any) -> Tensor:
        if len(shape) == 1 and isinstance(shape[0], dtype):
            return self.to(shape[0])
        return self.reshape(*shape)

    def reshape(self, *shape: Any) -> Tensor:
        return self.like(self.array.reshape(_sizes(shape)))

    def permute(self, *axes: Any) -> Tensor:
        return self.like(self.array.transpose(_sizes(axes)))

    def transpose(self, first: int, second: int) -> Tensor:
        return self.like(self.array.swapaxes(first, second))

    swapaxes = transpose

    def t(self) -> Tensor:
        return self.like(self.array.T)

    @property
    def T(self) -> Tensor:  # noqa: N802 - torch's name
        return self.like(self.array.T)

    def squeeze(self, dim: int | None = None) -> Tensor:
        if dim is None:
            return self.like(self.array.squeeze())
        return self.like(self.array.squeeze(dim)) if self.array.shape[dim] == 1 else self

    def unsqueeze(self, dim: int) -> Tensor:
        return self.like(np.expand_dims(self.array, dim))

    def flatten(self, start_dim: int = 0, end_dim: int = -1) -> Tensor:
        shape = self.array.shape
        end = end_dim % max(len(shape), 1)
        return self.like(self.array.reshape(*shape[:start_dim], -1, *shape[end + 1 :]))

    def expand(self, *shape: Any) -> Tensor:
        wanted = list(_sizes(shape))
        old = (1,) * (len(wanted) - self.ndim) + self.array.shape
        wanted = [length if length != -1 else old[place] for place, length in enumerate(wanted)]
        return self.like(np.broadcast_to(self.array, wanted).copy())

    def expand_as(self, other: Any) -> Tensor:
        return self.expand(*other.shape)

    def repeat(self, *times: Any) -> Tensor:
        return self.like(np.tile(self.array, _sizes(times)))

    def repeat_interleave(self, times: int, dim: int | None = None) -> Tensor:
        return self.like(np.repeat(self.array, times, axis=dim))

    def unbind(self, dim: int = 0) -> tuple[Tensor, ...]:
        return tuple(self.like(part) for part in np.moveaxis(self.array, dim, 0))

    def split(self, length: Any, dim: int = 0) -> tuple[Tensor, ...]:
        if isinstance(length, int):
            length = range(length, self.array.shape[dim], length)
            return tuple(self.like(part) for part in np.split(self.array, list(length), axis=dim))
        return tuple(self.like(part) for part in np.split(self.array, np.cumsum(length)[:-1], axis=dim))

    def chunk(self, count: int, dim: int = 0) -> tuple[Tensor, ...]:
        return tuple(self.like(part) for part in np.array_split(self.array, count, axis=dim))

    def movedim(self, source: int, target: int) -> Tensor:
        return self.like(np.moveaxis(self.array, source, target))

    def contiguous(self, **_: Any) -> Tensor:
        return self.like(np.ascontiguousarray(self.array))

    # -- types and places ----------------------------------------------------------------------------------------------

    def to(self, *targets: Any, **named: Any) -> Tensor:
        kind, place = self.dtype, self.device
        for target in (*targets, named.get("dtype"), named.get("device")):
            if isinstance(target, dtype):
                kind = target
            elif isinstance(target, Tensor):
                kind, place = target.dtype, target.device
            elif isinstance(target, (str, device, int)) and not isinstance(target, bool):
                place = device(target)
        return Tensor(self.array.astype(kind.kept), kind, place, is_noise=self.is_noise)

    def type(self, kind: Any = None) -> Any:
        return f"torch.{self.dtype.name}" if kind is None else self.to(kind)

    def cuda(self, *_: Any, **__: Any) -> Tensor:
        return self.to("cuda")

    def cpu(self) -> Tensor:
        return self.to("cpu")

    def type_as(self, other: Tensor) -> Tensor:
        return self.to(other)

    def is_floating_point(self) -> bool:
        return bool(self.dtype.is_floating_point)

    @property
    def is_cuda(self) -> bool:
        return str(self.device.type) == "cuda"

    def numpy(self, **_: Any) -> np.ndarray:
        if self.dtype.name == "bfloat16":
            raise TypeError("Got unsupported ScalarType BFloat16")
        if self.device.type != "cpu":
            raise TypeError(
                f"can't convert {self.device} device type tensor to numpy. Use Tensor.cpu() to copy the tensor to host "
                "memory first."
            )
        return self.array

    def __array__(self, kind: Any = None, copy: Any = None) -> np.ndarray:
        array = self.numpy()
        return array if kind is None else array.astype(kind)

    def item(self) -> Any:
        return self.array.item()

    def tolist(self) -> Any:
        return self.array.tolist()

    def detach(self) -> Tensor:
        return self

    detach_ = pin_memory = requires_grad_ = share_memory_ = lambda self, *_, **__: self

    def clone(self, **_: Any) -> Tensor:
        return self.like(self.array.copy())

    def new_zeros(self, *shape: Any, **_: Any) -> Tensor:
        return self.like(np.zeros(_sizes(shape), self.array.dtype))

    def new_ones(self, *shape: Any, **_: Any) -> Tensor:
        return self.like(np.ones(_sizes(shape), self.array.dtype))

    def new_tensor(self, data: Any, **_: Any) -> Tensor:
        return self.like(np.asarray(data, self.array.dtype))

    # -- elements ------------------------------------------------------------------------------------------------------

    def __getitem__(self, key: Any) -> Any:
        return self.like(self.array[_index(key)])

    def __setitem__(self, key: Any, new: Any) -> None:
        self.array[_index(key)] = raw(new)

    def __len__(self) -> int:
        if not self.array.ndim:
            raise TypeError("len() of a 0-d tensor")
        return len(self.array)

    def __iter__(self) -> Iterator[Tensor]:
        if not self.array.ndim:
            raise TypeError("iteration over a 0-d tensor")
        return (self.like(part) for part in self.array)

    def __contains__(self, other: Any) -> bool:
        return bool((self.array == raw(other)).any())

    def __bool__(self) -> bool:
        if self.array.size != 1:
            raise RuntimeError("Boolean value of Tensor with more than one value is ambiguous")
        return bool(self.array.item())

    def __float__(self) -> float:
        return float(self.array.item())

    def __int__(self) -> int:
        return int(self.array.item())

    def __index__(self) -> int:
        return operator.index(self.array.item())

    def __hash__(self) -> int:
        return id(self)

    def __repr__(self) -> str:
        return f"tensor({np.array2string(self.array, separator=', ')})"

    def __deepcopy__(self, _: Any) -> Tensor:
        return self.clone()

    # -- numbers -------------------------------------------------------------------------------------------------------

    def max(self, dim: Any = None, keepdim: bool = False) -> Any:
        return self._extreme(np.maximum, np.max, np.argmax, dim, keepdim)

    def min(self, dim: Any = None, keepdim: bool = False) -> Any:
        return self._extreme(np.minimum, np.min, np.argmin, dim, keepdim)

    def _extreme(self, both: Any, most: Any, place: Any, dim: Any, keepdim: bool) -> Any:
        if dim is None:
            return self.like(most(self.array))
        if isinstance(dim, Tensor):
            return self.like(both(self.array, dim.array))
        where = place(self.array, axis=dim)
        return Extreme(
            self.like(most(self.array, axis=dim, keepdims=keepdim)),
            Tensor(np.expand_dims(where, dim) if keepdim else where, DTYPES["int64"]),
        )

    def std(self, dim: Any = None, keepdim: bool = False, unbiased: bool = True, **_: Any) -> Tensor:
        return self.like(self.array.std(axis=dim, keepdims=keepdim, ddof=int(unbiased)))

    def norm(self, p: Any = 2, dim: Any = None, keepdim: bool = False) -> Tensor:
        return self.like(np.linalg.norm(self.array if dim is not None else self.array.reshape(-1), p, dim, keepdim))

    def argmax(self, dim: Any = None) -> Tensor:
        return Tensor(self.array.argmax(dim), DTYPES["int64"])

    def clamp(self, min: Any = None, max: Any = None) -> Tensor:
        return self.like(np.clip(self.array, raw(min), raw(max)))

    clip = clamp

    def softmax(self, dim: int = -1, **_: Any) -> Tensor:
        powers = np.exp(self.array - self.array.max(dim, keepdims=True))
        return self.like(powers / powers.sum(dim, keepdims=True))

    def sigmoid(self) -> Tensor:
        return self.like(1 / (1 + np.exp(-self.array)))

    def masked_fill(self, mask: Any, new: Any) -> Tensor:
        return self.like(np.where(raw(mask), raw(new), self.array).astype(self.array.dtype))

    def copy_(self, other: Any, **_: Any) -> Tensor:
        self.array[...] = raw(other)
        return self

    def fill_(self, new: Any) -> Tensor:
        self.array[...] = raw(new)
        return self

    def zero_(self) -> Tensor:
        return self.fill_(0)


def _sizes(shape: tuple[Any, ...]) -> tuple[int, ...]:
    if len(shape) == 1 and isinstance(shape[0], (tuple, list)):
        shape = tuple(shape[0])
    return tuple(operator.index(length) for length in shape)


def _index(key: Any) -> Any:
    if isinstance(key, tuple):
        return tuple(raw(part) for part in key)
    return raw(key)


arithmetic.equip(Tensor)
