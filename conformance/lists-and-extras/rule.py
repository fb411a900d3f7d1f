"""XPL216: Forms of an observation that the schema allows are not accepted."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.compare import difference
from xpl_cli.audit.probe import Probe, blame


@rule(code="XPL216", slug="lists-and-extras", gate="offline", requirement="XPL-OBS-1")
def lists_and_extras(probe: Probe) -> Iterator[Finding]:
    """Forms of an observation that the schema allows are not accepted.

    ## What it does
    Shows an observation whose state values are lists, and one with an additional key, and compares the actions.

    ## Why it matters
    Benchmarks send both. An adapter that insists on one form works in the simulator of its author only.

    ## Example
    `obs["state"]["arm_joint_state"].astype(np.float32)` fails on a list.

    ## Use instead
    `xpl.observation.pack_state`, or `np.asarray(value, dtype=np.float32)`.

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    obs = probe.observation()
    state = {key: value.tolist() for key, value in obs[spec.Obs.STATE].items()}
    forms = {
        "state values as lists": {**obs, spec.Obs.STATE: state},
        "an unknown key": {**obs, "weather": "sunny"},
    }
    expected = probe.answer(obs)
    for what, changed in forms.items():
        found = difference(expected, probe.answer(changed))
        if found is not None:
            yield blame(
                f"an observation with {what} is answered differently, although the schema allows it",
                expected="the same action",
                got=found,
                fix=Fix("advice", "convert with np.asarray and ignore keys that are not needed"),
            )
