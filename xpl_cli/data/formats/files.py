"""Writers of formats that are HDF5: robomimic, ACT / ALOHA and RoboTwin."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from xpl_cli.basics.atomic import write_file
from xpl_cli.data.formats import aloha, datasets, hdf5, robomimic, robotwin
from xpl_cli.data.formats.writing import CONVERTED, Names
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from xpl_cli.data.formats.writing import Plan
    from xpl_cli.data.sets.interface import Camera, Column, Episode

_SET: Final = "set"


class FileWriter:
    """Writes one file for each episode; what formats differ in is said by the classes below."""

    name: str
    names: Names
    images = "raw"
    """How cameras are kept by default."""
    needed: tuple[str, ...] = ()
    """Columns one of which has to be there."""

    def keeps(self, column: Column) -> str | None:
        """Return why a column cannot be kept: HDF5 keeps all of them."""
        del column
        return None

    def shows(self, camera: Camera) -> str | None:
        """Return why a camera cannot be kept: HDF5 keeps all of them."""
        del camera
        return None

    def check(self, plan: Plan) -> None:
        """Stop before anything is written."""
        if self.kept(plan) == "video":
            raise DataError(f"{self.name} keeps images in HDF5; --images takes raw, png or jpeg here")
        if self.needed and not any(name in plan.columns for name in self.needed):
            has = ", ".join(plan.columns) or "none at all"
            raise DataError(
                f"{self.name} needs a column {' or '.join(self.needed)}; there are {has}",
                hint="say by --map which column is which",
            )

    def piece(self, folder: Path, plan: Plan, index: int, episode: Episode) -> dict[str, Any]:
        """Write one episode's file."""
        with datasets.created(self.path(folder, index)) as file:
            found = datasets.write(file, episode, self.kept(plan))
            told = dict(episode.extras)
            if plan.rate_hz is not None:
                told["frequency"] = plan.rate_hz
            if plan.robot is not None:
                told["robot"] = plan.robot
            told[CONVERTED] = plan.extras.get(CONVERTED, {})
            large = datasets.attribute(file, {**told, **self.told(episode)})
        self.beside(folder, index, episode)
        return {"psnr_db": finite(found), "large": large}

    def finish(self, folder: Path, plan: Plan, pieces: list[dict[str, Any]]) -> Path:
        """Return the folder: the files are the set."""
        del plan, pieces
        return folder / _SET

    def path(self, folder: Path, index: int) -> Path:
        """Return the file of an episode."""
        return folder / _SET / f"episode_{index}.hdf5"

    def told(self, episode: Episode) -> dict[str, Any]:
        """Return the attributes that say what the robot was told."""
        if len(episode.instructions) > 1:
            return {"instructions": list(episode.instructions)}
        return {"instruction": episode.instructions[0]} if episode.instructions else {}

    def beside(self, folder: Path, index: int, episode: Episode) -> None:
        """Write what lies beside the file."""

    def kept(self, plan: Plan) -> str:
        """Return how cameras are kept."""
        return self.images if plan.options.images == "auto" else plan.options.images


class AlohaWriter(FileWriter):
    """ACT's and ALOHA's files."""

    name = aloha.NAME
    names = Names("action", "observations/qpos", "observations/", "observations/images/")
    needed = ("action",)

    def told(self, episode: Episode) -> dict[str, Any]:
        """Return the attributes, with `sim`, which ACT reads."""
        return {"sim": bool(episode.extras.get("sim", False)), **super().told(episode)}


class RobotwinWriter(FileWriter):
    """RoboTwin's files, with sentences beside them."""

    name = robotwin.NAME
    names = Names("joint_action/vector", "", "", "observation/")
    images = "jpeg"
    needed = ("joint_action/vector", "joint_action/left_arm")

    def path(self, folder: Path, index: int) -> Path:
        """Return the file of an episode."""
        return folder / _SET / "data" / f"episode{index}.hdf5"

    def told(self, episode: Episode) -> dict[str, Any]:
        """Return nothing: sentences lie beside the file."""
        del episode
        return {}

    def beside(self, folder: Path, index: int, episode: Episode) -> None:
        """Write the sentences."""
        path = folder / _SET / "instructions" / f"episode{index}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, json.dumps({"seen": list(episode.instructions), "unseen": []}).encode())


class RobomimicWriter(FileWriter):
    """robomimic's single file, made of one for each episode."""

    name = robomimic.NAME
    names = Names("actions", "", "obs/", "obs/")
    needed = ("actions",)

    def path(self, folder: Path, index: int) -> Path:
        """Return the file of an episode."""
        return folder / "episodes" / f"{index:06d}.hdf5"

    def told(self, episode: Episode) -> dict[str, Any]:
        """Return the attributes of an episode, as RoboCasa's have them."""
        meta = {"lang": episode.instructions[0]} if episode.instructions else {}
        return {"num_samples": episode.length, **({"ep_meta": json.dumps(meta)} if meta else {})}

    def finish(self, folder: Path, plan: Plan, pieces: list[dict[str, Any]]) -> Path:
        """Copy the episodes into one file."""
        result = folder / f"{_SET}.hdf5"
        with datasets.created(result) as file:
            data = file.create_group("data")
            extras = {key: value for key, value in plan.extras.items() if key != "total"}
            data.attrs["total"] = sum(plan.lengths)
            sentences = {told[0] for told in plan.instructions if told}
            if len(sentences) == 1 and "problem_info" not in extras:
                extras["problem_info"] = {"language_instruction": sentences.pop()}
            if "env_args" not in extras:
                arguments = {"control_freq": plan.rate_hz, "robots": [plan.robot] if plan.robot else []}
                extras["env_args"] = {"env_name": "", "type": 1, "env_kwargs": arguments}
            datasets.attribute(data, extras)
            for index in range(len(pieces)):
                with hdf5.opened(self.path(folder, index)) as piece:
                    piece.copy(piece, data, f"demo_{index}")
        shutil.rmtree(folder / "episodes")
        return result


def finite(found: dict[str, float]) -> dict[str, float]:
    """Return the PSNR of what is not exactly the same."""
    return {name: value for name, value in found.items() if value != float("inf")}
