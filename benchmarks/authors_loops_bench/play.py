"""Runs the authors' loop of a package in the policy's Python: `play.py PACKAGE REQUEST`.

The request is JSON: `loop` (its name in LOOPS of authors_loop.py), `config` (deploy.yml after overrides), `environment`
of policy.yml, `seed` of the episode, `entropy` of the noise, and `behind`: folders of packages that are found after the
policy's own, which are the simulator's and the SDK's. As reference.py, authors_loop.py may import neither the SDK nor
the adapter.
"""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace


def main() -> None:
    """Run the loop until the taps end it."""
    package, request = Path(sys.argv[1]), json.loads(sys.argv[2])
    sys.argv[1:] = []
    sys.path[:1] = []  # this file's folder
    sys.path.extend(request["behind"])
    import numpy as np
    from sitecustomize import EndOfTrial

    from xpl import variables
    from xpl.worker import reference

    variables.set_declared(package, request["config"], request["environment"])
    _, evaluate = reference.load(package, "authors_loop.py", "evaluation", request["config"])
    rng = np.random.default_rng(request["entropy"])
    with contextlib.suppress(EndOfTrial):
        evaluate(SimpleNamespace(loop=request["loop"], seed=request["seed"], rng=rng))


if __name__ == "__main__":
    main()
