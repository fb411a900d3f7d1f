"""XPL195: reference.py names the source of every convention that applies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from xpl_cli.audit import Finding, Fix, NotApplicable, Proof, rule
from xpl_cli.audit.static.borrowed import standing
from xpl_cli.audit.static.source import Source
from xpl_cli.model_io import names
from xpl_cli.model_io.citations import Citation, contradiction, folders, lookup
from xpl_cli.model_io.reading import Place, Reading, read_tree
from xpl_cli.model_io.reading import Source as Told
from xpl_cli.packages.conventions import Value, applying, declared


@rule(code="XPL195", requirement="XPL-NAT-5", after=("parses",))
def reference_sources(source: Source) -> Iterator[Finding | Proof]:
    """A convention in reference.py has no source that somebody else could look up.

    ## What it does
    Reads the map `CONVENTIONS` of reference.py, without running it. Every convention that applies to the policy (by its
    model_io block, or by its inputs and actions where it has none) is in it, and names file and line of the authors'
    code. A file of the package exists; there, and in what is installed in an environment inside the package, the line
    is looked up: it is not empty, it has the symbol that the citation names, and it does not say another value than
    the block (`xyzw` for `quaternion_wxyz`). Conventions that are assumed are counted in one finding, and those whose
    source is empty, as `xpl model-io reference` writes it, in another one; the verdict
    counts those that are not named with them.

    ## Why it matters
    reference.py is the second reading that the adapter is held against. A convention that both took from the same guess
    agrees with itself and proves nothing; the verdict says how many are assumed.

    ## Example
    `CONVENTIONS = {"gripper": "as usual"}`.

    ## Use instead
    `"gripper": "authors/env.py:88 OPEN_WIDTH"`, `"github.com/them/policy@4f1c2d0:data/env.py:88"`, or, where nobody
    says it, `"assumed: the paper does not say which value is open"`.

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
    lacking = [name for name in applies if name not in (*reading.conventions, *reading.renamed)]
    if lacking:
        message = f"{names.CODE} does not say where it has {', '.join(lacking)} from"
        yield _finding(source, message, reading.place, "nothing for these")
    model_io = source.manifest.model_io
    values = {} if model_io is None else declared(model_io)
    for name, told in reading.conventions.items():
        if not told.is_assumed:
            yield from _unfounded(source, name, told, values.get(name, ()))
    for what, counted in (("to be filled in", reading.empty), ("assumed", reading.guessed)):
        if counted:
            are = "a convention is" if len(counted) == 1 else f"{len(counted)} conventions are"
            first = reading.conventions[counted[0]]
            yield _finding(source, f"{are} {what}: {', '.join(counted)}", first.place, f"{len(counted)} times {what}")


def _unfounded(source: Source, name: str, told: Told, values: Sequence[Value]) -> Iterator[Finding]:
    """Yield a finding for a source that is no line of a file, or whose line is not there or says otherwise."""
    cited = Citation.parse(told.text)
    if cited is None:
        yield _finding(source, f"the source of {name} names no line of a file", told.place, told.text)
        return
    here = source.path.resolve()
    quoted = lookup(cited, folders(here))
    if quoted is None:
        if not cited.is_foreign and (here / cited.path.partition("/")[0]).exists():
            message = f"the source of {name} cannot be looked up: {cited.path} is not there"
            yield _finding(source, message, told.place, told.text)
    elif quoted.problem is not None:
        yield _finding(source, f"the source of {name} cannot be looked up: {quoted.problem}", told.place, told.text)
    elif (contrary := contradiction(quoted, values)) is not None:
        message = f"the source of {name} says otherwise: {contrary}"
        yield _finding(source, message, told.place, f"{cited.path}:{cited.first}: {' '.join(quoted.text)}")


def _finding(source: Source, message: str, place: Place | None, got: str) -> Finding:
    where = {"path": names.CODE, "line": 1, "column": 1} if place is None else standing(source, names.CODE, place)
    return Finding(
        message,
        **where,
        expected=f"{names.CONVENTIONS} = {{convention: file:line of the authors' code, or assumed: why}}",
        got=got,
        fix=Fix("advice", "name the line of the authors' code that says it, or write assumed, and why"),
    )
