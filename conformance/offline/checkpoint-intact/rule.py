"""XPL252: Serving the adapter changes files of its checkpoint."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL252", requirement="XPL-CKP-2", profile="full", tries="other checkpoints")
def checkpoint_intact(probe: Probe) -> Iterator[Finding]:
    """Serving the adapter changes files of its checkpoint.

    ## What it does
    Compares size and modification time of every file of the checkpoint with those before the first server of the audit
    started.

    ## Why it matters
    The checkpoint is no longer the published one: its hash differs, and its next user gets other results. Two servers
    that start on it race; a read-only store fails.

    ## Example
    The adapter rewrites the checkpoint's `dataset_statistics.json` at every load.

    ## Use instead
    Keep changed values in memory, or write them to a temporary folder that the model loads from.

    ## Fix safety
    No automatic fix.
    """
    if probe.checkpoint is None:
        raise NotApplicable("deploy.yml names no checkpoint that exists")
    if not probe.checkpoint_before:
        raise NotApplicable("the checkpoint is a folder without files")
    probe.require_answer()
    after = probe.checkpoint.state()
    changed = [path for path, state in probe.checkpoint_before.items() if after.get(path) != state]
    for path in changed:
        what = "is gone" if path not in after else "was written"
        yield blame(
            f"{path.name} of the checkpoint {what} while the adapter was served: its next user loads another "
            "one, and two servers race",
            expected="checkpoint files as they were published",
            got=f"{path} {what}",
            fix=Fix("advice", "keep the change in memory, or write a copy to a temporary folder"),
        )
