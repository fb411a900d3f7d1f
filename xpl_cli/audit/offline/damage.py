"""Malformed requests that no adapter can answer, as a faulty environment sends them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from xpl import _spec as sdk

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from xpl.contract import ObservationDict
    from xpl_cli.audit.served.probe import Probe
    from xpl_cli.audit.served.recorded_client import Answer, RecordedClient

_UNKNOWN = 99


def damaged_operations(probe: Probe) -> Iterator[tuple[str, Callable[[RecordedClient], Answer]]]:
    """Yield operations with something wrong in them, each with a description; they return the policy's answer."""
    complete = probe.observation()
    for name, obs in {
        "an empty observation": {sdk.Obs.ENV_IDX: 0},
        "an observation without state": {key: value for key, value in complete.items() if key != sdk.Obs.STATE},
        "an observation without pictures": {key: value for key, value in complete.items() if key != sdk.Obs.VISION},
        "state and pictures of the wrong type": {**complete, sdk.Obs.STATE: "none", sdk.Obs.VISION: []},
    }.items():
        yield name, partial(_update_and_act, obs=obs)
    batch = [complete, {sdk.Obs.ENV_IDX: 1}]
    yield "a batch whose second observation is empty", partial(_update_and_act_batch, observations=batch)
    yield "an unknown environment", lambda policy: policy.get_action_batch([_UNKNOWN])


def _update_and_act(policy: RecordedClient, obs: ObservationDict) -> Answer:
    """Send an observation and get an action; the first error counts, since an adapter may read observations late."""
    return policy.update_obs(obs) or policy.get_action()


def _update_and_act_batch(policy: RecordedClient, observations: list[ObservationDict]) -> Answer:
    return policy.update_obs_batch(observations) or policy.get_action_batch([0, 1])
