"""How a benchmark is launched, as `hand_over` of env.yml says: words of a command, and where its result will lie.

Words may hold `{names}`. They are those of setup_eval_env_client.sh in the standard, which is what launchers of the
ecosystem are called with, and a few more (`MORE`). Nothing is run by a shell.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.manifest import EnvManifest

KEY = "hand_over"
MORE = {
    "workspace": "folder of the benchmark",
    sdk.Deploy.POLICY_NAME: "name of the adapter",
    "policy_dir": "folder of the adapter",
    sdk.Deploy.EVAL_BATCH: "true or false, as deploy.yml says",
    "episodes": "how many episodes are wanted",
    "run_id": "name of this run, a time; the same one when a run goes on",
    "package": "folder of the environment package",
    "python": "this tool's interpreter",
}
LAYOUTS, RATE = "layouts", "rate"
FORMS = (LAYOUTS, RATE)
_NAME = re.compile(r"\{(\w*)\}")
_FIELDS = (sdk.Deploy.BENCH_NAME, "workspace", "command", "rehearsal", "variables", sdk.Payload.RESULT, "randomized")


class LauncherError(UserError):
    """env.yml declares a launcher that cannot be called."""


@dataclass(frozen=True)
class Launcher:
    """A benchmark's launcher.

    Attributes:
        bench_name: as launchers and deploy.yml call the benchmark.
        variable: environment variable that names the workspace.
        files: what has to be in a workspace, below its folder.
        command: words that launch it; it runs in the workspace.
        rehearsal: words that play a stand-in of it; empty where there is none.
        variables: environment variables of the command.
        result: path of the result below the workspace; `*` stands for a name that only the benchmark knows.
        form: `layouts`, RoboDojo's _result.json; `rate`, a text whose last line is the success rate.
        randomized: how names of tasks of the randomized setting end; None where names do not tell.
    """

    bench_name: str
    variable: str
    files: tuple[str, ...]
    command: tuple[str, ...]
    result: str
    form: str
    rehearsal: tuple[str, ...] = ()
    variables: Mapping[str, str] = field(default_factory=dict)
    randomized: str | None = None

    @classmethod
    def read(cls, facts: EnvManifest) -> Launcher:
        """Return the launcher that an env.yml declares.

        Raises:
            LauncherError: there is none, or it is not of the right form.
        """
        told = facts.hand_over
        name = facts.name
        if told is None:
            raise LauncherError(f"{name} hands nothing over: its env.yml has no {KEY}", hint="see docs/hand-over.md")
        try:
            found = cls(
                bench_name=_text(told[sdk.Deploy.BENCH_NAME]),
                variable=_text(told["workspace"]["variable"]),
                files=_texts(told["workspace"]["files"]),
                command=_texts(told["command"]),
                result=_text(told[sdk.Payload.RESULT]["file"]),
                form=_text(told[sdk.Payload.RESULT]["form"]),
                rehearsal=_texts(told.get("rehearsal", ())),
                variables={_text(key): _text(value) for key, value in (told.get("variables") or {}).items()},
                randomized=told.get("randomized"),
            )
        except (KeyError, TypeError, AttributeError) as error:
            said = f"lacks {error}" if isinstance(error, KeyError) else str(error)
            raise LauncherError(f"{KEY} in the env.yml of {name}: {said}", hint="see docs/hand-over.md") from None
        unknown = [str(key) for key in told if key not in _FIELDS]
        if unknown:
            raise LauncherError(
                f"{KEY} in the env.yml of {name}: unknown {', '.join(unknown)}; the keys are {', '.join(_FIELDS)}"
            )
        found._check(str(name))
        return found

    def _check(self, name: str) -> None:
        words = (*self.files, *self.command, *self.rehearsal, *self.variables.values(), self.result)
        unknown = sorted({key for word in words for key in _NAME.findall(word)} - set(known_names()))
        if unknown:
            raise LauncherError(
                f"{KEY} in the env.yml of {name} names {{{unknown[0]}}}; there are {', '.join(known_names())}"
            )
        if self.form not in FORMS:
            forms = " or ".join(FORMS)
            raise LauncherError(f"{KEY}.result.form in the env.yml of {name} is {self.form!r}, not {forms}")
        if not self.command:
            raise LauncherError(f"{KEY}.command in the env.yml of {name} is empty")
        if Path(self.result).is_absolute() or ".." in Path(self.result).parts:
            raise LauncherError(f"{KEY}.result.file in the env.yml of {name} must lie below the workspace")

    def workspace(self, given: Path | None, values: Mapping[str, str]) -> Path:
        """Return the folder of the benchmark, if all is there that a run needs.

        Args:
            given: a folder; None leaves it to the environment variable.
            values: by name, for the files.

        Raises:
            NotFoundError: none was named, or something is missing in it.
        """
        place = given if given is not None else Path(os.environ.get(self.variable) or "")
        if not place.parts:
            raise NotFoundError(
                f"no workspace of {self.bench_name} is known",
                hint=f"name its folder with --workspace or in {self.variable}"
                + ("; --rehearse plays a stand-in without one" if self.rehearsal else ""),
            )
        folder = place.resolve()
        for file in self.files:
            path = filled(file, values)
            if not (folder / path).is_file():
                hint = None
                if values[sdk.Deploy.POLICY_NAME] in Path(path).parts:
                    hint = f"{self.bench_name} looks for the adapter there: link {values['policy_dir']} to that folder"
                raise NotFoundError(f"{folder} is no workspace of {self.bench_name} for this run: no {path}", hint=hint)
        return folder

    def words(self, values: Mapping[str, str], *, rehearse: bool) -> list[str]:
        """Return the command line.

        Raises:
            UserError: there is no rehearsal.
        """
        if rehearse and not self.rehearsal:
            raise UserError(f"{self.bench_name} has no rehearsal", code=ExitCode.NOT_RUN)
        return [filled(word, values) for word in (self.rehearsal if rehearse else self.command)]

    def environment(self, values: Mapping[str, str]) -> dict[str, str]:
        """Return the environment variables that the command gets besides."""
        return {key: filled(word, values) for key, word in self.variables.items()}


def known_names() -> tuple[str, ...]:
    """Return what words may name: the arguments of setup_eval_env_client.sh, and `MORE`."""
    arguments = spec.data("package")["scripts"][sdk.File.SETUP_EVAL_ENV_CLIENT_SH]
    return (*(name.strip("[]") for name in arguments), *MORE)


def filled(word: str, values: Mapping[str, str]) -> str:
    """Return a word with its names replaced; what a value holds is not replaced again."""
    return _NAME.sub(lambda found: values[found.group(1)], word)


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise TypeError(f"expected a text, got {value!r}")
    return value


def _texts(values: Any) -> tuple[str, ...]:
    if isinstance(values, str):
        raise TypeError(f"expected a list of texts, got {values!r}")
    return tuple(_text(value) for value in values)
