"""XPL253: The adapter depends on the working directory of its process."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.offline.configurations import Configurations
from xpl_cli.audit.served.probe import blame


@rule(code="XPL253", requirement="XPL-CKP-3", loads=True, compares=True, tries="another working directory")
def any_working_directory(configurations: Configurations) -> Iterator[Finding]:
    """The adapter depends on the working directory of its process.

    ## What it does
    Serves the adapter with an empty folder as its working directory, and compares an episode with the same one from the
    usual folder.

    ## Why it matters
    Launchers start servers from their own folder. With the same deploy.yml the server finds the weights on one machine
    and not on the other, or finds other weights.

    ## Example
    `open("stats.json")`.

    ## Use instead
    `self.policy_dir / "stats.json"`.

    ## Fix safety
    No automatic fix.
    """
    if not configurations.probe.package.manifest.deterministic:
        configurations.require_usual()
        there = configurations.from_elsewhere()
        mismatch = there.refusal
    else:
        configurations.require_repeats()
        mismatch = configurations.usual.difference(configurations.from_elsewhere())
    if mismatch is not None:
        yield blame(
            "from another working directory the adapter acts differently: it depends on where a launcher started it",
            expected="the same actions",
            got=mismatch,
            fix=Fix("advice", "join relative paths to self.policy_dir"),
        )
