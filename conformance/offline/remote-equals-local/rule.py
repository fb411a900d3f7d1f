"""XPL255: The adapter's actions differ when it is served."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl.client import PolicyServerError
from xpl.contract import Config
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline import inprocess
from xpl_cli.audit.served.exact_comparison import Mismatch, mismatch
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.recorded_client import Answer

_STEPS = 3
_ENVS = (5, 2)
_SIZE = (96, 128)
"""Of the images: large enough to travel through shared memory."""
_WAYS: dict[str, Config] = {
    "packed, in shared memory": {},
    "packed, in the message": {sdk.Capability.SHARED_MEMORY: False},
    "as plain msgpack": {sdk.Capability.PACKED: False},
}
"""Ways from client to server, and the options of the client that choose them."""
_ASKING = (sdk.Method.GET_ACTION, sdk.Method.GET_ACTION_BATCH)


@rule(code="XPL255", requirement="XPL-SRV-11", compares=True, tries="a run without the server")
def remote_equals_local(probe: Probe) -> Iterator[Finding]:
    """The adapter's actions differ when it is served.

    ## What it does
    Runs an episode of one environment and one of a batch twice: on the model itself, in a process of the adapter's
    interpreter without server and client, and through the server, packed, packed in shared memory, and as plain
    msgpack. Every action has to be equal to the last bit.

    ## Why it matters
    A policy is developed and measured in one process, and evaluated through a server. If its actions differ there,
    neither result holds for the other.

    ## Example
    Normalising `obs["state"]` in place inside a `try`: arrays from the wire are read-only, the exception is ignored,
    and the served model gets raw values.

    ## Use instead
    Rely on values, dtypes and shapes of an observation, not on the memory layout of its arrays; write to copies.

    ## Fix safety
    No automatic fix.
    """
    probe.require_answer()
    probe.require_deterministic()
    script = _script(probe)
    with probe.own_server({}) as server:
        served = [_played(probe, server.url, wishes, script) for wishes in _WAYS.values()]
    # As often as on the server, whose random numbers go on from episode to episode.
    alone = inprocess.answers(probe, script * len(_WAYS))
    for number, (way, remote) in enumerate(zip(_WAYS, served, strict=True)):
        local = alone[number * len(script) : (number + 1) * len(script)]
        first_mismatch = next(((at, one) for at, one in enumerate(map(_apart, remote, local)) if one is not None), None)
        if first_mismatch is not None:
            _require_repeatable(alone, inprocess.answers(probe, script * len(_WAYS)))
            yield _finding(script, way, *first_mismatch)
            return


def _script(probe: Probe) -> list[inprocess.Call]:
    script: list[inprocess.Call] = [(sdk.Method.RESET, ())]
    for step in range(_STEPS):
        script.append((sdk.Method.UPDATE_OBS, (probe.observation(_ENVS[0], step, size=_SIZE),)))
        script.append((sdk.Method.GET_ACTION, ()))
    script.append((sdk.Method.RESET, ()))
    for step in range(_STEPS):
        observations = [probe.observation(env, step, size=_SIZE) for env in _ENVS]
        script.append((sdk.Method.UPDATE_OBS_BATCH, (observations,)))
        script.append((sdk.Method.GET_ACTION_BATCH, (list(_ENVS),)))
    return script


def _played(probe: Probe, url: str, wishes: Config, script: list[inprocess.Call]) -> list[Answer]:
    with probe.connected(url, **wishes) as policy:
        return [getattr(policy, method)(*arguments) for method, arguments in script]


def _apart(remote: Answer, local: inprocess.Answer) -> Mismatch | None:
    """Return where an answer of the server and one of the model differ; two errors are alike."""
    failed = isinstance(remote, PolicyServerError)
    if failed or local.error is not None:
        if failed and local.error is not None:
            return None
        return Mismatch((), f"an error: {remote}" if failed else "an answer", f"an error: {local.error}")
    return mismatch(remote, local.result)


def _require_repeatable(first: list[inprocess.Answer], second: list[inprocess.Answer]) -> None:
    """Stop where two processes differ anyway, so that nothing can be said about the way between.

    Raises:
        NotApplicable: if they do.
    """
    if mismatch(*([(answer.result, answer.error) for answer in run] for run in (first, second))) is not None:
        raise NotApplicable("the model does not repeat itself bit for bit in another process")


def _finding(script: list[inprocess.Call], way: str, at: int, deviation: Mismatch) -> Finding:
    method, arguments = script[at]
    batch, call = divmod(at, len(script) // 2)
    when = f"step {(call - 1) // 2} of the {'batch' if batch else 'single'} episode"
    call_text = f"{method}({', '.join(map(str, arguments)) if method in _ASKING else ''})"
    where = "".join(f"[{part!r}]" for part in deviation.path) or "the whole answer"
    apart = "" if deviation.size is None else f" (apart by {deviation.size:.3g})"
    return blame(
        f"served, the adapter's result of {call_text} differs from that of the same model in one process: what was "
        "measured there is not what a robot gets",
        expected=f"{deviation.second} at {where}, as in one process",
        got=f"{deviation.first}{apart}, at {when}, sent {way}",
        fix=Fix(
            "advice",
            "compute actions from the observation's values alone: arrays from the wire are read-only, so write "
            "to copies",
        ),
    )
