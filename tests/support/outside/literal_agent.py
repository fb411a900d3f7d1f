"""An agent without knowledge of its own: it carries out a skill to the letter, and stops where the text leaves a gap.

What it does of itself is reading: steps and commands from SKILL.md, pieces of code from `references/adapter.md`, keys
from `references/package.md`, words from `references/native.md`. What the skill tells it to ask is in `Answers`.
"""

from __future__ import annotations

import ast
import json
import os
import re
import shlex
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.support import forked
from xpl_cli.agents.skills.bundle import Bundle, chosen

SKILL = "xpl-integrate-policy"
MARK = "XPL-PLACEHOLDER"

_FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
_WORD = re.compile(r"\b[A-Z][A-Z_]+\b")


class GapError(AssertionError):
    """The text does not say what to do, or what it says should be seen is not."""


@dataclass(frozen=True)
class Answers:
    """What the user and the code of a policy answer to the skill's questions.

    Attributes:
        values: what words in capitals stand for, in commands and in code.
        sections: headings of adapter.md that fit.
        manifest: values of policy.yml.
        about: what the policy is, where its weights are, and what was measured, for README.md.
        code: file with the model's own code, and its name beside model.py.
        native: file with what runs the authors' own code, native.py.
        weights: file with the weights.
        beside: other files that lie where the weights do.
    """

    values: Mapping[str, str]
    sections: frozenset[str]
    manifest: Mapping[str, Any]
    about: tuple[str, str, str]
    code: tuple[Path, str]
    native: Path
    weights: Path
    beside: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Step:
    """One step of a skill: what it says, its commands, and what has to be seen after them."""

    text: str
    commands: tuple[str, ...]
    seen: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()


@dataclass(frozen=True)
class Piece:
    """Code that the skill gives, and where it belongs."""

    section: str
    place: str
    lines: tuple[str, ...]


@dataclass
class Run:
    """A command that was given, with its exit code and all that it printed."""

    command: str
    code: int
    output: str


@dataclass
class LiteralAgent:
    """Follows the steps of the skill in a project.

    Attributes:
        answers: what it is told when it asks.
        project: the folder that it works in.
        skill: the text that it follows.
        runs: the commands that it gave.
    """

    answers: Answers
    project: Path
    skill: Bundle = field(default_factory=lambda: chosen([SKILL])[0])
    runs: list[Run] = field(default_factory=list)

    @property
    def package(self) -> Path:
        """The adapter's folder."""
        return self.project / "policy" / self.answers.values["NAME"]

    def follow(self, *, until: int) -> None:
        """Carry out the steps 1 to `until`.

        Raises:
            GapError: if something does not come out as the text says.
        """
        found = steps(self.skill)
        by_hand: dict[str, Callable[[], None]] = {
            "policy.yml says what the policy is": self._declare,
            "It has a Python and weights": self._provide,
            "model.py is yours": self._write_model,
            "It is compared with the native model": self._answer_natively,
            "Fill in README.md": self._describe,
        }
        for words in by_hand:
            if sum(words in step.text for step in found) != 1:
                raise GapError(f"there is not one step that says: {words}")
        for step in found[:until]:
            for words, act in by_hand.items():
                if words in step.text:
                    act()
            self._carry_out(step)

    def _carry_out(self, step: Step) -> None:
        output = "\n".join(self.run(command) for command in step.commands)
        shown = " ".join(output.split())  # columns are padded
        missing = [text for text in step.seen if text not in shown]
        unwanted = [text for text in step.unseen if text in shown]
        if missing or unwanted:
            raise GapError(f"{step.text}\nnot seen: {missing}; seen although it must not be: {unwanted}\n{output}")

    def run(self, command: str) -> str:
        """Give a command, its words in capitals filled in, and return all that it printed.

        Raises:
            GapError: if it does not end with 0.
        """
        words = [self._filled(word) for word in shlex.split(command, comments=True)]
        done = forked.run(*words[1:], cwd=self.project, env={**os.environ, "NO_COLOR": "1"})
        self.runs.append(Run(shlex.join(words), done.returncode, done.stdout + done.stderr))
        if done.returncode:
            raise GapError(f"{shlex.join(words)} ended with {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout + done.stderr

    def _filled(self, text: str) -> str:
        values = {**self.answers.values, "POLICY": f"policy/{self.answers.values['NAME']}"}
        return _WORD.sub(lambda word: values.get(word[0], word[0]), text)

    def _reference(self, name: str) -> str:
        return next(path for path in self.skill.references if path.name == name).read_text(encoding="utf-8")

    # -- edits -----------------------------------------------------------------------------------------------------

    def _declare(self) -> None:
        """Write policy.yml as package.md says: its keys, and no others."""
        text = self._reference("package.md")
        named = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`[^|]+)\|", text, re.MULTILINE))))
        words = set(re.findall(r"\w+", "".join(re.findall(r"`[^`]+`", self._reference("native.md")))))
        if unknown := _words(self.answers.manifest.get("native")) - words:
            raise GapError(f"native.md does not tell of {', '.join(sorted(unknown))}")
        for language, body in _FENCE.findall(text):
            named |= set(re.findall(r"^(\w+):", body, re.MULTILINE)) if language == "yaml" else set()
        path = self.package / "policy.yml"
        written = path.read_text(encoding="utf-8")
        for key, value in self.answers.manifest.items():
            if key not in named:
                raise GapError(f"package.md does not tell of {key}")
            written = _with_key(written, key, value)
        written = re.sub(rf" *# {MARK}.*", "", written)
        path.write_text(written, encoding="utf-8")

    def _provide(self) -> None:
        """Put the weights into `checkpoints/` and name them; see that the interpreter is as declared."""
        weights = self.package / "checkpoints" / self.answers.weights.name
        weights.parent.mkdir(exist_ok=True)
        for file in (self.answers.weights, *self.answers.beside):
            shutil.copyfile(file, weights.with_name(file.name))
        path = self.package / "deploy.yml"
        path.write_text(_with_key(path.read_text(encoding="utf-8"), "ckpt_name", weights.name), encoding="utf-8")
        if "environment" in self.answers.manifest:
            self.run("xpl install POLICY --check")

    def _write_model(self) -> None:
        """Put model.py together from the sections of adapter.md that fit, and the model's own code beside it."""
        source, name = self.answers.code
        shutil.copyfile(source, self.package / name)
        given = pieces(self._reference("adapter.md"))
        if unknown := self.answers.sections - {piece.section for piece in given}:
            raise GapError(f"adapter.md has no section with a piece of code for: {', '.join(sorted(unknown))}")
        wanted = [piece for piece in given if piece.section in self.answers.sections]
        (self.package / "model.py").write_text(self._filled(assembled(wanted)), encoding="utf-8")

    def _answer_natively(self) -> None:
        """Write native.py, from the authors' code."""
        shutil.copyfile(self.answers.native, self.package / "native.py")

    def _describe(self) -> None:
        """Fill in the places of README.md in their order, and take out the sections that are said to go."""
        path = self.package / "README.md"
        text = path.read_text(encoding="utf-8")
        for title in re.findall(r'The section "([^"]+)" goes', self._reference("package.md")):
            text = re.sub(rf"^## {re.escape(title)}\n.*?(?=^## )", "", text, flags=re.MULTILINE | re.DOTALL)
        answers = iter(self.answers.about)
        text = re.sub(rf"{MARK}:.*?(?=( \|)?$)", lambda _: next(answers), text, flags=re.MULTILINE)
        path.write_text(text, encoding="utf-8")


_OPEN_NAMES = frozenset(("input", "file", "key", "names", "cameras", "arm"))
"""Keys of a native block whose values are names, not words."""


def _words(value: Any) -> set[str]:
    """Return the words of a native block: its keys, and values that are words."""
    if isinstance(value, dict):
        return {*value, *(word for key, item in value.items() if key not in _OPEN_NAMES for word in _words(item))}
    if isinstance(value, list):
        return {word for item in value for word in _words(item)}
    return {value} if isinstance(value, str) else set()


def steps(skill: Bundle) -> list[Step]:
    """Return the steps of a skill; all that stands in backquotes after "See" has to be seen, or not, after "no"."""
    part = skill.body.split("\n## Steps\n")[1].split("\n## ")[0]
    found = []
    for text in part.split("- [ ] ")[1:]:
        commands = [body.strip().splitlines() for language, body in _FENCE.findall(text) if language == "console"]
        said = " ".join(_FENCE.sub("", text).split())
        sentence = re.search(r"\bSee (.*?)(?:\. |\.$)", said)
        clauses = re.split(r"[,;] ", sentence[1]) if sentence else []
        absent = [bool(re.search(r"\bno\b", clause)) for clause in clauses]
        quoted = [re.findall(r"`([^`]+)`", clause) for clause in clauses]
        found.append(
            Step(
                said,
                tuple(command for block in commands for command in block),
                tuple(text for texts, no in zip(quoted, absent, strict=True) if not no for text in texts),
                tuple(text for texts, no in zip(quoted, absent, strict=True) if no for text in texts),
            )
        )
    return found


def pieces(text: str) -> list[Piece]:
    """Return the pieces of code of adapter.md in their order."""
    found = []
    for part in text.split("\n## ")[1:]:
        for language, body in _FENCE.findall(part):
            first, *lines = body.rstrip().splitlines()
            if language == "python" and first.startswith("# model.py: "):
                found.append(Piece(part.splitlines()[0], first.removeprefix("# model.py: "), tuple(lines)))
    return found


def assembled(wanted: list[Piece]) -> str:
    """Return model.py made of pieces, joined as the first paragraphs of adapter.md tell."""

    def of(place: str) -> list[str]:
        return [line for piece in wanted if piece.place == place for line in piece.lines]

    def last(place: str) -> list[str]:
        return next((list(piece.lines) for piece in reversed(wanted) if piece.place == place), [])

    module = _Module(of("the whole file"))
    for piece in wanted:
        if piece.place == "in the class":
            module.lines += ["", *piece.lines]
    module.add_to("load", of("load"))
    call = last("predict, the model") or module.find("predict", "answer = ")
    before, after = of("predict, before the model"), of("predict, after the model")
    module.replace("predict", "answer = ", [*before, *call, *after])
    return module.without_unused_imports()


class _Module:
    """Lines of a module with one class, whose methods are found by name."""

    def __init__(self, lines: list[str]) -> None:
        self.lines = lines

    def _method(self, name: str) -> tuple[int, int]:
        for node in ast.walk(ast.parse("\n".join(self.lines))):
            if isinstance(node, ast.FunctionDef) and node.name == name and node.col_offset:
                return node.lineno, node.end_lineno or node.lineno
        raise GapError(f"there is a piece for {name}, and no section that was taken has that method")

    def add_to(self, method: str, lines: list[str]) -> None:
        """Insert lines at the end of a method."""
        end = self._method(method)[1]
        self.lines[end:end] = lines

    def find(self, method: str, beginning: str) -> list[str]:
        """Return the one line of a method that begins so."""
        return [self.lines[self._place(method, beginning)]]

    def replace(self, method: str, beginning: str, lines: list[str]) -> None:
        """Replace the one line of a method that begins so."""
        at = self._place(method, beginning)
        self.lines[at : at + 1] = lines

    def _place(self, method: str, beginning: str) -> int:
        first, last = self._method(method)
        found = [at for at in range(first, last) if self.lines[at].strip().startswith(beginning)]
        if len(found) != 1:
            raise GapError(f"{method} has {len(found)} lines that begin with {beginning!r}, not one")
        return found[0]

    def without_unused_imports(self) -> str:
        """Return the text, without the imported names that nothing uses."""
        kept = []
        for line in self.lines:
            imported = re.match(r"from xpl\S* import (.+)", line)
            others = "\n".join(other for other in self.lines if other is not line)
            names = [name for name in imported[1].split(", ") if re.search(rf"\b{name}\b", others)] if imported else []
            if not imported or names:
                kept.append(re.sub(r"import .+", f"import {', '.join(names)}", line) if imported else line)
        return "\n".join(kept) + "\n"


def _with_key(text: str, key: str, value: Any) -> str:
    """Return a YAML text in which a key of the top has another value; appended if it has no such key."""
    line = f"{key}: {json.dumps(value)}\n"  # JSON is YAML
    found = re.search(rf"^{key}:.*\n(?:[ -].*\n)*", text, re.MULTILINE)
    return text[: found.start()] + line + text[found.end() :] if found else text + line
