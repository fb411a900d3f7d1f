"""Records a model's inputs and outputs for an episode: a subprocess task in the policy's interpreter.

    {"policy_dir", "config", "manifest", "observations": [observation, ...]}
    one map for the load, one for the inference: a "result" or an "error". The result has "inputs", the argument of
    `predict`, "raw", its result, and "steps", the decoded actions; or "failed", an error after `predict` got them.

A value that cannot be encoded is replaced by its type's name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NoReturn

import numpy as np

from xpl.policy import Policy
from xpl.wire import packed
from xpl.worker.copies import copy_value
from xpl.worker.inprocess import on_model
from xpl.worker.loading import LoadError
from xpl.worker.subprocess_task import FAILURES, TaskRequest, pack_error, pack_result, run_once

_DEEPEST = 8


def main(request_path: str, answers: str) -> NoReturn:
    """Answer the request in a file, and end."""
    run_once(request_path, answers, _all)


def _all(order: TaskRequest) -> Iterator[bytes]:
    def play(model: Any) -> Iterator[bytes]:
        if not isinstance(model, Policy):
            yield pack_error(LoadError("the model is no xpl.Policy: it has no predict whose inputs could be recorded"))
            return
        yield pack_result(None)
        try:
            yield pack_result(_observe_predict(model, order["observations"]))
        except FAILURES as error:
            yield pack_error(error)

    return on_model(order, play)


def _observe_predict(model: Any, observations: list[Any]) -> dict[str, Any]:
    """Return inputs, output and action steps of the model at the last observation."""
    recorded: dict[str, Any] = {}
    predict = model.predict

    def watched(inputs: object, envs: object) -> Any:
        recorded["inputs"] = plain(inputs)
        raw = predict(inputs, envs)
        recorded["raw"] = plain(raw)
        return raw

    model.predict = watched
    model.reset()
    for observation in observations:
        model.update_obs(copy_value(observation))
    try:
        return {"steps": plain(model.get_action()), **recorded}
    except FAILURES as error:
        if "inputs" not in recorded:
            raise
        return {"steps": [], "failed": f"{type(error).__name__}: {error}", **recorded}


def plain(value: object, depth: int = _DEEPEST) -> Any:
    """Return a value that can be encoded: other objects are replaced by their type's name."""
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
