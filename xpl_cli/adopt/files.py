"""Facts that an adapter's files state: deploy.yml, scripts, file names. Nothing is run or inferred."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

import yaml

from xpl import _spec as sdk
from xpl import robots
from xpl_cli.adopt.facts import Evidence, Tree, UnknownFact, certain, likely
from xpl_cli.basics import files as bounded
from xpl_cli.packages import documented
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from pathlib import Path

_MOST: Final = 1 << 20
_CONDA: Final = re.compile(r"\b(?:conda|mamba|micromamba)\s+(create|activate)\b(.*)")
_NAMED: Final = re.compile(r"(?:-n|--name)[ =]+[\"']?([\w.-]+)[\"']?(?=\s|$)")
_FIRST: Final = re.compile(r"\s+[\"']?([A-Za-z0-9][\w.-]*)[\"']?(?=\s|$)")
_UV: Final = re.compile(r"\buv\s+(?:venv|sync)\b(.*)")
_VENV: Final = re.compile(r"\bpython[\d.]*\s+-m\s+venv\b(.*)")
_PYTHON: Final = re.compile(r"(?:python=+|--python[ =]|-p )[\"']?(\d[\w.]*)")
_MOVES: Final = re.compile(r"^\s*cd\s", re.MULTILINE)
_CALLED: Final = re.compile(r"\bfunc_name\s*=\s*[\"'](\w+)[\"']")


def read_facts(folder: Path) -> dict[str, Tree]:
    """Return the keys of policy.yml that an adapter's files state, with their sources."""
    facts: dict[str, Tree] = {"name": certain(folder.name, Evidence("", None, "the folder's name"))}
    facts |= _run(folder)
    facts["evaluation_only"] = _training(folder)
    environment = _environment(folder)
    if environment:
        facts["environment"] = environment
    methods: dict[str, Evidence] = {}
    for number, line in enumerate(_lines(folder, sdk.File.DEPLOY_PY), start=1):
        for name in _CALLED.findall(line):
            if name not in (*sdk.CONTRACT_METHODS, *sdk.HOOKS):
                methods.setdefault(name, Evidence(sdk.File.DEPLOY_PY, number, f"calls {name}"))
    if methods:
        facts["methods"] = certain(list(methods), *methods.values())
    return facts


def _run(folder: Path) -> Iterator[tuple[str, Tree]]:
    """Yield embodiment and action type: from deploy.yml, else from the documented call of a script."""
    deploy, call = _deploy(folder), documented.documented_arguments(folder)
    keys: dict[str, dict[str, Any]] = {
        "embodiments": {"key": sdk.Deploy.ENV_CFG_TYPE, "values": robots.names()},
        "action_types": {"key": sdk.Deploy.ACTION_TYPE, "values": {kind: kind for kind in sdk.ACTION_TYPES}},
    }
    for name, how in keys.items():
        key, values = how["key"], how["values"]
        stated, documented_value = deploy.get(key), call.get(key)
        if isinstance(stated, str) and stated in values:
            line = next(
                (
                    number
                    for number, line in enumerate(_lines(folder, sdk.File.DEPLOY_YML), start=1)
                    if re.match(rf"{re.escape(key)}\s*:", line)
                ),
                None,
            )
            yield name, certain([values[stated]], Evidence(sdk.File.DEPLOY_YML, line, f"{key}: {stated}"))
        elif isinstance(documented_value, str) and documented_value in values:
            yield (
                name,
                likely(
                    [values[documented_value]],
                    Evidence("", None, f"the documented call of its scripts: {documented_value}"),
                ),
            )


def _deploy(folder: Path) -> dict[str, Any]:
    try:
        value = spec.parse_yaml("\n".join(_lines(folder, sdk.File.DEPLOY_YML)))
    except (yaml.YAMLError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def _training(folder: Path) -> Tree:
    """Return whether the package is for evaluation only: whether its data and training scripts are missing."""
    scripts = spec.data("package")["files"]["training"]
    there = [name for name in scripts if (folder / name).is_file()]
    missing = [name for name in scripts if name not in there]
    presence = [*(f"{name} is there" for name in there), *(f"{name} is not" for name in missing)]
    return certain(not there, Evidence("", None, ", ".join(presence)))


def _environment(folder: Path) -> dict[str, Tree]:
    """Return the Python environment that install.sh creates, or that the server's start script activates."""
    for script in (sdk.File.INSTALL_SH, sdk.File.SETUP_EVAL_POLICY_SERVER_SH):
        lines = _lines(folder, script)
        for number, line in enumerate(lines, start=1):
            where = Evidence(script, number, line.strip()[:70])
            python = _PYTHON.search(line)
            version = {"python": certain(python[1], where)} if python else {}
            if (conda := _CONDA.search(line)) is not None:
                name = (_NAMED if conda[1] == "create" else _FIRST).search(conda[2])
                called = certain(name[1], where) if name else UnknownFact("name of the conda environment", (where,))
                return {"manager": certain("conda", where), "name": called, **version}
            if _UV.search(line) or _VENV.search(line):
                kind = certain("uv" if _UV.search(line) else "venv", where)
                lies = UnknownFact(
                    "folder of the virtual environment, relative to the package; default: .venv", (where,)
                )
                return {"manager": kind, **({"name": lies} if _changes_folder(lines) else {}), **version}
    return {}


def _changes_folder(lines: list[str]) -> bool:
    """Tell whether a script changes its folder, so that relative paths in it are ambiguous."""
    return _MOVES.search("\n".join(lines)) is not None


def _lines(folder: Path, name: str) -> list[str]:
    """Return the lines of a file, comments blanked; an empty list if it cannot be read."""
    try:
        text = bounded.read_regular(folder / name, _MOST).decode("utf-8", "replace")
    except OSError:
        return []
    return ["" if line.lstrip().startswith("#") else line for line in text.split("\n")]
