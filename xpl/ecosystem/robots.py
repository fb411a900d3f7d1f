"""Replacement of a benchmark's folder `env_cfg`, which names each configuration's robot and its dimensions.

Benchmarks keep the folder beside the checkout. Adapters and the ecosystem's helpers read its files by path. If it is
absent, this module writes the same files from the standard's robots into a temporary folder, and redirects accesses of
the absent one to it. It changes neither a folder that exists nor any other path.
"""

from __future__ import annotations

import atexit
import builtins
import io
import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any, Callable

from xpl import robots
from xpl.ecosystem import checkout
from xpl.embodiment import get_embodiment

_SIM = "xpl"


def offer(policy_dir: Path) -> list[Path]:
    """Redirect reads of absent folders `env_cfg` to files of the standard's robots; return the absent folders.

    One is beside the checkout, where benchmarks keep it, and one inside, where some adapters expect it.
    """
    root = checkout.root_of(policy_dir.resolve())
    absent = [place for place in (root.parent / checkout.ENV_CFG, root / checkout.ENV_CFG) if not place.exists()]
    new = [place for place in absent if str(place) not in _answered]
    if new:
        folder = _written()
        _answered.update((str(place), folder) for place in new)
        _redirect()
    return absent


_answered: dict[str, str] = {}  # replacement folder by absent folder
_led_already: list[str] = []  # names of the redirected functions


def _written() -> str:
    """Return a new folder with a file for every robot, as benchmarks write them."""
    folder = tempfile.mkdtemp(prefix="xpl-env-cfg-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    dimensions: dict[str, Any] = {}
    words: dict[str, list[str]] = {}
    for word, name in robots.names().items():
        words.setdefault(name, [name]).extend([] if word == name else [word])
    for name, names in words.items():
        arms = get_embodiment(name).arms
        known = {"arm_dim": [arm.dof for arm in arms], "ee_dim": [arm.ee_dim for arm in arms]}
        for each in names:
            dimensions[each] = known
            text = f"config:\n  robot: {names[-1]}\n  sim: {_SIM}\n"
            Path(folder, f"{each}.yml").write_text(text, encoding="utf-8")
    for below, file, text in (
        ("robot", "_robot_info.json", json.dumps(dimensions)),
        ("sim", f"{_SIM}.yml", "scene:\n  num_envs: 1\n"),
    ):
        Path(folder, below).mkdir()
        Path(folder, below, file).write_text(text, encoding="utf-8")
    return folder


def _redirect() -> None:
    """Wrap the functions that open files and list folders; once."""
    if _led_already:
        return
    for module, name in ((builtins, "open"), (io, "open"), (os, "stat"), (os, "listdir"), (os, "scandir")):
        setattr(module, name, _redirected(getattr(module, name)))
        _led_already.append(name)


def _redirected(real: Callable[..., Any]) -> Callable[..., Any]:
    def instead(*arguments: Any, **named: Any) -> Any:
        return real(*(_redirect_path(arguments[0]), *arguments[1:]), **named) if arguments else real(**named)

    return instead


def _redirect_path(path: object) -> Any:
    """Return the path itself, or the one in the replacement folder if it is in an absent one."""
    if not isinstance(path, (str, os.PathLike)):
        return path
    text = os.fspath(path)
    if not isinstance(text, str) or checkout.ENV_CFG not in text:
        return path
    whole = os.path.abspath(text)  # noqa: PTH100 - `resolve` would call the redirected functions
    for absent, folder in _answered.items():
        if whole == absent or whole.startswith(absent + os.sep):
            return folder + whole[len(absent) :]
    return path
