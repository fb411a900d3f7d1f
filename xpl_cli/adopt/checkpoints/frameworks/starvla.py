"""StarVLA: `config.yaml` and `dataset_statistics.json` of a run, two folders above its `.pt`.

Source: starVLA/starVLA starVLA/model/framework/share_tools.py (read_mode_config), deployment/model_server/
policy_norm_processor.py. Weights are pickles and are not opened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints.layout import DataRange, VectorNumbers
from xpl_cli.adopt.checkpoints.trained_model import ImageSpec, TrainedModel, VectorSpec, upstream
from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact, certain, likely
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.reading import CheckpointFolder, ConfigDocument

NAME: Final = "starvla"
CODE: Final = "starVLA/starVLA@0ed0aad"
_CONFIG: Final = "config.yaml"
_STATISTICS: Final = "dataset_statistics.json"
_DATA: Final = ("datasets", "vla_data")
_HORIZONS: Final = (
    ("framework", "action_model", "action_horizon"),
    ("framework", "action_horizon"),
    ("framework", "action_model", "future_action_window_size"),
)


def inner(folder: CheckpointFolder) -> CheckpointFolder | None:
    """Return the folder of a run of StarVLA; None if it is none."""
    if not (folder.has(_CONFIG) and folder.has(_STATISTICS)):
        return None
    config = folder.yaml(_CONFIG)
    return folder if isinstance(config.at("framework"), dict) and config.at(*_DATA) else None


def read(folder: CheckpointFolder, key: str | None = None) -> TrainedModel:
    """Read a training run.

    Args:
        folder: with config.yaml.
        key: entry of the statistics, if there are several.

    Raises:
        UserError: a file is invalid, or there are several entries and `key` is None.
    """
    config, stats = folder.yaml(_CONFIG), folder.json(_STATISTICS)
    entry = stats.choose_entry(stats.get(dict), key)
    framework = config.get(str, "framework", "name", default="")
    mix = config.get(str, *_DATA, "data_mix", default="")
    reads_state = bool(config.at(*_DATA, "include_state"))
    where = config.evidence_of("framework", "name")
    return TrainedModel(
        framework=NAME,
        about=f"a policy of StarVLA ({framework or 'no framework named'}), trained on {mix or entry}",
        family=certain("vla", where),
        views=[_view(config)],
        states=[_vector(stats, entry, "state", certain("state", config.evidence_of(*_DATA, "include_state")))]
        if reads_state
        else [],
        action=_vector(stats, entry, "action", None),
        reference=_reference(config),
        chunk=_chunk(config),
        sampling=UnknownFact("none, seeded or free: it depends on the framework's action head", (where,)),
        instruction={
            "input": likely("lang", Evidence(f"{CODE}:deployment/model_server", None, "examples have a lang"))
        },
        upstream=upstream("starVLA/starVLA", "MIT"),
        notes=[
            folder.pickles("checkpoints/*.pt", "final_model/*.pt"),
            f"cameras, groups and the rule of normalisation are in the data config of {mix or 'the run'}",
        ],
    )


def _view(config: ConfigDocument) -> ImageSpec:
    path = next((path for path in ((*_DATA, "obs_image_size"), (*_DATA, "image_size")) if config.at(*path)), None)
    size = config.numbers(*path) if path else None
    where = config.evidence_of(*path) if path else Evidence(_CONFIG, None, "no obs_image_size")
    steps: list[Tree] = []
    if size and len(size) == 2:
        code = Evidence(f"{CODE}:deployment/model_server/policy_wrapper.py", None, "training_obs_image_size")
        steps.append(
            {
                "resize": {
                    "to": certain([int(one) for one in size], where),
                    "filter": UnknownFact("the filter", (code,)),
                }
            }
        )
    rest: dict[str, Tree] = {
        "channels": likely("rgb", Evidence(f"{CODE}:starVLA/dataloader", None, "images are PIL images in RGB")),
        "layout": "hwc",
        "dtype": "uint8",
    }
    views = Evidence(_CONFIG, None, "a list of views, in the order of the data config's video keys")
    rest["stack"] = UnknownFact("number of views, and how they are concatenated", (views,))
    size_known = (int(size[0]), int(size[1])) if size and len(size) == 2 else None
    return ImageSpec(likely("image", views), ["of the data config"], views, size_known, steps, rest)


def _vector(stats: ConfigDocument, entry: str, kind: str, name: Fact | None) -> VectorSpec:
    path = (entry, kind)
    within = DataRange.read(stats, path, "min", "max")
    if within is None:
        raise UserError(f"{stats.location(*path)}: expected min and max of {kind}, of equal length")
    width = len(within.low)
    numbers = VectorNumbers(width, stats.evidence_of(*path, what=f"{kind}: {width} numbers"), range=within)
    present = ", ".join(word for word in ("min", "max", "q01", "q99", "mean", "std") if stats.at(*path, word))
    rule = UnknownFact(
        "min_max, quantiles or mean_std: see the data config, by key", (stats.evidence_of(*path, what=present),)
    )
    return VectorSpec(numbers, name, rule)


def _reference(config: ConfigDocument) -> Fact | UnknownFact:
    mode = config.get(str, *_DATA, "action_type", default="")
    where = config.evidence_of(*_DATA, "action_type")
    if mode.startswith("delta"):
        return likely("cumulative", where)
    if mode.startswith("abs"):
        return likely("absolute", where)
    return UnknownFact("what actions are relative to", (where,) if mode else ())


def _chunk(config: ConfigDocument) -> Fact | UnknownFact:
    for path in _HORIZONS:
        steps = config.get(int, *path, default=0)
        if steps > 0:
            later = path[-1].startswith("future")  # the present step comes before them
            return likely(steps + later, config.evidence_of(*path))
    return UnknownFact("number of actions in a chunk: config.yaml names no action_horizon")
