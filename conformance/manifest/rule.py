"""XPL104: policy.yml validates against its schema and names the folder it lies in."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.source import Source


@rule(code="XPL104", slug="manifest", gate="static", requirement="XPL-CFG-5")
def manifest(source: Source) -> Iterator[Finding]:
    """policy.yml does not say what the standard asks of it.

    ## What it does
    Validates `policy.yml` against the manifest schema, compares its name with the folder's, and checks that every
    embodiment is one that the standard knows.

    ## Why it matters
    The audit, the server and comparisons between policies read it: inputs that must be there, embodiments, chunk
    length, interpreter. What is misspelt there is not checked and not served.

    ## Example
    `temporal: {kind: chunked}`; the kinds are single_step, chunk, history and memory.

    ## Use instead
    `xpl spec show policy` lists every key.

    ## Fix safety
    No automatic fix.
    """
    from xpl_cli.problems import path_text
    from xpl_cli.validate import validate_yaml_file

    name = sdk.File.POLICY_YML
    if source.is_ecosystem:
        raise NotApplicable("an adapter without policy.yml declares nothing")
    values = source.yaml(name)
    for problem in validate_yaml_file(source.path / name, "policy"):
        yield Finding(
            f"{path_text(problem.path) or name} is not understood: {problem.message}",
            path=name,
            line=problem.line,
            column=problem.column,
            expected=problem.expected,
            got=problem.got,
            fix=Fix("command", "xpl spec show policy"),
        )
    values = values if isinstance(values, dict) else {}
    if isinstance(values.get("name"), str) and values["name"] != source.path.name:
        yield Finding(
            f"the manifest describes {values['name']}, but this is {source.path.name}: results get the wrong name",
            path=name,
            line=_line(source, "name"),
            column=1,
            expected=source.path.name,
            got=values["name"],
            fix=Fix("safe_edit", f"name: {source.path.name}"),
        )
    robots = values.get("embodiments")
    for robot in robots if isinstance(robots, list) else []:
        if isinstance(robot, str) and not _is_known(robot):
            yield Finding(
                f"nobody can evaluate this policy on {robot}: the standard has no embodiment of that name",
                path=name,
                line=_line(source, "embodiments"),
                column=1,
                expected=", ".join(sdk.EMBODIMENTS),
                got=robot,
                fix=Fix("command", "xpl spec show embodiments"),
            )


def _is_known(robot: str) -> bool:
    return robot in sdk.EMBODIMENTS or any(robot in entry.get("aliases", ()) for entry in sdk.EMBODIMENTS.values())


def _line(source: Source, key: str) -> int:
    lines = source.text(sdk.File.POLICY_YML).split("\n")
    return next((number for number, text in enumerate(lines, start=1) if text.startswith(f"{key}:")), 1)
