"""RoboTwin's own code: a checkout that ROBOTWIN_ROOT names, or rlinf-robotwin-runtime with ROBOTWIN_ASSETS_ROOT.

Source: RoboTwin-Platform/RoboTwin, load_task_args of scripts/eval_policy_xpolicylab.py at cf47ab5; the runtime is
0.1.3.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import logging
import os
import random
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from xpl import _spec as sdk
from xpl.environment import NotInstalledError

from .stand_in_robot import MARKER

CHECKOUT, ASSETS = "ROBOTWIN_ROOT", "ROBOTWIN_ASSETS_ROOT"
RUNTIME = "rlinf-robotwin-runtime"
NEEDED = ("assets/background_texture", "assets/embodiments/aloha-agilex", "assets/objects")
"""Folders of assets, as the runtime's validate_root wants them."""
_CONFIGS = Path("env_cfg") / "task_config"


class UpstreamSource:
    """RoboTwin's tasks. The process works in its folder from now on, since its paths are relative.

    Raises:
        NotInstalledError: its code, what that imports, or its assets are missing.
    """

    has_expert = True
    """Tasks have an expert that solves seeds with RoboTwin's robot, for which it was written."""

    def __init__(self) -> None:
        self._begin(*check())

    def _begin(self, root: Path | None, assets: Path) -> None:
        """Work in the folder of assets from now on, with the code of a checkout, or None for the runtime's."""
        self._root, self._assets = root, assets
        self._prefix = "envs" if self._root is not None else "robotwin.envs"
        if self._root is not None:
            for folder in (self._root, self._root / "scripts", self._root / "description" / "utils"):
                sys.path.insert(0, str(folder))
        os.environ.setdefault("ASSETS_PATH", str(self._assets))
        os.chdir(self._assets)
        self.unstable: type[Exception] = self._module("utils.create_actor").UnStableError

    def make(self, task: str) -> Any:
        """Return a task of RoboTwin."""
        return getattr(self._module(task), task)()

    def arguments(self, task: str, setting: str) -> dict[str, Any]:
        """Return what `setup_demo` takes: a setting's file, the robot's, the size of pictures."""
        config = self._config(setting)
        robots, kinds = self._config("_embodiment_config"), config["embodiment"]
        if len(kinds) not in (1, 3):
            raise ValueError(f"RoboTwin's setting {setting} names {len(kinds)} robots, not 1 or 3 words")
        files = [
            str(self._assets / robots[name]["file_path"]) for name in (kinds[0], kinds[1 if len(kinds) == 3 else 0])
        ]
        camera = self._config("_camera_config")[config["camera"]["head_camera_type"]]
        configs = [_yaml(Path(file) / "config.yml") for file in files]
        apart = {"embodiment_dis": kinds[2]} if len(kinds) == 3 else {}
        return {
            **config,
            **apart,
            sdk.Deploy.TASK_NAME: task,
            "task_config": setting,
            # The three that the ecosystem's client requires (ensure_xpolicylab_observation_flags).
            "data_type": {**config.get("data_type", {}), "rgb": True, "qpos": True, "endpose": True},
            "head_camera_h": camera["h"],
            "head_camera_w": camera["w"],
            "left_robot_file": files[0],
            "right_robot_file": files[1],
            "dual_arm_embodied": len(kinds) == 1,
            "left_embodiment_config": configs[0],
            "right_embodiment_config": configs[1],
        }

    def describe(self, task: str, info: Mapping[str, Any], count: int, seed: int) -> Mapping[str, list[str]]:
        """Return RoboTwin's wordings of an instruction; empty if none matches the expert's names of objects."""
        name = "generate_episode_instructions" if self._root is not None else "robotwin.description.instructions"
        generate = importlib.import_module(name).generate_episode_descriptions
        before = random.getstate()
        random.seed(seed)  # it shuffles them by the generator that all share
        try:
            descriptions: list[Mapping[str, list[str]]] = generate(task, [info], count)
        finally:
            random.setstate(before)
        return descriptions[0] if descriptions else {}

    def _config(self, name: str) -> dict[str, Any]:
        if self._root is not None:
            return _yaml(self._root / _CONFIGS / f"{name}.yml")
        config: dict[str, Any] = importlib.import_module("robotwin.config").load_task_config(name)
        return config

    def _module(self, name: str) -> Any:
        try:
            return importlib.import_module(f"{self._prefix}.{name}")
        except ImportError as error:
            raise NotInstalledError(f"RoboTwin's code cannot be imported in {sys.executable}: {error}") from None


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep RoboTwin's output, a line for each step among it, from stderr."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            yield
        finally:
            logging.getLogger("toppra").handlers.clear()  # each planner that is made adds one


def check() -> tuple[Path | None, Path]:
    """Return the folders of the checkout, if one is named, and of the assets; nothing of RoboTwin is imported.

    Raises:
        NotInstalledError: code or assets are missing.
    """
    checkout = os.environ.get(CHECKOUT)
    root = _checkout(Path(checkout)) if checkout else None
    if root is None and importlib.util.find_spec("robotwin") is None:
        raise NotInstalledError(
            f"RoboTwin's code is not here: name a checkout in {CHECKOUT}, or install {RUNTIME} in {sys.executable}"
        )
    return root, _assets(root or Path(os.environ.get(ASSETS) or "."))


def _checkout(folder: Path) -> Path:
    root = folder.expanduser().resolve()
    if not (root / "envs" / "_base_task.py").is_file() or not (root / _CONFIGS).is_dir():
        raise NotInstalledError(f"{CHECKOUT} names {root}, which is no checkout of RoboTwin 2.0: no envs/_base_task.py")
    return root


def _assets(folder: Path) -> Path:
    root = folder.expanduser().resolve()
    missing = [name for name in NEEDED if not (root / name).is_dir()]
    if missing:
        raise NotInstalledError(
            f"RoboTwin's assets are not here: {root} lacks {', '.join(missing)}; scripts/_download_assets.sh brings "
            f"them, and {ASSETS} names their folder for {RUNTIME}"
        )
    if (root / MARKER).exists():
        raise NotInstalledError(f"RoboTwin's assets are not here: {root} has the mock robot of another setting")
    return root


def _yaml(file: Path) -> dict[str, Any]:
    import yaml

    content: dict[str, Any] = yaml.safe_load(file.read_text(encoding="utf-8"))
    return content
