"""XPL178: Inference reads no files and loads nothing."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, dotted, enclosing, is_conditional, last

_READS: Final = frozenset(
    (
        *(
            "torch.load",
            "np.load",
            "numpy.load",
            "json.load",
            "pickle.load",
            "yaml.safe_load",
            "yaml.load",
            "joblib.load",
        ),
        *("np.loadtxt", "h5py.File", "cv2.imread", "Image.open", "requests.get", "requests.post", "urlopen"),
        *("OmegaConf.load", "safetensors.torch.load_file", "load_file"),
    )
)
_LOADS: Final = frozenset(("from_pretrained", "snapshot_download", "hf_hub_download", "read_text", "read_bytes"))
_REMEMBERS: Final = frozenset(("cache", "lru_cache", "cached_property"))


@rule(code="XPL178", requirement="XPL-SRV-8")
def read_per_inference(source: Source) -> Iterator[Finding]:
    """A file is read, or something is loaded, at each observation or action.

    ## What it does
    Follows what `update_obs` and `get_action` call unconditionally, and looks for calls that read a file, load weights
    or statistics, or request something from another host. Not reported: calls in a branch, after an early return or in
    a cached function.

    ## Why it matters
    Reading from a shared disk takes milliseconds on one day and seconds on another, in the middle of an episode. The
    file may also change during a run; then the first episodes were run with another policy.

    ## Example
    `stats = json.load(open(self.stats_path))` in `get_action`.

    ## Use instead
    Read it in `load`, and store it in an attribute.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    at_start = {id(function.node) for name in LOADING if (function := adapter.method(name))}
    for function in _always(adapter, at_start):
        for call in function.of(ast.Call):
            if _is_read(call) and not _seldom(call, function):
                yield Finding(
                    f"{called(call)} runs at every step: each one waits for a disk or another host",
                    **source.at(function.file, call),
                    expected="reading it once, in load",
                    got=ast.unparse(call)[:80],
                    fix=Fix("advice", "read it in load, and keep it in an attribute"),
                )
                break


def _always(adapter: ModelClass, at_start: set[int]) -> list[Function]:
    """Return the functions that every observation or every action runs through."""
    functions = [function for name in (*OBSERVING, *ACTING) if (function := adapter.method(name))]
    visited = {id(function.node) for function in functions}
    for function in functions:
        for call in function.of(ast.Call):
            other = adapter.callee(function, call)
            if other is None or id(other.node) in visited | at_start or _remembers(other) or _seldom(call, function):
                continue
            visited.add(id(other.node))
            functions.append(other)
    return functions


def _remembers(function: Function) -> bool:
    return any(last(called(entry) or dotted(entry)) in _REMEMBERS for entry in function.node.decorator_list)


def _seldom(call: ast.Call, function: Function) -> bool:
    """Tell whether a call is made in some cases only."""
    is_nested = any(
        isinstance(entry, (ast.FunctionDef, ast.Lambda)) and entry is not function.node
        for entry in enclosing(call, function.up)
    )
    return is_nested or is_conditional(call, function.node, function.up)


def _is_read(call: ast.Call) -> bool:
    name = called(call)
    if name == "open":
        mode = constant(call.args[1]) if len(call.args) > 1 else "r"
        modes = [constant(entry.value) for entry in call.keywords if entry.arg == "mode"]
        return str((modes or [mode])[0]).startswith("r")
    return name in _READS or last(name) in _LOADS
