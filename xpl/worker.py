"""The worker: runs one adapter in the policy's own interpreter and answers the front end over a private descriptor.

Standard library and numpy only. Messages are packed maps (see `xpl.link`):

    {"op": "load", "policy_dir", "config", "manifest"}  -> {"ok": {"class", "methods", "shared"}}
    {"op": "run", "requests": [...]}                    -> {"answers": [one answer for each request]}
    {"op": "map", "segment", "path", "size"}            -> {"ok": None}; arrays of requests may lie there from now on
    {"op": "unmap", "segment"}                          -> {"ok": None}

A request of `run` is `{"client", "method", "payload": packed map, "segment", "optional"}`; its method is `infer` or
what a client may call. The answer to it is `{"ok": packed map}` of the entries that the wire's answer gets. Whatever
raises is answered by `{"error": {"type", "message", "traceback"}}`, with `"refused": true` where the request itself was
wrong and `"unserialisable": true` where the result cannot travel.
"""

from __future__ import annotations

import faulthandler
import functools
import os
import select
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, NoReturn

from xpl import _spec as spec
from xpl import packed
from xpl.link import Channel
from xpl.loading import check_shareable, load_model_class

if TYPE_CHECKING:
    from xpl.segment import Window
    from xpl.sharing import SharedModel


class RefusedError(ValueError):
    """A request asks for what the adapter does not offer, or lacks what it needs."""


class Worker:
    """Executes the operations of one adapter, one after the other."""

    def __init__(self) -> None:
        self._model: Any = None
        self._methods: frozenset[str] = frozenset()
        self._shared: SharedModel | None = None
        self._windows: dict[int, Window] = {}

    def handle(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to one message of the front end; whatever an adapter raises becomes an `error`."""
        operations: dict[str, Callable[[Mapping[str, Any]], Any]] = {
            "load": self._load,
            "map": self._map,
            "unmap": self._unmap,
        }
        if message["op"] == "run":
            return {"answers": self._run(message["requests"])}
        return _attempt(functools.partial(operations[message["op"]], message))

    # -- between requests ----------------------------------------------------------------------------------------------

    def _load(self, message: Mapping[str, Any]) -> dict[str, Any]:
        from xpl.policy import Policy

        policy_dir = Path(message["policy_dir"])
        model_class = load_model_class(policy_dir)
        config = dict(message["config"])
        manifest = message.get("manifest") or {}
        if issubclass(model_class, Policy):
            config["manifest"] = manifest
        declared = tuple(manifest.get("methods") or ())
        shared = bool((manifest.get("serving") or {}).get("shared"))
        offered = (*spec.CONTRACT_METHODS, *spec.HOOKS, spec.Method.INFER, *declared)
        if shared:
            check_shareable(model_class, (*spec.HOOKS, *declared))
        self._model = model_class(config)
        self._methods = frozenset(
            name for name in offered if not name.startswith("_") and callable(getattr(self._model, name, None))
        )
        if shared:
            from xpl.sharing import SharedModel

            self._shared = SharedModel(self._model)
        return {"class": model_class.__name__, "methods": sorted(self._methods), "shared": shared}

    def _map(self, message: Mapping[str, Any]) -> None:
        from xpl.segment import Window

        self._windows[message["segment"]] = Window(message["path"], message["size"])

    def _unmap(self, message: Mapping[str, Any]) -> None:
        self._windows.pop(message["segment"], None)  # adapters may keep what they have seen there

    # -- requests ------------------------------------------------------------------------------------------------------

    def _run(self, requests: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        if self._shared is not None:
            return self._run_shared(self._shared, requests)
        return [self._answer(request, functools.partial(self._perform, request)) for request in requests]

    def _run_shared(self, shared: SharedModel, requests: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        from xpl.sharing import Request

        results = [_tried(functools.partial(self._argument, request)) for request in requests]
        understood = [place for place, result in enumerate(results) if not isinstance(result, Exception)]
        asked = [Request(requests[place]["client"], requests[place]["method"], results[place]) for place in understood]
        for place, result in zip(understood, shared.run(asked)):
            results[place] = result
        return [self._answer(request, functools.partial(_raised, result)) for request, result in zip(requests, results)]

    def _perform(self, request: Mapping[str, Any]) -> Any:
        method, argument = request["method"], self._argument(request)
        if method not in self._methods and method != spec.Method.INFER:
            return None  # an optional one: `_argument` lets no other pass
        if method == spec.Method.INFER or (method == spec.Method.GET_ACTION and isinstance(argument, Mapping)):
            return self._infer(argument)
        if method in (spec.Method.RESET, spec.Method.GET_ACTION):
            return getattr(self._model, method)()
        return getattr(self._model, method)() if argument is None else getattr(self._model, method)(argument)

    def _infer(self, observation: Any) -> Any:
        if spec.Method.UPDATE_OBS not in self._methods and spec.Method.INFER in self._methods:
            return self._model.infer(observation)
        self._model.update_obs(observation)
        return self._model.get_action()

    def _argument(self, request: Mapping[str, Any]) -> Any:
        """Return the argument of a request's method.

        Raises:
            RefusedError: if the adapter has no such method, or the argument is of the wrong kind.
            PackingError: if the payload is damaged.
        """
        method = request["method"]
        payload = self._payload(request)
        if method == spec.Method.INFER:
            observation = payload.get(spec.Payload.OBSERVATION)
            if not isinstance(observation, dict):
                raise RefusedError("infer needs a payload with an observation map")
            return observation
        if method not in self._methods and not request.get("optional"):
            offered = ", ".join(sorted(self._methods))
            raise RefusedError(f"the adapter has no method {method!r}; it has {offered}")
        if method in spec.HOOKS:
            return payload
        argument = payload.get(spec.Payload.OBS)
        wanted = {spec.Method.UPDATE_OBS: dict, spec.Method.UPDATE_OBS_BATCH: list}.get(method)
        if wanted is not None and not isinstance(argument, wanted):
            kind = "map" if wanted is dict else "list"
            raise RefusedError(f"{method} needs a payload with obs, a {kind}; got {type(argument).__name__}")
        return argument

    def _payload(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        window = self._windows.get(request.get("segment") or 0)
        payload = packed.decode(request[spec.Frame.PAYLOAD].data, None if window is None else window.find)
        if not isinstance(payload, dict):
            raise RefusedError(f"a packed payload must be a map, got {type(payload).__name__}")
        return payload

    def _answer(self, request: Mapping[str, Any], action: Callable[[], Any]) -> dict[str, Any]:
        answer = _attempt(action)
        if "error" in answer:
            return answer
        result = answer["ok"]
        entries: Any = {}
        if request["method"] == spec.Method.INFER:
            passes = isinstance(result, Mapping) and spec.Payload.ACTIONS in result
            entries = result if passes else {spec.Payload.ACTIONS: result}
        elif result is not None:
            entries = {spec.Payload.RESULT: result}
        try:
            return {"ok": packed.Packed(b"".join(packed.encode(entries)))}
        except Exception as error:  # noqa: BLE001 - also what a library's own array type raises while it is converted
            return {"error": {**describe(error), "unserialisable": True}}


def _tried(action: Callable[[], Any]) -> Any:
    """Return the value of an action, or the exception that it raised."""
    try:
        return action()
    except Exception as error:  # noqa: BLE001 - reported with the request that it belongs to
        return error


def _raised(result: Any) -> Any:
    if isinstance(result, BaseException):
        raise result
    return result


def _attempt(action: Callable[[], Any]) -> dict[str, Any]:
    try:
        return {"ok": action()}
    # SystemExit, too: libraries that parse the command line end the process over an argument that is not theirs.
    except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever an adapter raises is reported, not fatal
        refused = isinstance(error, (RefusedError, packed.PackingError))
        return {"error": {**describe(error), **({"refused": True} if refused else {})}}


def describe(error: BaseException) -> dict[str, str]:
    """Return type, message and traceback of an exception, without this module's own frames."""
    frames = error.__traceback__.tb_next if error.__traceback__ else None
    text = "".join(traceback.format_exception(type(error), error, frames))
    message = f"the adapter called sys.exit({error.code!r})" if isinstance(error, SystemExit) else str(error)
    return {"type": type(error).__name__, "message": message or type(error).__name__, "traceback": text}


def main(descriptor: int) -> None:
    """Serve messages that arrive on a descriptor until it is closed.

    Adapters may print: standard output is joined to standard error, so the link stays clean. A thread watches the link,
    so that the worker ends with the front end even while the model computes. SIGUSR1 prints where it is.
    """
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the front end, which ends the worker in order
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    os.set_inheritable(descriptor, False)  # noqa: FBT003 - positional only
    channel = socket.socket(fileno=descriptor)
    channel.settimeout(None)
    threading.Thread(target=_watch, args=(descriptor,), daemon=True).start()
    link, worker = Channel(channel), Worker()
    try:
        while True:
            message = link.receive()
            if message is None:
                _end()
            answer = worker.handle(packed.decode(message, whole=False))
            del message  # what it holds may be large, and the next one may be long in coming
            link.send(answer)
    except packed.PackingError as error:
        sys.stderr.write(f"[worker] {error}\n")
    except OSError:
        pass
    _end()


def _watch(descriptor: int) -> None:
    """Wait until the other end of the link is closed."""
    poll = select.poll()
    poll.register(descriptor, 0)  # a hang-up is reported unasked
    while not any(event & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, event in poll.poll()):
        pass
    _end()


def _end() -> NoReturn:
    """End at once, with all child processes: the front end is gone, the main thread may be deep inside the model."""
    if os.getpid() == os.getpgrp():  # the front end starts a worker as the leader of a group of its own
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(0)
