"""`xpl doctor`: what this machine can run."""

from __future__ import annotations

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import JSON


@exit_codes(clean="nothing is broken", findings="something is broken")
def doctor(as_json: bool = JSON) -> None:
    """Check what this machine can run, and how to fix the rest.

    Only some policies need what is absent.
    """
    from dataclasses import asdict

    from xpl_cli.basics import console
    from xpl_cli.basics.errors import ExitCode
    from xpl_cli.lifecycle.doctor.check import Status
    from xpl_cli.lifecycle.doctor.run import examine

    checks = examine()
    broken = [check.name for check in checks if check.status is Status.BROKEN]
    if as_json:
        console.answer("xpl.doctor/1", {"broken": broken, "checks": [asdict(check) for check in checks]})
    else:
        width = max(len(check.name) for check in checks)
        for check in checks:
            console.data(f"{check.status:<6}  {check.name:<{width}}  {check.result}")
            if check.status is not Status.OK:
                console.data(f"{'':<{8 + width}}  for {check.serves}" + (f"; fix: {check.fix}" if check.fix else ""))
    if broken:
        raise typer.Exit(ExitCode.FINDINGS)
