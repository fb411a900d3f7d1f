"""Environments: list, run, check and render them.

The tests that come with a new environment package call `environments.make`; templates are frozen, so this name stays.
"""

from xpl_cli.packages.environments import make

__all__ = ["make"]
