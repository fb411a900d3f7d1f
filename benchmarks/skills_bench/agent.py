"""A coding agent as a command line: start it in a project with a prompt, wait for it, read its usage."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

PROMPT: Final = "{prompt}"


class NotRunError(Exception):
    """An agent could not begin; the message says why."""


@dataclass(frozen=True)
class Agent:
    """An agent, as it was named on the command line.

    Attributes:
        name: in results.
        words: its command; `{prompt}` stands for the prompt, which is appended if no word has it.
    """

    name: str
    words: tuple[str, ...]

    @classmethod
    def read(cls, text: str) -> Agent:
        """Return the agent of `NAME=COMMAND`.

        Raises:
            ValueError: if it has another form.
        """
        name, equals, command = text.partition("=")
        words = shlex.split(command)
        if not name or not equals or not words:
            raise ValueError(f"an agent is NAME=COMMAND, got {text!r}")
        return cls(name, tuple(words if PROMPT in command else [*words, PROMPT]))

    def ask(self, prompt: str, folder: Path, environment: Mapping[str, str], limit_s: float) -> AgentOutput:
        """Run the agent until it ends, or end it and all that it started after `limit_s` seconds.

        Raises:
            NotRunError: if there is no such program.
        """
        program = shutil.which(self.words[0], path=environment.get("PATH"))
        if program is None:
            raise NotRunError(f"there is no program {self.words[0]!r} on PATH")
        words = [word.replace(PROMPT, prompt) for word in self.words[1:]]
        started = time.time()
        with subprocess.Popen(
            [program, *words],
            cwd=folder,
            env=dict(environment),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        ) as process:
            try:
                output, _ = process.communicate(timeout=limit_s)
                in_time = True
            except subprocess.TimeoutExpired:
                _end(process)
                output, _ = process.communicate()
                in_time = False
            except BaseException:
                _end(process)
                raise
        return AgentOutput(output, process.returncode, started, time.time() - started, in_time)


@dataclass(frozen=True)
class AgentOutput:
    """The result of one call.

    Attributes:
        output: all that it printed.
        code: its exit code.
        started: when, s since the epoch.
        seconds: duration.
        in_time: False if it was ended.
    """

    output: str
    code: int
    started: float
    seconds: float
    in_time: bool

    @property
    def tokens(self) -> dict[str, int] | None:
        """Tokens as the agent counts them: the last `usage` of the JSON that it prints, or None."""
        usages = [usage for document in _documents(self.output) for usage in _usages(document)]
        return usages[-1] if usages else None


def _end(process: subprocess.Popen[str]) -> None:
    """End the agent and what it started; all of it is one process group."""
    os.killpg(process.pid, signal.SIGKILL)


def _documents(output: str) -> Iterator[Any]:
    """Yield the JSON in an output: all of it, or a line each."""
    for text in (output, *output.splitlines()):
        try:
            yield json.loads(text)
        except ValueError:
            continue


def _usages(document: Any) -> Iterator[dict[str, int]]:
    """Yield every mapping called `usage` with the numbers in it, however deep."""
    if isinstance(document, dict):
        for key, value in document.items():
            if key == "usage" and isinstance(value, dict):
                yield {name: number for name, number in value.items() if isinstance(number, int)}
            yield from _usages(value)
    elif isinstance(document, list):
        for entry in document:
            yield from _usages(entry)
