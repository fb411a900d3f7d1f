"""`xpl replay`."""

from __future__ import annotations

from pathlib import Path

import typer

from xpl_cli.basics.endings import ends
from xpl_cli.commands import values


@ends(clean="equal", findings="different", not_run="not playable")
def replay(
    folder: Path = typer.Argument(..., metavar="DIR", help="Folder that `xpl audit --trace` filled."),
    policy: str | None = typer.Option(None, "--policy", help="Adapter to play against; the recorded one by default."),
    url: str | None = typer.Option(None, "--url", metavar="URL", help="Play against the server at ws://host:port."),
    tolerance: float = typer.Option(0.0, min=0.0, help="Numbers may be apart by this much; 0 compares bits."),
    settings: list[str] = typer.Option([], "--set", metavar="KEY=VALUE", help="Override a key of deploy.yml."),
    python: str | None = typer.Option(None, help="Interpreter that runs the adapter."),
    policy_env: str | None = typer.Option(None, "--policy-env", "--env", help="conda:NAME, uv:DIR, venv:DIR or none."),
    token_file: Path | None = typer.Option(None, metavar="FILE", help="Bearer token for --url."),
    ca_file: Path | None = typer.Option(
        None, callback=values.certificates, metavar="FILE", help="Certificate authority for --url wss://..."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print a JSON object."),
) -> None:
    """Play a recording again; show the first answer that differs. It asks a server, or another version of it."""
    import shlex

    from xpl_cli.audit.replay.counterparts import Adapter, Counterpart, Remote
    from xpl_cli.audit.replay.play import replay as play
    from xpl_cli.audit.served import recording
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
    from xpl_cli.basics.progress import progress
    from xpl_cli.packages import package as packages
    from xpl_cli.serving.secrets import client_tls_context, read_token

    overrides = packages.parse_overrides(settings)
    if url is not None and (policy is not None or settings or python or policy_env):
        raise UserError(
            "--url names a server that runs already: --policy, --set, --python and --env say how to start one"
        )
    if url is None and (token_file or ca_file):
        raise UserError("--token-file and --ca-file go with --url")
    recordings = [recording.load(path) for path in recording.find(folder)]
    token = None if token_file is None else read_token(token_file)
    context = None if ca_file is None else client_tls_context(ca_file)

    def target(recorded: recording.Recording) -> Counterpart:
        index = recorded.index
        if url is not None:
            return Remote(url, index["overrides"], token, context)
        try:
            package = packages.load(policy or index["policy"]["path"])
        except NotFoundError as error:
            if policy is not None:
                raise
            raise NotFoundError(str(error), hint="name the adapter with --policy, or a server with --url") from None
        return Adapter(package, overrides, python, policy_env)

    targets = [target(recorded) for recorded in recordings]
    with progress() as say:
        played = [play(one, against, tolerance, say) for one, against in zip(recordings, targets, strict=True)]
    if as_json:
        next_steps = [f"xpl replay {shlex.quote(str(folder))} --tolerance 1e-6"] if tolerance == 0 else []
        differ = any(one.difference for one in played)
        entries = [one.document() for one in played]
        console.answer("xpl.replay/1", {"recordings": entries}, next_steps if differ else [])
    else:
        how = "bit for bit" if tolerance == 0 else f"up to {tolerance:g}"
        for one in played:
            counted = f"{one.compared} answers of {one.against}"
            console.data(f"{one.recording}: {one.difference or f'{counted} are equal, {how}'}")
            for remark in one.remarks:
                console.data(f"  {remark}")
    raise typer.Exit(ExitCode.FINDINGS if any(one.difference for one in played) else ExitCode.CLEAN)
