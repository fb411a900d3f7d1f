"""XPL102: Every file of the adapter parses, and none contains a merge conflict."""

from __future__ import annotations

import re
from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotRun, rule
from xpl_cli.audit.static import shell, vendored
from xpl_cli.audit.static.limits import TooMuchError
from xpl_cli.audit.static.source import Source

_CONFLICT = re.compile(r"^(<{7} |>{7} |\|{7} )")
_BASH = re.compile(r"#![^\n]*\b(ba|da)?sh\b")
_DATA = (".yml", ".yaml")


@rule(code="XPL102", requirement="XPL-PKG-4")
def parses(source: Source) -> Iterator[Finding]:
    """A file does not parse, or contains a merge conflict.

    ## What it does
    Reads every file of the adapter, parses those in Python, YAML and shell, and looks for git's conflict markers.
    Scripts are checked with `bash -n`, which runs nothing; without bash the rule is not run. Vendored code is searched
    for markers only; the first one is a warning, since the adapter may never run that file.

    ## Why it matters
    A script with a conflict marker fails when it runs, often hours after the job was queued. Other rules cannot check a
    file that does not parse.

    ## Example
    `<<<<<<< HEAD` in `train.sh`, after a merge that was committed unresolved.

    ## Use instead
    Resolve the conflict and commit again; `python -m py_compile model.py` shows that a module parses.

    ## Fix safety
    No automatic fix.
    """
    for name in sorted({*source.text_files, *source.python_files}):
        try:
            source.text(name)
        except NotRun as reason:
            yield Finding(f"{name} cannot be checked: {reason}", path=name, expected="source text", got=str(reason))
            continue
        yield from _conflicts(source, name)
        if name.endswith(".sh"):
            yield from _shell(source, name)
        if name.endswith(".py"):
            yield from _python(source, name)
        if name.endswith(_DATA):
            problem = source.yaml_problem(name)
            if problem is not None:
                message, line, column = problem
                yield Finding(
                    f"{name} cannot be parsed, so none of its values are used: {message}",
                    path=name,
                    line=line,
                    column=column,
                    expected="YAML",
                    got=message,
                    fix=Fix("advice", "fix the syntax at this position"),
                )
    yield from _vendored(source)


def _vendored(source: Source) -> Iterator[Finding]:
    """Yield the first conflict in a vendored tree."""
    for name, text in vendored.texts(source):
        if "<<<<<<< " in text and ">>>>>>> " in text:
            for number, line in enumerate(text.split("\n"), start=1):
                if _CONFLICT.match(line):
                    yield Finding(
                        f"a merge conflict is left in a vendored file: running {name} fails; the adapter may "
                        "never run it",
                        path=name,
                        line=number,
                        column=1,
                        expected="one version",
                        got=line[:40],
                        fix=Fix("advice", "keep one side and delete the markers, or delete the file"),
                        must=False,
                    )
                    return


def _conflicts(source: Source, name: str) -> Iterator[Finding]:
    for number, line in enumerate(source.text(name).split("\n"), start=1):
        if _CONFLICT.match(line):
            yield Finding(
                f"a merge conflict is left in {name}: running it fails, or runs both versions",
                path=name,
                line=number,
                column=1,
                expected="one version",
                got=line[:40],
                fix=Fix("advice", "keep one side and delete the markers"),
            )
            return


def _shell(source: Source, name: str) -> Iterator[Finding]:
    try:
        source.commands(name)
    except NotRun as reason:
        yield Finding(f"{name} cannot be checked: {reason}", path=name, expected="a script", got=str(reason))
        return
    text = source.text(name)
    if text.startswith("#!") and _BASH.match(text) is None:
        return
    try:
        refused = shell.bash_error(text)
    except (FileNotFoundError, TooMuchError) as error:
        raise NotRun(f"{name} cannot be checked: {error}") from None
    if refused is not None:
        line, error_text = refused
        yield Finding(
            f"{name} does not parse, so bash ends there: {error_text}",
            path=name,
            line=line,
            column=1,
            expected="a script that bash parses",
            got=error_text,
            fix=Fix("advice", f"`bash -n {name}` prints where bash stops"),
        )


def _python(source: Source, name: str) -> Iterator[Finding]:
    error, bytes_refused = source.syntax_error(name), source.encoding_error(name)
    if bytes_refused is not None:
        yield Finding(
            f"{name} does not parse, so importing it fails: {bytes_refused}",
            path=name,
            line=1,
            expected="UTF-8, or the encoding that its first lines declare",
            got=bytes_refused,
            fix=Fix("advice", "save the file as UTF-8"),
        )
    elif isinstance(error, SyntaxError):
        yield Finding(
            f"{name} does not parse: importing it fails",
            path=name,
            line=error.lineno or 1,
            column=max(error.offset or 1, 1),
            expected="Python",
            got=error.msg,
            fix=Fix("advice", "fix the syntax at this position"),
        )
    elif error is not None:
        yield Finding(f"{name} does not parse: {error}", path=name, expected="Python", got=str(error))
