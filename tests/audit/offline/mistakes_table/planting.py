"""Mistakes in trained policies: which there are, and a package with one of them."""

from __future__ import annotations

import json
import os
import re
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from xpl import get_embodiment
from xpl.convert import ConversionError, compile_interface
from xpl.manifest import Manifest

HERE = Path(__file__).parent
ROOT = HERE.parents[3]
LISTS = {"in": HERE / "mistakes.yml", "out": HERE / "planted.yml"}
"""Mistakes of whoever wrote the search, and of somebody who had not read it."""
RIGHT = "right"


@dataclass(frozen=True)
class Mistake:
    """A change of a right model_io block.

    Attributes:
        name: in a few words.
        conventions: any of them names the cause right.
        edits: by place in the block, keys joined by `/`, the new value; null takes it out.
        replace: in a file of the package, what stands for what: `file`, `old`, `new`.
    """

    name: str
    conventions: tuple[str, ...]
    edits: dict[str, Any]
    replace: dict[str, str] | None = None

    def planted(self, block: dict[str, Any]) -> dict[str, Any]:
        """Return the block with the mistake."""
        result = json.loads(json.dumps(block))  # places that YAML's aliases share are places of their own
        for place, value in self.edits.items():
            *way, last = [int(key) if key.isdigit() else key for key in place.split("/")]
            spot: Any = result
            for key in way:
                spot = spot[key]
            if value is None:
                del spot[last]
            else:
                spot[last] = value
        return result


@dataclass(frozen=True)
class Trained:
    """A trained policy.

    Attributes:
        name: of `trained.yml`.
        told: what it says there: package, weights, task, demos, lists.
    """

    name: str
    told: dict[str, Any]

    @property
    def package(self) -> Path:
        """The right adapter's folder."""
        return ROOT / str(self.told["package"])

    @cached_property
    def manifest(self) -> Manifest:
        """The right adapter's policy.yml."""
        return Manifest.parse(yaml.safe_load((self.package / "policy.yml").read_text()))

    @cached_property
    def subjects(self) -> list[Subject]:
        """The right adapter, and one with each mistake that is listed for its package, in sample first."""
        policies = [Subject(self, "in", None)]
        for sample, path in LISTS.items():
            if sample not in self.told.get("lists", LISTS):
                continue
            told = (yaml.safe_load(path.read_text()) if path.is_file() else {}).get(self.package.name, {})
            policies += [
                Subject(
                    self,
                    sample,
                    Mistake(name, listed(one["convention"]), one.get("edits") or {}, one.get("replace")),
                )
                for name, one in told.items()
            ]
        return policies


@dataclass(frozen=True)
class Subject:
    """A trained policy's adapter with a mistake, or right.

    Attributes:
        policy: which.
        sample: which list names the mistake.
        mistake: None for the right adapter.
    """

    policy: Trained
    sample: str
    mistake: Mistake | None

    @property
    def name(self) -> str:
        """Of the mistake."""
        return RIGHT if self.mistake is None else self.mistake.name

    @property
    def key(self) -> str:
        """A name for files."""
        return re.sub(r"\W+", "-", f"{self.policy.name} {self.sample} {self.name}")

    @property
    def block(self) -> dict[str, Any]:
        """The block model_io."""
        declared = self.policy.manifest.model_io
        model_io: dict[str, Any] = {} if declared is None else dict(declared.data)
        return model_io if self.mistake is None else self.mistake.planted(model_io)

    @property
    def same(self) -> str:
        """A text that equal adapters share: both lists hold some mistakes."""
        replaced = None if self.mistake is None else self.mistake.replace
        return json.dumps([self.policy.name, self.block, replaced], sort_keys=True)

    def fault(self, folders: list[Path]) -> str | None:
        """Return why the block cannot be compiled, None if it can."""
        manifest = self.policy.manifest
        robot = get_embodiment(manifest.embodiments[0])
        try:
            compile_interface(self.block, robot, manifest.action_types[0], folders, manifest.temporal.chunk)
        except ConversionError as error:
            return str(error)
        return None

    def write(self, place: Path, checkpoints: Path | None, pairs: Path | None) -> Path:
        """Write the package into a new folder below `place`, and return it.

        Args:
            place: a new folder.
            checkpoints: holds the folder of the weights; they are linked.
            pairs: the golden answers of these weights, where there are some.
        """
        told, source = self.policy.told, self.policy.package
        package = place / source.name
        left_out = shutil.ignore_patterns("checkpoints", "__pycache__", ".venv")
        shutil.copytree(source, package, ignore=left_out)
        manifest = {**self.policy.manifest.data, "model_io": self.block}
        if self.mistake is not None and self.mistake.replace is not None:
            change = self.mistake.replace
            text = (package / change["file"]).read_text()
            if change["old"] not in text:
                raise ValueError(f"{self.key}: {change['file']} does not hold {change['old']!r}")
            (package / change["file"]).write_text(text.replace(change["old"], change["new"]))
        (package / "policy.yml").write_text(yaml.safe_dump(manifest, sort_keys=False))
        if told["weights"] is not None and checkpoints is not None:
            weights = package / "checkpoints" / told["task"]
            weights.mkdir(parents=True)
            for file in (checkpoints / str(told["weights"])).iterdir():
                os.link(file, weights / file.name)
            deploy = (package / "deploy.yml").read_text()
            (package / "deploy.yml").write_text(re.sub(r"(?m)^ckpt_name:.*$", f"ckpt_name: {told['task']}", deploy))
        if pairs is not None and told["weights"] is not None and pairs.is_file():
            shutil.copyfile(pairs, package / "golden_pairs.json")
        return package


def trained(names: list[str] | None = None, path: Path = HERE / "trained.yml") -> list[Trained]:
    """Return the trained policies of a file, those of some names or all."""
    told = yaml.safe_load(path.read_text())
    return [Trained(name, one) for name, one in told.items() if not names or name in names]


def demonstrations(policy: Trained, demos: Path, place: Path, count: int) -> Path:
    """Return a new folder with links to some of a policy's demonstrations, the last ones.

    Args:
        policy: which.
        demos: holds the folder that `trained.yml` names.
        place: the new folder.
        count: episodes.
    """
    folders = sorted((demos / str(policy.told["demos"])).glob("*.hdf5"))[-count:]
    place.mkdir(parents=True)
    for file in folders:
        (place / file.name).symlink_to(file.resolve())
    return place


def said(path: Path) -> dict[str, Any]:
    """Return a JSON file's object, empty if it is not there or was cut."""
    try:
        sentence: dict[str, Any] = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return sentence


def listed(told: Any) -> tuple[str, ...]:
    """Return the conventions of which any names a cause right."""
    return (told,) if isinstance(told, str) else tuple(told)
