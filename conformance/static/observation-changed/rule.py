"""XPL140: An observation is left as it came."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.adapter import UPDATE, UPDATE_BATCH, Adapter
from xpl_cli.audit.static.aliases import Change, Held, Sharing
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import parameters

_GIVEN = {UPDATE: 0, UPDATE_BATCH: 0, "encode": 0, "decode": 1}
"""Methods that get an observation from outside, and as which parameter."""
_VALUES = frozenset((sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTIONS, sdk.Obs.ENV_IDX))


@rule(code="XPL140", requirement="XPL-OBS-5")
def observation_changed(source: Source) -> Iterator[Finding]:
    """The adapter writes into the observation that it was given.

    ## What it does
    Follows the observation through assignments, views (`np.asarray`, slices, `reshape`) and the adapter's own
    functions, and looks for entries that are set or removed and for arrays that are changed in place. Copies end the
    trail.

    ## Why it matters
    The observation belongs to the client. A recorder, a second policy, or the next step of the same loop then sees
    scaled images or joint values without their offset, and nothing says so.

    ## Example
    `state = np.asarray(obs["state"]["arm_joint_state"]); state -= self.mean`.

    ## Use instead
    `state = np.asarray(obs["state"]["arm_joint_state"]) - self.mean`, or a copy first.

    ## Fix safety
    Writing `a = a - b` instead of `a -= b` is safe wherever nobody relied on the change.
    """
    adapter = Adapter.of(source)
    sharing = Sharing(adapter)
    for name, place in _GIVEN.items():
        function = adapter.method(name)
        names = parameters(function.node) if function is not None else []
        if function is not None and len(names) > place:
            sharing.follow(function, {names[place]: Held(sdk.Payload.OBS)})
    seen: set[int] = set()
    for change in sharing.changes:
        if not _is_certain(change) or id(change.node) in seen:
            continue
        seen.add(id(change.node))
        what = ".".join((*change.held.keys, *([change.key] if change.key else []))) or "an entry"
        yield Finding(
            f"the client's own observation is changed ({what}): a recorder that uses it next gets other values",
            **source.at(change.function.file, change.node),
            expected="a copy, or a new array",
            got=ast.unparse(change.node).split("\n")[0],
            fix=Fix("advice", "write to a copy (np.array(x), dict(obs)), or make a new array"),
        )


def _is_certain(change: Change) -> bool:
    """Tell whether a change reaches the observation: numbers and texts that a name holds are made anew."""
    if isinstance(change.node, ast.AugAssign) and isinstance(change.node.target, ast.Name):
        return bool(change.held.keys) and not _VALUES & set(change.held.keys)
    return True
