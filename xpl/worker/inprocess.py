"""Plays a script on an adapter inside this very process, as somebody would who imports it: no server, no client.

What an audit compares the served adapter with. Standard library and numpy only. Script and answers lie in files
(`xpl.worker.errand`):

    {"policy_dir", "config", "manifest", "script": [[method, arguments], ...]}, further "shadow", as in the
    message by which a worker loads an adapter (`xpl.worker.main`), and "watch"
    one map for the load and one for each call: a "result" or an "error"; with "unreal": true where only the real model
    could have answered

Observations are handed over as a simulator makes them: arrays of their own that may be written to.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Callable, NoReturn

from xpl.manifest import Manifest
from xpl.policy import Policy
from xpl.worker.copies import own
from xpl.worker.errand import FAILURES, Order, carry_out, failed, result
from xpl.worker.lacking import ShadowError
from xpl.worker.loading import load_model_class


def load(order: Order) -> Any:
    """Return an adapter's model.

    Args:
        order: `policy_dir`, `config` and `manifest`; `shadow`: without the reference (`xpl.worker.shadow`);
            `watch`: what it does to its observations is noted (`xpl.worker.watch`).
    """
    policy_dir, config, manifest = Path(order["policy_dir"]), order["config"], order["manifest"]
    class_name = Manifest.parse(manifest).model_class
    if order.get("shadow"):
        from xpl.worker.shadow import load_shadow_class

        model_class: type = load_shadow_class(policy_dir, class_name)
    else:
        model_class = load_model_class(policy_dir, class_name)
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
        yield _called(model, method, arguments)


def _called(model: Any, method: str, arguments: Sequence[Any]) -> bytes:
    try:
        answer = getattr(model, method)(*map(own, arguments))
        return result(answer)  # what cannot travel is an error of the served adapter, too
    except FAILURES as error:
        return failed(error, **({"unreal": True} if isinstance(error, ShadowError) else {}))


def main(asked: str, answers: str) -> NoReturn:
    """Play the script in one file, write the answers to another, and end."""
    carry_out(asked, answers, _all)


def _all(order: Order) -> Iterator[bytes]:
    def script(model: Any) -> Iterator[bytes]:
        yield result(None)
        yield from play(model, order["script"])

    return on_model(order, script)


def on_model(order: Order, errand: Callable[[Any], Iterator[bytes]]) -> Iterator[bytes]:
    """Load an adapter's model and yield what an errand says of it; only the error, if it cannot be loaded.

    Args:
        order: as `load` reads it.
        errand: yields answers, packed, that for the load first.
    """
    try:
        model = load(order)
    except FAILURES as error:
        yield failed(error)
        return
    yield from errand(model)
