"""Types of numbers, devices, and sizes."""

from __future__ import annotations

from typing import Any

import numpy as np


class dtype:  # noqa: N801 - torch's name
    """A type of numbers.

    Args:
        name: torch's.
        kept: numpy's, in which they are kept.
    """

    def __init__(self, name: str, kept: Any) -> None:
        self.name, self.kept = name, np.dtype(kept)

    @property
    def is_floating_point(self) -> bool:
        """Whether it has fractions."""
        return str(self.kept.kind) == "f"

    @property
    def is_complex(self) -> bool:
        """Whether it is complex."""
        return str(self.kept.kind) == "c"

    @property
    def itemsize(self) -> int:
        """Bytes of a number."""
        return 2 if self.name == "bfloat16" else self.kept.itemsize

    def __repr__(self) -> str:
        return f"torch.{self.name}"

    def __reduce__(self) -> Any:
        return (_dtype, (self.name,))


DTYPES = {
    name: dtype(name, kept)
    for name, kept in (
        ("float32", np.float32),
        ("float64", np.float64),
        ("float16", np.float16),
        ("bfloat16", np.float32),
        ("uint8", np.uint8),
        ("int8", np.int8),
        ("int16", np.int16),
        ("int32", np.int32),
        ("int64", np.int64),
        ("bool", np.bool_),
        ("complex64", np.complex64),
    )
}
ALIASES = {
    "float": "float32", "double": "float64", "half": "float16", "int": "int32", "long": "int64", "short": "int16",
}  # fmt: skip
_BY_KEPT = {found.kept: found for name, found in DTYPES.items() if name != "bfloat16"}


def _dtype(name: str) -> dtype:
    return DTYPES[name]


def of_array(array: np.ndarray) -> dtype:
    """Return the type of an array's numbers.

    Raises:
        TypeError: if torch has none such, as torch does.
    """
    if array.dtype not in _BY_KEPT:
        raise TypeError(
            f"can't convert np.ndarray of type {array.dtype}. The only supported types are: float64, float32, float16, "
            "complex64, complex128, int64, int32, int16, int8, uint64, uint32, uint16, uint8, and bool."
        )
    return _BY_KEPT[array.dtype]


class device:  # noqa: N801 - torch's name
    """Where a tensor is said to be."""

    type: str
    index: int | None

    def __init__(self, name: Any = "cpu", index: int | None = None) -> None:
        if isinstance(name, device):
            self.type, self.index = name.type, name.index
            return
        if isinstance(name, int):
            name, index = "cuda", name
        kind, _, number = str(name).partition(":")
        self.type = kind
        self.index = int(number) if number.isdigit() else index

    def __eq__(self, other: object) -> bool:
        return isinstance(other, device) and (self.type, self.index) == (other.type, other.index)

    def __hash__(self) -> int:
        return hash((self.type, self.index))

    def __str__(self) -> str:
        return self.type if self.index is None else f"{self.type}:{self.index}"

    def __repr__(self) -> str:
        return (
            f"device(type='{self.type}')" if self.index is None else f"device(type='{self.type}', index={self.index})"
        )

    def __enter__(self) -> device:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Size(tuple):  # type: ignore[type-arg]
    """The lengths of a tensor's axes."""

    __slots__ = ()

    def numel(self) -> int:
        """Return the number of elements."""
        return int(np.prod(self)) if self else 1

    def __repr__(self) -> str:
        return f"torch.Size({list(self)})"
