"""What a block says of each convention: every key is of the convention that the vocabulary has it under."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.adapters import parity
from xpl.manifest import Manifest
from xpl_cli.model_io.reference_file import vocabulary
from xpl_cli.model_io.statements import Certainty, Statement, statements
from xpl_cli.standard import spec


def _statements(**changes: Any) -> dict[str, tuple[Statement, ...]]:
    return statements(Manifest.parse({"temporal": {"chunk": 4}, "model_io": parity.block(**changes)}))


def test_values_stand_under_their_conventions_with_their_places() -> None:
    by_convention = _statements()
    assert [(one.value, one.where) for one in by_convention["image_size"]] == [
        ("to: [24, 32]", ("images[0].steps[0].resize",))
    ]
    assert [one.value for one in by_convention["image_filter"]] == ["filter: nearest"]
    assert [one.value for one in by_convention["image_range"]] == ["layout: hwc, dtype: float32, range: [-1, 1]"]
    assert [one.value for one in by_convention["joint_order"]] == ["parts: [joints single, gripper single]"]
    assert by_convention["joint_order"][0].where == ("state[0]", "action")
    assert [one.value for one in by_convention["gripper"]] == ["closed: 0.0, open: 0.04", "closed: 0.0, open: 1.0"]
    assert [one.value for one in by_convention["chunk"]] == ["chunk: 4"]
    assert set(by_convention) <= set(vocabulary())


def test_a_value_that_is_assumed_or_open_says_why() -> None:
    """Wherever it stands: the value itself, or what it is a part of."""
    instruction = {"assumed": {"input": "prompt", "case": "lower"}, "why": "as in the paper"}
    images = [{**parity.BLOCK["images"][0], "steps": [{"mirror": {"unknown": "nobody says"}}]}]
    by_convention = _statements(instruction=instruction, images=images)
    (told,) = by_convention["instruction"]
    assert (told.value, told.standing, told.why) == ("input: prompt, case: lower", Certainty.ASSUMED, "as in the paper")
    (told,) = by_convention["image_orientation"]
    assert (told.value, told.standing, told.why) == ("mirror: ?", Certainty.UNKNOWN, "nobody says")
    assert {one.standing for name in ("camera", "gripper") for one in by_convention[name]} == {Certainty.KNOWN}


@pytest.mark.parametrize("kind", ["joints", "gripper", "hand", "position", "rotation"])
def test_no_key_of_a_part_is_of_no_convention(kind: str) -> None:
    """A key that the standard gains has to be given one; which arm a part is of stands in the order of parts."""
    keys = set(spec.schema("model_io")["$defs"][kind]["properties"]) - {"arm"}
    for key in keys:
        by_convention = _statements(state=[{"input": "state", "parts": [{kind: {"arm": "single", key: "VALUE"}}]}])
        assert [one.value for told in by_convention.values() for one in told if "VALUE" in one.value] == [
            f"{key}: VALUE"
        ]


def test_no_key_of_an_image_or_of_its_steps_is_of_no_convention() -> None:
    defs = spec.schema("model_io")["$defs"]
    for key in set(defs["image"]["properties"]) - {"input", "steps"}:
        by_convention = _statements(images=[{"input": "image", key: "VALUE"}])
        assert any("VALUE" in one.value for told in by_convention.values() for one in told), key
    for step, how in defs["step"]["properties"].items():
        for key in how.get("properties", [None]):
            value = "VALUE" if key is None else {key: "VALUE"}
            by_convention = _statements(images=[{"input": "image", "steps": [{step: value}]}])
            assert any("VALUE" in one.value for told in by_convention.values() for one in told), (step, key)
