"""XPL159: Scripts quote the arguments that they pass on by position."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Edit, Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.scripts.flow import SHELLS, executed_words, program, scripts, word_location
from xpl_cli.audit.static.shell import ShellCommand, ShellWord
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec

_ALL = frozenset(("$@", "$*", "${@}", "${*}"))
_CALLERS = SHELLS | {"python", "python3", "xpl"}


@rule(code="XPL159", requirement="XPL-PKG-9")
def unquoted_argument(source: Source) -> Iterator[Finding]:
    """An unquoted argument shifts the arguments after it if it is empty or contains a space.

    ## What it does
    Takes the calls of scripts and Python files, and finds arguments of the standard, `$1` and its like, and `$@`, that
    are passed on by position without quotes.

    ## Why it matters
    The shell drops an empty value and splits one at its spaces. All following arguments then shift by one position: the
    robot is used as the checkpoint, and a run that ends successfully is not the requested one.

    ## Example
    `bash process_data.sh ${bench_name} ${ckpt_name} ${env_cfg_type}` with an empty checkpoint name.

    ## Use instead
    `"${ckpt_name}"`, and `"$@"`.

    ## Fix safety
    Safe: quotes change nothing for values without spaces that are not empty.
    """
    standard = {entry.strip("[]") for entries in spec.data("package")["scripts"].values() for entry in entries}
    has_finding = False
    for name, script in scripts(source):
        has_finding = True
        for command in script:
            if program(command) in _CALLERS:
                bare = [word for word in _by_position(command) if _is_bare(word, standard)]
                if bare:
                    yield _finding(name, command, bare)
    if not has_finding:
        raise NotApplicable("the adapter has no scripts")


def _by_position(command: ShellCommand) -> list[ShellWord]:
    """Return what a program gets behind its script's name, without options and their values."""
    words = executed_words(command)[2:]
    before = ("", *(word.raw for word in words))
    return [word for word, previous in zip(words, before, strict=False) if not previous.startswith("-")]


def _is_bare(word: ShellWord, standard: set[str]) -> bool:
    if word.raw in _ALL:
        return True
    if word.raw.startswith(("'", '"')):
        return False
    return word.position is not None or (word.variable or "").lower() in standard


def _finding(name: str, command: ShellCommand, bare: list[ShellWord]) -> Finding:
    called = executed_words(command)[1].text.rpartition("/")[2]
    which = (bare[0].variable or bare[0].raw) if bare[0].raw[1:] not in {"@", "*"} else "an argument"
    quoted = [f'"{"$@" if word.raw in _ALL else word.raw}"' for word in bare]
    edits = tuple(
        Edit(name, word.line, word.column, word.line, word.column + len(word.raw), text)
        for word, text in zip(bare, quoted, strict=True)
    )
    better = " ".join(quoted)
    return Finding(
        f"if {which} is empty or contains a space, every later argument of {called} shifts",
        **word_location(name, bare[0]),
        expected=better[:120],
        got=" ".join(word.raw for word in bare)[:120],
        fix=Fix("safe_edit", better, edits),
    )
