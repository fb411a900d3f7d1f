"""XPL103: deploy.yml has the required keys with valid values, and its policy_name is the folder's name."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, rule
from xpl_cli.audit.static.manifests import key_line, rename_fix, schema_findings
from xpl_cli.audit.static.source import Source


@rule(code="XPL103", requirement="XPL-CFG-1")
def deploy_config(source: Source) -> Iterator[Finding]:
    """deploy.yml lacks a required key, has a value of the wrong type, or names another policy.

    ## What it does
    Validates `deploy.yml` against the schema of the standard and compares `policy_name` with the folder's name.

    ## Why it matters
    Launchers override these keys and pass them on. A missing one stops the run, or a default of some library replaces
    it; with a wrong `policy_name` another adapter is evaluated.

    ## Example
    A copy of an adapter whose `policy_name` still names the original.

    ## Use instead
    `xpl spec show deploy` lists the keys, their types and their defaults. null means not set.

    ## Fix safety
    Safe for the name, which has to be the folder's. The author has to fix everything else.
    """
    name = sdk.File.DEPLOY_YML
    values = source.yaml(name)
    yield from schema_findings(source, name, "deploy", "launchers cannot rely on {}")
    policy_name = values.get(sdk.Deploy.POLICY_NAME) if isinstance(values, dict) else None
    if isinstance(policy_name, str) and policy_name != source.path.name:
        yield Finding(
            f"launchers load the policy {policy_name}, but this is {source.path.name}",
            path=name,
            line=key_line(source, name, sdk.Deploy.POLICY_NAME),
            column=1,
            expected=source.path.name,
            got=policy_name,
            fix=rename_fix(source, name, sdk.Deploy.POLICY_NAME),
        )
