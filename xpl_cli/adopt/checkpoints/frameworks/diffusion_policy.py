"""Diffusion Policy (real-stanford): the Hydra configuration beside the checkpoints.

Source: real-stanford/diffusion_policy diffusion_policy/workspace/base_workspace.py (payload), diffusion_policy/policy/
(predict_action), diffusion_policy/config/. The model's inputs are those of `policy.predict_action`, which normalises
and crops itself with what is in the pickled payload. That is not opened: unpickling runs code.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.adopt.checkpoints import names
from xpl_cli.adopt.checkpoints.layout import VectorNumbers
from xpl_cli.adopt.checkpoints.reading import ConfigDocument
from xpl_cli.adopt.checkpoints.trained_model import ImageSpec, TrainedModel, VectorSpec, upstream
from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact, certain, likely
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.reading import CheckpointFolder

NAME: Final = "diffusion_policy"
CODE: Final = "real-stanford/diffusion_policy@5ba07ac:diffusion_policy"
_CONFIG: Final = ".hydra/config.yaml"
_REFERENCE: Final = re.compile(r"\$\{([\w.]+)\}")
_ROTATIONS: Final = {"rotation_6d": 6, "axis_angle": 3, "quaternion": 4}


def inner(folder: CheckpointFolder) -> CheckpointFolder | None:
    """Return the folder of a run, which contains .hydra; None if it is none."""
    if not folder.has(_CONFIG):
        return None
    config = folder.yaml(_CONFIG)
    return folder if isinstance(config.at("shape_meta"), dict) or config.at("task", "shape_meta") else None


def read(folder: CheckpointFolder) -> TrainedModel:
    """Read a training run.

    Raises:
        UserError: the configuration is invalid.
    """
    raw = folder.yaml(_CONFIG)
    config = ConfigDocument(raw.file, _resolve(raw.value, raw.value, 0), "", folder.path / _CONFIG)
    meta = ("shape_meta",) if isinstance(config.at("shape_meta"), dict) else ("task", "shape_meta")
    views, states = [], []
    for name in config.get(dict, *meta, "obs"):
        shape = [int(one) for one in config.numbers(*meta, "obs", name, "shape") or []]
        kind = config.get(str, *meta, "obs", name, "type", default="low_dim")
        where = Evidence(_CONFIG, None, f"shape_meta/obs/{name}: {kind} {shape}")
        if kind == "rgb" and len(shape) == 3:
            views.append(_view(str(name), (shape[1], shape[2]), where))
        else:
            states.append(_vector(str(name), shape, where))
    action = config.numbers(*meta, "action", "shape")
    if not action or len(action) != 1:
        raise UserError(f"{config.location()}: expected shape_meta/action/shape with one number, got {action}")
    absolute = config.at("task", "abs_action")
    return TrainedModel(
        framework=NAME,
        about=f"Diffusion Policy{_task_suffix(config)}",
        family=certain("diffusion", Evidence(_CONFIG, None, f"_target_: {config.at('_target_')}")),
        views=views,
        states=states,
        action=_action(int(action[0]), config),
        reference=_reference(absolute),
        chunk=_count(config, "n_action_steps", "how many steps predict_action returns"),
        sampling=likely("seeded", Evidence(f"{CODE}/policy", None, "conditional_sample draws noise")),
        history=_history(config),
        upstream=upstream("real-stanford/diffusion_policy", "MIT"),
        notes=[folder.pickles("checkpoints/*.ckpt")],
    )


def _resolve(value: object, root: object, depth: int) -> Any:
    """Return a configuration with `${a.b}` replaced by the value there; `${eval:...}` is kept, because it is code."""
    if depth > 20:
        return value
    if isinstance(value, dict):
        return {key: _resolve(entry, root, depth + 1) for key, entry in value.items()}
    if isinstance(value, list):
        return [_resolve(entry, root, depth + 1) for entry in value]
    reference = _REFERENCE.fullmatch(value) if isinstance(value, str) else None
    if reference is None:
        return value
    there = ConfigDocument("", root).at(*reference[1].split("."))
    return value if there is None else _resolve(there, root, depth + 1)


def _view(name: str, size: tuple[int, int], where: Evidence) -> ImageSpec:
    eye = Evidence(f"{CODE}/dataset", None, "images are float32 in 0..1, channel first")
    filter_ = UnknownFact("resize filter for images of another size: see the environment's runner", (where,))
    return ImageSpec(
        input=certain(name, where),
        names=[name],
        evidence=where,
        size=size,
        steps=[{"resize": {"to": certain(list(size), where), "filter": filter_}}],
        rest={"channels": likely("rgb", eye), "layout": likely("chw", eye), "dtype": likely("float32", eye)},
    )


def _vector(name: str, shape: list[int], where: Evidence) -> VectorSpec:
    width = shape[0] if len(shape) == 1 else 0
    if width < 1:
        raise UserError(f"{_CONFIG}: expected a shape with one number for {name}, got {shape}")
    short_name = re.sub(r"^robot\d?_", "", name)
    return VectorSpec(
        VectorNumbers(width, where, names.names_of_groups([(short_name, width)]), where),
        certain(name, where),
        _inside(),
    )


def _action(width: int, config: ConfigDocument) -> VectorSpec:
    where = Evidence(_CONFIG, None, f"shape_meta/action/shape: [{width}]")
    form = config.get(str, "task", "dataset", "rotation_rep", default="")
    turned = _ROTATIONS.get(form, 0)
    if config.at("task", "abs_action") and turned and width % (3 + turned + 1) == 0:
        arms = width // (3 + turned + 1)
        evidence = Evidence(_CONFIG, None, f"abs_action, rotation_rep: {form}")
        sides = [""] if arms == 1 else [f"robot{index}_" for index in range(arms)]
        groups = [
            (f"{side}{part}", count)
            for side in sides
            for part, count in (("eef_pos", 3), ("eef_rot", turned), ("gripper", 1))
        ]
        if arms == 1:
            return VectorSpec(VectorNumbers(width, where, names.names_of_groups(groups), evidence), None, _inside())
    return VectorSpec(VectorNumbers(width, where), None, _inside())


def _inside() -> Fact:
    return likely(None, Evidence(f"{CODE}/policy", None, "predict_action normalises by the policy's own normalizer"))


def _reference(absolute: object) -> Fact | UnknownFact:
    where = Evidence(_CONFIG, None, f"task/abs_action: {absolute}")
    if absolute is True:
        return certain("absolute", where)
    return UnknownFact("absolute, or deltas of the authors' controller (robosuite's are cumulative)", (where,))


def _count(config: ConfigDocument, name: str, reason: str) -> Fact | UnknownFact:
    value = config.at(name)
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        return certain(value, Evidence(_CONFIG, None, f"{name}: {value}"))
    return UnknownFact(f"{reason}: {name} is {value!r}")


def _history(config: ConfigDocument) -> dict[str, Tree] | None:
    length = _count(config, "n_obs_steps", "how many observations it sees")
    if isinstance(length, Fact) and length.value == 1:
        return None
    runner = Evidence(f"{CODE}/gym_util/multistep_wrapper.py", None, "stack_last_n_obs repeats the first one")
    return {"length": length, "pad": likely("repeat", runner)}


def _task_suffix(config: ConfigDocument) -> str:
    name = config.at("task_name") or config.at("task", "name")
    return f", trained on {name}" if isinstance(name, str) and "$" not in name else ""
