"""XPL208: An episode depends on the previous one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from xpl import _spec as spec
from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.offline.in_process_run import InProcessRun
from xpl_cli.audit.served.compare import brief, difference, first_step, is_answer_list
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer, RecordedClient


@rule(code="XPL208", requirement="XPL-EPI-1", compares=True, tries="resets", handler=spec.Method.RESET)
def reset_forgets(probe: Probe, in_process_run: InProcessRun) -> Iterator[Finding]:
    """An episode depends on the previous one.

    ## What it does
    Runs the same episode after different ones and compares it: after another scene of other length in another
    environment; after a longer one in the same environment with the same instruction; after the same scene with other
    images, with another state, and with another instruction; after a batch. So a cache is found whatever its key is.
    The first two, and the one of another instruction, run in separate servers. A policy that seeds each episode by its
    number passes.

    ## Why it matters
    Only the first episode of a run is then comparable; success rates depend on the order of the tasks.

    ## Example
    reset clears the observation buffer but not the queue of remaining actions.

    ## Use instead
    Keep all episode state in the base class, or clear it in `reset_env`, which is called for every environment.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    probe.require_repeatable()  # which also settles whether resets seed generators
    with probe.fresh_session() as policy:
        _another_scene(probe, policy)
        expected = probe.episode(policy, env=1)
    if not any(map(is_answer_list, expected)):
        raise NotRun(f"in environment 1 every get_action fails: {brief(expected[0])}")
    for group in _BEFORE:
        found = _compared(probe, in_process_run, group, expected)
        if found is not None:
            yield found
            return


def _compared(
    probe: Probe,
    in_process_run: InProcessRun,
    group: Mapping[str, Callable[[Probe, RecordedClient], None]],
    expected: Sequence[Answer],
) -> Finding | None:
    """Return how an episode differs after one of several others, which are played on one server."""
    with probe.fresh_session() as policy:
        # Where the number of an episode makes a difference, only the second one of each server can be compared.
        for what, play in list(group.items())[: None if probe.repeats_in_place else 1]:
            play(probe, policy)
            for step, pair in enumerate(zip(expected, probe.episode(policy, env=1), strict=True)):
                mismatch = difference(*pair)
                if mismatch is not None:
                    probe.require_repeatable_afresh()
                    in_process_run.require_no_draws(probe)
                    return blame(
                        f"an episode depends on the previous one, {what}: state survives reset, and results "
                        "depend on the order of episodes",
                        expected="the actions of the same episode after one of another scene in another environment",
                        got=mismatch,
                        evidence={
                            "episode_before": what,
                            "step": step,
                            "expected_and_got": [
                                first_step(chunk) if is_answer_list(chunk) else brief(chunk) for chunk in pair
                            ],
                        },
                        fix=Fix("advice", "clear every buffer, cache, counter and chunk queue in reset"),
                    )
    return None


def _another_scene(probe: Probe, policy: RecordedClient) -> None:
    probe.episode(policy, env=0, steps=1)


def _same_environment(probe: Probe, policy: RecordedClient) -> None:
    _play(probe, policy, spec.Obs.VISION, spec.Obs.STATE)


def _other_pictures(probe: Probe, policy: RecordedClient) -> None:
    _play(probe, policy, spec.Obs.VISION)


def _other_state(probe: Probe, policy: RecordedClient) -> None:
    _play(probe, policy, spec.Obs.STATE)


def _other_instruction(probe: Probe, policy: RecordedClient) -> None:
    policy.reset()
    for step in range(4):
        policy.update_obs({**probe.observation(1, step), spec.Obs.INSTRUCTION: "put the other thing somewhere else"})
        policy.get_action()


def _batch(probe: Probe, policy: RecordedClient) -> None:
    policy.reset()
    policy.update_obs_batch(probe.observations([2, 1, 0]))
    policy.get_action_batch([0, 1])


def _shrunk(probe: Probe, policy: RecordedClient) -> None:
    policy.reset()
    for scenes in ((2, 1, 0), (2, 0)):
        policy.update_obs_batch(probe.observations(list(scenes)))
        policy.get_action_batch(list(scenes))


def _play(probe: Probe, policy: RecordedClient, *other: str) -> None:
    """Play an episode like the one that is compared, but longer and with some parts of another scene."""
    policy.reset()
    for step in range(4):
        scene = probe.observation(2, step)
        policy.update_obs({**probe.observation(1, step), **{part: scene[part] for part in other}})
        policy.get_action()


_BEFORE: tuple[Mapping[str, Callable[[Probe, RecordedClient], None]], ...] = (
    {
        "a longer one of another scene in the same environment with the same instruction": _same_environment,
        "one that differed in its images only": _other_pictures,
        "one that differed in its state only": _other_state,
        "one of three environments": _batch,
        "one of a batch in which this environment ended first": _shrunk,
    },
    {"one that differed in its instruction only": _other_instruction},
)
"""Episodes to play before, by what they are: whatever a cache is keyed by, one of them has it in common."""
