"""Checkpoints of which one value is another: each is read, or refused in one sentence with its folder, soon."""

from __future__ import annotations

import ast
import copy
import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.adapters import trained
from xpl_cli.adopt.checkpoints import block, package_start, registry
from xpl_cli.basics.errors import UserError

HOSTILE: tuple[Any, ...] = (
    *(10**400, 2**64, -1, 0, 1e308, float("inf"), float("nan"), None, True),
    *("", "x" * 100_000, "\ud800", "\0", "../../etc/passwd"),
    *([], {}, [[[[]]]], {"a": {"b": 1}}, [10**400], [float("nan")]),
)
MAKERS: dict[str, Callable[[Path], Path]] = {
    "act": lambda path: trained.lerobot(path, n_action_steps=8),
    "diffusion": lambda path: trained.lerobot(path, "diffusion", n_action_steps=8),
    "openpi": trained.openpi,
    "groot": trained.groot,
    "older groot": trained.groot_older,
    "openvla": trained.openvla,
    "openvla-oft": lambda path: trained.openvla(path, oft=True),
    "starvla": trained.starvla,
    "rdt": trained.rdt,
    "diffusion policy": trained.diffusion_policy,
    "robomimic": trained.robomimic,
}


def _places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the way to every value of a document; of a list to the first two, as the others are like them."""
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value[:2]) if isinstance(value, list) else ()
    for key, entry in inner:
        yield from _places(entry, (*path, key))


def _put(document: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    changed = copy.deepcopy(document)
    place = changed
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return changed


def _documents(folder: Path) -> Iterator[tuple[Path, Any, Callable[[Any], str]]]:
    """Yield each document of a checkpoint, what it holds, and what writes it."""
    for file in sorted(folder.rglob("*")):
        if file.suffix in (".json", ".yaml"):
            reads, writes = (json.loads, json.dumps) if file.suffix == ".json" else (yaml.safe_load, yaml.safe_dump)
            yield file, reads(file.read_text("utf-8")), writes


def _changes(folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield a document of a checkpoint, and a text of it in which one value is hostile."""
    for file, document, writes in _documents(folder):
        for path in _places(document):
            for value in HOSTILE:
                yield file, writes(_put(document, path, value))


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("part", [pytest.param(97, id="some"), pytest.param(1, id="all", marks=pytest.mark.slow)])
def test_any_value_of_a_checkpoint_may_be_hostile(tmp_path: Path, maker: str, part: int) -> None:
    """Counts beyond memory, numbers that are none, other kinds of values, names that lead elsewhere."""
    folder = MAKERS[maker](tmp_path / "checkpoint")
    registry.read([folder])
    for file, text in list(_changes(folder))[::part]:
        whole = file.read_bytes()
        file.write_text(text, encoding="utf-8", errors="surrogatepass")
        try:
            registry.read([folder])
        except UserError as error:
            assert str(folder) in str(error), text[:200]  # noqa: PT017 - most are read
        finally:
            file.write_bytes(whole)


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ({"dtype": "F32", "shape": [2**64], "data_offsets": [0, 2**64]}, "ends at"),
        ({"dtype": "F32", "shape": [1], "data_offsets": [2**64, 2**64 + 4]}, "ends at"),
        ({"dtype": "F32", "shape": [1], "data_offsets": [4, 0]}, "offsets"),
        ({"dtype": "F32", "shape": [10**400], "data_offsets": [0, 4]}, "another size"),
        ({"dtype": "F32", "shape": 5, "data_offsets": [0, 4]}, "shape"),
        ({"dtype": "F32", "shape": [1], "data_offsets": [0, "4"]}, "offsets"),
        (5, "shape"),
    ],
)
def test_offsets_of_tensors_lie_in_the_file(tmp_path: Path, entry: Any, told: str) -> None:
    folder = trained.lerobot(tmp_path / "checkpoint", n_action_steps=8)
    name = "policy_postprocessor_step_0_unnormalizer_processor.safetensors"
    header = json.dumps({"action.mean": entry}).encode()
    (folder / name).write_bytes(struct.pack("<Q", len(header)) + header + bytes(64))
    with pytest.raises(UserError, match=rf"{name}.*{told}"):
        registry.read([folder])


@pytest.mark.parametrize(("count", "told"), [(65, "65 image inputs"), (20_000, "10000 entries at most")])
def test_inputs_are_as_many_as_models_have(tmp_path: Path, count: int, told: str) -> None:
    """Each is written and told of: thousands would be a flood of notes, and minutes."""
    folder = trained.lerobot(tmp_path / "checkpoint", n_action_steps=8)
    config = json.loads((folder / "config.json").read_text())
    camera = {"type": "VISUAL", "shape": [3, 8, 8]}
    others = {name: one for name, one in config["input_features"].items() if one["type"] != "VISUAL"}
    config["input_features"] = others | {f"observation.images.c{number}": camera for number in range(count)}
    (folder / "config.json").write_text(json.dumps(config))
    with pytest.raises(UserError, match=rf"{folder}.*{told}"):
        registry.read([folder])


ENDINGS = (
    "q)\n        PWNED()\n        # (",
    'x"""\nPWNED()\n"""',
    "x\\",
    "x\u2028pwned: 1\u2028#",
    "x\r\npwned: 1\n#",
    "x\x85pwned: 1",
)
"""Texts that end the comment, the docstring, the text or the line that they are put into."""


def _renamed(document: Any, path: tuple[Any, ...], name: str) -> Any:
    """Return a document with another last key on a path."""
    changed = copy.deepcopy(document)
    place = changed
    for key in path[:-1]:
        place = place[key]
    entries = list(place.items())
    place.clear()
    place.update((name if key == path[-1] else key, value) for key, value in entries)
    return changed


def _worded(folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield a document of a checkpoint, and a text of it in which one text or key tries to end where it is put."""
    for file, document, writes in _documents(folder):
        for path in _places(document):
            value = document
            for key in path:
                value = value[key]
            for ending in ENDINGS:
                if isinstance(value, str):
                    yield file, writes(_put(document, path, ending))
                    yield file, writes(_put(document, path, value + ending))
                if path and isinstance(path[-1], str):
                    yield file, writes(_renamed(document, path, path[-1] + ending))


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("part", [pytest.param(41, id="some"), pytest.param(1, id="all", marks=pytest.mark.slow)])
def test_no_text_of_a_checkpoint_becomes_code_or_a_key(tmp_path: Path, maker: str, part: int) -> None:
    """What is written from it parses, and names neither a function nor a key that a text tried to add."""
    folder = MAKERS[maker](tmp_path / "checkpoint")
    robot = "franka_single" if maker in ("openvla", "openvla-oft", "diffusion policy", "robomimic") else "aloha_agilex"
    wanted = package_start.StartOptions("Foo", robot, None, block.UserChoices(gripper=(0.0, 1.0)))
    assert package_start.new_package([folder], wanted).files
    for file, text in list(_worded(folder))[::part]:
        whole = file.read_bytes()
        file.write_text(text, encoding="utf-8")
        try:
            files = package_start.new_package([folder], wanted).files
        except UserError:
            continue
        finally:
            file.write_bytes(whole)
        for name, content in files.items():
            if name.endswith(".py"):
                tree = ast.parse(content)
                assert not any(isinstance(node, ast.Name) and node.id == "PWNED" for node in ast.walk(tree)), text
            elif name.endswith(".yml"):
                assert "pwned" not in yaml.safe_load(content), text
            else:
                assert b"\npwned" not in content, text
