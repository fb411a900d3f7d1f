"""Where the policy's interpreter comes from, and which scripts the package has."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl_cli.adopt.documents import environment_name
from xpl_cli.adopt.facts import Confidence, Evidence, Fact, Finding, Question, certain, likely
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.static.loops.functions import asked, loops
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.adopt.documents import Documents
    from xpl_cli.audit.static.shell import Command
    from xpl_cli.audit.static.source import Source

_HERE: Final = "."
_CONDA, _UV, _VENV = "conda", "uv", "venv"
_VERSION: Final = re.compile(r"python=+(\d[\w.*]*)|^(\d\.\d+(?:\.\d+)?)$")


def environment(documents: Documents) -> Iterator[Finding]:
    """Yield the interpreter that install.sh makes, or that the server's script activates."""
    source = documents.source
    for script in (sdk.File.INSTALL_SH, sdk.File.SETUP_EVAL_POLICY_SERVER_SH):
        found = list(_made(source, script))
        if not found:
            continue
        manager, name, python, evidence = found[0]
        for _, other_name, other_python, _ in found[1:]:
            name, python = name or other_name, python or other_python
        yield certain("environment.manager", manager, evidence)
        told = environment_name(documents) if manager == _CONDA and name is None else None
        if name is not None:
            yield likely("environment.name", name, evidence)
        elif told is not None:
            yield likely("environment.name", *told)
        elif manager == _CONDA:
            yield Question("environment.name", "the conda environment; null: it is called as the folder")
        if python is not None:
            at = next(entry[3] for entry in found if entry[2] == python)
            yield certain("environment.python", python, at)
        return
    managers = tuple(spec.schema("policy")["properties"]["environment"]["properties"]["manager"]["enum"])
    yield Question("environment.manager", "where the policy's interpreter comes from", managers)


def _made(source: Source, script: str) -> Iterator[tuple[str, str | None, str | None, Evidence]]:
    """Yield each command that makes or enters an environment: manager, name, Python, place."""
    values: dict[str, str] = {}
    place = _HERE
    try:
        commands = source.commands(script)
    except NotRun:
        return
    for command in commands:
        values.update({name: expanded(word.text, values) for name, word in command.assignments})
        words = [expanded(word.text, values) for word in command.arguments[1:]]
        tool = PurePosixPath(expanded(command.name, values)).name
        if tool == "cd" and words:
            place = _below(place, words[0])
            continue
        evidence = Evidence(script, _line(command), " ".join([tool, *words])[:70])
        python = next((found.group(1) or found.group(2) for found in map(_VERSION.search, words) if found), None)
        if tool in {_CONDA, "mamba", "micromamba"} and words[:1] == ["create"]:
            yield _CONDA, _after(words, ("-n", "--name")), python, evidence
        elif tool in {_CONDA, "mamba", "micromamba"} and words[:1] == ["activate"]:
            yield _CONDA, next((word for word in words[1:] if re.fullmatch(r"[\w.-]+", word)), None), None, evidence
        elif tool == _UV and words[:1] in (["venv"], ["sync"]):
            yield _UV, _environment_folder(place, words), python, evidence
        elif tool.startswith("python") and words[:2] == ["-m", _VENV]:
            yield _VENV, _environment_folder(place, words[1:]), None, evidence
    for number, line in enumerate(source.text(script).split("\n"), start=1):  # in a text that is run elsewhere
        if re.match(r"\s*conda activate\b", line):
            yield _CONDA, None, None, Evidence(script, number, line.strip())


def _environment_folder(place: str, words: list[str]) -> str | None:
    """Return the folder of a virtual environment; None for the usual one, or one outside of the package."""
    given = next((word for word in words[1:] if not word.startswith("-") and not _VERSION.search(word)), ".venv")
    folder = _below(place, given) if words[0] != "sync" else _below(place, ".venv")
    return None if folder in {"", ".venv"} or ".." in folder.split("/") or folder.startswith("/") else folder


def _below(place: str, path: str) -> str:
    """Return where a path leads from a folder of the package; "" if that cannot be told."""
    if not path or path.startswith("/"):
        return ""
    anchored = path.startswith(f"{_HERE}/") or path == _HERE
    joined = PurePosixPath(path if anchored or not place else f"{place}/{path}")
    parts: list[str] = []
    for part in joined.parts:
        if part == "..":
            if not parts:
                return ""
            parts.pop()
        else:
            parts.append(part)
    return "/".join(parts)


def _after(words: list[str], options: tuple[str, ...]) -> str | None:
    found = next((words[place + 1] for place, word in enumerate(words[:-1]) if word in options), None)
    return found if found and re.fullmatch(r"[\w.-]+", found) else None


def _line(command: Command) -> int | None:
    return command.words[0].line if command.words else None


def expanded(text: str, values: dict[str, str]) -> str:
    """Put values and defaults of variables into a word of a script; the folder of the script itself becomes `.`."""
    if "BASH_SOURCE" in text or "dirname" in text:
        ups = re.search(r"((?:/\.\.)+)\"?\)?\s*&&|((?:/\.\.)+)\"?$", text)
        return _HERE + (next(filter(None, ups.groups())) if ups else "")
    for _ in range(4):
        before = text
        text = re.sub(r"\$\{(\w+):?-((?:[^{}]|\$\{\w+\})*)\}", lambda m: values.get(m[1]) or m[2], text)
        text = re.sub(r"\$\{(\w+)\}|\$(\w+)", lambda m: values.get(m[1] or m[2], ""), text)
        if text == before:
            break
    return text


def scripts(source: Source) -> Iterator[Finding]:
    """Yield whether the package offers data processing and training."""
    training = spec.data("package")["files"]["training"]
    there = [name for name in training if source.has(name)]
    missing = [name for name in training if name not in there]
    if there:
        told = f"{' and '.join(there)} there" + (f", {' and '.join(missing)} not" if missing else "")
        confidence = Confidence.LIKELY if missing else Confidence.CERTAIN
    else:
        told, confidence = f"no {' and no '.join(training)}", Confidence.CERTAIN
    yield Fact("evaluation_only", value=not there, confidence=confidence, evidence=(Evidence("", None, told),))


def methods(source: Source) -> Iterator[Finding]:
    """Yield the methods beyond the contract that the evaluation loop calls."""
    known = {*sdk.CONTRACT_METHODS, *sdk.HOOKS}
    found: dict[str, Evidence] = {}
    for function in loops(source) if source.parses(sdk.File.DEPLOY_PY) else ():
        for node, name in asked(function):
            if name is not None and name not in known and getattr(node.func, "attr", "") == sdk.Message.CALL:
                found.setdefault(name, Evidence(function.file, node.lineno, f"calls {name}"))
    if found:
        yield certain("methods", list(found), *found.values())
