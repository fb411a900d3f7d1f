"""XPL131: Errors are not hidden behind a bare except."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Edit, Finding, Fix, rule
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import called, dotted, last, targets

_DELIVERS: Final = frozenset(("set_exception", "throw"))
_STORES: Final = frozenset(("append", "put", "put_nowait", "send", "add", "appendleft"))


@rule(code="XPL131", requirement="XPL-PKG-6")
def bare_except(source: Source) -> Iterator[Finding]:
    """A bare except hides every error, interrupts included.

    ## What it does
    Looks in the adapter's Python files for `except:` and `except BaseException:` that do not raise again. Not reported:
    an exception that is stored and raised elsewhere in the same file, as between threads.

    ## Why it matters
    Around an import it hides the real error: the library is installed but cannot be loaded, and a second import from
    another path fails for another reason. Around a control step it also swallows Ctrl-C.

    ## Example
    `try: from detr.main import build` with `except: from .main import build`.

    ## Use instead
    `except ImportError:`, or the exception that is expected.

    ## Fix safety
    Safe where no import is guarded: `except Exception:` now lets interrupts through. Around an import the fix is
    unsafe: `except ImportError:` raises errors that were hidden, which is its purpose.
    """
    for name in source.python_files:
        for node in source.nodes(name) if source.parses(name) else ():
            if isinstance(node, ast.Try):
                for handler in node.handlers:
                    if _is_bare(handler) and not _raises(source, name, handler):
                        imports = any(isinstance(entry, (ast.Import, ast.ImportFrom)) for entry in node.body)
                        if "/" in name and not imports:
                            continue  # the inside of a library that the adapter brings along
                        what = (
                            "the reason of a failed import is hidden"
                            if imports
                            else "every error is hidden, Ctrl-C included"
                        )
                        yield Finding(
                            f"{what}: the next step fails for another reason",
                            **source.start(name, handler),
                            expected="the exception that is expected" + (", ImportError" if imports else ""),
                            got="except:" if handler.type is None else "except BaseException:",
                            fix=_fix(source, name, handler, imports=imports),
                        )


def _fix(source: Source, name: str, handler: ast.ExceptHandler, *, imports: bool) -> Fix:
    meant = "ImportError" if imports else "Exception"
    if handler.type is not None:
        edit = Edit(**source.at(name, handler.type), text=meant)
    else:
        location = source.start(name, handler)
        column = location["column"] + len("except")
        edit = Edit(name, location["line"], column, location["line"], column, f" {meant}")
    return Fix("unsafe_edit" if imports else "safe_edit", f"except {meant}:", (edit,))


def _is_bare(handler: ast.ExceptHandler) -> bool:
    return handler.type is None or (isinstance(handler.type, ast.Name) and handler.type.id == "BaseException")


def _raises(source: Source, name: str, handler: ast.ExceptHandler) -> bool:
    """Tell whether a handler raises, or keeps its exception for code of the same file that does."""
    inside = set(ast.walk(handler))
    if any(isinstance(child, ast.Raise) for child in inside):
        return True
    caught = handler.name
    stored: set[str] = set()
    for node in inside if caught else ():
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None and _is_kept(node.value, caught):
            stored |= {_owner(target) for target in targets(node)}
        elif isinstance(node, ast.Call) and any(_is_kept(value, caught) for value in node.args):
            if last(called(node)) in _DELIVERS:
                return True
            if last(called(node)) in _STORES and isinstance(node.func, ast.Attribute):
                stored.add(_owner(node.func.value))
    outside = [node for node in source.nodes(name) if node not in inside]
    raised = [node.exc for node in outside if isinstance(node, ast.Raise) and node.exc is not None]
    if any(_names(error) & stored for error in raised):
        return True
    taken = {  # error = self.errors.get(); raise error
        dotted(target)
        for node in outside
        if isinstance(node, (ast.Assign, ast.AnnAssign, ast.For, ast.NamedExpr))
        and _names(node.iter if isinstance(node, ast.For) else node.value) & stored
        for target in targets(node)
    }
    return any(dotted(error) in taken for error in raised if dotted(error))


def _is_kept(value: ast.expr, caught: str | None) -> bool:
    """Tell whether a value is the exception itself, alone or in a tuple; its text cannot be raised any more."""
    if isinstance(value, (ast.Tuple, ast.List)):
        return any(_is_kept(entry, caught) for entry in value.elts)
    return isinstance(value, ast.Name) and value.id == caught


def _owner(node: ast.expr) -> str:
    """Return the variable or attribute that is assigned or added to: `self.errors` of `self.errors[0]`."""
    while isinstance(node, ast.Subscript):
        node = node.value
    return dotted(node)


def _names(node: ast.expr | None) -> set[str]:
    """Return the variables and attributes below an expression, as they are written."""
    return {dotted(child) for child in ast.walk(node)} - {""} if node is not None else set()
