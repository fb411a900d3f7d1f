"""Makes of models and helpers that adapters have in common, as stand-ins of their own.

Data: a map from names to classes and functions. A name that is not here is a thing.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any, Callable

from xpl import _spec as spec
from xpl.worker.standins.facts import Facts
from xpl.worker.standins.given import Given
from xpl.worker.standins.origins import Origin, origin
from xpl.worker.standins.things import Thing


def known(facts: Facts) -> dict[str, Any]:
    """Return what stands in for which name."""
    return {
        "*.dict_apply": dict_apply,
        "*.tree_map": lambda function, tree, *_: dict_apply(tree, function),
        "tqdm.tqdm": lambda items=(), *_, **__: items,
        "tqdm.auto.tqdm": lambda items=(), *_, **__: items,
        "easydict.EasyDict": Fields,
        "addict.Dict": Fields,
        "ml_collections.ConfigDict": Fields,
        "termcolor.cprint": _told,
        "termcolor.colored": lambda text, *_, **__: text,
        "dotenv.load_dotenv": lambda *_, **__: False,
        "*.WebsocketClientPolicy": type("WebsocketClientPolicy", (_Client,), {"facts": facts}),
    }


class Fields(dict):  # type: ignore[type-arg]
    """A map whose entries are attributes, too."""

    def __init__(self, *entries: Any, **named: Any) -> None:
        super().__init__()
        for key, item in dict(*entries, **named).items():
            self[key] = item

    def __setitem__(self, key: Any, item: Any) -> None:
        super().__setitem__(key, type(self)(item) if type(item) is dict else item)

    def update(self, *entries: Any, **named: Any) -> None:
        for key, item in dict(*entries, **named).items():
            self[key] = item

    def __getattr__(self, name: str) -> Any:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None

    def __setattr__(self, name: str, item: Any) -> None:
        self[name] = item


def dict_apply(tree: Any, function: Callable[[Any], Any]) -> Any:
    """Apply a function to the leaves of maps; a thing stays what it is."""
    if isinstance(tree, Thing):
        return tree
    if isinstance(tree, Mapping):
        return {key: dict_apply(item, function) for key, item in tree.items()}
    return function(tree)


def _told(text: Any = "", *_: Any, **__: Any) -> None:
    sys.stdout.write(f"{text}\n")


class _Client(Thing):
    """A client of an inference server: openpi's, and what follows it."""

    facts: Facts

    def get_server_metadata(self) -> dict[str, Any]:
        """Return what the server says of itself."""
        return {"action_dim": self.facts.width, "action_horizon": self.facts.steps}

    def infer(self, obs: Any, *_: Any, **__: Any) -> Any:
        """Return a chunk under any key."""
        return self._answer(spec.Method.INFER, obs)

    def predict_action(self, request: Any, *_: Any, **__: Any) -> Any:
        """Return a chunk as servers of vision-language-action frameworks wrap it."""
        return {"status": "ok", "ok": True, "data": _Map(self._answer("predict_action", request))}

    def reset(self, *_: Any, **__: Any) -> None:
        """Forget what came before."""
        origin(self).memory.clear()

    def _answer(self, verb: str, shown: Any) -> Any:
        memory = origin(self).memory
        given = Given(verb, (shown,), {}, memory)
        given.alone = verb == spec.Method.INFER
        memory.remember(given)
        return Thing(Origin(f"client.{verb}()", memory, given))


class _Map(dict):  # type: ignore[type-arg]
    """A map that has an answer under each key that speaks of actions."""

    def __init__(self, answer: Thing) -> None:
        super().__init__({name: answer[name] for name in ("normalized_actions", spec.Payload.ACTIONS)})
