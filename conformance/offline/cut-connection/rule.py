"""XPL228: An episode differs after the connection was cut."""

from __future__ import annotations

from collections.abc import Iterator

from xpl.client import ClientError
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.compare import brief, difference, first_step, is_answer_list, same
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer
from xpl_cli.audit.served.relay import CuttingRelay

_CUTS = (None, "confirmation", "action", "observation", None)
"""What is lost in each step of the episode."""


@rule(code="XPL228", requirement="XPL-SRV-2", compares=True, tries="broken connections")
def cut_connection(probe: Probe) -> Iterator[Finding]:
    """An episode differs after the connection was cut.

    ## What it does
    Runs an episode through a proxy that cuts the connection three times: after an observation was processed and before
    that was confirmed, after an action was computed and before it was delivered, and in the middle of a request. The
    client reconnects and repeats its request. Every action must equal that of the same episode without cuts.

    ## Why it matters
    Networks drop connections, and the client repeats unconfirmed requests. If that affects the policy, because an
    observation enters its history twice, or because it treats the pause as the end of an episode, results depend on the
    network.

    ## Example
    `if time.time() - self.last_call > 0.5: self.reset()`

    ## Use instead
    Nothing: the server returns its stored reply to a repeated request. Start episodes in `reset` and nowhere else.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    with probe.run() as policy:
        expected = probe.episode(policy, steps=len(_CUTS))
    if all(same(expected[0], later) for later in expected):
        raise NotApplicable("the actions are the same in every step: that an observation got lost cannot be seen")
    answered: list[Answer] = []
    cuts: list[str] = []
    try:
        with probe.own_server({}) as server, CuttingRelay(server.url) as relay, probe.connected(relay.url) as policy:
            policy.reset()
            for step, cut in enumerate(_CUTS):
                if cut == "confirmation":
                    cuts.append(f"step {step}, update_obs: {relay.cut_answer()}")
                elif cut == "observation":
                    cuts.append(f"step {step}, update_obs: {relay.cut_request()}")
                policy.update_obs(probe.observation(0, step))
                if cut == "action":
                    cuts.append(f"step {step}, get_action: {relay.cut_answer()}")
                answered.append(policy.get_action())
    except ClientError as error:
        answered.append(error)
    for step, (uncut, answer) in enumerate(zip(expected, answered, strict=False)):
        mismatch = str(answer) if isinstance(answer, ClientError) else difference(uncut, answer)
        if mismatch is not None:
            probe.require_repeatable_afresh()
            yield blame(
                f"after a reconnect the policy acts differently, from step {step} on: results depend on the network",
                expected="the actions of the same episode without a cut",
                got=mismatch,
                evidence={
                    "step": step,
                    "cuts": cuts,
                    "uncut": first_step(uncut) if is_answer_list(uncut) else None,
                    "cut": first_step(answer) if is_answer_list(answer) else brief(answer),
                },
                fix=Fix("advice", "start an episode in reset only, and process each observation once"),
            )
            return
