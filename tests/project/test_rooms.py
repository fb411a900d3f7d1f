"""The floor plan: no room is crowded, no prefix tells a family, and what documents import stays where it is."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from typing import TYPE_CHECKING

import pytest

import xpl
from tests.support.places import ROOT, tracked

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MOST = 19
"""Modules of one package, beside its sub-packages: as many as are read at a glance."""

INIT = "__init__"

FAMILIES = ("spec_", "env_", "evaluation_", "loop_", "simulation_", "yaml_")
"""Prefixes that told families before these had rooms."""

DOCUMENTS = ("README.md", "CONTRIBUTING.md", "docs/**", "templates/**", ".agents/skills/**", "envs/**", "policy/**")
EXAMPLES = "docs/rules/"
"""Pages that show imports of names that are not there."""
TEXTS = (".md", ".py", ".jinja", ".yml", ".sh")

PUBLIC = {
    "xpl": (
        *("ActionError", "AsyncClient", "Client", "Embodiment", "ObservationError", "Policy", "get_embodiment"),
        *("robots", "rotation", "training"),
    ),
    "xpl.action": ("ActionError", "action_dim", "check_step", "pack", "unpack"),
    "xpl.checkpoint": ("resolve", "resolve_step"),
    "xpl.client": ("ClientError",),
    "xpl.convert": ("compile_interface",),
    "xpl.decoding": ("ensemble", "within_limits"),
    "xpl.embodiment": ("Arm", "Embodiment", "get_embodiment"),
    "xpl.environment": (
        *("Environment", "EnvironmentBase", "Episode", "Setup", "TaskEnv", "one_of", "read_manifest", "require"),
        "NotInstalledError",
    ),
    "xpl.episode": ("MAX_STEPS", "SUCCESS", "SUCCESS_SCORE", "Setup", "Simulated"),
    "xpl.arms.arx": ("ArxDriver",),
    "xpl.arms.driver": ("Driver",),
    "xpl.arms.environment": ("ArmEnvironment",),
    "xpl.arms.episode": ("ArmEpisode",),
    "xpl.arms.lerobot": ("LeRobotDriver", "Words", "make"),
    "xpl.arms.simulated": ("SimulatedRobot",),
    "xpl.bridge": ("Bridge", "BridgeError", "Simulated"),
    "xpl.guard": ("GuardedEnv",),
    "xpl.images": ("decode",),
    "xpl.kinematics": ("Chain",),
    "xpl.observation": (
        "ObservationError",
        "env_indices",
        "get_image",
        "get_instruction",
        "offered_inputs",
        "pack_state",
    ),
    "xpl.poses": ("compose", "invert", "pose", "transform"),
    "xpl.process": ("link",),
    "xpl.process.modules": ("load_module",),
    "xpl.robots": ("load",),
    "xpl.rollout": ("run_batch", "run_episode"),
    "xpl.rotation": ("angle_between", "from_axis_angle", "from_matrix", "multiply", "to_axis_angle", "to_matrix"),
    "xpl.safety": ("GRIPPER_RANGE", "JOINT_LIMIT", "JOINT_SPEED", "NON_FINITE", "QUATERNION_NORM", "Supervisor"),
    "xpl.simulator.changes": ("COMMANDED", "MEASURED", "Changes", "bounded"),
    "xpl.training": ("Windows", "statistics", "windows"),
    "xpl.trajectory": ("Folder", "Writer", "open_files", "open_folder"),
    "xpl.vector": ("VectorEnv",),
    "xpl.wire": ("packed",),
    "xpl.wire.codec": ("WireError",),
    "xpl_cli": ("environments",),
    "xpl_cli.basics.content": ("load_module", "room"),
    "xpl_cli.environments": ("make", "play"),
}
"""What documents, templates and our own packages import; it stays where it is."""


def packages(root: Path = ROOT) -> dict[str, list[str]]:
    """Return every folder of ours that holds modules, with their names; of tests, too."""
    found: dict[str, list[str]] = defaultdict(list)
    for path in tracked("xpl/**/*.py", "xpl_cli/**/*.py", "tests/**/*.py", root=root):
        found[path.parent.relative_to(root).as_posix()].append(path.stem)
    return dict(found)


def complaints(root: Path = ROOT) -> list[str]:
    """Return what is wrong with the rooms of a checkout."""
    found = []
    for room, modules in sorted(packages(root).items()):
        if room.startswith("xpl") and INIT not in modules:
            found.append(f"{room} has no {INIT}.py, so that the contracts on imports pass it over")
        count = len({*modules} - {INIT})
        if count > MOST:
            found.append(f"{room} has {count} modules: give those that belong together a room")
        found += [
            f"{room}/{name} tells its family by a prefix" for name in sorted(modules) if name.startswith(FAMILIES)
        ]
    return found


def named(text: str) -> Iterator[tuple[str, str]]:
    """Yield every module of ours and public name in it that a text imports, or of the SDK writes out as code."""
    for module, wrapped, plain in re.findall(r"from (xpl(?:_cli)?[.\w]*) import (?:\(([\w\s,]+)\)|([\w ,]+))", text):
        words = [name.partition(" as ")[0].strip() for name in (wrapped or plain).split(",")]
        yield from ((module, word) for word in words if word and not word.startswith("_"))
    for path in re.findall(r"`xpl\.([\w.]+)", text):
        *folders, name = f"xpl.{path}".rstrip(".").split(".")
        if _is_module(".".join(folders)) and (len(folders) > 1 or name in xpl.__all__):
            yield ".".join(folders), name


def _is_module(name: str) -> bool:
    place = ROOT / name.replace(".", "/")
    return place.with_suffix(".py").is_file() or (place / "__init__.py").is_file()


# -- rooms ------------------------------------------------------------------------------------------------------------


def test_the_rooms_are_as_they_should_be() -> None:
    """None is crowded: a folder's listing reads like a table of contents. No family is told by a prefix."""
    assert complaints() == []


def test_a_crowded_room_and_a_family_with_a_prefix_are_found(tmp_path: Path) -> None:
    """And a folder that is no package."""
    (tmp_path / "xpl/wire").mkdir(parents=True)
    for name in (INIT, "spec_view", *(f"module{number}" for number in range(MOST))):
        (tmp_path / f"xpl/{name}.py").touch()
    (tmp_path / "xpl/wire/codec.py").touch()
    assert [found.split()[0] for found in complaints(tmp_path)] == ["xpl", "xpl/spec_view", "xpl/wire"]


# -- what documents import --------------------------------------------------------------------------------------------


def documented() -> dict[str, set[str]]:
    """Return what documents import or name: per module the names in it."""
    found = defaultdict(set)
    for path in tracked(*DOCUMENTS):
        if path.relative_to(ROOT).as_posix().startswith(EXAMPLES):
            continue
        if path.suffix in TEXTS:
            for module, name in named(path.read_text(encoding="utf-8", errors="replace")):
                found[module].add(name)
    return dict(found)


def test_what_documents_name_is_listed_as_public() -> None:
    """What a reader copies from a page has to stay: it is listed above, and does not move from there."""
    found = documented()
    assert len(found) > 10
    unlisted = {module: names - {*PUBLIC.get(module, ())} for module, names in found.items()}
    assert {module: names for module, names in unlisted.items() if names} == {}


def test_names_are_found_in_every_form() -> None:
    """In one line, in brackets over several, under another name, and in the middle of a sentence."""
    text = """
    from xpl import Client, _spec as spec
    from xpl.poses import (
        compose,
        pose as place,
    )
    Use `xpl.observation.get_image(obs, camera)`, `xpl.Policy`; `xpl.audit/1` is an answer.
    """
    assert list(named(text)) == [
        ("xpl", "Client"),
        ("xpl.poses", "compose"),
        ("xpl.poses", "pose"),
        ("xpl.observation", "get_image"),
        ("xpl", "Policy"),
    ]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("module", PUBLIC)
def test_a_public_name_is_imported_first_thing(module: str) -> None:
    """In a process that has imported nothing else of ours."""
    command = [sys.executable, "-c", f"from {module} import {', '.join(PUBLIC[module])}"]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
