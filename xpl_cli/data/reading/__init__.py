"""Sets of others, read in a process of its own that bounds what this takes.

demonstrations = open_set(path)   # finds the format by looking
demonstrations[0].read("action")
"""

from __future__ import annotations

from xpl_cli.data.reading.remote import open_set

__all__ = ["open_set"]
