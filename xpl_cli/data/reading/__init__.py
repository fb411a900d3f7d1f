"""Reading of untrusted datasets in a separate process with limits on memory and processor time.

demonstrations = open_set(path)   # detects the format
demonstrations[0].read("action")
"""

from __future__ import annotations

from xpl_cli.data.reading.remote import open_set

__all__ = ["open_set"]
