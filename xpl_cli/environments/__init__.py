"""What environments offer: listed, played, checked, drawn.

The tests that come with a new environment package make it by `environments.make`; templates are frozen, so that this
name stays.
"""

from xpl_cli.packages.environments import make

__all__ = ["make"]
