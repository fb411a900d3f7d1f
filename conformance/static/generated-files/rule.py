"""XPL188: Generated files are as they were rendered."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from xpl_cli.audit import Edit, Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.source import Source

if TYPE_CHECKING:
    from xpl_cli.scaffold.lock import Lock


@rule(code="XPL188", slug="generated-files", gate="static", requirement="XPL-PKG-15")
def generated_files(source: Source) -> Iterator[Finding]:
    """A generated file is not as it was rendered.

    ## What it does
    Compares the files that `.xpl/lock.yml` calls generated with the digests there. A file that is not there is left to
    the rule about required files.

    ## Why it matters
    A launch script that was edited in one adapter behaves otherwise than the same script in all others. The next update
    has to merge it, and whoever calls it from a benchmark cannot rely on what the standard says of it.

    ## Example
    An `eval.sh` with a path of one machine in it.

    ## Use instead
    Put what differs into `deploy.yml`, or give it as an argument. To keep a file as it is now, move its name from
    `generated` to `free` in `.xpl/lock.yml`: xpl then never touches it.

    ## Fix safety
    Safe: renders the file again, from the template and the answers that are recorded. What was edited in it is lost
    unless version control has it.
    """
    from xpl_cli.basics.errors import UserError
    from xpl_cli.scaffold import lock

    if not source.has(lock.PATH):
        raise NotApplicable(f"there is no {lock.PATH}: the package does not tell which of its files are generated")
    try:
        kept = lock.parse(source.text(lock.PATH), lock.PATH)
    except UserError as error:
        yield Finding(
            f"which files are generated cannot be told, and the package cannot be updated: {error}",
            path=lock.PATH,
            line=1,
            column=1,
            expected="what xpl wrote there",
            got="something else",
            fix=Fix("advice", error.hint or "bring the file back"),
        )
        return
    names = [name for name in kept.generated if name not in kept.free and source.has(name)]
    edited = [name for name in names if lock.digest(source.text(name).encode()) != kept.generated[name]]
    rendered = _rendered(kept) if edited else {}
    for name in edited:
        yield Finding(
            f"{name} is not as it was rendered: it may behave otherwise than in other adapters, and updates merge it",
            path=name,
            line=1,
            column=1,
            expected=f"the file of {kept.template}, or its name under free in {lock.PATH}",
            got="an edited file",
            fix=_again(source, name, rendered.get(name), kept.generated[name]),
        )


def _rendered(kept: Lock) -> dict[str, bytes]:
    """Render the package again; nothing where its template or its answers are not known here."""
    from xpl_cli.basics.errors import UserError
    from xpl_cli.scaffold import adapter, template

    try:
        return adapter.render(adapter.recorded(kept), kept.template) if template.exists(kept.template) else {}
    except UserError:
        return {}


def _again(source: Source, name: str, content: bytes | None, digest: str) -> Fix:
    from xpl_cli.scaffold import lock

    if content is None or lock.digest(content) != digest:
        return Fix("advice", f"bring {name} back as it was, or list it under free in {lock.PATH}")
    lines = source.text(name).split("\n")
    edit = Edit(name, 1, 1, len(lines), len(lines[-1]) + 1, content.decode())
    return Fix("safe_edit", f"render {name} again", (edit,))
