"""XPL188: Generated files are unchanged."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static import generated
from xpl_cli.audit.static.generated import LOCK
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.errors import UserError


@rule(code="XPL188", requirement="XPL-PKG-15")
def generated_files(source: Source) -> Iterator[Finding]:
    """A generated file was edited.

    ## What it does
    Compares the files that `.xpl/lock.yml` lists as generated with the digests there. `required-files` reports a
    missing file.

    ## Why it matters
    A launch script that was edited in one adapter behaves differently from the same script in all others. The next `xpl
    update` has to merge it, and a benchmark that calls it cannot rely on the standard.

    ## Example
    An `eval.sh` with an absolute path of one machine in it.

    ## Use instead
    Put what differs into `deploy.yml`, or pass it as an argument. To keep the edited file, move its name from
    `generated` to `free` in `.xpl/lock.yml`: xpl then never changes it.

    ## Fix safety
    Safe: restores the rendered file from `.xpl/rendered.json`. Edits are lost unless version control has them.
    """
    if not source.has(LOCK):
        raise NotApplicable(f"there is no {LOCK}: the package does not list its generated files")
    try:
        kept = generated.read(source)
    except UserError as error:
        yield Finding(
            f"the generated files are unknown, and the package cannot be updated: {error}",
            path=LOCK,
            line=1,
            column=1,
            expected="what xpl wrote there",
            got="something else",
            fix=Fix("advice", error.hint or "bring the file back"),
        )
        return
    edited = generated.edited_files(source, kept)
    rendered = generated.rendered_files(source) if edited else {}
    for name in edited:
        edit = generated.restore_edit(source, name, rendered.get(name), kept.generated[name])
        yield Finding(
            f"{name} was edited: it may behave differently from other adapters, and updates have to merge it",
            path=name,
            line=1,
            column=1,
            expected=f"the rendered file, or its name under free in {LOCK}",
            got="an edited file",
            fix=Fix("advice", f"restore {name}, or list it under free in {LOCK}")
            if edit is None
            else Fix("safe_edit", f"render {name} again", (edit,)),
        )
