"""What a process does once: hundreds of tests scaffold the same packages and ask the same command line.

Nothing of the tool is passed over but work that it did before: a template's code, which depends on its text and on the
settings of its environment; a whole render, which is the same whenever its arguments are; and the parser of commands.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any, Final

import jinja2
import typer.testing

from xpl_cli.scaffold import template

_SETTINGS: Final = (
    "block_start_string",
    "block_end_string",
    "variable_start_string",
    "variable_end_string",
    "comment_start_string",
    "comment_end_string",
    "line_statement_prefix",
    "line_comment_prefix",
    "trim_blocks",
    "lstrip_blocks",
    "newline_sequence",
    "keep_trailing_newline",
    "optimized",
    "sandboxed",
    "is_async",
)


def remember() -> None:
    """Let this process, and those forked from it, compile each text, make each render and each parser once."""
    typer.testing._get_command = functools.cache(typer.testing._get_command)  # type: ignore[attr-defined]
    jinja2.Environment.compile = _compiled_once(jinja2.Environment.compile)  # type: ignore[method-assign]
    template.render = _rendered_once(template.render)


def _compiled_once(compile_text: Any) -> Any:
    cache: dict[Any, Any] = {}

    @functools.wraps(compile_text)
    def compiled(
        self: jinja2.Environment, source: Any, name: str | None = None, filename: str | None = None, **options: Any
    ) -> Any:
        if not isinstance(source, str) or options.get("raw"):
            return compile_text(self, source, name, filename, **options)
        # The file's name is left out: copier's templates lie in a new folder each time, and it is for tracebacks only.
        settings = tuple(getattr(self, setting) for setting in _SETTINGS)
        key = (source, name, *options.items(), type(self), settings, self.autoescape, *sorted(self.extensions))
        if key not in cache:
            cache[key] = compile_text(self, source, name, filename, **options)
        return cache[key]

    return compiled


def _rendered_once(render: Any) -> Any:
    cache: dict[Any, template.Files] = {}
    usual = (template.content_folder, template.template_folder)
    folders = (template.content_folder("templates"), template.content_folder("spec"))

    @functools.wraps(render)
    def rendered(
        name: str,
        context: Mapping[str, Any],
        leave_out: Sequence[str] = (),
        variant: str | None = None,
    ) -> template.Files:
        now = (template.content_folder, template.template_folder)
        if now != usual or (template.content_folder("templates"), template.content_folder("spec")) != folders:
            return render(name, context, leave_out, variant)  # type: ignore[no-any-return]  # by other templates
        key = (name, repr(sorted(context.items())), tuple(leave_out), variant)
        if key not in cache:
            cache[key] = render(name, context, leave_out, variant)
        return dict(cache[key])

    return rendered
