"""XPL174: Inference runs in evaluation mode and without gradients."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.adapter import ACTING, LOADING, Adapter
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, constant, last, self_attribute, targets

_WITHOUT: Final = frozenset(
    ("no_grad", "inference_mode", "set_grad_enabled", "requires_grad_", "detach", "predict_action")
)
_EVALUATES: Final = frozenset(("eval", "train", "requires_grad_", "compile", "export"))


@rule(code="XPL174", requirement="XPL-CON-7")
def training_mode(source: Source) -> Iterator[Finding]:
    """The network is asked in training mode, or with gradients.

    ## What it does
    Where the adapter itself puts weights into a torch network (`load_state_dict`), looks for `.eval()` in the modules
    that it reaches; where it calls that network itself, for `torch.no_grad()` or `torch.inference_mode()`. Networks
    that another package makes and calls are left alone.

    ## Why it matters
    In training mode dropout and batch statistics stay on: actions differ from call to call, and depend on which
    environments happen to be in the batch. With gradients every step keeps its graph, and memory grows.

    ## Example
    `self.network.load_state_dict(weights)` in `load`, and `self.network(batch)` in `predict`.

    ## Use instead
    `self.network.eval()` after loading, `with torch.inference_mode():` around the call.

    ## Fix safety
    No automatic fix: some networks sample by their dropout on purpose.
    """
    adapter = Adapter.of(source)
    loaded = _loaded(adapter)
    if not loaded:
        raise NotApplicable("the adapter loads no weights itself")
    words = {
        node.attr
        for file in source.python_files
        if source.parses(file)
        for node in source.nodes(file)
        if isinstance(node, ast.Attribute)
    }
    name, (file, node) = next(iter(loaded.items()))
    if not words & _EVALUATES:
        yield Finding(
            f"{name} stays in training mode: dropout and batch statistics make each answer another one",
            **source.at(file, node),
            expected=f"{name}.eval()",
            got=ast.unparse(node)[:80],
            fix=Fix("advice", f"{name}.eval() after its weights are loaded"),
        )
    if words & _WITHOUT:
        return
    for function in adapter.reach(*ACTING):
        for call in function.of(ast.Call):
            attribute = self_attribute(call.func)
            if f"self.{attribute}" in loaded and ast.unparse(call.func) in {
                f"self.{attribute}",
                f"self.{attribute}.forward",
            }:
                yield Finding(
                    f"{ast.unparse(call.func)} is called with gradients: every step keeps its graph, and memory grows",
                    **source.at(function.file, call),
                    expected="with torch.inference_mode():",
                    got=ast.unparse(call)[:80],
                    fix=Fix("advice", "with torch.inference_mode(): around the call"),
                )
                return


def _loaded(adapter: Adapter) -> dict[str, tuple[str, ast.AST]]:
    """Return the networks that the adapter puts weights into, by the names that they have, `self.` where it is kept."""
    found: dict[str, tuple[str, ast.AST]] = {}
    for function in adapter.reach(*LOADING):
        for call in function.of(ast.Call):
            if last(called(call)) != "load_state_dict" or not isinstance(call.func, ast.Attribute):
                continue
            name = ast.unparse(call.func.value)
            if "optim" in name or "sched" in name or constant(call.func.value) is not ...:
                continue
            found[name] = (function.file, call)
            for node in function.of(ast.Assign):
                for target in targets(node):
                    if ast.unparse(node.value).startswith(name) and (kept := self_attribute(target)):
                        found[f"self.{kept}"] = (function.file, call)
    return found
