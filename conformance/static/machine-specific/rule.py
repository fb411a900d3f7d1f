"""XPL161: Devices, ports and folders come from arguments, configuration or the environment."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, Location, rule
from xpl_cli.audit.static.scripts.flow import is_candidate, scripts, word_location
from xpl_cli.audit.static.shell import ShellCommand, ShellScript, ShellWord
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import assigned, called, constant, last, targets

_FIXED: Final = re.compile(r"(CUDA_VISIBLE_DEVICES|(?:[A-Za-z]+_)*(?:port|PORT))=[\"']?(\d[\d,]*)[\"']?")
_PLACES: Final = re.compile(
    r"(?<![\w.$}/\\])/(?:mnt|data\d*|root|nfs\w*|nas\w*|ssd\w*|hdd\w*|disk\w*|cpfs\w*|workspace|share[d]?|storage|scratch"
    r"|project[s]?|raid|lustre|gpfs|fsx|efs|work|media|home2?|Users|Volumes)/[^\s\"'`<>$,;:)\]}]+"
)
_PERSON: Final = re.compile(r"/(?:home|Users)/")
_CHECKOUT = 4
"""Folders up from a file of the adapter: its own, policy/, the checkout, and the one that holds the checkout."""


@rule(code="XPL161", requirement="XPL-PKG-13")
def machine_specific(source: Source) -> Iterator[Finding]:
    """A script or deploy.yml hard-codes a GPU, a port or a folder of one machine.

    ## What it does
    Looks in the scripts for variables that set `CUDA_VISIBLE_DEVICES` or a port to a number, in scripts and
    `deploy.yml` for absolute paths of data disks, and in model.py and deploy.py for folders outside the checkout that
    are added to the import path. Not reported: devices and ports that are defaults of an environment variable
    (`${MASTER_PORT:-29500}`).

    ## Why it matters
    The number overrides the launcher's argument: two evaluations use one GPU or one port, and the second fails or
    connects to the first one's server. On other machines the folder does not exist.

    ## Example
    `export CUDA_VISIBLE_DEVICES=0` in `setup_eval_policy_server.sh`; `model_path: /mnt/disk1/ckpt` in `deploy.yml`.

    ## Use instead
    The script's argument, `null` in `deploy.yml`, or an environment variable that users set.

    ## Fix safety
    No automatic fix: only the author knows the meaning of the value.
    """
    for name, script in scripts(source):
        for command in script:
            yield from _fixed(name, command)
        yield from _folders(source, name, script)
    if source.has(sdk.File.DEPLOY_YML):
        lines = source.text(sdk.File.DEPLOY_YML).split("\n")
        for number, line in enumerate(lines, start=1):
            match = _PLACES.search(line.partition(" #")[0]) if not line.startswith("#") else None
            if match and not _PERSON.match(match.group()):
                yield _folder({"path": sdk.File.DEPLOY_YML, "line": number, "column": match.start() + 1}, match.group())
    for name in (sdk.File.MODEL_PY, sdk.File.DEPLOY_PY):
        if source.has(name) and source.parses(name):
            yield from _roots(source, name)


def _fixed(name: str, command: ShellCommand) -> Iterator[Finding]:
    """Yield variables that give a GPU or a port as a number."""
    for word in command.words:
        match = _FIXED.fullmatch(word.raw)
        if match:
            yield _finding(
                word_location(name, word),
                f"{match.group(1)} is {match.group(2)}, whatever the launcher chose: two runs share it",
                f"{match.group(1)} from the script's argument or the environment",
                word.raw,
            )


def _folders(source: Source, name: str, script: ShellScript) -> Iterator[Finding]:
    for word in _words(script):
        match = _PLACES.search(word.raw) if "/" in word.raw else None
        if match and not _PERSON.match(match.group()) and not is_candidate(source.text(name), word.line):
            yield _folder(word_location(name, word), match.group())


def _words(script: ShellScript) -> Iterator[ShellWord]:
    for command in script:
        if command.name not in {"echo", "printf"}:
            yield from command.words


def _folder(at: Location, path: str) -> Finding:
    message = f"{path} exists only on its author's machine"
    return _finding(at, message, "a path from the configuration, the environment, or the adapter's folder", path)


def _finding(at: Location, message: str, expected: str, got: str) -> Finding:
    return Finding(message, **at, expected=expected, got=got, fix=Fix("advice", f"take {expected}"))


def _roots(source: Source, name: str) -> Iterator[Finding]:
    """Yield folders beyond the checkout that a module puts on the path of imports."""
    made = assigned(source.tree(name).body)
    loops = {
        target.id: loop.iter
        for loop in source.tree(name).body
        if isinstance(loop, ast.For)
        for target in targets(loop)
        if isinstance(target, ast.Name)
    }
    for node in source.nodes(name):
        if isinstance(node, ast.Call) and called(node) in {"sys.path.insert", "sys.path.append"} and node.args:
            argument = node.args[-1]
            entries = loops.get(argument.id, argument) if isinstance(argument, ast.Name) else argument
            for entry in entries.elts if isinstance(entries, (ast.Tuple, ast.List)) else [entries]:
                levels = _levels(entry, made)
                if levels is not None and levels > _CHECKOUT:
                    yield _finding(
                        source.at(name, node),
                        f"a folder {levels - 1} above the adapter is on the import path, outside the checkout: "
                        "modules there on this machine are imported",
                        "the folder that holds the checkout, three above the adapter",
                        ast.unparse(entry),
                    )


def _levels(node: ast.expr, made: dict[str, ast.expr], depth: int = 8) -> int | None:
    """Return how many folders above a file of the adapter a path leads; None if it is made of anything else."""
    if depth == 0:
        return None
    inner: ast.expr | None = None
    more = 0
    if isinstance(node, ast.Name):
        if node.id == "__file__":
            return 0
        inner = made.get(node.id)
    elif isinstance(node, ast.Attribute) and node.attr == "parent":
        inner, more = node.value, 1
    elif isinstance(node, ast.Subscript) and isinstance(node.value, ast.Attribute) and node.value.attr == "parents":
        index = constant(node.slice)
        inner, more = node.value.value, index + 1 if isinstance(index, int) else 0
        inner = inner if isinstance(index, int) and index >= 0 else None
    elif isinstance(node, ast.Call):
        inner, more = _of_call(node)
    levels = None if inner is None else _levels(inner, made, depth - 1)
    return None if levels is None else levels + more


def _of_call(node: ast.Call) -> tuple[ast.expr | None, int]:
    """Return what a call makes a path of, and how many folders it goes up from there."""
    name = last(called(node))
    if name in {"resolve", "absolute", "as_posix"} and isinstance(node.func, ast.Attribute):
        return node.func.value, 0
    if name in {"Path", "abspath", "realpath", "str", "normpath"} and len(node.args) == 1:
        return node.args[0], 0
    if name == "dirname" and node.args:
        return node.args[0], 1
    parts = [constant(part) for part in node.args[1:]]
    if name == "join" and parts and all(isinstance(part, str) for part in parts):
        steps = [step for part in parts for step in str(part).split("/") if step not in {"", "."}]
        return (node.args[0], len(steps)) if all(step == ".." for step in steps) else (None, 0)
    return None, 0
