"""Writes the calls of named functions to files, in each process whose PYTHONPATH contains this folder.

A tap records what reaches a function of a third party, such as a simulator's `step`, whoever calls it: the authors'
loop or ours. It wraps the function when its module has been imported, and imports nothing by itself.

`AUTHORS_LOOPS_TAPS` is JSON: `folder` of the files, `taps` (name -> `module:Class.method` or `module:function`), and
`steps`, after which a call of the tap `step` raises `EndOfTrial`. Each outermost call becomes one file,
`TIME-NAME.npz`: arguments before the call as `in/NAME/...`, the result as `out/...`. What is neither number nor text,
nor an image, a mapping or a sequence of these, is left out.
"""

from __future__ import annotations

import functools
import importlib.abc
import importlib.util
import inspect
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

VARIABLE = "AUTHORS_LOOPS_TAPS"


class EndOfTrial(BaseException):
    """As many steps were executed as were asked for. No `except Exception` of a loop catches it."""


class _Taps(importlib.abc.MetaPathFinder):
    """Wraps functions of a module when it is imported."""

    def __init__(self, folder: str, taps: Mapping[str, str], steps: int) -> None:
        self._folder, self._left = Path(folder), steps
        self._taps: dict[str, list[tuple[str, str]]] = {}
        for name, target in taps.items():
            module, _, path = target.partition(":")
            self._taps.setdefault(module, []).append((name, path))
        self._running: set[str] = set()

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> Any:  # noqa: ARG002 - the protocol's
        if fullname not in self._taps:
            return None
        taps = self._taps.pop(fullname)
        spec = importlib.util.find_spec(fullname)
        if spec is None or spec.loader is None:
            return spec
        loader: Any = spec.loader
        execute = loader.exec_module

        def execute_and_wrap(module: Any) -> None:
            loader.exec_module = execute
            execute(module)
            for name, attributes in taps:
                *owners, last = attributes.split(".")
                owner = functools.reduce(getattr, owners, module)
                function = getattr(owner, last)
                tapped = self._wrap(function, name)
                setattr(owner, last, staticmethod(tapped) if inspect.ismethod(function) else tapped)

        loader.exec_module = execute_and_wrap
        return spec

    def _wrap(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def tapped(*args: Any, **kwargs: Any) -> Any:
            if name in self._running:  # an override calls what it overrides
                return function(*args, **kwargs)
            if name == "step":
                if not self._left:
                    raise EndOfTrial
                self._left -= 1
            arguments = signature.bind(*args, **kwargs).arguments
            found = dict(_values("in", {key: value for key, value in arguments.items() if key != "self"}))
            self._running.add(name)
            try:
                result = function(*args, **kwargs)
            finally:
                self._running.discard(name)
            self._write(name, {**found, **dict(_values("out", result))})
            return result

        return tapped

    def _write(self, name: str, values: Mapping[str, Any]) -> None:
        import numpy as np

        path = self._folder / f"{time.monotonic_ns():020}-{name}.npz"
        part = path.with_suffix(".part")
        with part.open("xb") as file:
            np.savez(file, **values)
        part.rename(path)


def _values(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and arrays of what is in a value, copied."""
    import numpy as np

    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _values(f"{name}/{key}", part)
    elif isinstance(value, (list, tuple)) and not all(isinstance(part, (int, float)) for part in value):
        for at, part in enumerate(value):
            yield from _values(f"{name}/{at}", part)
    elif hasattr(value, "detach"):  # of torch
        yield name, value.detach().cpu().double().numpy()
    elif type(value).__module__.partition(".")[0] in ("builtins", "numpy", "PIL", "jaxlib", "jax"):
        array = np.array(value, dtype=np.float64) if type(value).__module__.startswith("jax") else np.array(value)
        if array.dtype.kind in "biufU":
            yield name, array


if os.environ.get(VARIABLE):
    sys.meta_path.insert(0, _Taps(**json.loads(os.environ[VARIABLE])))
