"""Answers the same questions under one change of an adapter after another: a standing errand (`xpl.worker.errand`).

What an audit looks for a mistake with. The model is loaded once, as `xpl.worker.inprocess.load` reads, further "block",
its model_io block; then each order has

    "calls", a list of {"reset": True}, {"show": [[env, name], ...]} and {"ask": [env, ...]}; "observations", by name,
    those that were not in an order before; "seconds"; and "blocks", model_io blocks, or "changes" of encoded inputs
    one answer for whether the adapter can be asked so: its result is None, or the reason why not; then one for each
    block (its result is the chunk of every question) or change (`xpl.worker.encoded.play`), as far as the seconds reach
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

from xpl.policy import Policy
from xpl.worker import variants
from xpl.worker.encoded import play
from xpl.worker.errand import FAILURES, Order, Play, failed, result, stand
from xpl.worker.inprocess import load

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping


def main(asked: str, answers: str) -> NoReturn:
    """Load an adapter as one file says, answer what is asked about it, and end with the standard input."""
    stand(asked, answers, _loaded)


def _loaded(order: Order) -> tuple[bytes, Play]:
    try:
        model = load(order)
    except FAILURES as error:
        return failed(error), lambda _order: iter(())
    return result(None), Asked(model, order["block"]).answers


class Asked:
    """A loaded model and what it was shown."""

    def __init__(self, model: Any, block: Mapping[str, Any]) -> None:
        self._model, self._block = model, block
        self._shown: dict[str, Any] = {}
        self._variants: variants.Variants | None = None

    def answers(self, order: Order) -> Iterator[bytes]:
        """Yield the answers to an order, packed."""
        self._shown.update(order["observations"])
        why = self._unfit(order)
        yield result(why)
        if why is not None:
            return
        calls = [
            {**call, "show": [(env, self._shown[name]) for env, name in call["show"]]} if "show" in call else call
            for call in order["calls"]
        ]
        if "blocks" in order:
            self._variants = self._variants or variants.Variants(self._model, self._block)
            yield from self._variants.answers(order["blocks"], calls, order["seconds"])
        else:
            yield from play.changes(self._model, order["changes"], calls, order["seconds"])

    def _unfit(self, order: Order) -> str | None:
        if "blocks" in order:
            return variants.unfit(self._model)
        return None if isinstance(self._model, Policy) else "the adapter does not derive from xpl.Policy"
