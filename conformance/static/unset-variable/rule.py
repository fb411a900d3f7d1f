"""XPL155: Scripts expand only variables that are set, or give a default."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.scripts.flow import SHELLS, scripts, word_location
from xpl_cli.audit.static.shell import ShellCommand, ShellScript, ShellWord
from xpl_cli.audit.static.source import Source

_ALWAYS: Final = re.compile(
    r"BASH\w*|HOME|PATH|PWD|OLDPWD|USER|LOGNAME|SHELL|HOSTNAME|HOSTTYPE|OSTYPE|MACHTYPE|E?UID|PPID|GROUPS|RANDOM|SECONDS"
    r"|EPOCH\w+|LINENO|FUNCNAME|PIPESTATUS|IFS|OPT(?:ARG|IND)|REPLY|MAPFILE|COPROC|COLUMNS|LINES|TERM|LANG|SHLVL|_"
)
_NAME: Final = re.compile(r"\$\{?[#!]?([A-Za-z_]\w*)")
_ACTIVATED: Final = re.compile(r"CONDA_\w+|VIRTUAL_ENV")


@rule(code="XPL155", requirement="XPL-PKG-9")
def unset_variable(source: Source) -> Iterator[Finding]:
    """A script expands a variable that is never set.

    ## What it does
    Follows the variables of each script. A name that the script neither sets nor guards (`${name:-default}`,
    `${name:?message}`, a test) must come from the caller's environment, which is unlikely for a lower-case name. A
    search path that is extended by its own value needs a guard.

    ## Why it matters
    Usually the name is misspelt. Without `set -u` the shell expands it to nothing: the run gets another checkpoint or
    no seed. With `set -u`, the script stops on every machine that does not set it. A search path that ends in a colon
    makes Python import from the working directory.

    ## Example
    `export PYTHONPATH="$root:$PYTHONPATH"` under `set -u`, or `--seed "$sede"`.

    ## Use instead
    The name that was set; `"${PYTHONPATH:+:$PYTHONPATH}"` for search paths; `"${NAME:?what it is for}"` for values that
    users have to set.

    ## Fix safety
    Safe: a guard changes nothing if the variable is set.
    """
    has_finding = False
    for name, script in scripts(source):
        has_finding = True
        yield from _extended(name, script)
        set_names = script.variables | script.checked
        unknown = {word for word in _NAME.findall(source.text(name)) if word not in set_names}
        if unknown and not any(map(_sets_unknown, script)):
            yield from _unset(name, script, unknown)
    if not has_finding:
        raise NotApplicable("the adapter has no scripts")


def _unset(name: str, script: ShellScript, unknown: set[str]) -> Iterator[Finding]:
    """Yield the first expansion of each of these variables, as far as hardly any caller sets it."""
    nounset = "nounset" in script.options
    left = {
        variable
        for variable in unknown
        if not _ALWAYS.fullmatch(variable)
        and not _ACTIVATED.fullmatch(variable)
        and not (nounset and variable.isupper())
    }
    for word in (word for command in script for word in command.words) if left else ():
        for item in word.expansions:
            if item.name in left:
                left.remove(item.name)
                then = "the script stops there" if nounset else "the shell expands it to nothing"
                yield _finding(name, word, f"{item.name} is never set: {then}", f"{item.name} set, or a default")


def _extended(name: str, script: ShellScript) -> Iterator[Finding]:
    """Yield search paths that are extended by their own value, whether or not they have one."""
    extended: set[str] = set()
    for command in script:
        for variable, value in command.assignments:
            is_first = variable not in extended
            extended.add(variable)
            if not (is_first and variable.isupper() and ":" in value.raw and variable in value.raw):
                continue
            bare = any(item.name == variable and not item.guard for item in value.expansions)
            if not bare or _ALWAYS.fullmatch(variable):
                continue
            if "nounset" in script.options and variable not in script.checked:
                then = f"{name} stops with `unbound variable` there"
            elif variable not in script.checked:
                then = "the path gets an empty entry, which is the working directory"
            else:
                continue
            replacement = f"${{{variable}:+:${variable}}}"
            yield _finding(name, value, f"if the caller does not set {variable}, {then}", replacement)


def _sets_unknown(command: ShellCommand) -> bool:
    """Tell whether a command may set any variable: another file that is read in, or `eval`."""
    if command.name == "eval":
        return True
    if command.name not in SHELLS - {"bash", "sh"} or len(command.arguments) < 2:
        return False
    return not re.search(r"(?:conda\.sh|mamba\.sh|activate|\.bashrc)[\"']?$", command.arguments[1].raw)


def _finding(name: str, word: ShellWord, message: str, expected: str) -> Finding:
    return Finding(
        message,
        **word_location(name, word),
        expected=expected,
        got=word.raw[:80],
        fix=Fix("advice", f"write {expected}" if expected.startswith("$") else "set it, or write `${name:?what for}`"),
    )
