"""What is wrong with a model_io block, or with values that it is to convert."""

from __future__ import annotations


class ConversionError(ValueError):
    """A model_io block that cannot be compiled, or values that do not fit it; the text says where and what to do."""


class OpenError(ConversionError):
    """A model_io block that leaves values open which conversions need."""
