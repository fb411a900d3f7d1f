"""Modules and files of the ecosystem's package for adapters: from a checkout, or xpl's replacements if there is none.

Adapters of XPolicyLab import `XPolicyLab`, read its `env_cfg`, and rely on folders that their scripts add to Python's
path. This package lets them load unchanged: `checkout` finds a real checkout, `module_finder` and `robots` replace
missing modules and files, and `scripts` reads paths.
"""

from __future__ import annotations

import sys
from pathlib import Path

from xpl.ecosystem import checkout


def offer(policy_dir: Path) -> None:
    """Let this process import an adapter as its own server would, with a checkout or without one.

    Folders are added to `sys.path` in the order of the ecosystem's server: the checkout, then the folders that the
    adapter's scripts add. The parent of the checkout is not: its other folders would hide packages.

    Args:
        policy_dir: folder of the adapter. Nothing changes for an adapter that does not use the ecosystem.
    """
    names = checkout.names(policy_dir)
    if not names:
        return
    from xpl.ecosystem import module_finder, robots, scripts

    root = checkout.find_root(policy_dir)
    places = [*([] if root is None else [root]), *scripts.python_path(policy_dir)]
    sys.path[:0] = [str(place) for place in places if str(place) not in sys.path]
    module_finder.EcosystemFinder(policy_dir, root, names).install()
    robots.offer(policy_dir)
