"""XPL104: policy.yml validates against its schema and has the folder's name."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl import robots as robot_catalogue
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.manifests import key_line, rename_fix, schema_findings
from xpl_cli.audit.static.source import Source


@rule(code="XPL104", requirement="XPL-CFG-5")
def manifest(source: Source) -> Iterator[Finding]:
    """policy.yml does not conform to the manifest schema of the standard.

    ## What it does
    Validates `policy.yml` against the manifest schema, compares its name with the folder's, and checks that the
    standard knows every embodiment.

    ## Why it matters
    The audit, the server and comparisons between policies read it: required inputs, embodiments, chunk length,
    interpreter. A misspelt entry is neither checked nor served.

    ## Example
    `temporal: {kind: chunked}`; the kinds are single_step, chunk, history and memory.

    ## Use instead
    `xpl spec show policy` lists every key.

    ## Fix safety
    Safe for the name, which has to be the folder's. The author has to fix everything else.
    """
    name = sdk.File.POLICY_YML
    if source.is_ecosystem:
        raise NotApplicable("an adapter without policy.yml declares nothing")
    values = source.yaml(name)
    yield from schema_findings(source, name, "policy", "{} is not understood")
    values = values if isinstance(values, dict) else {}
    if isinstance(values.get("name"), str) and values["name"] != source.path.name:
        yield Finding(
            f"the manifest describes {values['name']}, but this is {source.path.name}: results get the wrong name",
            path=name,
            line=key_line(source, name, "name"),
            column=1,
            expected=source.path.name,
            got=values["name"],
            fix=rename_fix(source, name, "name"),
        )
    declared = values.get("embodiments")
    for robot in declared if isinstance(declared, list) else []:
        if isinstance(robot, str) and robot not in robot_catalogue.names():
            yield Finding(
                f"this policy cannot be evaluated on {robot}: there is no embodiment of that name",
                path=name,
                line=key_line(source, name, "embodiments"),
                column=1,
                expected=", ".join(robot_catalogue.entries()),
                got=robot,
                fix=Fix("command", "xpl spec show"),
            )
