"""The `xpl` command line: scaffold, serve, audit and evaluate robot policies against one standard."""

from xpl import __version__

__all__ = ["__version__"]
