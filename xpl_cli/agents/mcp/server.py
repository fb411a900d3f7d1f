"""The server: tools over standard input and output, by the protocol's official SDK."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl_cli import __version__
from xpl_cli.agents.mcp.call import end_all, kill_all, run
from xpl_cli.basics.endings import endings
from xpl_cli.basics.errors import ExitCode, UserError, no_such
from xpl_cli.basics.extras import how_to_install

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Sequence

    from mcp import types
    from mcp.server import Server

    from xpl_cli.agents.mcp.tools import Tool

_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
INSTRUCTIONS: Final = f"""\
Tools of xpl: robot policies and environments held to one standard. A tool runs the command of the same name, answers
with its JSON, whose `next` lists the commands that come next, and says how it ended. {endings()}
`not_run` is no pass: only a whole audit whose verdict is green proves an adapter's contract, and `statement` says what
else is proven: hand it on whole. `audit` runs the package's code. How to integrate, audit, debug and evaluate is told
by `xpl skills get NAME --full`; `xpl skills list` names them."""


def serve(tools: Sequence[Tool], folder: Path) -> None:
    """Serve until the client closes the connection.

    Args:
        tools: what is offered.
        folder: working directory of every command.

    Raises:
        UserError: if the SDK is not installed.
    """
    try:
        import anyio
        from mcp import stdio_server
    except ImportError as error:
        raise UserError(
            f"xpl mcp needs the protocol's SDK in version 2 or newer: {error}",
            hint=f"`{how_to_install('mcp')}`",
        ) from None

    async def serving() -> None:
        server = _server(tools, folder)
        async with anyio.create_task_group() as group:
            group.start_soon(_until_told)
            async with stdio_server() as (reading, writing):
                await server.run(reading, writing, server.create_initialization_options())
            group.cancel_scope.cancel()

    anyio.run(serving)


async def _until_told() -> None:
    """End the commands that run, and this process, when it is told to end; the second time at once.

    The protocol's SDK reads standard input in a thread that nothing can interrupt, so that nothing else would end it.
    """
    import anyio

    with anyio.open_signal_receiver(*_ENDING) as signals:
        async for number in signals:
            async with anyio.create_task_group() as group:
                group.start_soon(_end_at_once, signals)
                await end_all()
                group.cancel_scope.cancel()
            os._exit(ExitCode.INTERRUPTED if number == signal.SIGINT else 128 + number)


async def _end_at_once(signals: AsyncIterator[signal.Signals]) -> None:
    async for _ in signals:
        kill_all()


def _server(tools: Sequence[Tool], folder: Path) -> Server[Any]:
    from mcp import types
    from mcp.server import Server

    offered = {tool.name: tool for tool in tools}

    async def list_tools(_context: Any, _asked: Any) -> types.ListToolsResult:
        return types.ListToolsResult(tools=[_described(tool) for tool in offered.values()])

    async def call_tool(context: Any, asked: types.CallToolRequestParams) -> types.CallToolResult:
        async def progress(number: int, line: str) -> None:
            await context.session.report_progress(number, None, line)

        if asked.name not in offered:
            return _refused(no_such(f"there is no tool {asked.name!r}", asked.name, offered))
        try:
            command = offered[asked.name].command_line(asked.arguments or {})
        except UserError as error:
            return _refused(error)
        answer = await run(command, folder, progress)
        texts = [text for text in (answer.text, answer.about) if text]
        return types.CallToolResult(
            content=[types.TextContent(type="text", text=text) for text in texts],
            structured_content=answer.document,
            is_error=answer.is_error,
        )

    return Server(
        "xpl", version=__version__, instructions=INSTRUCTIONS, on_list_tools=list_tools, on_call_tool=call_tool
    )


def _refused(error: UserError) -> types.CallToolResult:
    from mcp import types

    text = "\n".join([str(error), *([f"Hint: {error.hint}"] if error.hint else [])])
    return types.CallToolResult(content=[types.TextContent(type="text", text=text)], is_error=True)


def _described(tool: Tool) -> types.Tool:
    from mcp import types

    return types.Tool(
        name=tool.name,
        description=tool.description,
        input_schema=tool.schema,
        annotations=types.ToolAnnotations(read_only_hint=tool.offer.reads_only, destructive_hint=tool.overwrites),
    )
