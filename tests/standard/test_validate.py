from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xpl.action import unpack
from xpl.embodiment import embodiment_names, get_embodiment
from xpl_cli.standard import spec
from xpl_cli.standard.validate import Problem, validate, validate_yaml_file

if TYPE_CHECKING:
    from pathlib import Path


def _joint_step(dof: int = 6) -> dict[str, Any]:
    """Return a joint action of two arms, in every form that an array may have."""
    return {
        "left_arm_joint_state": [0.0] * dof,
        "left_ee_joint_state": (1,),
        "right_arm_joint_state": np.zeros(dof, np.float32),
        "right_ee_joint_state": np.ones(1, np.int64),
    }


def _only(problems: list[Problem]) -> Problem:
    assert len(problems) == 1, [str(problem) for problem in problems]
    return problems[0]


@pytest.mark.parametrize("name", embodiment_names())
@pytest.mark.parametrize("action_type", ["joint", "ee"])
def test_what_the_sdk_unpacks_is_a_valid_action(name: str, action_type: str) -> None:
    """The schema and the SDK mean the same action step, for every robot."""
    robot = get_embodiment(name)
    step = unpack(np.zeros(sum(robot.dims(action_type).values())), robot, action_type)
    bindings = {"DOF": robot.arms[0].dof, "EEF": robot.arms[0].ee_dim}
    assert validate([step, step], "chunk", bindings=bindings) == []


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ({}, []),
        ({"right_arm_joint_state": [0.0] * 7}, ["right_arm_joint_state"]),  # DOF has one size in a document
        ({"right_ee_joint_state": ...}, ["right_ee_joint_state"]),  # of four alternatives the nearest is explained
        ({"left_ee_pose": [0, 0, 0, 1, 0, 0, 0]}, ["left_ee_pose"]),  # joint and end-effector control at once
        *(
            ({"left_arm_joint_state": values}, ["left_arm_joint_state"])  # nothing is turned into numbers on the way
            for values in ([True] * 6, ["1"] * 6, [None] * 6, [1j] * 6, np.zeros(6, bool), b"123456")
        ),
    ],
)
def test_an_action_is_arrays_lists_or_tuples_of_numbers_of_one_robot(change: dict[str, Any], wrong: list[str]) -> None:
    step = {key: value for key, value in (_joint_step() | change).items() if value is not ...}
    assert [problem.missing or problem.path[0] for problem in validate(step, "action")] == wrong


def test_a_symbol_can_be_bound_beforehand() -> None:
    """A known robot fixes DOF for one call, not for the next."""
    problems = validate(_joint_step(), "action", bindings={"DOF": 7})
    assert [problem.path for problem in problems] == [("left_arm_joint_state",), ("right_arm_joint_state",)]
    assert validate(_joint_step(), "action") == []  # and the binding ends with the call


def test_cameras_may_differ_in_size_but_depth_belongs_to_its_color() -> None:
    def camera(height: int, width: int, depth: tuple[int, ...]) -> dict[str, Any]:
        return {"color": np.zeros((height, width, 3), np.uint8), "depth": np.zeros(depth, np.float32)}

    vision = {"cam_head": camera(48, 64, (48, 64)), "cam_wrist": camera(24, 32, (24, 32, 1))}
    assert validate({"vision": vision}, "observation") == []
    vision["cam_head"] = camera(48, 64, (24, 32))
    assert _only(validate({"vision": vision}, "observation")).path == ("vision", "cam_head", "depth")


@pytest.mark.parametrize("color", [b"\xff\xd8", bytearray(b"ab"), np.zeros(9, np.uint8), [[[0, 127, 255]]]])
def test_images_arrive_as_bytes_arrays_and_lists(color: Any) -> None:
    assert validate({"vision": {"cam_head": {"color": color}}}, "observation") == []


@pytest.mark.parametrize(
    "color",
    [np.zeros((4, 4, 3), np.float32), np.zeros((4, 4, 4), np.uint8), [[[0, 0, 256]]], "file.png", [[[0], [0, 0]]]],
)
def test_an_image_of_another_kind_is_told_what_would_do(color: Any) -> None:
    problem = _only(validate({"vision": {"cam_head": {"color": color}}}, "observation"))
    assert problem.path == ("vision", "cam_head", "color")
    assert "(H, W, 3) uint8 or (N,) uint8" in problem.message


def test_depth_in_integers_is_refused_as_it_would_be_millimetres() -> None:
    depth = {"depth": np.zeros((4, 4), np.uint16)}
    assert "float" in _only(validate({"vision": {"cam_head": depth}}, "observation")).message


def test_an_array_where_a_word_belongs_is_a_problem_not_a_crash() -> None:
    problem = _only(validate({"data_format_version": np.zeros(3)}, "observation"))
    assert problem.expected == "'v1.0'"


def test_numpy_scalars_count_as_numbers() -> None:
    observation = {"env_idx": np.int64(3), "additional_info": {"frequency": np.float32(25)}}
    assert validate(observation, "observation") == []


def test_definitions_of_a_schema_can_be_validated_by() -> None:
    assert validate({"func_name": "reset"}, "payload#/$defs/call") == []
    assert _only(validate({}, "payload#/$defs/call")).expected == "func_name"


def test_a_document_that_contains_itself_ends_in_a_problem() -> None:
    loop: list[Any] = []
    loop.append({"left_arm_joint_state": loop})
    assert validate(loop, "chunk")


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_any_document_gives_problems_and_never_an_exception(document: Any) -> None:
    """Whatever arrives, every problem is one that can be read."""
    for name in ("action", "observation", "deploy", "policy"):
        for problem in validate(document, name):
            assert problem.message


# -- YAML files --------------------------------------------------------------------------------------------------------

DEPLOY = """\
policy_name: Foo
protocol: ws
host: localhost
port: null
bench_name: null
task_name: null
env_cfg_type: null
seed: 0
action_type: joint
eval_batch: false
"""


def _problems(tmp_path: Path, text: str, schema: str = "deploy") -> list[Problem]:
    file = tmp_path / "file.yml"
    file.write_text(text, encoding="utf-8")
    return validate_yaml_file(file, schema)


@pytest.mark.parametrize(
    ("old", "new", "place", "message"),
    [
        ("seed: 0", "seed: first", (8, 1), "expected an integer or null, got the text 'first'"),
        ("action_type: joint", "action_type: joints", (9, 1), "expected one of 'joint', 'ee' or null, got 'joints'"),
        ("port: null", "port: 70000", (4, 1), "expected at most 65535, got 70000"),
        ("eval_batch: false", "eval_batch: 'false'", (10, 1), "expected true or false, got the text 'false'"),
        ("host: localhost\n", "", (1, 1), "the key 'host' (address the policy server listens on) is missing"),
    ],
)
def test_a_problem_has_its_line_and_column(
    tmp_path: Path, old: str, new: str, place: tuple[int, int], message: str
) -> None:
    assert _problems(tmp_path, DEPLOY) == []
    problem = _only(_problems(tmp_path, DEPLOY.replace(old, new)))
    assert (problem.line, problem.column) == place
    assert problem.message == message
    assert str(problem).startswith(f"{tmp_path}/file.yml:{place[0]}:{place[1]}")


def test_places_inside_lists_and_maps_are_found(tmp_path: Path) -> None:
    """A place is that of the entry, not of the block around it."""
    text = "inputs:\n  required:\n    - vision.cam_head\n    - vision.cam_hed\n"
    problem = next(problem for problem in _problems(tmp_path, text, "policy") if problem.nearest)
    assert (problem.line, problem.column) == (4, 7)
    assert problem.nearest == "vision.cam_head"


def test_every_schema_compiles() -> None:
    for name in spec.schema_names():
        validate({}, name)
