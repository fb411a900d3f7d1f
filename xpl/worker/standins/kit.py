"""Puts stand-ins in place for an unmodified adapter, and tells which they are."""

from __future__ import annotations

import ast
import functools
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Callable

import numpy as np

from xpl import _spec as spec
from xpl import ecosystem
from xpl.action import action_dim
from xpl.embodiment import Embodiment, get_embodiment
from xpl.worker.lacking import StandInError
from xpl.worker.loading import load_model_class
from xpl.worker.standins import facts as known
from xpl.worker.standins import makes
from xpl.worker.standins.facts import Facts
from xpl.worker.standins.finder import Finder
from xpl.worker.standins.folders import Folders
from xpl.worker.standins.origins import WORLD
from xpl.worker.standins.torch import library
from xpl.worker.standins.values import Values

_STEPS = 16
_MOST_STEPS = 64
_CHUNKS = (
    r"(.*_)?(action_)?(chunk|chunk_size|horizon|chunk_len|n_action_steps|num_actions|replan_steps|exc_action_size)"
)
_PATHS = re.compile(
    r"(.*_)?(ckpt|checkpoint|model|stats|norm|pretrained|tokenizer|weights?|root|norm_stats|dataset_stats)"
    r"(_?(json|pkl|base))?_?(path|dir|root|file|setting|ckpt)?|.*_(root|ckpt)"
)
_NOT = re.compile(r".*(log|result|output|cache|save|env_cfg|action|state|name|type).*|.*model_(id|type)|prompt")
_TRIES = 8
_ABSOLUTE = re.compile(r"/[\w./+-]+")
_ATTRIBUTE = re.compile(r"(?:config|cfg)\.([a-z]\w*)\b(?!\()")
_READ = re.compile(r"""(?:cfg|config|args)(?:\.get\(|\[)\s*["'](\w+)["']""")
_WIDTH = re.compile(r"(?:^|\W)(?:\w*_)?(?:ACTION|action)_(?:DIM|dim)(?:: *int)? *[=:] *(\d+)", re.MULTILINE)
_LOW, _HIGH = 0.05, 0.35
"""Of a column: fit for a joint and for a gripper, also where an adapter has columns in an order of its own."""
_OPENING = 0.1, 0.45


class Kit:
    """The stand-ins of one adapter.

    Args:
        policy_dir: its folder.
        config: deploy.yml after overrides.
    """

    def __init__(self, policy_dir: Path, config: Mapping[str, Any]) -> None:
        self._config, self._policy_dir = dict(config), policy_dir
        roots = [policy_dir, *ecosystem.roots(policy_dir)]
        facts = _facts(config, policy_dir)
        self._values = Values(facts)
        WORLD.facts, WORLD.value, WORLD.makes = facts, self._values.of, makes.find
        WORLD.serving = False
        parts = library.parts()
        makes.load(facts)
        WORLD.documents = tuple(
            sorted(set(_ATTRIBUTE.findall((policy_dir / spec.File.MODEL_PY).read_text(errors="replace"))))
        )
        self._finder = Finder(
            policy_dir, roots, lambda name: {**parts.get(name, {}), **makes.parts(name)}, vendored=True
        )
        self._is_installed, self._widths = False, len(facts.widths)
        self.answered = False
        self._folders = Folders([policy_dir, *(root.parent for root in roots)])

    @property
    def names(self) -> list[str]:
        """What was stood in for, in the order of the imports."""
        return list(self._finder.names)

    def built(self) -> Any:
        """Return the adapter's model, built with the first configuration that it can be built with.

        The first is as it is, the second has paths where it says nothing. The error of the last one counts.
        """
        if not self._is_installed:
            self._is_installed = True
            self._finder.install()
            self._folders.install()
        WORLD.serving = False
        model = self._loaded()
        WORLD.failed.clear()
        WORLD.serving = True
        for name in (spec.Method.GET_ACTION, spec.Method.GET_ACTION_BATCH, spec.Method.INFER):
            if callable(getattr(model, name, None)):
                setattr(model, name, self._guessing(getattr(model, name)))
        return model

    def _loaded(self) -> Any:
        """Load and build the model; a module of vendored code whose data is asked for runs as it is."""
        for _ in range(_TRIES):
            try:
                return self._tried(load_model_class(self._policy_dir))
            except StandInError as error:  # noqa: PERF203 - the last one tells
                if not self._finder.release(str(error)):
                    raise
        return self._tried(load_model_class(self._policy_dir))

    def _guessing(self, method: Callable[..., Any]) -> Callable[..., Any]:
        """Return a method that tries the widths that actions may have, until one has done."""

        @functools.wraps(method)
        def guessing(*arguments: Any, **named: Any) -> Any:
            if self.answered:
                return method(*arguments, **named)
            first: Exception | None = None
            for place in range(self._widths):
                self._values.guess(place)
                try:
                    found = method(*arguments, **named)
                except Exception as error:  # noqa: BLE001 - the first one is told, if none does
                    first = first or error
                else:
                    self.answered = True
                    WORLD.failed.clear()
                    return found
            self._values.guess(0)
            raise first or RuntimeError("there is no width to try")

        return guessing

    def lacks(self, error: BaseException) -> dict[str, str] | None:
        """Return what an error says that only the real model could give; None if the adapter is to blame for it.

        Before the first answer came about, nobody knows whether shapes that do not fit are the adapter's or the
        stand-ins'. Afterwards they are the adapter's, unless a stand-in itself raised them.
        """
        if isinstance(error, (NameError, SyntaxError, NotImplementedError, AttributeError)) and not _in_kit(error):
            return None
        if isinstance(error, StandInError) or not self.answered or _in_kit(error):
            told = str(error) if isinstance(error, StandInError) else f"{type(error).__name__}: {error}"
            return {"kind": "stub", "name": f"stand-ins do not carry it: {told}"}
        return None

    def _tried(self, model_class: Any) -> Any:
        """Build the model; what it asks for and is not there, it gets, one after the other."""
        config, *others = self._configs()
        for _ in range(_TRIES):
            try:
                return model_class(dict(config))
            except Exception as error:  # noqa: PERF203 - whatever it is may be for want of something
                more = self._more(error, config)
                if more is None and not others:
                    raise
                config = more or others.pop()
        return model_class(dict(config))

    def _more(self, error: Exception, config: dict[str, Any]) -> dict[str, Any] | None:
        """Return a configuration that says what an error says that it lacks; None if there is nothing new to say."""
        if isinstance(error, KeyError) and error.args and isinstance(error.args[0], str):
            name = error.args[0]
            if name not in config and _PATHS.fullmatch(name) and not _NOT.fullmatch(name):
                return {**config, name: self._path(name)}
        for found in _ABSOLUTE.findall(str(error)):
            if self._folders.add(found):
                return config
        return None

    def _path(self, name: str) -> str:
        self._folders.files.add(name)
        return os.path.join(self._folders.root, name + (".json" if "stats" in name or "norm" in name else ""))

    def _configs(self) -> list[dict[str, Any]]:
        first = dict(self._config)
        for key in (spec.Deploy.CKPT_NAME, spec.Deploy.BENCH_NAME, spec.Deploy.TASK_NAME):
            if first.get(key) in (None, ""):
                first[key] = "stand_in"
        if first.get(spec.Deploy.SEED) is None:
            first[spec.Deploy.SEED] = 0
        second = {**dict.fromkeys(_asked(self._policy_dir)), **first}
        for name, value in list(second.items()):
            if value in (None, "") and _PATHS.fullmatch(name) and not _NOT.fullmatch(name):
                second[name] = self._path(name)
        return [first] if second == first else [first, second]


def _in_kit(error: BaseException) -> bool:
    """Tell whether the code that raised is a stand-in's."""
    trace, file = error.__traceback__, ""
    while trace is not None:
        file, trace = trace.tb_frame.f_code.co_filename, trace.tb_next
    return file != __file__ and Path(file).is_relative_to(Path(__file__).parent)


def wants(policy_dir: Path) -> bool:
    """Tell whether an adapter is one that was written without the SDK, so that it has no part that is the model's."""
    file = policy_dir / spec.File.MODEL_PY
    try:
        tree = ast.parse(file.read_text(encoding="utf-8", errors="replace"))
    except (OSError, SyntaxError, ValueError):
        return False
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module]
        if any(name.partition(".")[0] == "xpl" for name in names):
            return False
    return True


def _facts(config: Mapping[str, Any], policy_dir: Path) -> Facts:
    steps = [count for count in known.declared(config, _CHUNKS) if count > 1]
    action_type = config.get(spec.Deploy.ACTION_TYPE)
    if action_type not in spec.ACTION_TYPES:
        action_type = spec.ACTION_TYPES[0]
    try:
        robot = get_embodiment(str(config.get(spec.Deploy.ENV_CFG_TYPE)))
    except LookupError:
        robot = get_embodiment(next(iter(spec.EMBODIMENTS)))
    width = action_dim(robot, action_type)
    low, high = np.full(width, _LOW), np.full(width, _HIGH)
    quaternions = _shape(robot, action_type, low, high)
    numbers = {
        str(name).lower(): value
        for name, value in config.items()
        if isinstance(value, (int, float)) and not isinstance(value, bool)
    }
    others = known.declared(config, r"(max|model|padded)_action_dim")
    others += [
        int(found)
        for path in sorted(policy_dir.glob("*.py"))
        for found in _WIDTH.findall(path.read_text(errors="replace"))
    ]
    widths = tuple(dict.fromkeys([width, *others, sum(arm.dof + arm.ee_dim for arm in robot.arms)]))
    facts = Facts(min(max([*steps, 0]) or _STEPS, _MOST_STEPS), width, low, high, numbers, widths)
    ends = sum(arm.ee_dim for arm in robot.arms)
    facts.quaternions = quaternions
    facts.parts = (("effector", ends), ("gripper", ends), ("arm.", width - ends), ("arm_", width - ends))
    return facts


def _asked(policy_dir: Path) -> list[str]:
    """Return the keys that the adapter's modules read of a configuration."""
    return [
        found for path in sorted(policy_dir.glob("*.py")) for found in _READ.findall(path.read_text(errors="replace"))
    ]


def _shape(robot: Embodiment, action_type: Any, low: np.ndarray, high: np.ndarray) -> list[int]:
    """Give grippers and quaternions values that they can have; tell where quaternions are."""
    start, quaternions = 0, []
    for arm in robot.arms:
        if action_type == spec.ACTION_TYPES[0]:
            start += arm.dof
        else:
            low[start + spec.POSITION_DIM], high[start + spec.POSITION_DIM] = 0.8, 1.0
            quaternions.append(start + spec.POSITION_DIM)
            start += spec.POSE_DIM
        low[start : start + arm.ee_dim], high[start : start + arm.ee_dim] = _OPENING
        start += arm.ee_dim
    return quaternions
