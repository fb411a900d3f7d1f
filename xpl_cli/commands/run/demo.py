"""`xpl demo`: the whole route in one command."""

from __future__ import annotations

from pathlib import Path

import typer


def demo(
    keep: Path | None = typer.Option(None, "--keep", metavar="DIR", help="Keep the adapters in this new folder."),
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object instead of the commands' output."),
) -> None:
    """Run the whole workflow on a small adapter. Scaffolds, serves and audits it, then audits a broken copy."""
    from xpl_cli import demo as route
    from xpl_cli.basics import console

    played = route.run_demo(keep, console.note if as_json else console.data, quiet=as_json)
    if as_json:
        console.answer("xpl.demo/1", route.summary(played), ["xpl new-policy Foo", "xpl audit policy/Foo"])
        return
    total = sum(step.seconds for step in played.steps)
    console.data(
        f"\nNothing is wrong with the scaffold, and its broken copy was caught, in {total:.0f} s. Next:\n"
        "  xpl new-policy Foo          start your own adapter\n"
        "  xpl audit policy/Foo        carry it through the gates\n"
        "  xpl eval scripted_expert --env mujoco --task handover_block --episodes 3"
    )
