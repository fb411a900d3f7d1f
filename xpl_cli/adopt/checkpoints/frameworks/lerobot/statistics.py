"""LeRobot's normalisation: the rule of each kind of feature, and the location of its statistics.

Source: huggingface/lerobot src/lerobot/processor/normalize_processor.py (`_apply_transform`), and for checkpoints from
before version 0.4 src/lerobot/processor/migrate_policy_normalization.py, which names the buffers in the weights.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from xpl_cli.adopt.checkpoints.layout import DataRange
from xpl_cli.adopt.facts import Evidence, Tree, UnknownFact, certain
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from xpl_cli.adopt.checkpoints.reading import CheckpointFolder, ConfigDocument

_RULES: Final = {
    "MEAN_STD": ("mean_std", ("mean", "std"), {}),
    "MIN_MAX": ("min_max", ("min", "max"), {}),
    "QUANTILES": ("quantiles", ("q01", "q99"), {"low": "q01", "high": "q99"}),
    "QUANTILE10": ("quantiles", ("q10", "q90"), {"low": "q10", "high": "q90"}),
}
_EPSILON: Final = 1e-8
_STEPS: Final = ("normalizer_processor", "unnormalizer_processor")
_BUFFER: Final = re.compile(r"^(?:normalize_inputs|unnormalize_outputs|normalize_targets)\.buffer_(\w+)\.(\w+)$")
_WEIGHTS: Final = "model.safetensors"


@dataclass(frozen=True)
class Statistics:
    """The statistics of one processor, or of the weights.

    Attributes:
        file: of the statistics; "" if there is none.
        numbers: by feature, then by name of the statistic.
        epsilon: added to divisors.
        step: evidence of the processor that uses them.
        modes: normalisation mode, by kind of feature.
        is_inside: whether they are in the weights.
    """

    file: str
    numbers: dict[str, dict[str, list[float]]]
    epsilon: float
    step: Evidence
    modes: dict[str, str]
    is_inside: bool = False

    def range(self, feature: str) -> DataRange | None:
        """Return the range of a feature."""
        arrays = self.numbers.get(feature, {})
        for low, high in (("min", "max"), ("q01", "q99")):
            if low in arrays and high in arrays:
                what = Evidence(self.file, None, f"{feature} {low}..{high}")
                return DataRange(tuple(arrays[low]), tuple(arrays[high]), what)
        if "mean" in arrays and "std" in arrays:
            pairs = list(zip(arrays["mean"], arrays["std"], strict=False))
            what = Evidence(self.file, None, f"{feature} mean +- 2 std")
            return DataRange(tuple(m - 2 * s for m, s in pairs), tuple(m + 2 * s for m, s in pairs), what)
        return None

    def rule(self, feature: str, kind: str) -> Tree:
        """Return `normalize` of a vector.

        Args:
            feature: such as observation.state.
            kind: STATE or ACTION.
        """
        mode = self.modes.get(kind, "IDENTITY")
        if mode == "IDENTITY":
            return certain(None, Evidence(self.step.file, self.step.line, f"norm_map {kind}: {mode}"))
        if mode not in _RULES:
            return UnknownFact(f"LeRobot's normalisation {mode} of {kind}, which is not known here", (self.step,))
        rule, needed, names = _RULES[mode]
        arrays = self.numbers.get(feature, {})
        if not arrays:
            reason = f"{self.file or self.step.file} has no numbers of {feature}: LeRobot does not normalise it"
            return certain(None, Evidence(self.step.file, self.step.line, reason))
        if missing := [name for name in needed if name not in arrays]:
            return UnknownFact(f"{self.file} lacks {', '.join(missing)} of {feature}, which {mode} needs", (self.step,))
        here = Evidence(self.step.file, self.step.line, f"norm_map {kind}: {mode}")
        entry: dict[str, Tree] = {"rule": certain(rule, here)}
        if self.is_inside:
            keys = ("low", "high") if rule == "quantiles" else needed
            there = Evidence(self.file, None, f"buffers of {feature}")
            entry["values"] = certain(
                {key: _short(arrays[name]) for key, name in zip(keys, needed, strict=True)}, there
            )
        else:
            there = Evidence(self.file, None, ", ".join(f"{feature}.{name}" for name in needed))
            entry |= {"file": certain(self.file, there), "key": feature, **({"names": names} if names else {})}
        entry["epsilon"] = certain(self.epsilon, Evidence(self.step.file, self.step.line, f"eps: {self.epsilon}"))
        return entry if rule == "mean_std" else {**entry, "constant": "epsilon"}

    def colours(self, feature: str) -> dict[str, Tree]:
        """Return `mean` and `std` of an image, applied after scaling to 0..1."""
        mode, arrays = self.modes.get("VISUAL", "IDENTITY"), self.numbers.get(feature, {})
        if mode == "IDENTITY" or not arrays:
            return {}
        where = Evidence(self.file, None, f"{feature}, {mode} by {self.step}")
        if mode not in _RULES or any(len(arrays.get(name, ())) != 3 for name in _RULES[mode][1]):
            return {"mean": UnknownFact(f"what {mode} does to images: no three numbers of {feature}", (where,))}
        one, two = (arrays[name] for name in _RULES[mode][1])
        if mode != "MEAN_STD":  # 2 (x - low) / (high - low) - 1
            one, two = (
                [(a + b) / 2 for a, b in zip(one, two, strict=True)],
                [(b - a) / 2 for a, b in zip(one, two, strict=True)],
            )
        return {"mean": certain(_short(one), where), "std": certain(_short(two), where)}


def of_processor(folder: CheckpointFolder, name: str, step: str) -> Statistics | None:
    """Return the statistics of one processor file; None if the file or step does not exist.

    Args:
        folder: the checkpoint.
        name: policy_preprocessor.json or policy_postprocessor.json.
        step: registry name of the step.
    """
    if not folder.has(name):
        return None
    document = folder.json(name)
    for index in _steps(document, step):
        config = ("steps", index, "config")
        file = document.get(str, "steps", index, "state_file", default="")
        numbers: dict[str, dict[str, list[float]]] = {}
        if file and folder.has(file):
            for key, values in folder.tensors(file, re.compile(r"\.")).items():
                feature, _, word = key.rpartition(".")
                numbers.setdefault(feature, {})[word] = values
        epsilon = document.get(float, *config, "eps", default=_EPSILON)
        modes = document.get(dict, *config, "norm_map", default={})
        evidence = Evidence(name, document.line("steps", "config", "norm_map"), step)
        return Statistics(file, numbers, epsilon, evidence, {str(k): str(v) for k, v in modes.items()})
    return None


def of_weights(folder: CheckpointFolder, config: ConfigDocument) -> Statistics | None:
    """Return the statistics in the weights of a checkpoint from before version 0.4; None if there are none."""
    if not folder.has(_WEIGHTS):
        return None
    try:
        buffers = folder.tensors(_WEIGHTS, _BUFFER)
    except UserError:
        if (folder.path / _WEIGHTS).stat().st_size > 1024:
            raise
        return None  # a git-lfs pointer, without weights
    numbers: dict[str, dict[str, list[float]]] = {}
    features = [*config.get(dict, "input_features", default={}), *config.get(dict, "output_features", default={})]
    features += [*config.get(dict, "input_shapes", default={}), *config.get(dict, "output_shapes", default={})]
    for key, values in buffers.items():
        match = _BUFFER.match(key)
        if match is not None:
            feature = next((name for name in features if name.replace(".", "_") == match[1]), match[1])
            numbers.setdefault(feature, {})[match[2]] = values
    modes = config.get(dict, "normalization_mapping", default={})
    kinds = {str(kind): str(mode) for kind, mode in modes.items()} or _older(config)
    if not numbers and not kinds:
        return None
    key = "normalization_mapping" if modes else "input_normalization_modes"
    evidence = Evidence(config.file, config.line(key), key)
    return Statistics(_WEIGHTS, numbers, _EPSILON, evidence, kinds, is_inside=True)


def _older(config: ConfigDocument) -> dict[str, str]:
    """Return the modes in checkpoints of 2024, by kind of feature: `min_max`, `mean_std`."""
    result: dict[str, str] = {}
    for key in ("input_normalization_modes", "output_normalization_modes"):
        for feature, mode in config.get(dict, key, default={}).items():
            kind = "VISUAL" if "image" in feature else "ACTION" if feature == "action" else "STATE"
            result[kind] = str(mode).upper()
    return result


def _steps(document: ConfigDocument, name: str) -> list[int]:
    steps = document.get(list, "steps", default=[])
    return [index for index, step in enumerate(steps) if isinstance(step, dict) and step.get("registry_name") == name]


def _short(values: list[float]) -> list[float]:
    """Return 32-bit floats with nine significant digits."""
    return [float(f"{value:.9g}") for value in values]
