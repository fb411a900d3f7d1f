"""What a model_io block leaves open is told whole, and what does not depend on it can be tried."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import jsonschema
import numpy as np
import pytest

from tests.support.adapters.model_io import CASES, observation, steps
from xpl import get_embodiment
from xpl.convert import ConversionError, compile_interface
from xpl.convert.gaps import fill_gaps, gaps, missing_files
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PARTS = [
    {"joints": {"arm": "single", "names": {"unknown": "14 numbers without names"}}},
    {"gripper": {"arm": "single", "closed": {"unknown": "not in the config"}, "open": 0.0}},
]
ROBOT = get_embodiment("franka_single")
OPEN: dict[str, Any] = {
    "images": [
        {
            "input": "image",
            "cameras": {"unknown": "the config has one camera of another name"},
            "channels": {"unknown": "read with cv2"},
            "layout": "hwc",
            "dtype": {"unknown": "-"},
            "mean": [0.5, 0.5, 0.5],
            "steps": [{"resize": {"to": [8, 8], "filter": {"unknown": "-"}}}, {"crop": {"to": {"unknown": "-"}}}],
        }
    ],
    "state": [{"input": "s", "parts": PARTS, "normalize": {"rule": "mean_std", "file": "stats.json"}, "pad": 32}],
    "action": {"reference": {"unknown": "-"}, "parts": {"unknown": "-"}, "normalize": {"unknown": "-"}},
    "sampling": {"unknown": "the paper does not say"},
}


def test_all_that_is_open_is_named_in_one_sentence() -> None:
    assert len(gaps(OPEN)) == 11
    with pytest.raises(ConversionError) as raised:
        compile_interface(OPEN, ROBOT, "joint")
    told = str(raised.value)
    assert "model_io leaves 10 values open" in told
    assert "\n" not in told
    for gap in gaps(OPEN):
        assert (f"{gap.where} ({gap.reason})" in told) == (gap.path != ("sampling",))
    alone = {"action": CASES["hands, absolute"].model_io["action"], "sampling": {"unknown": "-"}}
    compile_interface(alone, get_embodiment("tianji_marvin_wuji"), "joint")


def test_the_rest_of_an_open_block_converts() -> None:
    interface = compile_interface(fill_gaps(OPEN, ROBOT, "joint"), ROBOT, "joint")
    obs = observation("franka_single")
    inputs = interface.encode(obs)
    assert inputs["image"].shape == (8, 8, 3)
    assert inputs["s"].shape == (8,)
    steps = [{key: obs["state"][key] for key in ROBOT.dims("joint")}]
    (step,) = interface.decode(interface.action.encode(steps, obs["state"]), obs)
    assert step["arm_joint_state"] == pytest.approx(obs["state"]["arm_joint_state"], abs=1e-6)


VALID = jsonschema.Draft202012Validator(spec.schema("model_io"))


def opened(model_io: dict[str, Any], path: tuple[Any, ...]) -> dict[str, Any]:
    block: dict[str, Any] = copy.deepcopy(model_io)
    inner: Any = block
    for part in path[:-1]:
        inner = inner[part]
    inner[path[-1]] = {"unknown": "why"}
    return block


def places(model_io: dict[str, Any], value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    for key, item in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(model_io, item, (*path, key))
        if isinstance(key, str) and VALID.is_valid(opened(model_io, (*path, key))):
            yield (*path, key)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", CASES)
def test_a_block_converts_with_any_one_value_open(name: str) -> None:
    case = CASES[name]
    obs = observation(case.robot)
    turns = np.random.default_rng(0)
    found = list(places(case.model_io, case.model_io))
    assert len(found) > 2
    for path in found:
        block = opened(case.model_io, path)
        assert [gap.path for gap in gaps(block)] == [path]
        interface = compile_interface(
            fill_gaps(block, case.embodiment, case.action_type), case.embodiment, case.action_type
        )
        if path[0] in ("images", "state"):
            interface.encode(obs, {})
        wanted = steps(case, turns, 1)
        answer = interface.action.encode(wanted, obs["state"])
        assert len(interface.decode(answer, obs)) == len(wanted)


def test_statistics_that_are_not_there_are_told_once(tmp_path: Path) -> None:
    normalize = {"rule": "mean_std", "file": "stats.json"}
    vector = {"parts": [{"joints": {"arm": "single"}}, {"gripper": {"arm": "single", "closed": 0.0, "open": 1.0}}]}
    model_io = {
        "state": [{"input": "s", **vector, "normalize": normalize}],
        "action": {"reference": "absolute", **vector, "normalize": normalize},
    }
    assert missing_files(model_io, [tmp_path]) == ["stats.json"]
    made = fill_gaps(model_io, ROBOT, "joint", missing_files(model_io, [tmp_path]))
    assert "normalize" not in made["action"]
    (tmp_path / "stats.json").write_text("{}")
    assert missing_files(model_io, [tmp_path]) == []
    assert fill_gaps(model_io, ROBOT, "joint", missing_files(model_io, [tmp_path])) == model_io
