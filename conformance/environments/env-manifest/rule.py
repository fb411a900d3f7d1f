"""XPL401: env.yml validates against its schema and has the folder's name."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, rule
from xpl_cli.audit.static.manifests import key_line, rename_fix, schema_findings
from xpl_cli.audit.static.source import Source

_NAME = "env.yml"


@rule(code="XPL401", gate="static", requirement="XPL-ENV-1")
def env_manifest(source: Source) -> Iterator[Finding]:
    """env.yml does not conform to the environment schema of the standard.

    ## What it does
    Validates `env.yml` against the environment schema and compares its name with the folder's.

    ## Why it matters
    Evaluation and audit read tasks, embodiments and step limits from it. An environment is found by its folder; a
    result with another name cannot be assigned to it.

    ## Example
    A task without `max_steps`: its episodes have no end.

    ## Use instead
    `xpl spec show env` lists every key.

    ## Fix safety
    Safe for the name, which has to be the folder's. The author has to fix everything else.
    """
    values = source.yaml(_NAME)
    yield from schema_findings(source, _NAME, "env", "{} is not understood")
    name = values.get("name") if isinstance(values, dict) else None
    if isinstance(name, str) and name != source.path.name:
        yield Finding(
            f"results of {source.path.name} are recorded under {name}",
            path=_NAME,
            line=key_line(source, _NAME, "name"),
            column=1,
            expected=source.path.name,
            got=name,
            fix=rename_fix(source, _NAME, "name"),
        )
