"""Mapping files of envs/gymnasium: what they compute, what they refuse; Gymnasium itself is not needed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml

from tests.support.checkout import ROOT, tracked
from xpl_cli.basics.content import load_module

ENV = ROOT / "envs" / "gymnasium"
MAPPINGS = tracked("envs/gymnasium/mappings/*.yml")
SCHEMA = json.loads((ENV / "mapping.schema.json").read_text(encoding="utf-8"))
MODULE: Any = load_module(ENV / "mapping.py")
SOURCES = {"obs": {"pose": np.array([1.0, 2.0, 3.0]), "deep": {"x": 5}}, "info": {"text": "no", "done": np.True_}}


def _value(entry: Any) -> list[float]:
    numbers: list[float] = MODULE.Value.read(entry, "state.x").numbers(SOURCES).tolist()
    return numbers


@pytest.mark.parametrize("file", MAPPINGS, ids=lambda file: file.stem)
def test_a_shipped_mapping_is_valid_and_named_by_a_task(file: Path) -> None:
    """By the schema that authors read, and by the reader."""
    jsonschema.validate(yaml.safe_load(file.read_text(encoding="utf-8")), SCHEMA)
    assert MODULE.EnvMapping.load(file).action
    tasks = yaml.safe_load((ENV / "env.yml").read_text(encoding="utf-8"))["tasks"]
    assert f"mappings/{file.name}" in {task["mapping"] for task in tasks.values()}


@pytest.mark.parametrize(
    ("entry", "numbers"),
    [
        (0.5, [0.5]),
        ("obs.pose", [1.0, 2.0, 3.0]),
        ("obs.pose[1]", [2.0]),
        ("obs.pose[-1]", [3.0]),
        ("obs.pose[0:2]", [1.0, 2.0]),
        ("obs.deep.x", [5.0]),
        ("info.done", [1.0]),
        ({"from": "obs.pose", "minus": "obs.pose[2]", "scale": 10, "offset": 1}, [-19.0, -9.0, 1.0]),
        ({"from": "obs.pose", "scale": 2, "clip": [0, 3]}, [2.0, 3.0, 3.0]),
    ],
)
def test_a_value_is_taken_scaled_and_clipped(entry: Any, numbers: list[float]) -> None:
    """(from - minus) * scale + offset."""
    assert _value(entry) == numbers
    jsonschema.validate(entry, {**SCHEMA["$defs"]["value"], "$defs": SCHEMA["$defs"]})


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("obs.pos", "obs has no 'pos'; there is pose, deep"),
        ("obs.pose[7]", "there are only 3 numbers"),
        ("info.text", "holds no numbers"),
        ("obs pose", "is no path"),
        ({"scale": 2}, "state.x: expected a number, a path or a map"),
        ({"from": "obs.pose", "times": 2}, "state.x: expected a number, a path or a map"),
        (True, "state.x: expected a number"),
    ],
)
def test_what_cannot_be_taken_is_told_with_its_place(entry: Any, said: str) -> None:
    with pytest.raises(MODULE.MappingError) as raised:
        _value(entry)
    assert said in str(raised.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"succes": "info.done"}, "unknown succes"),
        ({"id": None}, "no id"),
        ({"state": [1]}, "state must be a map"),
        ({"action": {"ee": {"scale": 1}}}, "action.ee: expected"),
    ],
)
def test_a_mapping_file_with_a_mistake_names_itself(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    entries = yaml.safe_load(MAPPINGS[0].read_text(encoding="utf-8")) | change
    file = tmp_path / "mine.yml"
    file.write_text(json.dumps({key: value for key, value in entries.items() if value is not None}), encoding="utf-8")
    with pytest.raises(MODULE.MappingError, match=r"mine\.yml") as raised:
        MODULE.EnvMapping.load(file)
    assert said in str(raised.value)
