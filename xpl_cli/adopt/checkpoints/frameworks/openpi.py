"""openpi: `norm_stats.json` in a checkpoint's assets, `config.json` of converted ones, and its training configs.

Source: Physical-Intelligence/openpi src/openpi/shared/normalize.py, src/openpi/training/checkpoints.py (assets/<asset
id>/norm_stats.json beside params/), src/openpi/transforms.py, src/openpi/models/model.py (IMAGE_KEYS, Observation) and
examples/convert_jax_model_to_pytorch.py (config.json). A data config is Python: `config.py` is parsed, not run.
"""

from __future__ import annotations

import ast
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.adopt.checkpoints.layout import DataRange, VectorNumbers
from xpl_cli.adopt.checkpoints.trained_model import ImageSpec, TrainedModel, VectorSpec, upstream
from xpl_cli.adopt.facts import Evidence, Fact, Tree, UnknownFact, certain, likely
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl_cli.adopt.checkpoints.reading import CheckpointFolder, ConfigDocument

NAME: Final = "openpi"
CODE: Final = "Physical-Intelligence/openpi@15a9616:src/openpi"
CONFIGS: Final = "src/openpi/training/config.py"
_FILE: Final = "norm_stats.json"
_IMAGES: Final = ("base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb")
_SIZE: Final = 224
_WIDTH: Final = 32
_EPSILON: Final = 1e-6
_FAMILIES: Final = (("pi0_fast", "none"), ("pi05", "seeded"), ("pi0", "seeded"))


def inner(folder: CheckpointFolder) -> CheckpointFolder | None:
    """Return the folder of a checkpoint of openpi; None if it is none."""
    if _files(folder):
        return folder
    steps = [name for name in folder.names("[0-9]*") if name.isdigit() and _files(folder.below(name))]
    return folder.below(max(steps, key=int)) if steps else None


def _files(folder: CheckpointFolder) -> list[str]:
    paths = [name for pattern in (_FILE, f"assets/*/{_FILE}", f"assets/*/*/{_FILE}") for name in folder.names(pattern)]
    return [name for name in paths if isinstance(folder.json(name).at("norm_stats"), dict)]


def read(folder: CheckpointFolder, key: str | None = None, code: CheckpointFolder | None = None) -> TrainedModel:
    """Read a checkpoint.

    Args:
        folder: with `assets/`.
        key: the asset id, if there are several.
        code: a checkout of openpi, for its training config.

    Raises:
        UserError: a file is invalid, or there are several assets and `key` is None.
    """
    return _OpenpiReader(folder, key, code).trained()


class _OpenpiReader:
    def __init__(self, folder: CheckpointFolder, key: str | None, code: CheckpointFolder | None) -> None:
        self.folder = folder
        self.file = _choose_assets(_files(folder), key)
        self.stats = folder.json(self.file)
        self.config: ConfigDocument | None = folder.json("config.json") if folder.has("config.json") else None
        self.name = _config_name(folder)
        self.source = _TrainConfig.of(code, self.name) if code is not None else None
        self.notes: list[str] = []

    def trained(self) -> TrainedModel:
        where = Evidence(self.file, self.stats.line("norm_stats"), "norm_stats")
        kind = next((kind for kind, _ in _FAMILIES if self.name.startswith(kind)), "")
        if self.source is None:
            self.notes.append(
                f"cameras, joints and deltas are in openpi's training config{f' {self.name}' if self.name else ''}: "
                "pass a checkout of openpi with a second --from"
            )
        return TrainedModel(
            framework=NAME,
            about=f"a policy of openpi{f', {self.name}' if self.name else ''}",
            family=certain("vla", where),
            views=[self._view(name) for name in _IMAGES],
            states=[
                VectorSpec(self._numbers("state"), certain("state", where), self._rule("state", kind), self._pad())
            ],
            action=VectorSpec(self._numbers("actions"), None, self._rule("actions", kind), self._pad()),
            reference=self._reference(),
            chunk=self._chunk(),
            sampling=self._sampling(kind),
            instruction={"input": likely("prompt", Evidence(f"{CODE}/transforms.py:248", None, "TokenizePrompt"))},
            upstream=upstream("Physical-Intelligence/openpi", "Apache-2.0"),
            code=[
                likely(
                    "the tokenizer strips the prompt and replaces _ and line breaks by spaces",
                    Evidence(f"{CODE}/models/tokenizer.py:23", None, "tokenize"),
                )
            ],
            notes=self.notes,
        )

    def _numbers(self, name: str) -> VectorNumbers:
        path = ("norm_stats", name)
        mean, std = self.stats.numbers(*path, "mean"), self.stats.numbers(*path, "std")
        if not mean or not std or len(mean) != len(std):
            raise UserError(f"{self.stats.location(*path)}: expected mean and std of {name}, of equal length")
        moved = max((index + 1 for index, (a, b) in enumerate(zip(mean, std, strict=True)) if a or b), default=0)
        width = moved or len(mean)
        where = Evidence(self.file, self.stats.line(*path), f"{name}: {width} of {len(mean)} numbers are not zero")
        within = DataRange.read(self.stats, path, "q01", "q99")
        if within is not None:  # constant dimensions are padding
            is_complete = len(within.low) == len(mean)
            within = replace(within, low=within.low[:width], high=within.high[:width]) if is_complete else None
        return VectorNumbers(width, where, range=within)

    def _rule(self, name: str, kind: str) -> Tree:
        path = ("norm_stats", name)
        has_quantiles = bool(self.stats.numbers(*path, "q01"))
        there = Evidence(self.file, self.stats.line(*path), f"norm_stats/{name}")
        common = {"file": certain(self.file, there), "key": f"norm_stats/{name}"}
        epsilon = certain(_EPSILON, Evidence(f"{CODE}/transforms.py:139", None, "Normalize adds 1e-6"))
        use = Evidence(f"{CODE}/training/config.py:187", None, f"use_quantile_norm is for all but PI0; {self.name}")
        if not has_quantiles:
            return {"rule": certain("mean_std", there), **common, "epsilon": epsilon}
        if kind == "pi0":
            return {"rule": likely("mean_std", use), **common, "epsilon": epsilon}
        if kind:
            names = {"low": "q01", "high": "q99"}
            return {"rule": likely("quantiles", use), **common, "names": names, "epsilon": epsilon}
        return UnknownFact(
            "mean_std for pi0, quantiles for pi05 and pi0-FAST: the checkpoint's name does not tell which it is",
            (there,),
        )

    def _pad(self) -> Tree:
        width = self.config.get(int, "action_dim", default=0) if self.config else 0
        if self.config and width:
            return certain(width, self.config.evidence_of("action_dim"))
        if self.source and (action_dim := self.source.model.get("action_dim")):
            return likely(*action_dim)
        if self.name.startswith("pi0_fast"):
            return None
        return likely(_WIDTH, Evidence(f"{CODE}/models/pi0_config.py:25", None, "action_dim: int = 32"))

    def _chunk(self) -> Fact | UnknownFact:
        if self.config and (steps := self.config.get(int, "action_horizon", default=0)):
            return certain(steps, self.config.evidence_of("action_horizon"))
        if self.source and (horizon := self.source.model.get("action_horizon")):
            return certain(*horizon)
        if self.source:
            return likely(50, Evidence(f"{CODE}/models/pi0_config.py:26", None, "action_horizon: int = 50"))
        return UnknownFact("action_horizon of the training config, 50 by default")

    def _view(self, name: str) -> ImageSpec:
        where = Evidence(f"{CODE}/models/model.py:39", None, f"IMAGE_KEYS: {name}")
        box = {
            "to": certain([_SIZE, _SIZE], Evidence(f"{CODE}/training/config.py:119", None, "ResizeImages(224, 224)")),
            "filter": likely("bilinear", Evidence("openpi_client/image_tools.py:15", None, "resize_with_pad, Pillow")),
            "antialias": True,
        }
        rest = {
            "channels": likely("rgb", where),
            "layout": likely("hwc", Evidence(f"{CODE}/models/model.py:91", None, "*b h w c")),
            "dtype": likely("float32", Evidence(f"{CODE}/models/model.py:118", None, "/ 255.0 * 2.0 - 1.0")),
            "range": [-1, 1],
        }
        camera = self.source.cameras.get(name) if self.source else None
        return ImageSpec(
            input=certain(name, where),
            names=[camera[0] if camera else name],
            evidence=camera[1] if camera else where,
            steps=[{"letterbox": box}],
            rest=rest,
            optional=name != _IMAGES[0],
        )

    def _reference(self) -> Fact | UnknownFact:
        if self.source is None:
            return UnknownFact("delta_state where the data config has DeltaActions, else as recorded")
        return self.source.reference()

    def _sampling(self, kind: str) -> Fact | UnknownFact:
        where = Evidence(f"{CODE}/models/pi0.py:231", None, "sample_actions draws noise")
        sampling = dict(_FAMILIES).get(kind)
        return likely(sampling, where) if sampling else UnknownFact("seeded for pi0 and pi05, none for pi0-FAST")


class _TrainConfig:
    """One `TrainConfig(...)` of openpi's config.py, as far as it has literals."""

    def __init__(self, name: str, call: ast.Call) -> None:
        self.name = name
        arguments = {keyword.arg: keyword.value for keyword in call.keywords if keyword.arg}
        model, data = arguments.get("model"), arguments.get("data")
        self.model = self._literals(model) if isinstance(model, ast.Call) else {}
        self.data = self._literals(data) if isinstance(data, ast.Call) else {}
        self.factory = ast.unparse(data.func) if isinstance(data, ast.Call) else ""
        self.line = data.lineno if isinstance(data, ast.Call) else call.lineno
        self.cameras = dict(self._cameras(data)) if data is not None else {}

    @classmethod
    def of(cls, code: CheckpointFolder, name: str) -> _TrainConfig | None:
        """Return the config of a name; None if there is none, or the file does not parse."""
        try:
            tree = ast.parse(code.text(CONFIGS))
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            return None
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "TrainConfig":
                config_name = {keyword.arg: keyword.value for keyword in node.keywords}.get("name")
                if isinstance(config_name, ast.Constant) and config_name.value == name:
                    return cls(name, node)
        return None

    def _literals(self, call: ast.Call) -> dict[str, tuple[Any, Evidence]]:
        return {
            keyword.arg: (keyword.value.value, self._at(keyword.value))
            for keyword in call.keywords
            if keyword.arg and isinstance(keyword.value, ast.Constant)
        }

    def _at(self, node: ast.expr) -> Evidence:
        return Evidence(CONFIGS, node.lineno, f"{self.name}: {ast.unparse(node)[:60]}")

    def _cameras(self, data: ast.expr) -> Any:
        """Yield the dataset's names of the model's images, if a RepackTransform lists them."""
        meant = {"cam_high": _IMAGES[0], "cam_left_wrist": _IMAGES[1], "cam_right_wrist": _IMAGES[2]}
        for node in ast.walk(data):
            if isinstance(node, ast.Dict):
                for key, value in zip(node.keys, node.values, strict=True):
                    if isinstance(key, ast.Constant) and isinstance(value, ast.Constant) and key.value in meant:
                        yield meant[key.value], (str(value.value), self._at(value))

    def reference(self) -> Fact | UnknownFact:
        """Return what actions are relative to, by the data config's factory."""
        where = Evidence(CONFIGS, self.line, f"{self.name}: {self.factory}")
        flags = {
            "LeRobotAlohaDataConfig": ("use_delta_joint_actions", True),
            "LeRobotLiberoDataConfig": ("extra_delta_transform", False),
        }
        if self.factory not in flags:
            return UnknownFact(f"delta_state where {self.factory or 'its data config'} has DeltaActions", (where,))
        flag, usual = flags[self.factory]
        value, evidence = self.data.get(flag, (usual, where))
        if value:
            return certain("delta_state", evidence)
        return likely("absolute" if "Aloha" in self.factory else "cumulative", evidence)


def _config_name(folder: CheckpointFolder) -> str:
    """Return the name of the training config: openpi writes checkpoints/<config>/<experiment>/<step>."""
    path = folder.path.resolve()
    names = [path.parents[1].name] if path.name.isdigit() and len(path.parents) > 1 else [path.name]
    return next((name for name in names if name.startswith("pi0")), "")


def _choose_assets(paths: list[str], key: str | None) -> str:
    paths_by_asset: Mapping[str, str] = {name.removesuffix(f"/{_FILE}").removeprefix("assets/"): name for name in paths}
    if key is not None and key in paths_by_asset:
        return paths_by_asset[key]
    if len(paths) == 1 and key is None:
        return paths[0]
    raise UserError(
        f"--statistics {key}: the checkpoint has {', '.join(paths_by_asset)}"
        if key
        else f"there are statistics of {', '.join(paths_by_asset)}",
        hint=f"--statistics {next(iter(paths_by_asset))}",
    )
