"""Run read-only git commands, with explicit paths of repository and work tree.

A third party's branch may contain a folder that git takes for a repository: with `HEAD`, `objects`, `refs` and a
`config` whose `core.fsmonitor` is a command. So git never searches for its repository: it gets repository and work tree
by name (`discovery.py` finds them), and every setting that could run a command is overridden, because even the user's
own `.git/config` may include a file of the branch. Only these commands are run: `rev-parse`, `merge-base`, `ls-tree`,
`ls-files`, `cat-file`, `config`. None of them filters, converts or compares content, so attributes do not matter.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from xpl_cli.basics.errors import UserError

_NOTHING: Final = os.devnull
_OVERRULED: Final = {
    "core.alternateRefsCommand": "",
    "core.attributesFile": _NOTHING,
    "core.fsmonitor": "false",
    "core.hooksPath": _NOTHING,
    "core.pager": "cat",
    "core.sshCommand": "false",
    "core.untrackedCache": "false",
    "diff.external": "",
    "protocol.allow": "never",
    "safe.bareRepository": "explicit",
    "submodule.recurse": "false",
}
_ENVIRONMENT: Final = {
    "GIT_ALLOW_PROTOCOL": "none",  # stronger than `protocol.NAME.allow`; missing objects are not fetched
    "GIT_GRAFT_FILE": os.devnull,  # otherwise .git/info/grafts could move the merge base
    "GIT_NO_LAZY_FETCH": "1",
    "GIT_NO_REPLACE_OBJECTS": "1",
    "GIT_OPTIONAL_LOCKS": "0",
    "GIT_PAGER": "cat",
    "GIT_TERMINAL_PROMPT": "0",
    "LC_ALL": "C",
}
_LONGEST_S: Final = 60.0
"""Longest run time: matching an untrusted .gitignore pattern can take exponential time."""
_MOST_BYTES: Final = 64 << 20
"""Largest output: a listing of some 500,000 files."""
_MOST_SAID: Final = 4096
_READING: Final = frozenset(("rev-parse", "merge-base", "ls-tree", "ls-files", "cat-file", "config"))


@dataclass(frozen=True)
class Git:
    """A repository and its work tree.

    Attributes:
        directory: the repository that `.git` is or points to.
        root: top of the work tree.
    """

    directory: Path
    root: Path

    def text(self, command: str, *arguments: str) -> str:
        """Return the output of a command; undecodable bytes become surrogates."""
        return self.answer(command, *arguments).decode(errors="surrogateescape")

    def answer(self, command: str, *arguments: str, input_bytes: bytes = b"") -> bytes:
        """Return the output of a command for an input on its standard input.

        Raises:
            UserError: if it fails, takes over a minute, has too much output, or git is missing.
            ValueError: if it is no read-only command.
        """
        if command not in _READING:
            raise ValueError(f"git {command} is not among the commands that only read")
        overruled = (word for name, value in _OVERRULED.items() for word in ("-c", f"{name}={value}"))
        line = ["git", "--no-pager", "--literal-pathspecs", *overruled, command, *arguments]
        with tempfile.TemporaryFile() as stdin, tempfile.TemporaryFile() as stderr:
            stdin.write(input_bytes)
            stdin.seek(0)
            try:
                process = subprocess.Popen(
                    line, cwd=self.root, env=self._environment(), stdin=stdin, stdout=subprocess.PIPE, stderr=stderr
                )
            except FileNotFoundError:
                raise UserError("what changed needs git, which is not on PATH") from None
            except ValueError:  # a NUL in an argument
                raise UserError("an argument of git holds a NUL, which no name in git has") from None
            answer = self._read(process, command)
            if process.returncode:
                stderr.seek(0)
                message = stderr.read(_MOST_SAID).decode(errors="replace").strip()
                raise UserError(message or f"git ended with {process.returncode}")
        return answer

    def _read(self, process: subprocess.Popen[bytes], command: str) -> bytes:
        """Return the output of a process.

        Raises:
            UserError: if it takes over a minute, or writes more than a repository of code has.
        """
        late = threading.Timer(_LONGEST_S, process.kill)
        with process:
            late.start()
            try:
                answer = process.stdout.read(_MOST_BYTES + 1) if process.stdout else b""
                if len(answer) <= _MOST_BYTES:
                    process.wait()
            finally:
                is_late = late.finished.is_set()
                late.cancel()
                process.kill()
        if is_late:
            raise UserError(
                f"git {command} did not end within {_LONGEST_S:.0f} s, as a pattern of a .gitignore can make it",
                hint=f"look at the patterns in {self.root}",
            )
        if len(answer) > _MOST_BYTES:
            raise UserError(
                f"git {command} answers more than {_MOST_BYTES >> 20} MB about {self.root}, expected the files of a "
                "repository of code: a few trees can stand for any number of names",
                hint=f"look with: git -C {shlex.quote(str(self.root))} count-objects -v",
            )
        return answer

    def _environment(self) -> dict[str, str]:
        """Return the environment variables, without the caller's git variables."""
        inherited = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
        return inherited | _ENVIRONMENT | {"GIT_DIR": str(self.directory), "GIT_WORK_TREE": str(self.root)}
