"""What goes wrong with demonstrations."""

from __future__ import annotations


class DataError(ValueError):
    """Demonstrations, or a part of them, cannot be read or written; the text says what, where and what to do."""
