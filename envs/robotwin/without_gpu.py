"""RoboTwin's runtime with the mock robot, on a machine with neither a GPU nor RoboTwin's assets.

The runtime is written for a ray tracer, for planners on a GPU and for libraries that its tasks do not use. Here cameras
rasterise, mplib plans, and unused imports may be missing.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys
import tempfile
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from xpl.environment import require
from xpl.rendering import VULKAN_COMPLAINTS, choose_vulkan, no_vulkan

from . import stand_in_robot
from .upstream import UpstreamSource, quiet

_UNUSED = ("open3d",)  # of point clouds, which no setting here uses
_NO_WAY = {"status": "Fail"}
_SEARCH = 1  # seed of every search for a way


class SourceWithoutGpu(UpstreamSource):
    """RoboTwin's tasks in its own runtime, with another robot than its own.

    Raises:
        NotInstalledError: the runtime is not installed.
        RendererMissingError: `XPL_MESA` names a folder without a driver.
    """

    has_expert = False

    def __init__(self) -> None:
        require("robotwin", __file__)
        choose_vulkan()
        for name in _UNUSED:
            if name not in sys.modules and importlib.util.find_spec(name) is None:
                sys.modules[name] = types.ModuleType(name)
        with quiet():
            self._begin(None, Path(_assets().name))

    def make(self, task: str) -> Any:
        """Return a task of RoboTwin whose cameras rasterise."""
        with quiet():
            made = super().make(task)
        sapien = importlib.import_module("sapien")
        scene, robot = made.setup_scene, made.load_robot

        def setup_scene(**kwargs: Any) -> None:
            try:
                scene(**kwargs)
            except RuntimeError as error:
                raise _explain(error) from error
            sapien.render.set_camera_shader_dir("default")

        def load_robot(**kwargs: Any) -> None:
            robot(**kwargs)
            for planner in (made.robot.left_planner, made.robot.right_planner):
                planner.plan_path = _steady(planner.plan_path)

        made.setup_scene, made.load_robot = setup_scene, load_robot
        return made

    def arguments(self, task: str, setting: str) -> dict[str, Any]:
        """Return what `setup_demo` takes besides, with the planner that needs no GPU."""
        config: Mapping[str, Any] = super().arguments(task, setting)
        return {**config, "planner_backend": "mplib"}


def _steady(plan: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
    """Return a planner that finds the same way for the same question, and none to where an arm is.

    mplib searches at random. To where an arm is it raises, or finds a way without a step, and RoboTwin divides by the
    number of steps. Where there is no way, RoboTwin has the arm stay.
    """
    mplib = importlib.import_module("mplib")

    @functools.wraps(plan)
    def planned(*arguments: Any, **options: Any) -> dict[str, Any]:
        mplib.set_global_seed(_SEARCH)
        try:
            trajectory = plan(*arguments, **options)
        except RuntimeError:
            return _NO_WAY
        return trajectory if trajectory["status"] != "Success" or len(trajectory["position"]) else _NO_WAY

    return planned


@functools.cache
def _assets() -> tempfile.TemporaryDirectory[str]:
    """Return this process's folder of assets, which goes with it."""
    made = tempfile.TemporaryDirectory(prefix="xpl-robotwin-", ignore_cleanup_errors=True)
    stand_in_robot.write(Path(made.name))
    return made


def _explain(error: RuntimeError) -> RuntimeError:
    is_about_vulkan = any(complaint in str(error) for complaint in VULKAN_COMPLAINTS)
    return no_vulkan("RoboTwin", error) if is_about_vulkan else error
