"""XPL412: Invalid requests are refused with an error of the environment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from xpl import _spec as sdk
from xpl.contract import Action
from xpl.simulator.process import EnvRaisedError
from xpl_cli.audit import Finding, rule
from xpl_cli.audit.environments.env_probe import EnvProbe, Offer, RunningEnv, motion
from xpl_cli.audit.environments.observed_episode import ObservedEpisode, difference

ACCIDENTS = frozenset(
    ("KeyError", "IndexError", "AttributeError", "TypeError", "NameError", "UnboundLocalError", "ZeroDivisionError")
)


@rule(code="XPL412", gate="offline", requirement="XPL-ENV-11", after=("env-runs",), tries="invalid requests")
def env_invalid_requests(env_probe: EnvProbe) -> Iterator[Finding]:
    """An invalid request is accepted, or refused only by an accidental exception.

    ## What it does
    Requests a task, a robot and an action type that env.yml does not declare, and sends actions that lack a key, have
    an additional one, or have another dimension, and one for an environment that does not exist. Each has to raise an
    error of the environment's own (no accidental KeyError or IndexError), and the robot has to stay where it was.

    ## Why it matters
    An action without the right gripper that is executed all the same moves a robot with half a command. An accidental
    exception does not tell the caller what was wrong.

    ## Example
    A misspelt task silently runs the first one.

    ## Use instead
    `xpl.action.ActionError` for actions, `ValueError` with the declared names for the rest.
    `xpl.environment.Environment`, which implements this for an author's `Episode`.

    ## Fix safety
    No automatic fix.
    """
    offer = env_probe.offers[0]
    expected = "an error that lists what env.yml declares"
    unknown = {"task": "no_such_task", "embodiment": "no_such_robot", sdk.Deploy.ACTION_TYPE: "telepathy"}
    if env_probe.manifest.scripted:
        del unknown["task"]  # a script is the same for any task
    for key, value in unknown.items():
        got = _made(env_probe, replace(offer, **{key: value}))
        if got is not None:
            yield env_probe.finding(
                f"{key} {value!r} is not declared, and requesting it {got}",
                expected=expected,
                got=got,
                advice="raise ValueError with the declared names",
            )
    for each in dict.fromkeys((offer, *(item for item in env_probe.tasks if item.action_type != offer.action_type))):
        yield from env_probe.report_failure(_mistakes(env_probe, each), f"{each} can run")


def _made(env_probe: EnvProbe, offer: Offer) -> str | None:
    """Return what is wrong with how an environment refuses what it does not offer, None if nothing is."""
    try:
        with env_probe.make_env(offer) as play:
            play.reset(0)
    except EnvRaisedError as error:
        return _accident(error)
    return "is accepted"


def _mistakes(env_probe: EnvProbe, offer: Offer) -> Iterator[Finding]:
    with env_probe.make_env(offer) as play:
        play.reset(0)
        (first,) = play.observe()
        right = motion(offer, first, 0)
        key = next(iter(right))
        for what, actions in (
            (f"an action without {key}", {0: {name: value for name, value in right.items() if name != key}}),
            ("an action with an additional key", {0: {**right, "no_such_key": np.zeros(1, np.float32)}}),
            (f"an action with an additional value in {key}", {0: {**right, key: np.append(right[key], np.float32(0))}}),
            ("an action for environment 7, of one", {7: right}),
        ):
            got = _sent(play, actions)
            (now,) = play.observe(0)
            moved = difference(ObservedEpisode((first,), {}), ObservedEpisode((now,), {}), env_probe.rest_tolerance)
            if got is None and moved is not None:
                got = f"moves the robot all the same ({moved})"
            if got is not None:
                yield env_probe.finding(
                    f"{offer}: {what} {got}",
                    expected="an error that says what is expected, and no motion",
                    got=got,
                    advice="check an action before anything moves, with xpl.action",
                )
                play.reset(0)


def _sent(play: RunningEnv, actions: Mapping[int, Action]) -> str | None:
    try:
        play.act(actions)
    except EnvRaisedError as error:
        return _accident(error)
    return "is executed"


def _accident(error: EnvRaisedError) -> str | None:
    return f"stops with an accidental {error}" if error.kind in ACCIDENTS else None
