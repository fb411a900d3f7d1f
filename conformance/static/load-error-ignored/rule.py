"""XPL147: A part of the model that cannot be loaded is an error."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import LOADING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, dotted, is_broad, last

_LOADS = re.compile(r"(^|_)(load|restore|from_pretrained|build|create|make)(_|$)", re.IGNORECASE)
_PARTS = re.compile(
    r"model|weight|ckpt|checkpoint|encoder|tokenizer|processor|embed|stat|norm|adapter|lora|policy|backbone|vae|t5|dim|info",
    re.IGNORECASE,
)
_MISSING = frozenset(("FileNotFoundError", "OSError", "IOError", "KeyError"))
_EXISTS = frozenset(("exists", "is_file", "isfile", "isdir", "is_dir"))
_MADE = frozenset(("zeros", "ones", "rand", "randn", "eye", "zeros_like", "empty", "identity"))


@rule(code="XPL147", requirement="XPL-CKP-5")
def load_error_ignored(source: Source) -> Iterator[Finding]:
    """A part of the model that cannot be loaded is replaced or left out, and the run continues.

    ## What it does
    Looks in what `__init__` and `load` reach for handlers around the loading of a part that do not raise but replace it
    by None, a default or another part, and for functions that load a file if it exists and return zeros if it does not.

    ## Why it matters
    A policy without its text encoder moves; so does one with random weights, or with the dimensions of another robot.
    The message that says so was printed once, an hour before the user looked at the score.

    ## Example
    `try: encoder = load_encoder(path)` with `except Exception: print("using zeros"); encoder = None`.

    ## Use instead
    Let the exception pass; if a part is optional, let a setting decide whether to load it.

    ## Fix safety
    No automatic fix.
    """
    for function in ModelClass.of(source).reach(*LOADING):
        for node in function.of(ast.Try):
            part = _part(node.body)
            for handler in node.handlers if part else ():
                if _catches(handler) and (instead := _instead(handler)):
                    yield _finding(source, function, handler, f"{part} that fails", instead)
        yield from (
            _finding(source, function, node, f"{function.name} without its file", ast.unparse(node.value or node))
            for node in _stand_ins(function)
        )


def _finding(source: Source, function: Function, node: ast.AST, what: str, instead: str) -> Finding:
    return Finding(
        f"{what} is ignored, and the policy runs with {instead}: it moves, and its score is that of another model",
        **source.start(function.file, node),
        expected="an exception that names what is missing",
        got=ast.unparse(node).split("\n")[0],
        fix=Fix("advice", "raise an error; if a part is optional, let a setting decide"),
    )


def _part(body: list[ast.stmt]) -> str:
    """Return the call of a block that loads a part of the model, as it is written."""
    for statement in body:
        for node in ast.walk(statement):
            name = last(called(node))
            if not name or called(node).startswith(("yaml.", "json.", "importlib.")):
                continue
            whole = name in {"from_pretrained", "load_state_dict"}
            if whole or (_LOADS.search(name) and _PARTS.search(ast.unparse(node))):
                return called(node)
            if name.startswith("get_") and _PARTS.search(name):
                return called(node)
    return ""


def _catches(handler: ast.ExceptHandler) -> bool:
    if is_broad(handler):
        return True
    caught = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
    return any(entry is not None and last(dotted(entry)) in _MISSING for entry in caught)


def _instead(handler: ast.ExceptHandler) -> str:
    """Return what a handler puts in the place of the part, "" if it raises, tries again or loads something else."""
    inside = [child for entry in handler.body for child in ast.walk(entry)]
    if any(_LOADS.search(last(called(child))) for child in inside if isinstance(child, ast.Call)):
        return ""
    if _always_leaves(handler.body) or any(last(called(child)) in {"exit", "_exit"} for child in inside):
        return ""
    for entry in handler.body:
        value = getattr(entry, "value", None)
        if isinstance(entry, ast.Return):
            return ast.unparse(value) if value is not None else "nothing"
        if isinstance(entry, (ast.Assign, ast.AnnAssign)) and value is not None:
            return ast.unparse(value)
    return "" if any(isinstance(child, ast.Raise) for child in inside) else "nothing in its place"


def _always_leaves(body: list[ast.stmt]) -> bool:
    """Tell whether a handler ends in an exception, whatever the branch."""
    for entry in body:
        if isinstance(entry, ast.Raise):
            return True
        if isinstance(entry, ast.If) and entry.orelse and _always_leaves(entry.body) and _always_leaves(entry.orelse):
            return True
    return False


def _stand_ins(function: Function) -> Iterator[ast.Return]:
    """Yield returns of made-up numbers at the end of a function that returns what a file holds, where there is one."""
    body = function.node.body
    if not body or not isinstance(body[-1], ast.Return) or body[-1].value is None:
        return
    made = any(last(called(node)) in _MADE for node in ast.walk(body[-1].value) if isinstance(node, ast.Call))
    loads = any(
        isinstance(entry, ast.If)
        and any(last(called(node)) in _EXISTS for node in ast.walk(entry.test))
        and any(isinstance(node, ast.Return) for child in entry.body for node in ast.walk(child))
        and any(_LOADS.search(last(called(node))) for child in entry.body for node in ast.walk(child))
        for entry in body[:-1]
    )
    if made and loads:
        yield body[-1]
