"""Arithmetic of tensors: operators, functions of elements, and sums."""

from __future__ import annotations

from typing import Any, Callable

import numpy as np

from xpl.worker.standins.torch import kinds
from xpl.worker.standins.torch.kinds import DTYPES


def raw(value: Any) -> Any:
    """Return the array of a tensor, and anything else as it is."""
    return value.array if hasattr(value, "is_noise") else value


def _binary(function: Callable[..., Any], *, swapped: bool = False, in_place: bool = False) -> Callable[..., Any]:
    def operation(self: Any, other: Any = None, **_: Any) -> Any:
        from xpl.worker.standins.origins import value
        from xpl.worker.standins.things import Thing

        if isinstance(other, Thing):
            other = value(other)
        if other is None or isinstance(other, (str, dict)):
            return NotImplemented
        mine, theirs = self.array, raw(other)
        if isinstance(theirs, (int, float)) and mine.dtype.kind == "f":
            theirs = mine.dtype.type(theirs)
        with np.errstate(all="ignore"):
            made = function(theirs, mine) if swapped else function(mine, theirs)
        if (
            made.dtype == np.float64
            and mine.dtype.kind == "f"
            and mine.dtype != np.float64
            and (not isinstance(theirs, np.ndarray) or theirs.dtype != np.float64)
        ):
            made = made.astype(np.float32)
        if in_place:
            self.array[...] = made
            return self
        return self.like(made)

    return operation


_FUNCTIONS = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "truediv": np.true_divide, "floordiv": np.floor_divide,
    "mod": np.mod, "pow": np.power, "matmul": np.matmul, "and": np.logical_and,
    "or": np.logical_or, "xor": np.logical_xor,
}  # fmt: skip


def _unary(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda self, *_, **__: self.like(function(self.array))


def _reduction(function: Callable[..., Any]) -> Callable[..., Any]:
    def reduce(self: Any, dim: Any = None, keepdim: bool = False, dtype: Any = None, **_: Any) -> Any:
        axis = tuple(dim) if isinstance(dim, list) else dim
        made = self.like(np.asarray(function(self.array, axis=axis, keepdims=keepdim)))
        return made if dtype is None else made.to(dtype)

    return reduce


def equip(tensor: Any) -> None:
    """Give a class of tensors its operators."""
    for name, function in _FUNCTIONS.items():
        setattr(tensor, f"__{name}__", _binary(function))
        setattr(tensor, f"__r{name}__", _binary(function, swapped=True))
        setattr(tensor, f"__i{name}__", _binary(function, in_place=True))
    for name in ("add", "sub", "mul", "pow", "matmul"):
        setattr(tensor, name, _binary(_FUNCTIONS[name]))
        setattr(tensor, f"{name}_", _binary(_FUNCTIONS[name], in_place=True))
    tensor.div, tensor.div_ = _binary(np.true_divide), _binary(np.true_divide, in_place=True)
    for name in ("lt", "le", "gt", "ge", "eq", "ne"):
        function = {
            "lt": np.less,
            "le": np.less_equal,
            "gt": np.greater,
            "ge": np.greater_equal,
            "eq": np.equal,
            "ne": np.not_equal,
        }[name]
        setattr(tensor, f"__{name}__", _binary(function))
        setattr(tensor, name, _binary(function))

    for name in (
        "abs",
        "exp",
        "log",
        "sin",
        "cos",
        "tan",
        "sqrt",
        "tanh",
        "floor",
        "ceil",
        "sign",
        "isnan",
        "isfinite",
        "isinf",
    ):
        setattr(tensor, name, _unary(getattr(np, name)))
    tensor.round = lambda self, decimals=0: self.like(np.round(self.array, decimals))
    tensor.__neg__ = _unary(np.negative)
    tensor.__abs__ = _unary(np.abs)
    tensor.__invert__ = _unary(np.logical_not)

    for name in ("mean", "sum", "prod", "any", "all"):
        setattr(tensor, name, _reduction(getattr(np, name)))
    tensor.cumsum = lambda self, dim, **_: self.like(self.array.cumsum(dim))
    for name, kind in {**kinds.ALIASES, "bfloat16": "bfloat16", "bool": "bool"}.items():
        setattr(tensor, name, lambda self, kind=kind: self.to(DTYPES[kind]))
