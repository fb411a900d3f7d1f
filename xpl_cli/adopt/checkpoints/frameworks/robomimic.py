"""robomimic: the `config.json` of a run; the `.pth` beside it is a pickle and is not opened.

Source: ARISE-Initiative/robomimic robomimic/scripts/train.py (config.json), robomimic/utils/train_utils.py
(save_model), robomimic/utils/file_utils.py (content of a checkpoint: shape_metadata, normalisation statistics).
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints.layout import VectorNumbers
from xpl_cli.adopt.checkpoints.trained_model import ImageSpec, TrainedModel, VectorSpec, upstream
from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact, certain, likely

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.reading import CheckpointFolder, ConfigDocument

NAME: Final = "robomimic"
CODE: Final = "ARISE-Initiative/robomimic@d309eae:robomimic"
_CONFIG: Final = "config.json"
_WIDTHS: Final = {"eef_pos": 3, "eef_quat": 4, "gripper_qpos": 2}
_NAMES: Final = {
    "eef_pos": ("x", "y", "z"),
    "eef_quat": ("qx", "qy", "qz", "qw"),
    "gripper_qpos": ("gripper_0", "gripper_1"),
}
"""Observations of robosuite with one arm, with the names of their numbers."""
_STOCHASTIC: Final = ("gaussian", "gmm", "vae")


def inner(folder: CheckpointFolder) -> CheckpointFolder | None:
    """Return the folder of a run of robomimic; None if it is none."""
    if not folder.has(_CONFIG):
        return None
    config = folder.json(_CONFIG)
    is_run = isinstance(config.at("algo_name"), str) and isinstance(config.at("observation", "modalities"), dict)
    return folder if is_run else None


def read(folder: CheckpointFolder) -> TrainedModel:
    """Read a training run.

    Raises:
        UserError: config.json is invalid.
    """
    config = folder.json(_CONFIG)
    algorithm = config.get(str, "algo_name")
    modalities = ("observation", "modalities", "obs")
    eye = Evidence(f"{CODE}/utils/obs_utils.py", None, "process_frame: float32 in 0..1, channel first")
    rest: dict[str, Tree] = {
        "channels": likely("rgb", eye),
        "layout": likely("chw", eye),
        "dtype": likely("float32", eye),
    }
    rgb, low = config.texts(*modalities, "rgb") or [], config.texts(*modalities, "low_dim") or []
    size = UnknownFact("height and width: those of the dataset, in the pickled shape_metadata")
    return TrainedModel(
        framework=NAME,
        about=f"{algorithm} of robomimic",
        family=likely("diffusion" if "diffusion" in algorithm else "imitation", config.evidence_of("algo_name")),
        views=[
            ImageSpec(
                certain(name, config.evidence_of(*modalities, "rgb", what=name)),
                [name],
                config.evidence_of(*modalities, "rgb", what=name),
                steps=[{"resize": {"to": size, "filter": UnknownFact("the filter")}}],
                rest=rest,
            )
            for name in rgb
        ],
        states=[_state(name, config, config.evidence_of(*modalities, "low_dim", what=name)) for name in low],
        action=VectorSpec(
            VectorNumbers(0, config.evidence_of("train", "action_keys")), None, _actions(config), parts=_unknown_width()
        ),
        reference=UnknownFact("deltas of robosuite's controller (cumulative), or absolute: see the dataset's env_args"),
        chunk=_chunk(config, algorithm),
        sampling=_sampling(config, algorithm),
        recurrent=_recurrent(config),
        history=_history(config, algorithm),
        upstream=upstream("ARISE-Initiative/robomimic", "MIT"),
        notes=[f"{folder.pickles('models/*.pth')}; it contains widths and statistics"],
    )


def _unknown_width() -> UnknownFact:
    return UnknownFact("width of an action: shape_metadata/ac_dim is in the pickled checkpoint")


def _state(name: str, config: ConfigDocument, where: Evidence) -> VectorSpec:
    quantity = re.sub(r"^robot\d_", "", name)
    width = _WIDTHS.get(quantity, 0)
    if config.at("train", "hdf5_normalize_obs") is True:
        rule: Tree = UnknownFact(
            "mean_std: its numbers (obs_normalization_stats) are in the pickled checkpoint", (where,)
        )
    else:
        rule = certain(None, config.evidence_of("train", "hdf5_normalize_obs"))
    if not width:
        parts = UnknownFact(f"meaning of {name}: its width is in the pickled checkpoint", (where,))
        return VectorSpec(VectorNumbers(0, where), certain(name, where), rule, parts=parts)
    names_evidence = Evidence(where.file, where.line, f"{name}, as in robosuite")
    return VectorSpec(VectorNumbers(width, where, _NAMES[quantity], names_evidence), certain(name, where), rule)


def _actions(config: ConfigDocument) -> Tree:
    entries = config.get(dict, "train", "action_config", default={})
    rules = {str(entry.get("normalization")) for entry in entries.values() if isinstance(entry, dict)}
    if rules <= {"None"}:
        return certain(None, config.evidence_of("train", "action_config", what="normalization: null"))
    return UnknownFact(
        f"{', '.join(sorted(rules))}: its numbers are in the pickled checkpoint",
        (config.evidence_of("train", "action_config"),),
    )


def _chunk(config: ConfigDocument, algorithm: str) -> Fact | UnknownFact:
    if "diffusion" in algorithm:
        steps = config.get(int, "algo", "horizon", "action_horizon", default=0)
        return (
            certain(steps, config.evidence_of("algo", "horizon", "action_horizon"))
            if steps
            else UnknownFact("algo.horizon.action_horizon")
        )
    return likely(1, Evidence(f"{CODE}/algo/bc.py", None, "get_action returns one action"))


def _recurrent(config: ConfigDocument) -> Fact | None:
    enabled = config.at("algo", "rnn", "enabled")
    return certain(enabled, config.evidence_of("algo", "rnn", "enabled")) if enabled is True else None


def _history(config: ConfigDocument, algorithm: str) -> dict[str, Tree] | None:
    path = ("algo", "horizon", "observation_horizon") if "diffusion" in algorithm else ("train", "frame_stack")
    length = config.get(int, *path, default=1)
    return {"length": certain(length, config.evidence_of(*path))} if length > 1 else None


def _sampling(config: ConfigDocument, algorithm: str) -> Fact | UnknownFact:
    stochastic = [name for name in _STOCHASTIC if config.at("algo", name, "enabled") is True]
    if stochastic or "diffusion" in algorithm:
        where = config.evidence_of("algo", stochastic[0], "enabled") if stochastic else config.evidence_of("algo_name")
        return likely("seeded", where)
    return likely("none", config.evidence_of("algo_name"))
