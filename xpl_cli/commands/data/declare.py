"""`xpl data declare`: the demonstrations that audits compare a policy with."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import JSON


@exit_codes(clean="written", not_found="no such policy, or no demonstrations there")
def declare(
    policy: Path = typer.Argument(..., metavar="POLICY", help="Folder of the policy."),
    demonstrations: Path = typer.Argument(..., metavar="PATH", help="Folder of episodes in the standard's format."),
    as_json: bool = JSON,
) -> None:
    """Write demonstrations.yml: the episodes that audits compare a policy with, and their digests."""
    from xpl_cli.audit.offline.demonstrations import declaration
    from xpl_cli.basics import console

    path, digests = declaration.declare(policy, demonstrations)
    if as_json:
        answer = {"file": str(path), "episodes": len(digests)}
        console.answer("xpl.data-declare/1", answer, [f"xpl audit {policy}"])
    else:
        console.data(f"{path}: {len(digests)} episodes\nnext\n  xpl audit {policy}")
