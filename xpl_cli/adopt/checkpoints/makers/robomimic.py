"""robomimic: the `config.json` of a run; the `.pth` beside it is a pickle, and is not opened.

Source: ARISE-Initiative/robomimic robomimic/scripts/train.py (config.json), robomimic/utils/train_utils.py
(save_model), robomimic/utils/file_utils.py (what a checkpoint holds: shape_metadata, normalisation statistics).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints.layout import Numbers
from xpl_cli.adopt.checkpoints.trained import Trained, Vector, View, upstream
from xpl_cli.adopt.facts import Evidence, Open, Told, Tree, certain, likely

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.reading import Document, Folder

NAME: Final = "robomimic"
CODE: Final = "ARISE-Initiative/robomimic@d309eae:robomimic"
_CONFIG: Final = "config.json"
_WIDTHS: Final = {"eef_pos": 3, "eef_quat": 4, "gripper_qpos": 2}
_NAMES: Final = {
    "eef_pos": ("x", "y", "z"),
    "eef_quat": ("qx", "qy", "qz", "qw"),
    "gripper_qpos": ("gripper_0", "gripper_1"),
}
"""Observations of robosuite with one arm: what they hold."""
_STOCHASTIC: Final = ("gaussian", "gmm", "vae")


def inner(folder: Folder) -> Folder | None:
    """Return the folder of a run of robomimic, which holds config.json; None if it is none."""
    if not folder.has(_CONFIG):
        return None
    config = folder.json(_CONFIG)
    is_run = isinstance(config.at("algo_name"), str) and isinstance(config.at("observation", "modalities"), dict)
    return folder if is_run else None


def read(folder: Folder) -> Trained:
    """Return what a run says.

    Raises:
        UserError: if config.json is not what it should be.
    """
    config = folder.json(_CONFIG)
    algorithm = config.get(str, "algo_name")
    shown = ("observation", "modalities", "obs")
    eye = Evidence(f"{CODE}/utils/obs_utils.py", None, "process_frame: float32 in 0..1, channel first")
    rest: dict[str, Tree] = {
        "channels": likely("rgb", eye),
        "layout": likely("chw", eye),
        "dtype": likely("float32", eye),
    }
    rgb, low = config.texts(*shown, "rgb") or [], config.texts(*shown, "low_dim") or []
    size = Open("height and width: the data set's own, which the pickled shape_metadata holds")
    return Trained(
        maker=NAME,
        about=f"{algorithm} of robomimic",
        family=likely("diffusion" if "diffusion" in algorithm else "imitation", config.seen("algo_name")),
        views=[
            View(
                certain(name, config.seen(*shown, "rgb", what=name)),
                [name],
                config.seen(*shown, "rgb", what=name),
                steps=[{"resize": {"to": size, "filter": Open("the filter")}}],
                rest=rest,
            )
            for name in rgb
        ],
        states=[_state(name, config, config.seen(*shown, "low_dim", what=name)) for name in low],
        action=Vector(Numbers(0, config.seen("train", "action_keys")), None, _actions(config), parts=_unsaid()),
        reference=Open("deltas of robosuite's controller (cumulative), or absolute: the data set's env_args say it"),
        chunk=_chunk(config, algorithm),
        sampling=_sampling(config, algorithm),
        recurrent=_recurrent(config),
        history=_history(config, algorithm),
        upstream=upstream("ARISE-Initiative/robomimic", "MIT"),
        notes=[f"{folder.pickles('models/*.pth')}; widths and statistics are in it"],
    )


def _unsaid() -> Open:
    return Open("how many numbers an action has: shape_metadata/ac_dim is in the pickled checkpoint")


def _state(name: str, config: Document, where: Evidence) -> Vector:
    word = re.sub(r"^robot\d_", "", name)
    width = _WIDTHS.get(word, 0)
    if config.at("train", "hdf5_normalize_obs") is True:
        rule: Tree = Open("mean_std: its numbers (obs_normalization_stats) are in the pickled checkpoint", (where,))
    else:
        rule = certain(None, config.seen("train", "hdf5_normalize_obs"))
    if not width:
        parts = Open(f"what {name} holds: its width is in the pickled checkpoint", (where,))
        return Vector(Numbers(0, where), certain(name, where), rule, parts=parts)
    named = Evidence(where.file, where.line, f"{name}, as robosuite has it")
    return Vector(Numbers(width, where, _NAMES[word], named), certain(name, where), rule)


def _actions(config: Document) -> Tree:
    found = config.get(dict, "train", "action_config", default={})
    rules = {str(entry.get("normalization")) for entry in found.values() if isinstance(entry, dict)}
    if rules <= {"None"}:
        return certain(None, config.seen("train", "action_config", what="normalization: null"))
    return Open(
        f"{', '.join(sorted(rules))}: its numbers are in the pickled checkpoint",
        (config.seen("train", "action_config"),),
    )


def _chunk(config: Document, algorithm: str) -> Told | Open:
    if "diffusion" in algorithm:
        steps = config.get(int, "algo", "horizon", "action_horizon", default=0)
        return (
            certain(steps, config.seen("algo", "horizon", "action_horizon"))
            if steps
            else Open("algo.horizon.action_horizon")
        )
    return likely(1, Evidence(f"{CODE}/algo/bc.py", None, "get_action returns one action"))


def _recurrent(config: Document) -> Told | None:
    enabled = config.at("algo", "rnn", "enabled")
    return certain(enabled, config.seen("algo", "rnn", "enabled")) if enabled is True else None


def _history(config: Document, algorithm: str) -> dict[str, Tree] | None:
    path = ("algo", "horizon", "observation_horizon") if "diffusion" in algorithm else ("train", "frame_stack")
    length = config.get(int, *path, default=1)
    return {"length": certain(length, config.seen(*path))} if length > 1 else None


def _sampling(config: Document, algorithm: str) -> Told | Open:
    drawn = [name for name in _STOCHASTIC if config.at("algo", name, "enabled") is True]
    if drawn or "diffusion" in algorithm:
        where = config.seen("algo", drawn[0], "enabled") if drawn else config.seen("algo_name")
        return likely("seeded", where)
    return likely("none", config.seen("algo_name"))
