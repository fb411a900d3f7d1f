"""The launcher of a benchmark, from `hand_over` of env.yml: words of a command, and the path of its result.

Words may hold `{names}`: the arguments of setup_eval_env_client.sh in the standard, with which launchers of the
ecosystem are called, and a few more (`MORE`). No shell runs them.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.manifest import EnvManifest, HandOver

KEY = "hand_over"
MORE = {
    "workspace": "folder of the benchmark",
    sdk.Deploy.POLICY_NAME: "name of the adapter",
    "policy_dir": "folder of the adapter",
    sdk.Deploy.EVAL_BATCH: "true or false, as in deploy.yml",
    "episodes": "how many episodes are wanted",
    "run_id": "name of this run, a time; the same one when a run goes on",
    "package": "folder of the environment package",
    "python": "this tool's interpreter",
}
RATE = "rate"
"""Form of a result without the success of each episode."""
_NAME = re.compile(r"\{(\w*)\}")


class LauncherError(UserError):
    """env.yml declares no launcher, or one that cannot be called."""


@dataclass(frozen=True)
class Launcher:
    """A benchmark's launcher, as its env.yml declares it."""

    entry: HandOver

    @classmethod
    def read(cls, facts: EnvManifest) -> Launcher:
        """Return the launcher of an environment.

        Raises:
            LauncherError: there is none, something is missing, or a word names what there is not.
        """
        entry, where = facts.hand_over, f"{KEY} in the env.yml of {facts.name}"
        if entry is None:
            raise LauncherError(
                f"{facts.name} hands nothing over: its env.yml has no {KEY}", hint="see docs/hand-over.md"
            )
        result = entry.result
        needed = {
            sdk.Deploy.BENCH_NAME: entry.bench_name,
            "workspace": entry.workspace.variable and entry.workspace.files,
            "command": entry.command,
            sdk.Payload.RESULT: result.form and result.file,
        }
        lacking = [key for key, value in needed.items() if not value]
        if lacking:
            raise LauncherError(f"{where} lacks {lacking[0]}, or parts of it", hint="see docs/hand-over.md")
        words = (*entry.workspace.files, *entry.command, *entry.rehearsal, *entry.variables.values(), result.file)
        unknown = sorted({key for word in words for key in _NAME.findall(word)} - set(known_names()))
        if unknown:
            raise LauncherError(f"{where} names {{{unknown[0]}}}; there are {', '.join(known_names())}")
        if Path(result.file).is_absolute() or ".." in Path(result.file).parts:
            raise LauncherError(f"{where}: {sdk.Payload.RESULT}.file must lie below the workspace")
        return cls(entry)

    @property
    def bench_name(self) -> str:
        """What launchers and deploy.yml call the benchmark."""
        return self.entry.bench_name

    def workspace(self, folder_name: Path | None, values: Mapping[str, str]) -> Path:
        """Return the folder of the benchmark, if all is there that a run needs.

        Args:
            folder_name: a folder; None leaves it to the environment variable.
            values: by name, for the files.

        Raises:
            NotFoundError: none was named, or something is missing in it.
        """
        path_given = (
            folder_name if folder_name is not None else Path(os.environ.get(self.entry.workspace.variable) or "")
        )
        if not path_given.parts:
            raise NotFoundError(
                f"no workspace of {self.bench_name} is known",
                hint=f"name its folder with --workspace or in {self.entry.workspace.variable}"
                + ("; --rehearse runs a mock without one" if self.entry.rehearsal else ""),
            )
        folder = path_given.resolve()
        for file in self.entry.workspace.files:
            path = fill_placeholders(file, values)
            if not (folder / path).is_file():
                hint = None
                if values[sdk.Deploy.POLICY_NAME] in Path(path).parts:
                    hint = f"{self.bench_name} expects the adapter there: link {values['policy_dir']} to that folder"
                raise NotFoundError(f"{folder} is no workspace of {self.bench_name} for this run: no {path}", hint=hint)
        return folder

    def words(self, values: Mapping[str, str], *, rehearse: bool) -> list[str]:
        """Return the command line.

        Raises:
            UserError: there is no rehearsal.
        """
        if rehearse and not self.entry.rehearsal:
            raise UserError(f"{self.bench_name} has no rehearsal", code=ExitCode.NOT_RUN)
        return [fill_placeholders(word, values) for word in (self.entry.rehearsal if rehearse else self.entry.command)]

    def environment(self, values: Mapping[str, str]) -> dict[str, str]:
        """Return the environment variables that the command gets besides."""
        return {key: fill_placeholders(word, values) for key, word in self.entry.variables.items()}


def known_names() -> tuple[str, ...]:
    """Return the allowed names in words: the arguments of setup_eval_env_client.sh, and `MORE`."""
    arguments = spec.data("package")["scripts"][sdk.File.SETUP_EVAL_ENV_CLIENT_SH]
    return (*(name.strip("[]") for name in arguments), *MORE)


def fill_placeholders(word: str, values: Mapping[str, str]) -> str:
    """Return a word with its names replaced; what a value holds is not replaced again."""
    return _NAME.sub(lambda match: values[match.group(1)], word)
