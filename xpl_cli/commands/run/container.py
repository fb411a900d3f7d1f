"""`xpl container`: a Dockerfile for the policy server of an adapter."""

from __future__ import annotations

import typer

from xpl_cli.commands.options import JSON, POLICY


def container(
    policy: str = POLICY,
    write: bool = typer.Option(False, "--write", help="Put Dockerfile and .dockerignore into the adapter's folder."),
    as_json: bool = JSON,
) -> None:
    """Print a Dockerfile that builds a policy server. --write puts it into the adapter's folder."""
    import shlex

    from xpl_cli.basics import console
    from xpl_cli.lifecycle import container as recipes
    from xpl_cli.packages import package

    adapter = package.load(policy)
    files = recipes.recipe(adapter)
    new = recipes.write(adapter, files) if write else []
    if as_json:
        answer = {"policy": adapter.name, "files": files, "written": new}
        console.answer(
            "xpl.container/1", answer, [] if write else [shlex.join(["xpl", "container", policy, "--write"])]
        )
    elif write:
        console.data("\n".join(str(adapter.path / name) for name in files))
    else:
        console.data(files[recipes.DOCKERFILE])
