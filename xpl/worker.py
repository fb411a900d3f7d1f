"""The worker: runs one adapter in the policy's own interpreter and answers the front end over a private descriptor.

Standard library and numpy only. Requests and answers are maps (see `xpl.link`):

    {"op": "load", "policy_dir", "config", "manifest"}  -> {"ok": {"class", "methods"}}
    {"op": "call", "method", "args"}                    -> {"ok": result}
    {"op": "infer", "observation"}                      -> {"ok": actions, or a map that has them}
    anything that raises                                -> {"error": {"type", "message", "traceback"}}
"""

from __future__ import annotations

import importlib.util
import inspect
import os
import queue
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, Callable, NoReturn

from xpl import _spec as spec
from xpl import link


class LoadError(RuntimeError):
    """model.py does not offer what the contract asks for."""


class UnknownMethodError(AttributeError):
    """A call names a method that the adapter does not offer."""


def load_model_class(policy_dir: Path) -> type:
    """Import model.py of an adapter under a module name of its own and return its class `Model`.

    The package's `__init__.py` is not run. Relative imports work, and so do imports of the ecosystem's package where
    the adapter lies inside a checkout of it.

    Raises:
        LoadError: if there is no model.py or no class `Model` in it.
    """
    path = policy_dir / spec.File.MODEL_PY
    if not path.is_file():
        raise LoadError(f"{policy_dir} has no model.py")
    _offer_ecosystem(policy_dir)
    package = f"_xpl_policy_{policy_dir.name}"
    holder = ModuleType(package)
    holder.__path__ = [str(policy_dir)]
    sys.modules[package] = holder
    name = f"{package}.model"
    found = importlib.util.spec_from_file_location(name, path)
    if found is None or found.loader is None:
        raise LoadError(f"{path} cannot be imported")
    module = importlib.util.module_from_spec(found)
    sys.modules[name] = module
    found.loader.exec_module(module)
    model = getattr(module, spec.MODEL_CLASS, None)
    if not inspect.isclass(model):
        raise LoadError(f"{path} defines no class {spec.MODEL_CLASS}")
    return model


def _offer_ecosystem(policy_dir: Path) -> None:
    """Let an adapter inside an XPolicyLab checkout import that package, as its own server would."""
    root = policy_dir.parent.parent
    if (root / "model_template.py").is_file():
        sys.path[:0] = [str(root.parent), str(root)]


class Worker:
    """Executes the operations of one adapter, one after the other."""

    def __init__(self) -> None:
        self._model: Any = None
        self._methods: frozenset[str] = frozenset()

    def handle(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to one request; an exception of the adapter becomes an `error` answer."""
        operations: dict[str, Callable[[Mapping[str, Any]], Any]] = {
            "load": self._load,
            "call": self._call,
            "infer": self._infer,
        }
        try:
            return {"ok": operations[request["op"]](request)}
        # SystemExit, too: libraries that parse the command line end the process over an argument that is not theirs.
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever an adapter raises is reported, not fatal
            return {"error": describe(error)}

    def _load(self, request: Mapping[str, Any]) -> dict[str, Any]:
        from xpl.policy import Policy

        policy_dir = Path(request["policy_dir"])
        model_class = load_model_class(policy_dir)
        config = dict(request["config"])
        manifest = request.get("manifest") or {}
        if issubclass(model_class, Policy):
            config["manifest"] = manifest
        self._model = model_class(config)
        declared = tuple(manifest.get("methods") or ())
        offered = (*spec.CONTRACT_METHODS, *spec.HOOKS, spec.Method.INFER, *declared)
        self._methods = frozenset(
            name for name in offered if not name.startswith("_") and callable(getattr(self._model, name, None))
        )
        return {"class": model_class.__name__, "methods": sorted(self._methods)}

    def _call(self, request: Mapping[str, Any]) -> Any:
        if request["method"] not in self._methods:
            offered = ", ".join(sorted(self._methods))
            raise UnknownMethodError(f"the adapter has no method {request['method']!r}; it has {offered}")
        return getattr(self._model, request["method"])(*request["args"])

    def _infer(self, request: Mapping[str, Any]) -> Any:
        observation = request["observation"]
        if spec.Method.UPDATE_OBS not in self._methods and spec.Method.INFER in self._methods:
            return self._model.infer(observation)
        self._model.update_obs(observation)
        return self._model.get_action()


def describe(error: BaseException) -> dict[str, str]:
    """Return type, message and traceback of an exception, without this module's own frames."""
    frames = error.__traceback__.tb_next if error.__traceback__ else None
    text = "".join(traceback.format_exception(type(error), error, frames))
    message = f"the adapter called sys.exit({error.code!r})" if isinstance(error, SystemExit) else str(error)
    return {"type": type(error).__name__, "message": message or type(error).__name__, "traceback": text}


def main(descriptor: int) -> None:
    """Serve requests that arrive on a descriptor until it is closed.

    Adapters may print: standard output is joined to standard error, so the link stays clean. A thread reads the link,
    so that the worker ends with the front end even while the model computes.
    """
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the front end, which ends the worker in order
    channel = socket.socket(fileno=descriptor)
    channel.settimeout(None)
    requests: queue.Queue[Any] = queue.Queue()
    threading.Thread(target=_read_all, args=(channel, requests), daemon=True).start()
    worker = Worker()
    while True:
        _send(channel, worker.handle(requests.get()))


def _read_all(channel: socket.socket, requests: queue.Queue[Any]) -> None:
    while True:
        try:
            message = receive(channel)
        except link.LinkError as error:
            sys.stderr.write(f"[worker] {error}\n")
            message = None
        if message is None:
            _end()
        requests.put(message)


def _end() -> NoReturn:
    """End at once, with all child processes: the front end is gone, the main thread may be deep inside the model."""
    if os.getpid() == os.getpgrp():  # the front end starts a worker as the leader of a group of its own
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(0)


def _send(channel: socket.socket, answer: dict[str, Any]) -> None:
    try:
        pieces = link.encode(answer)
    except Exception as error:  # noqa: BLE001 - also what a library's own array type raises while it is converted
        pieces = link.encode({"error": {**describe(error), "unserialisable": True}})
    try:
        for piece in pieces:
            channel.sendall(piece)
    except OSError:
        _end()


def receive(channel: socket.socket) -> Any | None:
    """Return the next message of a blocking socket, or None at its end.

    Raises:
        LinkError: if what arrives is not a message.
    """
    prefix = _exactly(channel, link.PREFIX_BYTES)
    if prefix is None:
        return None
    header = _exactly(channel, link.header_length(bytes(prefix)))
    if header is None:
        return None
    tree, sizes = link.parse_header(bytes(header))
    buffers = [_exactly(channel, size) for size in sizes]
    if any(buffer is None for buffer in buffers):
        return None
    return link.decode(tree, [memoryview(buffer) for buffer in buffers if buffer is not None])


def _exactly(channel: socket.socket, size: int) -> bytearray | None:
    data = bytearray(size)
    view = memoryview(data)
    while view:
        try:
            count = channel.recv_into(view)
        except OSError:
            return None
        if not count:
            return None
        view = view[count:]
    return data
