"""Plays a script on an adapter inside this very process, as somebody would who imports it: no server, no client.

What an audit compares the served adapter with. Standard library and numpy only. Script and answers are packed maps
(`xpl.wire.packed`) in files:

    {"policy_dir", "config", "manifest", "script": [[method, arguments], ...]}, further what stands in for the model
    and whether it is watched, as in the message by which a worker loads an adapter (`xpl.worker.main`)
    one map for the load and one for each call, each after its length (u64, little endian) and written when it is known:
    a "result" or an "error"; with "unreal": true where only the real model, or a real module, could have answered

Whatever threads the adapter has left, the process ends when the script has ended. SIGUSR1 prints where it is.

Observations are handed over as a simulator makes them: arrays of their own that may be written to.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from xpl import _spec as spec
from xpl.policy import Policy
from xpl.wire import packed
from xpl.worker import stubs
from xpl.worker.copies import own
from xpl.worker.lacking import StandInError
from xpl.worker.loading import ecosystem, load_model_class

# SystemExit, too: see xpl.worker.main.
_FAILURES = (Exception, SystemExit)
LENGTH = struct.Struct("<Q")
"""What stands before each answer in the file."""


def load(order: Mapping[str, Any]) -> Any:
    """Return an adapter's model.

    Args:
        order: `policy_dir`, `config` and `manifest`; `shadow`: without the native model (`xpl.worker.shadow`);
            `stub_missing`: with stubs for modules that are not installed (`xpl.worker.stubs`); `watch`: what it does to
            its observations is noted (`xpl.worker.watch`).
    """
    policy_dir, config, manifest = Path(order["policy_dir"]), order["config"], order["manifest"]
    if order.get("stub_missing"):
        stubs.Stubs(policy_dir, [policy_dir, *ecosystem(policy_dir)]).install()
    model_class = load_model_class(policy_dir)
    if order.get("shadow"):
        from xpl.worker.shadow import shadow_of

        model_class = shadow_of(model_class)
    model = model_class({**config, "manifest": manifest} if issubclass(model_class, Policy) else dict(config))
    if not order.get("watch"):
        return model
    from xpl.worker.watch import Watched

    return Watched(model)


def play(model: Any, script: Sequence[Sequence[Any]]) -> Iterator[bytes]:
    """Call the methods of a script and yield each result, packed before the next call can change it.

    Args:
        model: an adapter's model.
        script: pairs of a method's name and its arguments.
    """
    for method, arguments in script:
        yield b"".join(packed.encode(_called(model, method, arguments)))


def _called(model: Any, method: str, arguments: Sequence[Any]) -> dict[str, Any]:
    try:
        result = getattr(model, method)(*map(own, arguments))
        stubs.check()
        packed.encode(result)  # what cannot travel is an error of the served adapter, too
    except _FAILURES as error:
        stands_in = isinstance(error, StandInError) or stubs.asked() is not None
        return {"error": f"{type(error).__name__}: {error}", **({"unreal": True} if stands_in else {})}
    return {spec.Payload.RESULT: result}


def main(script: str, answers: str) -> NoReturn:
    """Play the script in one file, write the answers to another, and end."""
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    asked = packed.decode(Path(script).read_bytes())
    with Path(answers).open("wb", buffering=0) as told:
        try:
            model = load(asked)
        except _FAILURES as error:
            _tell(told, b"".join(packed.encode({"error": f"{type(error).__name__}: {error}"})))
        else:
            _tell(told, b"".join(packed.encode({spec.Payload.RESULT: None})))
            for answer in play(model, asked["script"]):
                _tell(told, answer)
    sys.stdout.flush()
    os._exit(0)  # an adapter's threads may go on for ever


def _tell(told: BinaryIO, answer: bytes) -> None:
    told.write(LENGTH.pack(len(answer)) + answer)
