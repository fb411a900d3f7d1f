"""XPL158: Scripts delete only what they created."""

from __future__ import annotations

import re
from collections.abc import Iterator

from xpl_cli.audit import Edit, Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.scripts.flow import may_be_empty, scripts, word_location
from xpl_cli.audit.static.shell import ShellCommand, ShellScript, ShellWord
from xpl_cli.audit.static.source import Source

_LEADING = re.compile(r"[\"']?\$\{?([A-Za-z_]\w*|\d+)(?::-)?\}?[\"']?/(.*)", re.DOTALL)
_CLOSING = re.compile(r"(.*)/\$\{?([A-Za-z_]\w*|\d+)(?::-)?\}?[\"']?(?:/\*?)?[\"']?", re.DOTALL)


@rule(code="XPL158", requirement="XPL-PKG-12")
def unsafe_delete(source: Source) -> Iterator[Finding]:
    """A script may delete more than intended, because a variable is empty or a folder is another one.

    ## What it does
    Takes every recursive `rm` and checks of each variable in its path whether it may be empty there: an argument or
    environment variable that is not checked, an empty default, a folder that may not exist. A relative path after a
    `cd` that may fail is reported too.

    ## Why it matters
    `rm -rf "$out/$name"` with an empty name deletes the results of all runs; with an empty `out`, it starts at the root
    of the file system.

    ## Example
    `ckpt_name=$2` and `rm -rf "checkpoints/${ckpt_name}"`, called with one argument.

    ## Use instead
    `rm -rf "${out:?}/${name:?}"`, which stops instead of deleting the wrong thing.

    ## Fix safety
    Safe: `:?` changes nothing if the variables are not empty.
    """
    has_finding = False
    for name, script in scripts(source):
        has_finding = True
        for number, command in enumerate(script):
            if command.name == "rm" and any(re.match(r"-\w*[rR]|--recursive", word.raw) for word in command.words):
                before = script[number - 1] if number else None
                for word in command.arguments[1:]:
                    yield from _checked(name, script, word)
                    yield from _elsewhere(name, script, word, before)
    if not has_finding:
        raise NotApplicable("the adapter has no scripts")


def _checked(name: str, script: ShellScript, word: ShellWord) -> Iterator[Finding]:
    leading, closing = _LEADING.fullmatch(word.raw), _CLOSING.fullmatch(word.raw)
    if leading and _is_open(leading.group(1), script):
        deleted = f"/{leading.group(2)}".replace('"', "")
        yield _finding(name, word, leading.group(1), f"{deleted} is deleted, from the root of the file system")
    elif closing and _is_open(closing.group(2), script):
        deleted = closing.group(1).replace('"', "") or "/"
        yield _finding(name, word, closing.group(2), f"all of {deleted} is deleted, including other runs")


def _is_open(variable: str, script: ShellScript) -> bool:
    if variable.isdigit():
        return "nounset" not in script.options
    return may_be_empty(variable, script)


def _elsewhere(name: str, script: ShellScript, word: ShellWord, before: ShellCommand | None) -> Iterator[Finding]:
    """Yield relative paths that are deleted in the wrong folder if the `cd` before them failed."""
    if before is None or before.name not in {"cd", "pushd"} or "errexit" in script.options:
        return
    if before.end not in {"&&", "||"} and not word.text.startswith(("/", "$", "~", "-")):
        yield Finding(
            f"if `cd` fails, {word.text} is deleted in the folder from which {name} was started",
            **word_location(name, word),
            expected="set -e, or cd ... && rm ...",
            got=f"{before.words[0].raw} without a check for failure",
            fix=Fix("advice", "set -e, or delete by a path that starts at the script's folder"),
        )


def _finding(name: str, word: ShellWord, variable: str, consequence: str) -> Finding:
    checked = f"${{{variable}:?}}"
    text = re.sub(rf"\$(?:{variable}\b|\{{{variable}(?::-)?\}})", lambda _: checked, word.raw)
    end = word.column + len(word.raw)
    return Finding(
        f"if {variable} is empty, {consequence}",
        **word_location(name, word),
        expected=checked,
        got=word.raw,
        fix=Fix("safe_edit", f"{checked} for ${variable}", (Edit(name, word.line, word.column, word.line, end, text),)),
    )
