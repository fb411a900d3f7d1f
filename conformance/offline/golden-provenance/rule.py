"""XPL261: Golden pairs were recorded with other reference code or weights."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.inprocess import python_of
from xpl_cli.audit.served.probe import Probe
from xpl_cli.basics.errors import UserError
from xpl_cli.model_io import names, pairs, provenance, record


@rule(code="XPL261", requirement="XPL-NAT-6", profile="full", tries="golden pairs")
def golden_provenance(probe: Probe) -> Iterator[Finding]:
    """Golden pairs were recorded with other reference code or weights.

    ## What it does
    Reads golden_pairs.json and compares what it was recorded with to the current state: reference.py without its
    citations, the files of the package that it imported, the authors' code if it is installed, the checkpoint that
    deploy.yml names, the script that makes the observations, and the robots and action types that the manifest
    declares.

    ## Why it matters
    Parity with actions of other code, or of other weights, proves nothing about the current ones.

    ## Example
    reference.py is fixed, and the pairs are not recorded again.

    ## Use instead
    `xpl model-io record POLICY --diff`, which reports what would change, and `xpl model-io record POLICY` after every
    change of reference.py, of the authors' code or of the weights.

    ## Fix safety
    No automatic fix.
    """
    package = probe.package
    folder = pairs.folder_of(package, probe.config)
    if not (folder / names.PAIRS).exists():
        there = (package.path / names.CODE).exists()
        raise NotApplicable(f"{names.CODE} was never recorded" if there else f"there is no {names.CODE}")
    try:
        recorded = pairs.read(folder)
    except UserError as error:
        yield _finding("the golden pairs cannot be used", "a file that `xpl model-io record` wrote", str(error))
        return
    for problem in provenance.code_problems(package.path, recorded.provenance, _python(probe)):
        yield _finding(
            f"the golden pairs were recorded with other reference code: {problem}",
            "the files that were recorded",
            problem,
        )
    settings = {**recorded.provenance["settings"], **probe.options.overrides}
    before, now = recorded.provenance["weights"], provenance.weights(package, package.config(settings))
    if (before or {}).get("digest") != (now or {}).get("digest"):
        yield _finding(
            "the golden pairs were recorded with other weights than those that are served", _told(before), _told(now)
        )
    covered = {(session.embodiment, session.action_type) for session in recorded.sessions}
    lacking = [
        f"{session.embodiment} {session.action_type}"
        for session in record.sessions(package, settings)
        if (session.embodiment, session.action_type) not in covered
    ]
    if lacking:
        yield _finding(
            f"the golden pairs lack what the manifest declares: {', '.join(lacking)}",
            "pairs of every robot and action type",
            f"pairs of {', '.join(' '.join(one) for one in sorted(covered))}",
        )


def _python(probe: Probe) -> str | None:
    """Return the interpreter of the package, None where there is none here."""
    try:
        return python_of(probe)
    except UserError:
        return None


def _told(weights: dict[str, str] | None) -> str:
    return "none" if weights is None else f"{weights['name']}, {weights['digest'][:12]}"


def _finding(message: str, expected: str, got: str) -> Finding:
    fix = Fix(
        "advice", "`xpl model-io record POLICY --diff` reports which actions would change; without it they are written"
    )
    return Finding(message, path=names.PAIRS, expected=expected, got=got, fix=fix)
