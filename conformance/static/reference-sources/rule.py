"""XPL195: reference.py cites a source for every convention that applies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from xpl_cli.audit import Finding, Fix, NotApplicable, Proof, rule
from xpl_cli.audit.static.independence import location_of
from xpl_cli.audit.static.source import Source
from xpl_cli.model_io import names
from xpl_cli.model_io.citations import Citation, contradiction, folders, lookup
from xpl_cli.model_io.reference_file import ConventionSource as Told
from xpl_cli.model_io.reference_file import ReferenceFile, SourceRange, parse_tree
from xpl_cli.packages.conventions import DeclaredValue, applicable_conventions, declared_values


@rule(code="XPL195", requirement="XPL-NAT-5", after=("parses",))
def reference_sources(source: Source) -> Iterator[Finding | Proof]:
    """A convention in reference.py has no source that a reviewer could look up.

    ## What it does
    Reads the dict `CONVENTIONS` of reference.py, without running it. It has to list every convention that applies to
    the policy (by its model_io block, or by its inputs and actions if it has none), with file and line of the authors'
    code. A cited file of the package has to exist. In the package, and in an environment installed inside it, the rule
    looks up the line: it must not be empty, must contain the symbol that the citation names, and must not state another
    value than the block (`xyzw` for `quaternion_wxyz`). One finding counts the assumed conventions, another one the
    empty sources that `xpl model-io reference` wrote; the verdict counts both.

    ## Why it matters
    Parity compares the adapter with reference.py. If both follow the same guess of a convention, they agree, and that
    proves nothing; the verdict says how many are assumed.

    ## Example
    `CONVENTIONS = {"gripper": "as usual"}`.

    ## Use instead
    `"gripper": "authors/env.py:88 OPEN_WIDTH"`, `"github.com/them/policy@4f1c2d0:data/env.py:88"`, or, if no source
    states it, `"assumed: the paper does not say which value is open"`.

    ## Fix safety
    No automatic fix.
    """
    if not source.has(names.CODE):
        raise NotApplicable(f"there is no {names.CODE}: there is no reference for the model")
    reading = parse_tree(source.tree(names.CODE))
    if reading.location is None:
        message = f"{names.CODE} has no {names.CONVENTIONS}: a reviewer cannot look up its sources"
        yield _finding(source, message, None, "no such map")
        return
    applies = applicable_conventions(source.manifest)
    yield from _findings(source, reading, applies)
    granted = reading.without_source(applies)
    yield Proof({"conventions": len(reading.all_conventions(applies)), "assumed": len(granted)})


def _findings(source: Source, reading: ReferenceFile, applies: Sequence[str]) -> Iterator[Finding]:
    for problem, location in reading.problems:
        yield _finding(source, problem, location, "another map")
    lacking = [name for name in applies if name not in (*reading.conventions, *reading.renamed)]
    if lacking:
        message = f"{names.CODE} cites no source for {', '.join(lacking)}"
        yield _finding(source, message, reading.location, "nothing for these")
    model_io = source.manifest.model_io
    values = {} if model_io is None else declared_values(model_io)
    for name, convention in reading.conventions.items():
        if not convention.is_assumed:
            yield from _unfounded(source, name, convention, values.get(name, ()))
    for what, counted in (("to be filled in", reading.empty), ("assumed", reading.guessed)):
        if counted:
            are = "a convention is" if len(counted) == 1 else f"{len(counted)} conventions are"
            first = reading.conventions[counted[0]]
            yield _finding(
                source, f"{are} {what}: {', '.join(counted)}", first.location, f"{len(counted)} times {what}"
            )


def _unfounded(source: Source, name: str, convention: Told, values: Sequence[DeclaredValue]) -> Iterator[Finding]:
    """Yield a finding for a source that is no line of a file, or whose line is not there or says otherwise."""
    cited = Citation.parse(convention.text)
    if cited is None:
        yield _finding(source, f"the source of {name} names no line of a file", convention.location, convention.text)
        return
    here = source.path.resolve()
    quoted = lookup(cited, folders(here))
    if quoted is None:
        if not cited.is_foreign and (here / cited.path.partition("/")[0]).exists():
            message = f"the source of {name} cannot be looked up: {cited.path} does not exist"
            yield _finding(source, message, convention.location, convention.text)
    elif quoted.problem is not None:
        yield _finding(
            source, f"the source of {name} cannot be looked up: {quoted.problem}", convention.location, convention.text
        )
    elif (contrary := contradiction(quoted, values)) is not None:
        message = f"the source of {name} contradicts it: {contrary}"
        yield _finding(source, message, convention.location, f"{cited.path}:{cited.first}: {' '.join(quoted.text)}")


def _finding(source: Source, message: str, location: SourceRange | None, got: str) -> Finding:
    where = (
        {"path": names.CODE, "line": 1, "column": 1} if location is None else location_of(source, names.CODE, location)
    )
    return Finding(
        message,
        **where,
        expected=f"{names.CONVENTIONS} = {{convention: file:line of the authors' code, or assumed: why}}",
        got=got,
        fix=Fix("advice", "cite the line of the authors' code that states it, or write assumed, and why"),
    )
