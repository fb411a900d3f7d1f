"""XPL195: native.py names the source of every convention that applies."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from xpl_cli.audit import Finding, Fix, NotApplicable, NotRun, Proof, rule
from xpl_cli.audit.static.borrowed import standing
from xpl_cli.audit.static.reading import inside, text
from xpl_cli.audit.static.source import Source
from xpl_cli.native import names
from xpl_cli.native.reading import Place, Reading, read_tree
from xpl_cli.native.reading import Source as Told
from xpl_cli.packages.conventions import applying

_FOREIGN = re.compile(r"@|://")
_LINE = re.compile(r"(?P<path>[^\s:#]+)(?::|#L)(?P<line>[0-9]{1,7})(?:-L?[0-9]{1,7})?(?![\w.])")


@rule(code="XPL195", requirement="XPL-NAT-5", after=("parses",))
def native_sources(source: Source) -> Iterator[Finding | Proof]:
    """A convention in native.py has no source that somebody else could look up.

    ## What it does
    Reads the map `CONVENTIONS` of native.py, without running it. Every convention that applies to the policy (by its
    native block, or by its inputs and actions where it has none) is in it, and names file and line of the authors'
    code. A file that lies in the package exists, and has that line. Conventions that are assumed are counted in one
    finding; the verdict counts those that are not named with them.

    ## Why it matters
    native.py is the second reading that the adapter is held against. A convention that both took from the same guess
    agrees with itself and proves nothing; the verdict says how many are assumed.

    ## Example
    `CONVENTIONS = {"gripper": "as usual"}`.

    ## Use instead
    `"gripper": "authors/env.py:88"`, `"github.com/them/policy@4f1c2d0:data/env.py:88"`, or, where nobody says it,
    `"assumed: the paper does not say which value is open"`.

    ## Fix safety
    No automatic fix.
    """
    if not source.has(names.CODE):
        raise NotApplicable(f"there is no {names.CODE}: nothing says what the model does")
    reading = read_tree(source.tree(names.CODE))
    if reading.place is None:
        message = f"{names.CODE} has no {names.CONVENTIONS}: nobody can look up what it assumes"
        yield _finding(source, message, None, "no such map")
        return
    applies = applying(source.manifest)
    yield from _findings(source, reading, applies)
    granted = reading.taken_for_granted(applies)
    yield Proof({"conventions": len(reading.agreed(applies)), "assumed": len(granted)})


def _findings(source: Source, reading: Reading, applies: Sequence[str]) -> Iterator[Finding]:
    for problem, place in reading.problems:
        yield _finding(source, problem, place, "another map")
    lacking = [name for name in applies if name not in reading.conventions]
    if lacking:
        message = f"{names.CODE} does not say where it has {', '.join(lacking)} from"
        yield _finding(source, message, reading.place, "nothing for these")
    for name, told in reading.conventions.items():
        if not told.is_assumed:
            yield from _unfounded(source, name, told)
    if reading.assumed:
        count = len(reading.assumed)
        what = "a convention is" if count == 1 else f"{count} conventions are"
        first = reading.conventions[reading.assumed[0]]
        yield _finding(source, f"{what} assumed: {', '.join(reading.assumed)}", first.place, f"{count} times assumed")


def _unfounded(source: Source, name: str, told: Told) -> Iterator[Finding]:
    """Yield a finding for a source that is no line of a file, or a line that is not there."""
    found = _LINE.search(told.text)
    if found is None:
        yield _finding(source, f"the source of {name} names no line of a file", told.place, told.text)
    elif not _FOREIGN.search(told.text[: found.start("line")]):
        lines = _lines(source, found["path"])
        if lines is not None and not 1 <= int(found["line"]) <= lines:
            there = f"has {lines} lines" if lines else "is not there"
            message = f"the source of {name} cannot be looked up: {found['path']} {there}"
            yield _finding(source, message, told.place, told.text)


def _lines(source: Source, path: str) -> int | None:
    """Return how many lines a file of the package has, 0 if it is not there; None if it is not the package's."""
    here = source.path.resolve()
    if inside(here, path) is None:
        return 0 if inside(here, path.partition("/")[0]) or (here / path.partition("/")[0]).is_dir() else None
    try:
        return len(text(here, path).content.splitlines())
    except NotRun:  # larger than what is read
        return None


def _finding(source: Source, message: str, place: Place | None, got: str) -> Finding:
    where = {"path": names.CODE, "line": 1, "column": 1} if place is None else standing(source, names.CODE, place)
    return Finding(
        message,
        **where,
        expected=f"{names.CONVENTIONS} = {{convention: file:line of the authors' code, or assumed: why}}",
        got=got,
        fix=Fix("advice", "name the line of the authors' code that says it, or write assumed, and why"),
    )
