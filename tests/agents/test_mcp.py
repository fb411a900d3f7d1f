"""`xpl mcp`: every tool answers what the command line answers, to the protocol's own client over a real pipe."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import uuid
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.main import get_command

from tests.support import forked
from tests.support.peer import MARK, processes, wait_until, xpl
from xpl_cli.agents.mcp.tools import OFFERS, Tool, tools
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.main import app

if TYPE_CHECKING:
    from mcp import Client
    from mcp.types import CallToolResult

    Talk = Callable[[Client], Awaitable[Any]]

# One process of the tests, and only when it comes to them, imports the client: a second and more.
pytestmark = pytest.mark.usefixtures("_client")


@pytest.fixture(scope="module")
def _client() -> None:
    pytest.importorskip("mcp", reason="the extra `mcp` is not installed")


def talk(folder: Path, conversation: Talk, **environment: str) -> Any:
    """Start a server in a folder, talk to it, and return what came of that."""
    import anyio
    from mcp import Client, StdioServerParameters

    async def talking() -> Any:
        command = ["-m", "xpl_cli", "mcp", "--dir", str(folder)]
        server = StdioServerParameters(command=sys.executable, args=command, env={**os.environ, **environment})
        async with Client(server) as client:
            return await conversation(client)

    return anyio.run(talking)


def tool(name: str) -> Tool:
    """Return a tool by its name."""
    return next(item for item in tools(get_command(app)) if item.name == name)


def steady(document: Any) -> Any:
    """Return a document without what two equal runs differ in: times."""
    if isinstance(document, dict):
        return {key: steady(value) for key, value in document.items() if key not in {"seconds", "when"}}
    return [steady(item) for item in document] if isinstance(document, list) else document


def said(answer: CallToolResult) -> str:
    """Return the last text of an answer, which tells how the command ended."""
    return str(getattr(answer.content[-1], "text", ""))


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one adapter, which has a fault of the static gate."""
    folder = tmp_path_factory.mktemp("project")
    assert xpl("new-policy", "Foo", cwd=folder).returncode == ExitCode.CLEAN
    with (folder / "policy/Foo/model.py").open("a", encoding="utf-8") as model:
        model.write(
            "\n    def reset(self):\n        try:\n            super().reset()\n        except:\n            pass\n"
        )
    return folder


CALLS = [
    ("new_policy", {"name": "Bar", "dry_run": True, "chunk": 4}),
    ("new_env", {"name": "bar", "dry_run": True}),
    ("audit", {"paths": ["policy/Foo"], "gate": ["static"]}),
    ("audit", {"paths": ["Nowhere"]}),
    ("audit", {"paths": ["policy/Foo"], "gate": ["statics"]}),
    ("explain", {"names": ["XPL101", "XPL203"]}),
    ("explain", {"names": ["batch-by-positio"]}),
    ("status", {"packages": ["policy/Foo"]}),
]


def test_every_tool_has_a_call() -> None:
    """Those below, and that of a test of its own."""
    assert {name for name, _ in CALLS} | {"eval_summary"} == set(OFFERS)


@pytest.mark.slow
@pytest.mark.parametrize("calls", [pytest.param(CALLS, marks=pytest.mark.slow), CALLS[2:4]], ids=["all", "some"])
def test_every_tool_answers_what_the_command_answers(calls: list[tuple[str, dict[str, Any]]], project: Path) -> None:
    """The same document, the same exit code, and the same sentence where there is no document."""

    async def all_calls(client: Client) -> list[CallToolResult]:
        return [await client.call_tool(name, arguments) for name, arguments in calls]

    for (name, arguments), answer in zip(calls, talk(project, all_calls), strict=True):
        done = xpl(*tool(name).command_line(arguments), cwd=project)
        where = f"{name} {arguments}: {said(answer)}"
        expected = json.loads(done.stdout) if done.stdout.strip() else None
        assert steady(answer.structured_content) == steady(expected), where
        assert said(answer).startswith(f"exit code {done.returncode} ("), where
        assert answer.is_error == (done.returncode not in {ExitCode.CLEAN, ExitCode.FINDINGS, ExitCode.NOT_RUN}), where
        for line in done.stderr.splitlines():
            if line.startswith(("error:", "Hint:")):
                assert line in said(answer), where


@pytest.mark.slow
def test_a_recorded_run_is_summarised(tmp_path: Path) -> None:
    """What `xpl report` writes of it, from its record."""
    recorded = ("--env", "mujoco", "--episodes", "1", "--out", "run", "--film", "0")
    assert xpl("eval", "demo_policy", *recorded, cwd=tmp_path).returncode == ExitCode.CLEAN

    async def summarise(client: Client) -> CallToolResult:
        return await client.call_tool("eval_summary", {"runs": ["run"]})

    answer = talk(tmp_path, summarise)
    assert not answer.is_error, said(answer)
    assert answer.structured_content == json.loads(xpl("report", "run", "--json", cwd=tmp_path).stdout)


def test_tools_describe_themselves(project: Path) -> None:
    """Each has a schema and says whether it changes anything; the server says how to read an answer."""

    async def look(client: Client) -> Any:
        return (await client.list_tools()).tools, client.instructions

    listed, instructions = talk(project, look)
    assert {item.name: item.input_schema for item in listed} == {name: tool(name).schema for name in OFFERS}
    assert {item.name for item in listed if item.annotations.read_only_hint} >= {"explain", "status"}
    replacing = {name for name, item in OFFERS.items() if {"overwrite", "fix", "out"} & {*item.takes}}
    assert {"new_policy", "new_env", "audit"} <= replacing
    assert {item.name for item in listed if item.annotations.destructive_hint} == replacing
    assert all(item.description for item in listed)
    assert "not_run" in instructions


@pytest.mark.slow
def test_what_a_command_says_meanwhile_arrives_as_progress(project: Path) -> None:
    """An audit takes long, and clients give up on silence."""
    heard: list[str] = []

    async def hear(progress: float, total: float | None, message: str | None) -> None:
        heard.append(message or "")

    async def audit(client: Client) -> CallToolResult:
        arguments = {"paths": ["policy/Foo"], "gate": ["static"]}
        return await client.call_tool("audit", arguments, progress_callback=hear)

    answer = talk(project, audit)
    assert not answer.is_error
    assert any("static gate" in line for line in heard)


@pytest.mark.slow
def test_a_wrong_call_is_answered_and_the_server_goes_on(project: Path) -> None:
    """An unknown tool, an unknown argument, a value of another type, a missing argument: each is told what is wrong."""

    async def wrong(client: Client) -> list[CallToolResult]:
        calls: list[tuple[str, dict[str, Any]]] = [
            ("evaluate", {}),
            ("explain", {"names": ["XPL101"], "loud": True}),
            ("audit", {"paths": "policy/Foo"}),
            ("explain", {}),
            ("explain", {"names": ["XPL101", "XPL203"]}),
        ]
        return [await client.call_tool(name, arguments) for name, arguments in calls]

    *refused, answered = talk(project, wrong)
    assert [answer.is_error for answer in refused] == [True] * len(refused)
    for answer, word in zip(refused, ("there is no tool 'evaluate'", "loud", "array", "'names'"), strict=True):
        assert word in said(answer)
    assert not answered.is_error


def test_an_argument_cannot_become_an_option() -> None:
    """What stands in a place stays there, whatever it begins with."""
    assert tool("explain").command_line({"names": ["--help"]}) == ["explain", "--json", "--", "--help"]
    given = {"paths": ["--fix"], "gate": ["static", "--fix"], "keep_going": False, "episodes": 3}
    assert tool("audit").command_line(given) == [
        *("audit", "--json", "--gate=static", "--gate=--fix", "--episodes=3", "--", "--fix")
    ]
    with pytest.raises(UserError, match="episodes"):
        tool("audit").command_line({"episodes": "--fix"})


@pytest.mark.slow
def test_a_call_that_is_given_up_ends_its_command(project: Path) -> None:
    """Neither the audit nor the server and the worker that it started are left."""
    import anyio

    mark = uuid.uuid4().hex

    async def give_up(client: Client) -> None:
        began = anyio.Event()

        async def hear(progress: float, total: float | None, message: str | None) -> None:
            if "offline gate" in (message or ""):
                began.set()

        async def audit() -> None:
            arguments = {"paths": ["policy/Foo"], "gate": ["offline"]}
            await client.call_tool("audit", arguments, progress_callback=hear)

        async with anyio.create_task_group() as group:
            group.start_soon(audit)
            await began.wait()
            group.cancel_scope.cancel()

        def only_the_server() -> bool:
            return all(" mcp " in f"{command} " for command in processes(mark).values())

        await anyio.to_thread.run_sync(wait_until, only_the_server, "the audit has ended")
        answer = await client.call_tool("explain", {"names": ["XPL101", "XPL203"]})
        assert not answer.is_error

    talk(project, give_up, **{MARK: mark})
    wait_until(lambda: not processes(mark), "the server has ended, too")


@pytest.mark.slow
@pytest.mark.sampled(1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, None], ids=str)
def test_the_server_ends_when_told_and_leaves_nothing(project: Path, number: signal.Signals | None) -> None:
    """By Ctrl-C, by SIGTERM, or because its client is gone: the audit ends, and the server that it started."""
    mark = uuid.uuid4().hex
    command = [sys.executable, "-m", "xpl_cli", "mcp", "--dir", str(project)]
    server = subprocess.Popen(
        command,
        env={**os.environ, MARK: mark},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    with server:
        assert server.stdin is not None
        assert server.stdout is not None

        def send(method: str, **parts: Any) -> None:
            assert server.stdin is not None
            server.stdin.write(json.dumps({"jsonrpc": "2.0", "method": method, **parts}).encode() + b"\n")
            server.stdin.flush()

        about = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "test", "version": "1"}}
        send("initialize", id=1, params=about)
        server.stdout.readline()
        send("notifications/initialized")
        arguments = {"paths": ["policy/Foo"], "gate": ["offline"]}
        call = {"name": "audit", "arguments": arguments, "_meta": {"progressToken": "t"}}
        send("tools/call", id=2, params=call)
        assert any(b"offline gate" in line for line in server.stdout)
        wait_until(lambda: len(processes(mark)) > 2, "the audit has started a server")
        if number is None:
            server.stdin.close()
        else:
            server.send_signal(number)
        wait_until(lambda: server.poll() is not None, "the server has ended")
        wait_until(lambda: not processes(mark), "nothing that it started is left")
    wanted = {signal.SIGINT: ExitCode.INTERRUPTED, signal.SIGTERM: 128 + signal.SIGTERM, None: ExitCode.CLEAN}
    assert server.returncode == wanted[number]


def test_without_the_sdk_the_command_says_what_to_install(project: Path, tmp_path: Path) -> None:
    """One sentence and a command, and no traceback."""
    (tmp_path / "mcp.py").write_text("raise ImportError('there is none')\n")
    done = forked.anew("mcp", cwd=tmp_path)
    assert done.returncode == ExitCode.USAGE
    assert "there is none" in done.stderr
    assert "pip install 'mcp" in done.stderr
    assert forked.anew("mcp", "--json", cwd=tmp_path).returncode == ExitCode.CLEAN


@pytest.mark.parametrize("name", OFFERS)
def test_an_offer_names_options_that_the_command_has(name: str) -> None:
    """Making the tools reads them, and fails otherwise; what concerns output is not among them."""
    assert not {"json", "format", "output"}.intersection(OFFERS[name].takes)
    assert len(tool(name).parameters) == len(OFFERS[name].takes)
