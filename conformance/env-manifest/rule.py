"""XPL401: env.yml validates against its schema and names the folder it lies in."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.source import Source

_NAME = "env.yml"


@rule(code="XPL401", slug="env-manifest", gate="static", requirement="XPL-ENV-1", target="env")
def env_manifest(source: Source) -> Iterator[Finding]:
    """env.yml does not say what the standard asks of it.

    ## What it does
    Validates `env.yml` against the environment schema and compares its name with the folder's.

    ## Why it matters
    Evaluation and audit read tasks, embodiments and step limits from it. An environment is found by its folder; a
    result that bears another name is not found again.

    ## Example
    A task without `max_steps`: its episodes have no end.

    ## Use instead
    `xpl spec show env` lists every key.

    ## Fix safety
    No automatic fix.
    """
    from xpl_cli.problems import path_text
    from xpl_cli.validate import validate_yaml_file

    values = source.yaml(_NAME)
    for problem in validate_yaml_file(source.path / _NAME, "env"):
        yield Finding(
            f"{path_text(problem.path) or _NAME} is not understood: {problem.message}",
            path=_NAME,
            line=problem.line,
            column=problem.column,
            expected=problem.expected,
            got=problem.got,
            fix=Fix("command", "xpl spec show env"),
        )
    given = values.get("name") if isinstance(values, dict) else None
    if isinstance(given, str) and given != source.path.name:
        lines = source.text(_NAME).split("\n")
        yield Finding(
            f"results of {source.path.name} are filed under {given}",
            path=_NAME,
            line=next((number for number, text in enumerate(lines, start=1) if text.startswith("name:")), 1),
            column=1,
            expected=source.path.name,
            got=given,
            fix=Fix("safe_edit", f"name: {source.path.name}"),
        )
