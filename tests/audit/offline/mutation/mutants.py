"""The defects of published adapters, each planted into a correct one; and correct ways to write that one otherwise.

A mutant is the adapter of this folder with some of its text replaced, as `mutants.yml` says. The defects follow the
field study behind the rules: batch identity, episode state, images, meaning, numbers, configuration, checkpoints,
service.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import yaml

HERE = Path(__file__).parent
ADAPTER = HERE / "adapter"
CORRECT = "correct"
_MODEL = "model.py"


@dataclass(frozen=True)
class Mutant:
    """A changed adapter.

    Attributes:
        name: what goes wrong, or what is written otherwise.
        group: class of the defect; `correct` for none.
        edits: file, text of the correct adapter, and what replaces it.
        without: a file that is left out.
        model: what takes the place of model.py.
    """

    name: str
    group: str
    edits: tuple[tuple[str, str, str], ...] = ()
    without: str | None = None
    model: Path | None = None

    def plant(self, folder: Path) -> Path:
        """Write the adapter into `folder`, whose name becomes the policy's name, and return the folder.

        Raises:
            LookupError: if the correct adapter does not hold a text that is to be replaced.
        """
        shutil.copytree(ADAPTER, folder, ignore=shutil.ignore_patterns("__pycache__"))
        if self.without is not None:
            (folder / self.without).unlink()
        if self.model is not None:
            shutil.copyfile(self.model, folder / _MODEL)
        for file, old, new in self.edits:
            text = (folder / file).read_text()
            if old not in text:
                message = f"{self.name}: {file} does not hold {old!r}"
                raise LookupError(message)
            (folder / file).write_text(text.replace(old, new, 1))
        return folder


def _read() -> tuple[Mutant, ...]:
    return tuple(
        Mutant(name, group, tuple((edit.get("file", _MODEL), edit["replace"], edit["by"]) for edit in edits))
        for group, mutants in yaml.safe_load((HERE / "mutants.yml").read_text()).items()
        for name, edits in mutants.items()
    )


_ALL = _read()
MUTANTS = tuple(mutant for mutant in _ALL if mutant.group != CORRECT)
VARIANTS = (
    *(mutant for mutant in _ALL if mutant.group == CORRECT),
    Mutant("without-a-manifest", CORRECT, without="policy.yml"),
    Mutant("derived-from-the-base-class", CORRECT, model=HERE / "variants" / "derived.py"),
)
