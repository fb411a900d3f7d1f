"""Shows an adapter an episode and tells what its model gets and says: an errand in the policy's interpreter.

    {"policy_dir", "config", "manifest", "observations": [observation, ...]}
    one map for the load, one for the question: a "result" or an "error". The result has "inputs", what `predict` got,
    "raw", what it answered, and "steps", what became of that; or "failed", why nothing did.

What cannot travel, such as an object of a library of its own, is told by its type.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NoReturn

import numpy as np

from xpl.policy import Policy
from xpl.wire import packed
from xpl.worker.copies import own
from xpl.worker.errand import FAILURES, Order, carry_out, failed, result
from xpl.worker.inprocess import on_model
from xpl.worker.loading import LoadError

_DEEPEST = 8


def main(asked: str, answers: str) -> NoReturn:
    """Show what one file says, write what was seen to another, and end."""
    carry_out(asked, answers, _all)


def _all(order: Order) -> Iterator[bytes]:
    def play(model: Any) -> Iterator[bytes]:
        if not isinstance(model, Policy):
            yield failed(LoadError("the model is no xpl.Policy: it has no predict whose inputs could be shown"))
            return
        yield result(None)
        try:
            yield result(_seen(model, order["observations"]))
        except FAILURES as error:
            yield failed(error)

    return on_model(order, play)


def _seen(model: Any, observations: list[Any]) -> dict[str, Any]:
    """Return what the model got at the last of some observations, and what came of it."""
    told: dict[str, Any] = {}
    predict = model.predict

    def watched(inputs: object, envs: object) -> Any:
        told["inputs"] = plain(inputs)
        raw = predict(inputs, envs)
        told["raw"] = plain(raw)
        return raw

    model.predict = watched
    model.reset()
    for observation in observations:
        model.update_obs(own(observation))
    try:
        return {"steps": plain(model.get_action()), **told}
    except FAILURES as error:
        if "inputs" not in told:
            raise
        return {"steps": [], "failed": f"{type(error).__name__}: {error}", **told}


def plain(value: object, depth: int = _DEEPEST) -> Any:
    """Return a value that can travel: maps, lists, texts, numbers and arrays as they are, all else by its type."""
    if isinstance(value, Mapping) and depth:
        return {str(key): plain(item, depth - 1) for key, item in value.items()}
    if isinstance(value, (list, tuple)) and depth:
        return [plain(item, depth - 1) for item in value]
    if isinstance(value, np.ndarray):
        value = value.copy()
    try:
        packed.encode(value)
    except (packed.PackingError, TypeError, ValueError, OverflowError):
        return f"<{type(value).__module__}.{type(value).__qualname__}>"
    return value
