"""XPL229: Observations between two get_action calls do not reach the model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from xpl import _spec as spec
from xpl.contract import ObservationDict
from xpl.manifest import ModelIO
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served import changed_inputs
from xpl_cli.audit.served.compare import first_step, is_answer_list, same
from xpl_cli.audit.served.effects import Scale, is_negligible, is_weak
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer

_GROUPS = {"images": spec.Obs.VISION, "state": spec.Obs.STATE}
"""Parts of an observation, as the model_io block calls them."""
_MANY = 12
"""Observations without a request between: more than the histories of the field."""
_Second = Callable[..., "Answer"]
"""Plays the episode with these observations after the first question, and returns the second answer."""


@rule(code="XPL229", requirement="XPL-EPI-8", tries="observations within a chunk")
def observations_between_inferences(probe: Probe) -> Iterator[Finding]:
    """Observations between two get_action calls do not reach the model.

    ## What it does
    Sends an observation, calls `get_action`, sends more observations, as a benchmark does while it executes a chunk,
    and calls `get_action` again. The second action must depend on the newest observation: it must differ from that of
    an adapter that got none of them, or all but the newest; and older ones must not affect it more than four times as
    much. With a declared history the observations in between must count, too: changing them changes the action by at
    least a thousandth of what changing the newest does. If the model_io block declares which inputs have a history,
    each of these is checked.

    ## Why it matters
    A policy that observes only once per chunk runs open loop, while the benchmark assumes feedback. With a history,
    frames at the wrong interval are inputs that the model never saw in training.

    ## Example
    `if self.queue: return self.queue.pop(0)` in `get_action`, whatever was observed since.

    ## Use instead
    Compute each action from the newest observation; the client decides how much of a chunk it executes.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    span = probe.package.manifest.reach
    observations = [{**probe.observation(scene, scene), spec.Obs.ENV_IDX: 0} for scene in range(max(span, 2) + 1)]
    first, *between, newest = observations

    def second(*observations: ObservationDict) -> Answer:
        with probe.run() as policy:
            policy.act(first)
            for obs in observations:
                policy.update_obs(obs)
            return policy.get_action()

    all_shown = second(*between, newest)
    if same(all_shown, second()):
        if same(probe.answer(first), probe.answer(newest)):
            raise NotApplicable("the actions do not depend on what is observed")
        yield _finding("is that of an adapter that got none of them: the chunk is executed open loop", all_shown)
        return
    if same(all_shown, second(*between)):
        if not same(probe.answer(between[-1]), probe.answer(newest)):
            yield _finding("depends on older ones, not on the newest: the policy lags behind", all_shown)
            return
        raise NotApplicable("the newest observation gives the same actions as the one before it")
    many = [{**probe.observation(scene, scene % 5), spec.Obs.ENV_IDX: 0} for scene in range(_MANY)]
    changed = _changed(newest, changed_inputs.present(newest))
    is_told_apart = not same(all_shown, second(*between, changed))
    if is_told_apart and same(second(*many, newest), second(*many, changed)):
        yield _finding(f"no longer depends on the newest one after {_MANY} others: the policy lags behind", all_shown)
        return
    if span > 1:
        yield from _with_a_history(probe, second, between, newest, all_shown)


def _with_a_history(
    probe: Probe, second: _Second, between: list[ObservationDict], newest: ObservationDict, all_shown: Answer
) -> Iterator[Finding]:
    """Find that what is older counts for more than the newest observation, or for nothing."""
    manifest = probe.package.manifest
    model_io, span = manifest.model_io or ModelIO(), manifest.reach
    stride = 1 if model_io.longest is None else model_io.longest.stride
    everything = changed_inputs.present(newest)
    renewed = second(*between, _changed(newest, everything))
    before = list(between)
    before[-stride] = _changed(before[-stride], everything)
    with_older = second(*before, newest)
    scale = Scale([all_shown, renewed, with_older])
    by_newest, by_older = scale.effect(all_shown, renewed), scale.effect(all_shown, with_older)
    if is_weak(by_newest, by_older):
        how = f"moves by {by_newest:.2g} of its spread with the newest, by {by_older:.2g} with the one {stride} before"
        yield _finding(f"{how}: it depends on older observations", all_shown)
        return
    alone: list[tuple[str, ...]] = [(_GROUPS[name],) for name in model_io.remembered]
    for parts in alone or [tuple(_GROUPS.values())]:
        names = [name for name in everything if name.partition(".")[0] in parts]
        others = second(*(_changed(obs, names) for obs in between), newest)
        of_newest = second(*between, _changed(newest, names))
        scale = Scale([all_shown, others, of_newest])
        if is_negligible(scale.effect(all_shown, others), scale.effect(all_shown, of_newest)):
            what = " and ".join(parts)
            problem = f"ignores {what} of the ones in between, although a history of {span} is declared"
            yield _finding(f"{problem}: frames are missing", all_shown)


def _changed(obs: ObservationDict, names: Iterable[str]) -> ObservationDict:
    """Return an observation with some inputs changed, the instruction not: an episode has one."""
    for name in names:
        obs = obs if name == spec.Obs.INSTRUCTION else changed_inputs.varied(obs, name)
    return obs


def _finding(problem: str, second: Answer) -> Finding:
    return blame(
        f"the action after observations in the middle of a chunk {problem}",
        expected="an action that depends on the newest observation, and on the declared history",
        got="the same actions as without it, or nearly",
        evidence={
            "shown": ["scene 0", "asked", "scene 1", "scene 2, ...", "asked"],
            "second_answer": first_step(second) if is_answer_list(second) else None,
        },
        fix=Fix("advice", "process every update_obs, and compute get_action from the newest observation"),
    )
