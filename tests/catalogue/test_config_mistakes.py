"""Mistakes as other words of a model_io block: valid, each once, likeliest first, and every planted one found again."""

from __future__ import annotations

import contextlib
import json
from typing import TYPE_CHECKING, Any

import jsonschema
import pytest
import yaml

from tests.support import pages
from tests.support.adapters.model_io import CASES, Case
from tests.support.adapters.planted import RecordedEpisodes
from tests.support.checkout import ROOT
from xpl import catalogue
from xpl.action import ActionError
from xpl.conventions import camera, image_size
from xpl.convert import ConversionError, compile_interface
from xpl.embodiment import get_embodiment
from xpl_cli.model_io.difference import differences, spreads
from xpl_cli.model_io.explain import TriedChange, explain
from xpl_cli.model_io.mistakes import in_block
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from xpl.catalogue import Mistake

SCHEMA = spec.schema("model_io")
VOCABULARY = {option["const"] for option in SCHEMA["$defs"]["convention"]["oneOf"]}
NAMES = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def _all(case: Case, model_io: Mapping[str, Any] | None = None) -> list[tuple[Mistake, dict[str, Any]]]:
    return list(in_block(catalogue.AdapterCase(case.embodiment, case.action_type, model_io or case.model_io)))


@pytest.mark.slow
@NAMES
def test_each_is_another_block_that_is_valid(case: Case) -> None:
    validator = jsonschema.Draft202012Validator(SCHEMA)
    found = _all(case)
    texts = [json.dumps(block, sort_keys=True) for _, block in found]
    assert len(set(texts)) == len(texts)
    assert json.dumps(case.model_io, sort_keys=True) not in texts
    assert {one.convention for one, _ in found} <= VOCABULARY
    widths = case.compiled().action.vector.padded
    for _, block in found[::7]:
        validator.validate(block)
        changed = compile_interface(block, case.embodiment, case.action_type)
        assert changed.action.vector.padded == widths


def test_the_likeliest_come_first_and_the_block_itself_is_left_alone() -> None:
    """A search that is cut short by time has tried the same every time."""
    case = CASES["two arms, joint deltas"]
    before = json.dumps(case.model_io)
    words = [one.description for one, _ in _all(case)]
    assert json.dumps(case.model_io) == before
    for common, rare in (
        ("channels: bgr", "fill: 114 (wrists)"),
        ("gripper: closed and open exchanged", "gripper: closed 0, open 100"),
        ("unit: deg", "names: joints 1 and 7 exchanged"),
        ("cameras: cam_left_wrist and cam_right_wrist exchanged", "parts: reversed"),
    ):
        assert words.index(common) < words.index(rare)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("name", "convention", "change"),
    [
        ("two arms, joint deltas", "image_channels", lambda b: b["images"][0].update(channels="bgr")),
        ("two arms, joint deltas", "image_range", lambda b: b["images"][1].update(range=[0, 1])),
        ("two arms, joint deltas", "camera", lambda b: b["images"][1]["cameras"].reverse()),
        ("two arms, joint deltas", "action_reference", lambda b: b["action"].update(reference="cumulative")),
        ("two arms, joint deltas", "normalization", lambda b: b["state"][0].pop("normalize")),
        (
            "one arm, poses in the base, history",
            "gripper",
            lambda b: b["action"]["parts"][2]["gripper"].update(closed=[0.04, -0.04], open=[0.0, 0.0]),
        ),
        (
            "one arm, poses in the base, history",
            "rotation",
            lambda b: b["action"]["parts"][1]["rotation"].update(form="rot6d_rows"),
        ),
        (
            "one arm, poses in the base, history",
            "frame",
            lambda b: b["state"][0]["parts"][0]["position"].update(unit="m"),
        ),
        ("one arm, poses in the base, history", "history_stride", lambda b: b["history"].update(stride=1)),
        (
            "one arm, cumulative poses",
            "image_filter",
            lambda b: b["images"][0]["steps"][0]["resize"].update(filter="nearest"),
        ),
        ("one arm, cumulative poses", "joint_order", lambda b: b["action"]["parts"].reverse()),
        ("numbers that never moved", "rotation", lambda b: b["action"]["parts"][1]["rotation"].update(euler="ZYX")),
        ("hands, absolute", "angle_unit", lambda b: b["action"]["parts"][0]["joints"].update(unit="deg")),
    ],
)
def test_what_was_changed_is_named(name: str, convention: str, change: Any) -> None:
    case = CASES[name]
    wrong = json.loads(json.dumps(case.model_io))
    change(wrong)
    rig = RecordedEpisodes(case)
    model_io, given = rig.answers(case.model_io), rig.answers(wrong)
    spread = spreads(model_io)
    before = differences(model_io, given, spread)
    tried = []
    for one, block in _all(case, wrong):
        if one.convention == convention:
            with contextlib.suppress(ActionError):  # an opening far from 0..1
                tried.append(
                    TriedChange(one.description, one.convention, differences(model_io, rig.answers(block), spread))
                )
    found = explain(before, tried, 1e-4)
    assert found.cause is not None
    assert found.cause.convention == convention
    assert found.cause.after < 1e-6
    assert found.cause.before > 1e-3


@pytest.mark.slow
def test_the_block_of_the_documentation_has_alternatives(tmp_path: Path) -> None:
    blocks = pages.blocks([ROOT / "docs" / "model-io.md"])
    model_io = next(yaml.safe_load(block.text) for block in blocks if block.language == "yaml")["model_io"]
    numbers = {"q01": [-1.0] * 16, "q99": [2.0] * 16, "mean": [0.1] * 16, "std": [0.5] * 16}
    other = {"q01": [-2.0] * 16, "q99": [3.0] * 16}
    table = {"norm_stats": {"state": numbers, "actions": numbers}, "other": {"state": other}}
    (tmp_path / "norm_stats.json").write_text(json.dumps(table), encoding="utf-8")
    found = list(in_block(catalogue.AdapterCase(get_embodiment("franka"), "joint", model_io, [tmp_path]), 50))
    words = {one.description for one, _ in found}
    assert "normalize: rule: mean_std" in words
    assert "normalize: the action's numbers for the state" in words
    assert "normalize: key: other/state (state)" in words
    assert not any("min_max" in one for one in words), "the file has no minimum"


def test_a_block_that_does_not_fit_is_an_error() -> None:
    case = CASES["two arms, joint deltas"]
    with pytest.raises(ConversionError, match="no arm 'left'"):
        list(in_block(catalogue.AdapterCase(get_embodiment("franka_single"), "joint", case.model_io)))


@pytest.mark.parametrize(
    "step", [{"resize": {"to": [96, 96], "filter": "bilinear"}}, {"letterbox": {"to": [96, 96], "filter": "area"}}]
)
def test_a_model_may_resize_images_itself(step: dict[str, Any]) -> None:
    """Then a block that does it as well is explained by one that does not."""
    case = next(case for case in CASES.values() if case.model_io.get("images"))
    first, *others = case.model_io["images"]
    block = {**case.model_io, "images": [{**first, "steps": [step]}, *others]}
    words = {one.description for one, changed in _all(case, block) if "steps" not in changed["images"][0]}
    assert any(f"no {word}" in text for text in words for word in step), words


def test_changes_of_a_pose_may_have_the_range_of_robosuites_controller() -> None:
    """0.05 is the range of positions, and often taken for that of rotations as well."""
    block = yaml.safe_load((ROOT / "policy/starVLA/policy.yml").read_text(encoding="utf-8"))["model_io"]
    right = block["action"]["normalize"]["values"]
    wrong = {key: [max(-0.05, min(0.05, one)) for one in values[:6]] + values[6:] for key, values in right.items()}
    planted = {**block, "action": {**block["action"], "normalize": {**block["action"]["normalize"], "values": wrong}}}
    found = in_block(catalogue.AdapterCase(get_embodiment("panda_libero"), "ee", planted))
    assert any(changed["action"].get("normalize", {}).get("values") == right for _, changed in found)


def test_a_checkpoint_names_the_inputs_that_its_model_knows(tmp_path: Path) -> None:
    """A model may take an image of an unknown name for a camera that is missing."""
    features = {"observation.images.wrist": {"shape": [3, 4, 4]}, "observation.state": {}, "action": {}}
    (tmp_path / "config.json").write_text(json.dumps({"input_features": features, "resize": {"image_size": [4, 4]}}))
    (tmp_path / "tiny.json").write_text(json.dumps({"observation.images.other": {}}))
    (tmp_path / "broken.json").write_text("{")
    block = {
        "images": [{"input": "observation.images.left_wrist", "cameras": ["cam_wrist"], "channels": "rgb"}],
        "action": {},
    }
    case = catalogue.AdapterCase(get_embodiment("franka_single"), "joint", block=block, folders=[tmp_path])
    found = [one for one in camera.CONVENTION.config_mistakes(case) if "input" in one.description]
    assert [(one.description, dict(one.edits or {})) for one in found] == [
        (
            "input: observation.images.wrist, not observation.images.left_wrist",
            {("images", 0, "input"): "observation.images.wrist"},
        )
    ]


@pytest.mark.parametrize(
    ("name", "how"), [("resize", {"to": [8, 8], "filter": "area"}), ("crop", {"fraction": 0.95})], ids=str
)
def test_a_model_may_itself_resize_what_the_block_turns(name: str, how: dict[str, Any]) -> None:
    """Without the block's resize or crop the model gets the camera's own size, whatever other steps are left."""
    steps = [{"mirror": "left_right"}, {name: how}]
    block = {"images": [{"input": "image", "cameras": ["cam_head"], "steps": steps}], "action": {}}
    case = catalogue.AdapterCase(get_embodiment("franka_single"), "joint", block=block)
    found = {one.description: one.edits for one in image_size.CONVENTION.config_mistakes(case)}
    assert found[f"no {name}"] == {("images", 0, "steps"): steps[:1]}
