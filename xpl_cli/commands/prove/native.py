"""`xpl native`: what the model says through its authors' own code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from xpl_cli.basics.endings import ends
from xpl_cli.commands.run.serve import PATIENCE_HELP, POLICY, POLICY_ENV, SETTINGS

if TYPE_CHECKING:
    from xpl_cli.native.record import Recorded

app = typer.Typer(help="What the model says through its authors' own code.", no_args_is_help=True)


@app.callback()
def native() -> None:
    """What the model says through its authors' own code."""


@app.command()
@ends(clean="recorded", not_found="no native.py", not_run="native.py could not be run")
def record(
    policy: str = POLICY,
    settings: list[str] = SETTINGS,
    python: str | None = typer.Option(None, help="Interpreter that runs native.py."),
    policy_env: str | None = POLICY_ENV,
    patience: float = typer.Option(300.0, min=0.1, metavar="SECONDS", help=PATIENCE_HELP),
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object."),
) -> None:
    """Ask native.py about scripted episodes and write its answers into the package, for audits to compare with."""
    import shlex

    from xpl_cli.basics import console
    from xpl_cli.basics.progress import progress
    from xpl_cli.native import names
    from xpl_cli.native import record as recording
    from xpl_cli.packages import package as packages

    adapter = packages.load(policy)
    overrides = packages.parse_overrides(settings)
    with progress() as say:
        options = recording.Options(overrides, python, policy_env, patience, say)
        done = recording.record(adapter, options)
    path = adapter.path / names.PAIRS
    following = [shlex.join(["xpl", "audit", policy])]
    if as_json:
        console.answer("xpl.native-record/1", _document(adapter.name, str(path), done), following)
        return
    console.data(str(path))
    for line in _lines(done):
        console.note(line)
    console.note(f"next: {following[0]}")


def _document(name: str, path: str, done: Recorded) -> dict[str, Any]:
    return {
        "policy": name,
        "path": path,
        "bytes": done.size,
        "pairs": done.pairs.count,
        "sessions": [
            {
                "embodiment": one.embodiment,
                "action_type": one.action_type,
                "pairs": len(one.questions),
                "takes": one.takes,
            }
            for one in done.pairs.sessions
        ],
        "conventions": done.conventions,
        "assumed": list(done.assumed),
        "noise": dict(done.noise),
    }


def _lines(done: Recorded) -> list[str]:
    """Return what was recorded, for people."""
    from xpl_cli.basics.sizes import told_size

    kinds = ", ".join(f"{one.embodiment} {one.action_type} ({len(one.questions)})" for one in done.pairs.sessions)
    takes = max(one.takes for one in done.pairs.sessions)
    each = f", {takes} answers each" if takes > 1 else ""
    assumed = (
        f"{len(done.assumed)} of them assumed: {', '.join(done.assumed)}" if done.assumed else "none of them assumed"
    )
    noise = max(done.noise.values(), default=0.0)
    apart = "two recordings are equal" if noise == 0 else f"two recordings differ by up to {noise:.1g} of the span"
    return [
        f"{done.pairs.count} pairs{each}, {told_size(done.size)}: {kinds}",
        f"{done.conventions} conventions named, {assumed}",
        *([] if takes > 1 else [apart]),
    ]
