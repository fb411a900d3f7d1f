"""Faulty observations that an adapter must refuse: inputs that are missing, not finite, or of another type or shape."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from xpl import _spec as sdk
from xpl.client import PolicyServerError
from xpl_cli.audit.served.changed_inputs import state_keys
from xpl_cli.audit.served.compare import brief
from xpl_cli.audit.served.probe import blame

if TYPE_CHECKING:
    from xpl.contract import Entry, ObservationDict
    from xpl_cli.audit.rules.model import Finding, Fix
    from xpl_cli.audit.served.recorded_client import Answer, RecordedClient


@dataclass(frozen=True)
class FaultyInput:
    """An observation with one fault.

    Attributes:
        name: the input, as in a manifest.
        fault: what is wrong, in words.
        obs: the observation.
        names: an error is clear if it holds one of these.
    """

    name: str
    fault: str
    obs: ObservationDict
    names: tuple[str, ...]

    def is_named_by(self, error: PolicyServerError) -> bool:
        """Tell whether an error names what is at fault."""
        return any(name in str(error) for name in self.names)


def missing(obs: ObservationDict, name: str) -> Iterator[FaultyInput]:
    """Yield the observation without one input: all of it, one arm's share, a camera's picture, the whole group."""
    group, _, leaf = name.partition(".")
    if not leaf:
        yield FaultyInput(name, f"without {name}", _without(obs, group), (group,))
        return
    entries = obs[group]
    keys = state_keys(obs, leaf) if group == sdk.Obs.STATE else [leaf]
    yield FaultyInput(name, f"without {name}", {**obs, group: _without(entries, *keys)}, (leaf,))
    if len(keys) > 1:
        for key in keys:
            yield FaultyInput(name, f"without {key}", {**obs, group: _without(entries, key)}, (key,))
    if group == sdk.Obs.VISION:
        blind = _without(entries[leaf], sdk.Camera.COLOR)
        yield FaultyInput(name, f"with {name} that has no picture", {**obs, group: {**entries, leaf: blind}}, (leaf,))
    yield FaultyInput(name, f"without any {group}", _without(obs, group), (group, *entries))


def damaged(obs: ObservationDict, name: str) -> Iterator[FaultyInput]:
    """Yield the observation with one input damaged in different ways."""
    group, _, leaf = name.partition(".")
    if group == sdk.Obs.INSTRUCTION:
        yield FaultyInput(name, "a number", {**obs, group: 2.5}, (group,))
    elif group == sdk.Obs.VISION:
        camera = obs[group][leaf]
        for fault, picture in _pictures(camera[sdk.Camera.COLOR]):
            vision = {**obs[group], leaf: {**camera, sdk.Camera.COLOR: picture}}
            yield FaultyInput(name, fault, {**obs, group: vision}, (leaf,))
    else:
        key = state_keys(obs, leaf)[-1]
        for fault, values in _vectors(obs[group][key]):
            yield FaultyInput(name, fault, {**obs, group: {**obs[group], key: values}}, (leaf,))


def judge(
    policy: RecordedClient, cases: Iterable[FaultyInput], *, goes_on: str, unclear: str | None, fix: Fix
) -> Iterator[Finding]:
    """Show an adapter faulty observations, and yield what it does instead of refusing them with a clear error.

    Args:
        policy: a session.
        cases: the observations.
        goes_on: what to say where it answers with an action; `{name}` and `{faults}` stand for the input and what was
            wrong with it.
        unclear: what to say where it refuses with an error that does not name the input; None to say nothing.
        fix: advice.
    """
    failures: dict[tuple[str, str], list[tuple[FaultyInput, Answer]]] = {}
    for case in cases:
        answer = policy.act(case.obs)
        refused = isinstance(answer, PolicyServerError)
        message = unclear if refused else goes_on
        if message is not None and not (refused and case.is_named_by(answer)):
            failures.setdefault((case.name, message), []).append((case, answer))
    for (name, text), entries in failures.items():
        case, answer = entries[0]
        yield blame(
            text.format(name=name, faults=", ".join(entry.fault for entry, _ in entries)),
            expected=f"an error that names {case.names[0]}",
            got=f"{case.fault}: {answer if isinstance(answer, PolicyServerError) else brief(answer)}",
            fix=fix,
        )


def _pictures(image: np.ndarray) -> Iterator[tuple[str, object]]:
    yield "a picture of floats from 0 to 1", (image / 255.0).astype(np.float32)
    yield "a picture without channels", np.ascontiguousarray(image[:, :, 0])
    yield "a picture with the channels first", np.ascontiguousarray(image.transpose(2, 0, 1))
    yield "a picture with a fourth channel", np.concatenate([image, image[:, :, :1]], axis=2)


def _vectors(values: np.ndarray) -> Iterator[tuple[str, object]]:
    for fault, number in (("NaN", np.nan), ("infinity", np.inf)):
        other = np.array(values)
        other[-1] = number
        yield fault, other
    yield "text", [str(value) for value in values.tolist()]
    yield "one value too many", np.append(values, values[-1:])
    yield "another axis", values[None]
    if len(values) > 1:  # else it would be empty
        yield "one value too few", values[:-1].copy()


def _without(entries: Entry, *keys: str) -> ObservationDict:
    return {key: value for key, value in entries.items() if key not in keys}
