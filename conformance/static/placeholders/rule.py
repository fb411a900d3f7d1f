"""XPL139: No placeholder of the template is left."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.scripts.empty_scripts import empty_scripts as hollow_scripts
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec


@rule(code="XPL139", requirement="XPL-PKG-5")
def placeholders(source: Source) -> Iterator[Finding]:
    """Placeholders of the template are not filled in.

    ## What it does
    Counts the template's marker in the files of the adapter. As long as one is left, it also lists process_data.sh and
    train.sh if they run nothing yet; afterwards `empty-scripts` reports them.

    ## Why it matters
    An adapter that is not filled in runs: it holds the pose. The marker distinguishes such a run from a policy that
    fails.

    ## Example
    `license: null # XPL-PLACEHOLDER: SPDX identifier of the adapter's own licence` in policy.yml.

    ## Use instead
    Fill in the value, and delete the marker with its comment.

    ## Fix safety
    No automatic fix.
    """
    marker = spec.data("package")["placeholder"]
    lines_by_file: dict[str, list[int]] = {}
    for name in source.text_files:
        lines = [number for number, line in enumerate(source.text(name).split("\n"), start=1) if f"{marker}:" in line]
        if lines:
            lines_by_file[name] = lines
    if lines_by_file:
        count = sum(map(len, lines_by_file.values()))
        first = min(lines_by_file)
        hollow = {entry.script: entry for entry in hollow_scripts(source) if entry.by_xpl}
        missing = " and ".join(sorted(entry.runs for entry in hollow.values()))
        advice = "fill in the placeholders and delete the markers"
        yield Finding(
            f"{count} placeholders of the template remain, in {', '.join(sorted(lines_by_file))}",
            path=first,
            line=lines_by_file[first][0],
            column=1,
            expected="no marker left",
            got=f"{count} of {marker}",
            evidence={**lines_by_file, **{script: [entry.word.line] for script, entry in hollow.items() if entry.word}},
            fix=Fix("advice", f"{advice}; write {missing}, or declare evaluation_only: true" if hollow else advice),
        )
