"""Tiny random checkpoints: the real files and classes of a model with a shrunken configuration and random weights.

A package's tiny.py writes one. It is made in the policy's interpreter, and every input is varied to see that the answer
depends on it (`xpl.worker.tiny`): an audit with weights that ignore the instruction proves nothing about it.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import _spec as sdk
from xpl.checkpoint import CUDA_ON_CPU, VARIABLES
from xpl.embodiment import get_embodiment
from xpl_cli.basics import atomic
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import ExitCode, UnknownNameError, UserError
from xpl_cli.basics.progress import Progress
from xpl_cli.isolation import subprocess_task
from xpl_cli.lifecycle import interpreter
from xpl_cli.model_io import recipes, script, tiny_checkpoint
from xpl_cli.packages.package import POLICY, load

if TYPE_CHECKING:
    from xpl.contract import Config, ObservationDict
    from xpl.manifest import Manifest
    from xpl_cli.packages.package import Package

FUNCTION: Final = "write"
NAME: Final = "tiny"
"""Of the checkpoint, below `checkpoints`."""
SHARE: Final = 0.02
"""Of the span of the answers that every input has to move them by."""
MOST_BYTES: Final = 20_000_000
LIMIT_S: Final = 600.0
_BASES = ((0, 0), (0, script.EPISODE), (2, 1))
"""Environment and first place of the episodes in which inputs are varied; then of what replaces them."""
_OTHERS = ((5, 0), (2, script.EPISODE), (5, 2))
_POSES = (sdk.State.EE_POSE, sdk.State.TCP_POSE, sdk.State.DELTA_EE_POSE)
"""State keys with a position and a rotation."""


@dataclass(frozen=True)
class TinyOptions:
    """How a checkpoint is made.

    Attributes:
        overrides: keys of deploy.yml.
        share: of the span of the answers that every input has to move them by.
        seed: of all generators.
        python, env: interpreter, as for `xpl serve`.
        patience: how long the task may be silent, s.
        progress: where progress is shown.
        may_fail: keep a checkpoint on which the model fails, unmeasured.
    """

    overrides: Config = field(default_factory=dict)
    share: float = SHARE
    seed: int = 0
    python: str | None = None
    env: str | None = None
    patience: float = 300.0
    progress: Progress = field(default_factory=Progress)
    may_fail: bool = False


@dataclass(frozen=True)
class TinyCheckpoint:
    """A checkpoint that was made.

    Attributes:
        path: its folder.
        size: bytes of its files.
        effects: by input, how far it moves the answer, as a share of the answer's span.
        gains: by name, the factors that weights were scaled by.
        unmoved: inputs below the share, with the reason.
    """

    path: Path
    size: int
    effects: Mapping[str, float]
    gains: Mapping[str, float]
    unmoved: Mapping[str, str]


def of_family(name: str) -> tuple[Path, str | None]:
    """Return the package, and its variant, whose tiny.py makes a checkpoint of a family.

    Args:
        name: of a policy, or of a variant of one, such as `smolvla`; case and punctuation do not count.

    Raises:
        UnknownNameError: none has this name, in the project or among those that come with xpl.
    """
    families: dict[str, tuple[str, Path, str | None]] = {}
    found = [path for folder in (Path(POLICY), content_folder(POLICY)) for path in folder.glob(f"*/{recipes.CODE}")]
    for folder in (path.parent.resolve() for path in found):
        variants = load(folder).manifest.data.get("variants") or {}
        for label, variant in ((folder.name, None), *((one, one) for one in variants)):
            families.setdefault(_plain(label), (label, folder, variant))
    wanted = families.get(_plain(name))
    if wanted is None:
        labels = [label for label, _, _ in families.values()]
        raise UnknownNameError(f"--family must be one of {', '.join(labels)}; got {name!r}", name, labels)
    return wanted[1:]


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


def make(package: Package, target: Path, options: TinyOptions) -> TinyCheckpoint:
    """Write a tiny random checkpoint of a package's model, measure it, and replace the folder `target` by it.

    Raises:
        UserError: if there is no tiny.py, or it fails, or writes too much.
    """
    recipe = recipes.find(package)
    if recipe is None:
        raise UserError(
            f"{package.path} has no {recipes.CODE}: it defines {FUNCTION}(folder, gain, config), which writes the "
            "model's files with a shrunken configuration",
            hint="docs/tiny-checkpoints.md shows one of twenty lines",
            code=ExitCode.NOT_FOUND,
        )
    with atomic.replaced_folder(target) as staging:
        config = package.config(recipe.overrides(staging, options.overrides))
        bases, inputs = _inputs(package, str(config[sdk.Deploy.ENV_CFG_TYPE]))
        options.progress.step(f"{recipe.path.name}: {len(inputs)} inputs")
        request = {
            "policy_dir": str(package.path),
            "config": config,
            "manifest": package.manifest.data,
            "file": str(recipe.path),
            "function": FUNCTION,
            "folder": str(staging),
            "seed": options.seed,
            "share": options.share,
            "most_bytes": MOST_BYTES,
            "cuda_on_cpu": recipe.cuda_on_cpu,
            "variables": dict(recipe.variables),
            "may_fail": options.may_fail,
            "bases": bases,
            "inputs": inputs,
        }
        measured = _run(package, recipe.path.name, request, options)
        effects, asked = measured["effects"], set(measured["asked"])
        if not package.manifest:  # which inputs the adapter reads is then known from its recipe alone
            inputs = [one for one in inputs if one["gain"] in asked]
        unmoved = dict(_unmoved([one for one in inputs if one["name"] in effects], effects, asked, options.share))
        made = {"seed": options.seed, "effects": effects, "gains": measured["gains"], "unmoved": unmoved}
        if recipe.cuda_on_cpu:
            made[CUDA_ON_CPU] = True
        if recipe.variables:
            made[VARIABLES] = dict(recipe.variables)
        if "failed" in measured:
            made["failed"] = measured["failed"]
        tiny_checkpoint.mark(staging, made)
    return TinyCheckpoint(target, int(measured["bytes"]), effects, measured["gains"], unmoved)


def _run(package: Package, file: str, request: Mapping[str, object], options: TinyOptions) -> Mapping[str, Any]:
    """Return what the task measured with the last checkpoint that it wrote.

    Raises:
        UserError: the task ended early, or the recipe failed.
    """
    settings = subprocess_task.TaskSettings(
        python=interpreter.resolve(package.path, package.manifest.environment, python=options.python, env=options.env),
        checkout=package.path,
        patience=options.patience,
        limit_s=LIMIT_S,
        on_answer=lambda count: options.progress.detail(f"{file}: checkpoint {count}"),
    )
    task = subprocess_task.run("xpl.worker.tiny", request, settings)
    if not task.answers or task.problem is not None:
        raise UserError(f"{file} {task.failure}", code=ExitCode.NOT_RUN)
    last = task.answers[-1]
    if last.error is not None:
        where = f" ({last.trace})" if last.trace else ""
        raise UserError(f"{file}, or the model that loads its files: {last.error}{where}")
    measured: Mapping[str, Any] = last.result
    return measured


def _unmoved(
    inputs: Sequence[Mapping[str, Any]], effects: Mapping[str, float], asked: set[str], share: float
) -> Iterator[tuple[str, str]]:
    """Yield the inputs that move the answer by too little, with the reason."""
    for one in inputs:
        if effects[one["name"]] < share:
            scaled = f"its gain {one['gain']!r} did not help" if one["gain"] in asked else f"no gain({one['gain']!r})"
            yield one["name"], f"moves the answer by {effects[one['name']]:.2g} of its span; {scaled}"


@dataclass(frozen=True)
class _Input:
    """An input of the policy that is varied.

    Attributes:
        name: as reports call it, such as `vision.cam_head` or `state.arm_joint_state[2]`.
        gain: name of the factor for the weights that read it.
        change: replaces it in an observation by that of another observation.
        earlier: change the earlier observations instead of the newest.
    """

    name: str
    gain: str
    change: Callable[[Any, Any], None]
    earlier: bool = False


def _inputs(package: Package, embodiment: str) -> tuple[list[list[ObservationDict]], list[dict[str, Any]]]:
    """Return episodes, and each input that the manifest reads with the same episodes in which it is another one."""
    manifest, robot = package.manifest, get_embodiment(embodiment)
    scene = script.ScriptedScene(robot, script.cameras(manifest, robot))
    reach = min(manifest.reach, script.EPISODE - 8)
    episodes = [[scene.observation(env, place + step) for step in range(reach)] for env, place in _BASES]
    others = [scene.observation(env, place + 7) for env, place in _OTHERS]
    widths = {key: len(values) for key, values in episodes[0][-1][sdk.Obs.STATE].items()}
    found = []
    kinds = _varied(manifest, robot.prefixes, widths, reach) if manifest else _all_varied(scene.cameras)
    for one in kinds:
        changed = copy.deepcopy(episodes)
        for episode, other in zip(changed, others, strict=True):
            for observation in episode[:-1] if one.earlier else episode[-1:]:
                one.change(observation, other)
        found.append({"name": one.name, "gain": one.gain, "observations": changed})
    return episodes, found


def _varied(manifest: Manifest, prefixes: Sequence[str], widths: Mapping[str, int], reach: int) -> Iterator[_Input]:
    """Yield what a manifest reads: each camera, each number of the state, the instruction, the history."""
    for name in manifest.read:
        group, _, key = name.partition(".")
        if group == sdk.Obs.VISION:
            yield _Input(name, key, partial(_replace_camera, key))
        elif group == sdk.Obs.STATE:
            for full in (prefix + key for prefix in prefixes if prefix + key in widths):
                yield from _numbers(full, widths[full], has_rotation=key in _POSES)
        elif name == sdk.Obs.INSTRUCTION:
            yield _Input(name, name, _replace_instruction)
    if reach > 1:
        yield _Input("history", "history", _replace_all, earlier=True)


def _all_varied(cameras: Iterable[str]) -> Iterator[_Input]:
    """Yield what an adapter without a manifest may read: every camera, the whole state, the instruction."""
    yield from (_Input(name, name, partial(_replace_camera, name)) for name in cameras)
    yield _Input(sdk.Obs.STATE, "state", _replace_state)
    yield _Input(sdk.Obs.INSTRUCTION, sdk.Obs.INSTRUCTION, _replace_instruction)


def _numbers(key: str, width: int, *, has_rotation: bool) -> Iterator[_Input]:
    """Yield the numbers of a state key; those of a rotation vary together."""
    ends = [*range(sdk.POSITION_DIM), width - 1] if has_rotation else range(width)
    first = 0
    for end in ends:
        label = f"{first}" if first == end else f"{first}:{end + 1}"
        yield _Input(f"state.{key}[{label}]", "state", partial(_replace_numbers, key, slice(first, end + 1)))
        first = end + 1


def _replace_camera(name: str, observation: Any, other: Any) -> None:
    observation[sdk.Obs.VISION][name] = copy.deepcopy(other[sdk.Obs.VISION][name])


def _replace_numbers(key: str, where: slice, observation: Any, other: Any) -> None:
    values = np.array(observation[sdk.Obs.STATE][key])
    values[where] = np.asarray(other[sdk.Obs.STATE][key])[where]
    observation[sdk.Obs.STATE][key] = values


def _replace_state(observation: Any, other: Any) -> None:
    observation[sdk.Obs.STATE] = copy.deepcopy(other[sdk.Obs.STATE])


def _replace_instruction(observation: Any, other: Any) -> None:
    observation[sdk.Obs.INSTRUCTION] = other[sdk.Obs.INSTRUCTION]


def _replace_all(observation: Any, other: Any) -> None:
    observation.update(copy.deepcopy(other))
