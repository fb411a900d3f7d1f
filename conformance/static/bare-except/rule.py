"""XPL131: Errors are not hidden behind a bare except."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl_cli.audit import Edit, Finding, Fix, rule
from xpl_cli.audit.static.source import Source


@rule(code="XPL131", requirement="XPL-PKG-6")
def bare_except(source: Source) -> Iterator[Finding]:
    """A bare except hides every error, interrupts included.

    ## What it does
    Looks in the adapter's Python files for `except:` and `except BaseException:` that do not raise again.

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
                    if _is_bare(handler) and not any(isinstance(child, ast.Raise) for child in ast.walk(handler)):
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
