"""XPL221: Actions depend on more or fewer observations than the manifest declares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from xpl import _spec as spec
from xpl.contract import ObservationDict
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.served.changed_inputs import with_gripper
from xpl_cli.audit.served.compare import difference, first_step, is_answer_list, same
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer


@rule(code="XPL221", requirement="XPL-CFG-9", tries="long episodes and histories")
def declared_history(probe: Probe) -> Iterator[Finding]:
    """Actions depend on more or fewer observations than the manifest declares.

    ## What it does
    Runs two episodes that differ only in their first observation, until it is older than the history that policy.yml
    declares, and compares the last actions: they have to be equal. If policy.yml declares `kind: memory`, it runs
    episodes that start with different observations or a different number of them and end with the same ones: an action
    has to depend on the start. Temporal ensembling is excluded.

    ## Why it matters
    Evaluations that batch, replay or resume a policy rely on the declared history. A policy that uses older
    observations, for example a cache that is filled once, acts on a scene that has changed. A recurrent model whose
    state is discarded acts in every step as in the first one.

    ## Example
    Image features of the first step are kept for the whole episode. Or `hidden = None` in every `predict`.

    ## Use instead
    Declare what the policy uses (`temporal.history`, `kind: memory`), or drop older observations. Store recurrent state
    in `self.memory(env)`.

    ## Fix safety
    No automatic fix.
    """
    manifest = probe.package.manifest
    if not manifest:
        raise NotApplicable("no manifest declares a history")
    if manifest.temporal.ensembling is not None:
        raise NotApplicable("the manifest declares that earlier observations count for the whole chunk")
    probe.require_answer()
    history = manifest.reach
    if manifest.temporal.kind == "memory":
        yield from _nothing_kept(probe, history)
    else:
        yield from _too_much(probe, history)


def _too_much(probe: Probe, history: int) -> Iterator[Finding]:
    """Find an observation that counts although it is older than what is declared."""
    now = [probe.observation(0, step) for step in range(1, history + 1)]
    last = [_last_answer(probe, [_in_environment_0(probe, scene), *now]) for scene in (2, 3)]
    mismatch = difference(*last)
    if mismatch is not None:
        yield blame(
            f"the action of step {history} depends on the observation of step 0, although the manifest declares "
            f"a history of {history}: the policy acts on a scene that has changed",
            expected="the same action after another first observation",
            got=mismatch,
            evidence={
                "step": history,
                "declared_history": history,
                "first_actions": [first_step(answer) if is_answer_list(answer) else None for answer in last],
            },
            fix=Fix(
                "advice",
                "forget older observations, or declare the history or memory in policy.yml: an action that counts from "
                "the command before (delta_command) depends on all before it, which is memory",
            ),
        )
    elif same(*(_last_answer(probe, [_in_environment_0(probe, scene)]) for scene in (2, 3))):
        raise NotApplicable("two scenes give the same actions: which observations they depend on cannot be seen")


def _nothing_kept(probe: Probe, history: int) -> Iterator[Finding]:
    """Find that nothing counts of what is older than the history, although memory is declared."""
    if probe.profile.name is Profile.SHADOW:
        raise NotApplicable("only the real model has a memory, and in shadow mode there is none")
    now = [probe.observation(0, step) for step in range(4, 4 + history)]
    scenes = [_in_environment_0(probe, scene) for scene in range(4)]
    closed, opened = (_with_grippers(probe, scenes[0], value) for value in (spec.GRIPPER_CLOSED, spec.GRIPPER_OPEN))
    short = [[scenes[2]], [scenes[3]]]
    long = [[scenes[2], closed, scenes[3], scenes[1]], [scenes[3], opened, *scenes[:2]]]
    groups: list[list[list[Answer]]] = [short, long, [[]]]
    ended = [[_last_answer(probe, [*past, *now]) for past in pasts] for pasts in groups]
    if not all(same(answer, group[0]) for group in ended for answer in group):
        return
    if not all(same(group[0], ended[0][0]) for group in ended):
        if same(*_asked_twice(probe, now[0])):
            return  # it remembers how long the episode lasts
        raise NotApplicable(
            "actions vary from inference to inference: memory cannot be distinguished from random numbers"
        )
    yield blame(
        "policy.yml declares memory, and whatever was observed before, the same observation gives the same "
        "action: no state is carried from one observation to the next",
        expected="another action after other observations before",
        got="the same action after five sequences of up to four observations",
        evidence={"declared_history": history, "answer": first_step(ended[0][0])},
        fix=Fix("advice", "carry the recurrent state in self.memory(env), or declare the kind that the policy is"),
    )


def _asked_twice(probe: Probe, obs: ObservationDict) -> tuple[Answer, Answer]:
    with probe.run() as policy:
        return policy.act(obs), policy.get_action()


def _last_answer(probe: Probe, observations: Sequence[ObservationDict]) -> Answer:
    """Return the last answer of an episode in which every observation is asked about."""
    with probe.run() as policy:
        policy.reset()
        for obs in observations:
            policy.update_obs(obs)
            answer = policy.get_action()
    return answer


def _in_environment_0(probe: Probe, scene: int) -> ObservationDict:
    return {**probe.observation(scene), spec.Obs.ENV_IDX: 0}


def _with_grippers(probe: Probe, obs: ObservationDict, value: float) -> ObservationDict:
    for arm in probe.embodiment.arms:
        obs = with_gripper(obs, arm.prefix + spec.State.EE_JOINT_STATE, value)
    return obs
