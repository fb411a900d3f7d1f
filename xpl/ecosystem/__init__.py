"""What the ecosystem's own package offers adapters: found where a checkout is there, and offered by us where none is.

Adapters of the field import `XPolicyLab`, read its `env_cfg`, and rely on what their scripts put on Python's path. Here
is what makes them load as they stand: `checkout` finds the real thing, `offering` and `robots` give what lacks, and
`scripts` reads paths.
"""

from __future__ import annotations

import sys
from pathlib import Path

from xpl.ecosystem import checkout


def offer(policy_dir: Path) -> None:
    """Let this process import an adapter as its own server would: from a checkout that is there, or without one.

    Folders come onto the path in the order of the ecosystem's server: the checkout, then what the adapter's scripts put
    there. The folder that holds the checkout does not: whatever lies beside it would hide other packages.

    Args:
        policy_dir: folder of the adapter. One that never speaks of the ecosystem is left as it is.
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
