"""XPL216: Observations that the schema allows are refused, or give other actions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xpl import _spec as spec
from xpl.contract import ObservationDict
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.changed_inputs import only
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL216", requirement="XPL-OBS-1", compares=True, tries="forms of observations")
def observation_forms(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """Observations that the schema allows are refused, or give other actions.

    ## What it does
    Sends an observation whose state values are lists, one with double precision, one with additional keys, cameras and
    states, one in another order, and one with only what the manifest lists as required or optional. The actions must be
    the same.

    ## Why it matters
    Benchmarks send all of them. An adapter that requires one form works only with its author's simulator.

    ## Example
    `obs["state"]["arm_joint_state"].astype(np.float32)` fails on a list; `list(obs["vision"].values())[0]` is the head
    camera in one simulator and a wrist in another.

    ## Use instead
    `xpl.observation.pack_state`, or `np.asarray(value, dtype=np.float32)`; cameras by their names.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    obs = probe.observation()
    forms = _forms(obs)
    if probe.required:
        forms["only what the manifest lists"] = only(obs, probe.package.manifest.read)
    found = False
    answers = semantics.compare([((obs,), (form,)) for form in forms.values()])
    for what, pair in zip(forms, answers, strict=True):
        mismatch = semantics.disagreement(*pair)
        if mismatch is not None:
            found = True
            yield blame(
                f"an observation with {what} gives other actions, although the schema allows it: the policy "
                "works with some benchmarks only",
                expected="the same action",
                got=mismatch,
                fix=Fix("advice", "convert with np.asarray, read by name, and ignore keys that are not needed"),
            )
    if not found:
        semantics.require_steady()


def _forms(obs: ObservationDict) -> dict[str, ObservationDict]:
    state, vision = obs[spec.Obs.STATE], obs[spec.Obs.VISION]
    camera = next(iter(vision.values()))
    more = {
        "weather": "sunny",
        spec.Obs.VISION: {"cam_of_a_visitor": camera, **vision},
        spec.Obs.STATE: {"temperature": np.array([21.5]), **state},
    }
    return {
        "state values as lists": {**obs, spec.Obs.STATE: {key: value.tolist() for key, value in state.items()}},
        "state values in double precision": {
            **obs,
            spec.Obs.STATE: {key: value.astype(np.float64) for key, value in state.items()},
        },
        "unknown keys, cameras and states": {**obs, **more},
        "its cameras and states in another order": {
            **obs,
            spec.Obs.VISION: dict(reversed(vision.items())),
            spec.Obs.STATE: dict(reversed(state.items())),
        },
    }
