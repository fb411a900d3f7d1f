"""Errors of a model_io block and of its conversions."""

from __future__ import annotations


class ConversionError(ValueError):
    """A model_io block cannot be compiled, or values do not fit it; the text says where and what to do."""


class UnknownValueError(ConversionError):
    """A model_io block has unknown values that conversions need."""
