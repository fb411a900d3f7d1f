"""XPL101: The package has every required file."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.source import Source
from xpl_cli.standard import spec

_EVALUATES_ONLY: Final = re.compile(
    r"(?:evaluat\w+|eval|inference|deployment)[- ]only|only (?:covers |for )?(?:inference|evaluat)"
    r"|train\w*[^.\n]{0,40}\bnot\b|\bno (?:re)?training\b|\bnot\b[^.\n]{0,40}\btrain",
    re.IGNORECASE,
)
_CONSEQUENCES: Final = {
    sdk.File.README_MD: "users do not learn how to install the policy, or which checkpoint it needs",
    sdk.File.INIT_PY: "the package cannot be imported by its name",
    sdk.File.DEPLOY_YML: "neither servers nor clients find a configuration",
    sdk.File.DEPLOY_PY: "an evaluation client finds no loop that runs an episode",
    sdk.File.MODEL_PY: "a server finds no model",
}
"""What follows without a file that no launcher calls; the others are scripts."""


@rule(code="XPL101", requirement="XPL-PKG-1")
def required_files(source: Source) -> Iterator[Finding]:
    """A required file is missing.

    ## What it does
    Compares the adapter's folder with the list of files in the standard; `process_data.sh` and `train.sh` are required
    unless `policy.yml` declares `evaluation_only: true`. An adapter of the ecosystem cannot declare that: one of them
    that is missing is a warning unless README.md says so, if README.md tells to run it, if the other one is there, or
    if README.md does not say that the adapter only evaluates. A `policy.yml` that is not a regular file is reported.

    ## Why it matters
    Launchers call the scripts by name. A missing one ends a benchmark run after the job waited in the queue. Servers
    and clients read the other files, and users the README.

    ## Example
    Only the author can set up a package without `install.sh`.

    ## Use instead
    `xpl new-policy` writes all of them; copy the missing one from a fresh scaffold.

    ## Fix safety
    No automatic fix.
    """
    files = spec.data("package")["files"]
    required = list(files["required"])
    if not source.is_ecosystem and not source.manifest.evaluation_only:
        required += files["training"]
    manifest = files["manifest"]
    if os.path.lexists(source.path / manifest) and not source.has(manifest):
        yield Finding(
            message=f"{manifest} is not a regular file: tools cannot read what it declares",
            expected=f"a file {manifest} in the adapter's folder, or none",
            got="a folder, a pipe, a device, or a link to outside the package",
            fix=Fix("advice", f"replace it by a file, as a fresh `xpl new-policy` writes {manifest}"),
        )
    if source.is_ecosystem:
        yield from _untrained(source, files["training"])
    for name in required:
        if not source.has(name):
            yield Finding(
                message=f"{name} is missing: {_CONSEQUENCES.get(name, 'launchers that call it fail')}",
                expected=f"a file {name} in the adapter's folder",
                got="no such file",
                fix=Fix("advice", f"copy {name} from a fresh `xpl new-policy` scaffold"),
            )


def _untrained(source: Source, names: list[str]) -> Iterator[Finding]:
    """Yield the scripts of training that an adapter of the ecosystem lacks without saying so."""
    readme = source.text(sdk.File.README_MD) if source.has(sdk.File.README_MD) else ""
    missing = [name for name in names if not source.has(name)]
    for name in missing:
        lines = [line for line in readme.split("\n") if name in line]
        if any(re.search(r"\b(?:no|not|without|lacks?)\b", line, re.IGNORECASE) for line in lines):
            continue
        if any(re.search(rf"\bbash\b.*{re.escape(name)}", line) for line in lines):
            why = f"{sdk.File.README_MD} tells to run it"
        elif len(missing) < len(names):
            why = "the other script of training is there, and README.md does not say what takes its place"
        elif not _EVALUATES_ONLY.search(readme):
            why = f"{sdk.File.README_MD} does not say that the adapter only evaluates"
        else:
            continue
        yield Finding(
            f"{name} is missing: {why}",
            expected=f"a file {name} in the adapter's folder",
            got="no such file",
            fix=Fix("advice", f"add {name}, or say in {sdk.File.README_MD} that the adapter only evaluates"),
            must=False,
        )
