"""The field's formats of demonstrations, one module or package each: how a set is recognised, read and written.

demonstrations = open_set(path)   # finds the format by looking
demonstrations[0].read("action")

A format's module has `recognises(path)` and `opened(path)` (`xpl_cli.basics.formats`).
"""

from __future__ import annotations

from xpl_cli.data.formats.detection import open_set

__all__ = ["open_set"]
