"""What is wrong with a native block, or with values that it is to convert."""

from __future__ import annotations


class NativeError(ValueError):
    """A native block that cannot be compiled, or values that do not fit it; the text says where and what to do."""


class OpenError(NativeError):
    """A native block that leaves values open which conversions need."""
