"""Answers of an adapter under one change after another: a persistent subprocess task (`xpl.worker.subprocess_task`).

The audit's mistake search uses it. The first request loads the model once; it has the keys of
`xpl.worker.inprocess.load`, and "block", the adapter's model_io block. Each further request has

    "calls", a list of {"reset": True}, {"show": [[env, name], ...]} and {"ask": [env, ...]}; "observations", by name,
    those that no earlier request had; "seconds"; and "blocks", model_io blocks, or "changes" of encoded inputs
    one answer for whether the task applies to the adapter: its result is None, or the reason why not; then one for each
    block (its result is the chunks of all inferences) or change (`xpl.worker.encoded.play`), until the time limit
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

from xpl.policy import Policy
from xpl.worker import block_answers
from xpl.worker.encoded import play
from xpl.worker.inprocess import load
from xpl.worker.subprocess_task import FAILURES, Answering, TaskRequest, pack_error, pack_result, serve_requests

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


def main(request_path: str, answers: str) -> NoReturn:
    """Load the adapter of a request, answer further requests, and end at the end of standard input."""
    serve_requests(request_path, answers, _loaded)


def _loaded(order: TaskRequest) -> tuple[bytes, Answering]:
    try:
        model = load(order)
    except FAILURES as error:
        return pack_error(error), lambda _order: iter(())
    return pack_result(None), PerturbedModel(model, order["block"]).answers


class PerturbedModel:
    """A loaded model and its observations."""

    def __init__(self, model: Any, block: Mapping[str, Any]) -> None:
        self._model, self._block = model, block
        self._observations: dict[str, Any] = {}
        self._variants: block_answers.BlockAnswers | None = None

    def answers(self, order: TaskRequest) -> Iterator[bytes]:
        """Yield the answers to a request, packed."""
        self._observations.update(order["observations"])
        why = self._unfit(order)
        yield pack_result(why)
        if why is not None:
            return
        calls = [
            {**call, "show": [(env, self._observations[name]) for env, name in call["show"]]}
            if "show" in call
            else call
            for call in order["calls"]
        ]
        if "blocks" in order:
            self._variants = self._variants or block_answers.BlockAnswers(self._model, self._block)
            yield from self._variants.answers(order["blocks"], calls, order["seconds"])
        else:
            yield from play.changes(self._model, order["changes"], calls, order["seconds"])

    def _unfit(self, order: TaskRequest) -> str | None:
        if "blocks" in order:
            return block_answers.why_converts_in_code(self._model)
        return None if isinstance(self._model, Policy) else "the adapter does not derive from xpl.Policy"
