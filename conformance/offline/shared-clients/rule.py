"""XPL217: Clients that share the model influence each other."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

from xpl import _spec as spec
from xpl.client import PolicyServerError
from xpl_cli.audit import Finding, Fix, NotApplicable, NotRun, rule
from xpl_cli.audit.served.compare import brief, difference, first_step, is_answer_list, same
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer, RecordedClient

_ENVS = ([0, 1], [1, 0])  # of each client: the same numbers, which only the server tells apart
_SCENES = ([0, 1], [2, 3])  # what each of these environments shows
_EPISODES, _STEPS = 2, 3
_BEHIND = 3
"""Turns that the second client lags by. An odd number: then each resets between an observation of the other and its
action, and each acts on an observation after which the other was observed."""


@dataclass(frozen=True)
class _Turn:
    """One operation of one client, and what it was answered."""

    method: str
    episode: int
    step: int
    answer: Answer

    def __str__(self) -> str:
        return f"{self.method} in step {self.step} of episode {self.episode}"


@rule(code="XPL217", requirement="XPL-SRV-7", compares=True, tries="clients that share the model")
def shared_clients(probe: Probe) -> Iterator[Finding]:
    """Clients that share the model influence each other.

    ## What it does
    For an adapter that declares `serving: {shared: true}`: two clients run two episodes each, first alone on a server
    of their own, then together on one server in turns, so that each one observes and resets in the middle of the
    other's episodes. Every action is compared.

    ## Why it matters
    Clients that share a model belong to different evaluations. If one's reset or observation affects another, results
    depend on what else ran on the server at the time, and cannot be reproduced.

    ## Example
    `reset_envs(env_idx_list)` that clears every environment, or `self.batch = obs_list`, which the next client
    overwrites before the first one calls `get_action`.

    ## Use instead
    `xpl.Policy` keeps observations, history and generators per environment, and no two clients share an environment
    number. Store state of a library in a dict by environment and drop single entries in `reset_env(env)`; or leave
    `serving` out, and each client gets a model of its own.

    ## Fix safety
    No automatic fix.
    """
    if not probe.package.manifest.serving.shared:
        raise NotApplicable("the manifest does not declare serving.shared: a model has one client at a time")
    probe.require_deterministic()
    alone = []
    for client in range(len(_ENVS)):
        # A new process each: where random numbers are drawn, clients have to be the first of their servers.
        with probe.fresh_session() as policy:
            alone.append(list(_play(probe, policy, client)))
    errors = [turn for turn in itertools.chain(*alone) if isinstance(turn.answer, PolicyServerError)]
    if errors:
        raise NotRun(f"{errors[0]} fails with one client already: {errors[0].answer}")
    with probe.fresh_sessions(len(_ENVS)) as policies:
        turns = list(_in_turns(*(_play(probe, policy, client) for client, policy in enumerate(policies))))
    expected = [iter(played) for played in alone]
    last: dict[int, _Turn] = {}
    for client, beside in turns:
        undisturbed = next(expected[client])
        mismatch = difference(undisturbed.answer, beside.answer)
        if mismatch is not None:
            yield _finding(client, undisturbed, beside, mismatch, last.get(1 - client))
            return
        last[client] = beside


def _play(probe: Probe, policy: RecordedClient, client: int) -> Iterator[_Turn]:
    """Play a client's episodes, one operation whenever the next turn is asked for."""
    for episode in range(_EPISODES):
        yield _Turn(spec.Method.RESET, episode, 0, policy.reset())
        for step in range(_STEPS):
            batch = [
                {**probe.observation(scene, step), spec.Obs.ENV_IDX: env}
                for env, scene in zip(_ENVS[client], _SCENES[client], strict=True)
            ]
            yield _Turn(spec.Method.UPDATE_OBS_BATCH, episode, step, policy.update_obs_batch(batch))
            yield _Turn(spec.Method.GET_ACTION_BATCH, episode, step, policy.get_action_batch(_ENVS[client]))


def _in_turns(first: Iterator[_Turn], second: Iterator[_Turn]) -> Iterator[tuple[int, _Turn]]:
    """Yield the turns of two clients, one of each in the order in which they happen, with the client's number."""
    for pair in itertools.zip_longest(first, itertools.chain(itertools.repeat(None, _BEHIND), second)):
        yield from ((client, turn) for client, turn in enumerate(pair) if turn is not None)


def _finding(client: int, alone: _Turn, beside: _Turn, mismatch: str, other: _Turn | None) -> Finding:
    index = 0
    if is_answer_list(alone.answer) and is_answer_list(beside.answer, len(alone.answer)):
        index = next(at for at, pair in enumerate(zip(alone.answer, beside.answer, strict=True)) if not same(*pair))
    return blame(
        f"{beside.method} returns other actions to a client together with another one than alone, from step "
        f"{beside.step} of its episode {beside.episode} on: clients share more than the model, and results "
        "depend on which other clients are served",
        expected="the action of this client alone on the server",
        got=mismatch,
        evidence={
            "client": client,
            "environment": _ENVS[client][index],
            "episode": beside.episode,
            "step": beside.step,
            "other_client_before": None if other is None else str(other),
            "alone": _shown(alone.answer, index),
            "beside": _shown(beside.answer, index),
        },
        fix=Fix(
            "advice", "store state in dicts by environment, and clear in reset_envs only the environments it names"
        ),
    )


def _shown(answer: Answer, index: int) -> Answer:
    if is_answer_list(answer):
        return first_step(answer[index])
    return str(answer) if isinstance(answer, PolicyServerError) else brief(answer)
