"""The `xpl` command line: scaffold, serve, audit and evaluate robot policies against one standard."""

__version__ = "0.1.0"
