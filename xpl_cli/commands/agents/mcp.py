"""`xpl mcp`: the command line for agents that speak the Model Context Protocol."""

from __future__ import annotations

from pathlib import Path

import typer


def mcp(
    context: typer.Context,
    project: Path = typer.Option(
        Path(), "--dir", metavar="DIR", help="Project that the tools work in; this folder by default."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print the tools as a JSON object, and serve nothing."),
) -> None:
    """Serve commands as tools of the Model Context Protocol. Over standard input and output.

    Ends when the client does. Needs the extra `mcp`; --json does not.
    """
    from xpl_cli.agents.mcp.tools import tools
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import NotFoundError

    if not project.is_dir():
        raise NotFoundError(f"--dir {project} is no folder")
    offered = tools(context.find_root().command)
    if as_json:
        told = [
            {"name": tool.name, "command": f"xpl {tool.offer.command}", "description": tool.description}
            for tool in offered
        ]
        console.data_json({"schema": "xpl.mcp/1", "tools": told, "next": []})
        return
    from xpl_cli.agents.mcp.server import serve

    serve(offered, project.resolve())
