"""XPL153: The device comes from the configuration or the launcher."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, LOADING, OBSERVING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, enclosing, last

_DEVICE = re.compile(r"cuda(:\d+)?$")
_PLACES = frozenset(("to", "device", "set_device"))
_VISIBLE = "CUDA_VISIBLE_DEVICES"


@rule(code="XPL153", requirement="XPL-CFG-7")
def fixed_device(source: Source) -> Iterator[Finding]:
    """The model is put on one device, whatever the configuration says.

    ## What it does
    Looks in what `__init__`, `update_obs` and `get_action` reach for `.cuda()`, for "cuda" or "cuda:0" as a device
    without a condition, and for code that sets `CUDA_VISIBLE_DEVICES` itself. Not reported: a default of a setting, and
    a choice by `is_available()`.

    ## Why it matters
    A second server on the machine uses the same device and runs out of memory, and on a machine without a GPU the
    adapter cannot run at all. If the code sets the visible devices, the launcher's choice has no effect.

    ## Example
    `device = torch.device("cuda:0")`.

    ## Use instead
    `torch.device(config.get("device") or ("cuda" if torch.cuda.is_available() else "cpu"))`.

    ## Fix safety
    No automatic fix.
    """
    for function in ModelClass.of(source).reach(*LOADING, *OBSERVING, *ACTING):
        if "cuda" not in source.text(function.file).lower():
            continue
        for node in function.of(ast.Call, ast.Assign):
            device_text = _fixed(node)
            if device_text and not _is_chosen(node, function):
                yield Finding(
                    f"{device_text}: a setting of the device has no effect, and servers on one machine share one "
                    "device",
                    **source.at(function.file, node),
                    expected="a device from the configuration",
                    got=ast.unparse(node).split("\n")[0][:80],
                    fix=Fix("advice", "read the device from deploy.yml, and pass it on"),
                )
                break  # one device of a function is like the next


def _fixed(node: ast.AST) -> str:
    """Return how a node fixes the device, "" if it does not."""
    if isinstance(node, ast.Call):
        name = last(called(node)) or getattr(node.func, "attr", "")
        if name == "cuda" and isinstance(node.func, ast.Attribute) and not _arguments(node):
            return "the model goes to the first GPU"
        if name in _PLACES and node.args and _is_device(node.args[0]):
            return f"the model goes to {constant(node.args[0])}"
        for keyword in node.keywords:
            if keyword.arg == "device" and _is_device(keyword.value):
                return f"the model goes to {constant(keyword.value)}"
    target = node.targets[0] if isinstance(node, ast.Assign) else None
    if isinstance(node, ast.Assign) and isinstance(target, ast.Subscript) and constant(target.slice) == _VISIBLE:
        return f"the adapter sets {_VISIBLE} itself" if isinstance(constant(node.value), str) else ""
    return ""


def _arguments(call: ast.Call) -> bool:
    return bool(call.args) or any(keyword.arg != "non_blocking" for keyword in call.keywords)


def _is_device(node: ast.expr) -> bool:
    value = constant(node)
    return isinstance(value, str) and bool(_DEVICE.match(value))


def _is_chosen(node: ast.AST, function: Function) -> bool:
    """Tell whether a device is taken only under a condition about devices, or after one that raises."""
    for outer in enclosing(node, function.up):
        if isinstance(outer, (ast.If, ast.IfExp)) and re.search(r"cuda|device|gpu", ast.unparse(outer.test)):
            return True
    return any(
        "is_available" in ast.unparse(other.test) and other.lineno < node.lineno
        for other in function.of(ast.If)
        if hasattr(node, "lineno")
    )
