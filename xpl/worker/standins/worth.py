"""Numbers, texts and operations of things."""

from __future__ import annotations

from typing import Any, Callable

from xpl.worker.standins.origins import WORLD, holds, origin, refuse, value


class Worth:
    """What a thing is where a number, a text or an array is asked of it."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        import numpy as np

        found = value(self)
        if found is None:
            refuse(origin(self).name, "value")
        array = np.asarray(found)
        return array if dtype is None else array.astype(dtype)

    def __float__(self) -> float:
        return float(_number(self))

    def __int__(self) -> int:
        return int(_number(self))

    def __index__(self) -> int:
        return int(_number(self))

    def __complex__(self) -> complex:
        return complex(_number(self))

    def __bytes__(self) -> bytes:  # noqa: PLE0308 - it is refused
        refuse(origin(self).name, "value")

    def __fspath__(self) -> str:
        if WORLD.facts is None:
            refuse(origin(self).name, "path")
        return str(self)

    def __str__(self) -> str:
        return origin(self).last

    def __repr__(self) -> str:
        return f"<stub {origin(self).name}>"

    def __hash__(self) -> int:
        return id(self)

    def __eq__(self, other: object) -> Any:
        return self is other if not holds(self) else operation(self, "eq", other)

    def __ne__(self, other: object) -> Any:
        return self is not other if not holds(self) else operation(self, "ne", other)


def _number(thing: Any) -> Any:
    found = value(thing)
    if found is None:
        refuse(origin(thing).name, "value")
    return found.item() if hasattr(found, "item") else found


def operation(thing: Any, name: str, *others: Any) -> Any:
    """Return what an operation of a thing with others gives: a value if all have one, else a thing."""
    import operator

    function = getattr(operator, name.removeprefix("r") if not hasattr(operator, name) else name, None)
    found = value(thing)
    if found is not None and function is not None and not isinstance(found, list):
        values = [value(other) if isinstance(other, Worth) else other for other in others]
        if all(item is not None for item in values):
            ordered = [*values, found] if name.startswith("r") and not hasattr(operator, name) else [found, *values]
            return function(*ordered)
    return thing._xpl_again()  # noqa: SLF001 - of things


def _operator(name: str) -> Callable[..., Any]:
    return lambda self, *others: operation(self, name, *others)


for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "matmul", "and_", "xor"):
    for _form in ("", "r"):
        setattr(Worth, f"__{_form}{_name.rstrip('_')}__", _operator(f"{_form}{_name}"))
for _name in ("neg", "pos", "abs", "invert", "lt", "le", "gt", "ge"):
    setattr(Worth, f"__{_name}__", _operator(_name))
