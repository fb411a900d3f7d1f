"""Do a policy and an environment fit? What both announce in hello is compared before the first step.

A policy announces `{name, embodiments, embodiment, action_types, action_type, control_frequency, inputs}` (inputs:
those it needs), an environment `{embodiment, action_type, control_frequency, inputs}` (inputs: those it offers). What
one side does not say, or says is null, is not compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xpl import _spec as spec
from xpl.embodiment import UnknownEmbodimentError, get_embodiment

_EMBODIMENT, _EMBODIMENTS, _ACTION_TYPES, _INPUTS = "embodiment", "embodiments", "action_types", "inputs"
_ACTION_TYPE, _FREQUENCY = spec.Deploy.ACTION_TYPE, "control_frequency"


def needs(manifest: Mapping[str, Any], config: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a policy announces.

    Args:
        manifest: its policy.yml, or nothing.
        config: the configuration it runs with.
    """
    inputs = manifest.get(_INPUTS) or {}
    return {
        "name": config.get(spec.Deploy.POLICY_NAME),
        _EMBODIMENTS: _all_canonical(manifest.get(_EMBODIMENTS)),
        _EMBODIMENT: _canonical(config.get(spec.Deploy.ENV_CFG_TYPE)),
        _ACTION_TYPES: manifest.get(_ACTION_TYPES),
        _ACTION_TYPE: config.get(spec.Deploy.ACTION_TYPE),
        _FREQUENCY: manifest.get(_FREQUENCY),
        _INPUTS: inputs.get("required"),
    }


def offered_inputs(obs: Mapping[str, Any]) -> list[str]:
    """Return the inputs that an observation holds, by their names in policy.yml: `state.ee_pose`, `vision.cam_head`."""
    state = obs.get(spec.Obs.STATE) or {}
    prefixes = {prefix for names in spec.ARM_PREFIXES.values() for prefix in names if prefix}
    bare = [next((key[len(prefix) :] for prefix in prefixes if key.startswith(prefix)), key) for key in state]
    found = [f"{spec.Obs.STATE}.{key}" for key in dict.fromkeys(bare)]
    found += [f"{spec.Obs.VISION}.{camera}" for camera in obs.get(spec.Obs.VISION) or {}]
    found += [name for name in (spec.Obs.INSTRUCTION, spec.Obs.PRIVILEGED) if obs.get(name) is not None]
    return found


def differences(policy: Mapping[str, Any], environment: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return where policy and environment do not fit: maps with `field`, `policy`, `environment` and a `message`."""
    found = []

    def differ(field: str, wanted: Any, offered: Any, message: str) -> None:
        found.append({"field": field, "policy": wanted, "environment": offered, "message": message})

    for one, many in ((_EMBODIMENT, _EMBODIMENTS), (_ACTION_TYPE, _ACTION_TYPES)):
        offered, configured, declared = environment.get(one), policy.get(one), policy.get(many)
        if one == _EMBODIMENT:
            offered, configured, declared = (
                _canonical(offered) or offered,
                _canonical(configured) or configured,
                _all_canonical(declared),
            )
        if offered is None:
            continue
        if configured is not None and configured != offered:
            text = f"the policy was started for {one} {configured}, the environment has {offered}"
            differ(one, configured, offered, text)
        elif isinstance(declared, list) and offered not in declared:
            differ(one, declared, offered, f"the policy takes {one} {' or '.join(map(str, declared))}, not {offered}")
    rates = policy.get(_FREQUENCY), environment.get(_FREQUENCY)
    if None not in rates and rates[0] != rates[1]:
        text = f"the policy's actions are meant for {rates[0]} Hz, the environment executes them at {rates[1]} Hz"
        differ(_FREQUENCY, *rates, text)
    wanted, offered = policy.get(_INPUTS), environment.get(_INPUTS)
    if isinstance(wanted, list) and isinstance(offered, list):
        missing = [name for name in wanted if name not in offered]
        if missing:
            differ(_INPUTS, wanted, offered, f"the environment does not offer {', '.join(map(str, missing))}")
    return found


def sentence(found: list[dict[str, Any]]) -> str:
    """Return one sentence about the differences."""
    return "policy and environment do not fit: " + "; ".join(str(one["message"]) for one in found)


def _all_canonical(names: Any) -> Any:
    return [_canonical(name) or name for name in names] if isinstance(names, list) else names


def _canonical(name: Any) -> str | None:
    try:
        return get_embodiment(name).name if isinstance(name, str) else None
    except UnknownEmbodimentError:
        return None
