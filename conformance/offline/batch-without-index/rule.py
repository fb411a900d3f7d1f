"""XPL206: Observations without env_idx are confused or refused."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as spec
from xpl.contract import ObservationDict
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.compare import difference, error_code, is_answer_list, raised, same
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer


@rule(code="XPL206", requirement="XPL-BAT-4", compares=True, tries="observations without env_idx")
def batch_without_index(probe: Probe) -> Iterator[Finding]:
    """Observations without env_idx are confused or refused.

    ## What it does
    Sends the same two observations with and without `env_idx`, for two steps, requests both and then the second alone,
    and compares the actions. Then sends a batch in which only the first observation has an index, 1, the position of
    the other one: the action of environment 1 must not come from that other one.

    ## Why it matters
    `env_idx` is optional. With a client that omits it, every robot would get the actions of the last one, or an
    exception.

    ## Example
    `self.obs[obs.get("env_idx", 0)] = obs` inside the loop over the batch stores all of them under 0.

    ## Use instead
    `xpl.observation.env_indices(batch)`

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    episodes = []
    refused: str | None = None
    for bare in (False, True):
        with probe.run() as policy:
            policy.reset()
            answered = []
            for step, indices in enumerate(([0, 1], [1])):
                batch = probe.observations([0, 1], step)
                taken = policy.update_obs_batch([_bare(obs) for obs in batch] if bare else batch)
                refused = refused or (raised(taken) if bare else None)
                answered.append(policy.get_action_batch(indices))
            episodes.append(answered)
    probe.require_chunks(episodes[0][0], [0, 1])
    mismatch = difference(*episodes)
    if mismatch is not None:
        yield blame(
            _describe(*episodes, refused=refused),
            expected="the same actions as with env_idx 0 and 1",
            got=mismatch,
            evidence={"asked": [[0, 1], [1]]},
            fix=Fix("advice", "number the observations of a batch by position if all of them lack env_idx"),
        )
        return
    named, unnamed = ({**obs, spec.Obs.ENV_IDX: 1} for obs in probe.observations([0, 1]))
    mixed = probe.batch_answer([named, _bare(unnamed)], [1])
    own, other = (probe.batch_answer([obs], [1]) for obs in (named, unnamed))
    if same(mixed, other) and not same(own, other) and error_code(mixed) is None:
        yield blame(
            "in a batch of which only some observations have env_idx, environment 1 gets the action for an "
            "observation without one: its own was overwritten",
            expected="an error, or the actions for the observation with env_idx 1",
            got="the actions for the observation without env_idx",
            evidence={"indices": [1, None], "asked": [1]},
            fix=Fix("advice", "refuse a batch of which only some observations have env_idx"),
        )
    elif same(*episodes[0][0]):
        raise NotApplicable("both environments get the same actions: that one overwrites the other cannot be seen")


def _describe(indexed: list[Answer], bare: list[Answer], *, refused: str | None) -> str:
    """Return what becomes of a batch without indices.

    Args:
        indexed: the answers with indices.
        bare: those without.
        refused: what update_obs_batch raises without them, or None.
    """
    if refused is not None:
        return f"update_obs_batch raises {refused} for a batch without env_idx, although the key is optional"
    pairs = list(zip(indexed, bare, strict=True))
    error = next((raised(answer) for usual, answer in pairs if raised(answer) and not raised(usual)), None)
    if error is not None:
        return f"observations without env_idx are not numbered by position: get_action_batch then raises {error}"
    usual, answer = pairs[0]
    if is_answer_list(usual, 2) and is_answer_list(answer, 2) and same(*answer) and not same(*usual):
        return "observations without env_idx are not numbered by position: one environment overwrites another"
    return "a batch without env_idx gives other actions than the same observations with env_idx 0 and 1, by position"


def _bare(obs: ObservationDict) -> ObservationDict:
    return {key: value for key, value in obs.items() if key != spec.Obs.ENV_IDX}
