"""Values that a manifest assumes: they run as if they stood there, and are named."""

from __future__ import annotations

from typing import Any

import pytest

from xpl.assumptions import assumptions, resolve_assumptions
from xpl.manifest import Manifest
from xpl_cli.standard.validate import validate

IMAGE = {"input": "image", "cameras": ["cam_head"], "channels": "rgb", "layout": "hwc", "dtype": "uint8"}
ACTION = {"reference": "absolute", "parts": [{"joints": {"arm": "single"}}]}


def _manifest(**changes: Any) -> dict[str, Any]:
    model_io = {"images": [{**IMAGE, **changes}], "action": ACTION}
    return {
        "spec": "v1", "name": "Foo", "summary": "a policy", "family": "vla", "model_io": model_io,
        "temporal": {"kind": "chunk", "chunk": 8}, "embodiments": ["arx_x5_single"], "action_types": ["joint"],
    }  # fmt: skip


def _problems(**changes: Any) -> list[str]:
    known = {problem.text for problem in validate(_manifest(), "policy")}
    return [problem.text for problem in validate(_manifest(**changes), "policy") if problem.text not in known]


def test_an_assumed_value_counts_as_if_it_stood_there() -> None:
    document = _manifest(channels={"assumed": "bgr", "why": "nobody says it"})
    manifest = Manifest.parse(document)
    assert manifest.model_io is not None
    assert manifest.model_io.images[0]["channels"] == manifest.model_io.data["images"][0]["channels"] == "bgr"
    assert [(one.where, one.value, one.why) for one in manifest.assumed] == [
        ("model_io.images[0].channels", "bgr", "nobody says it")
    ]
    assert resolve_assumptions(document) == _manifest(channels="bgr")
    assert not _problems(channels={"assumed": "bgr", "why": "nobody says it"})


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ({"assumed": "gbr", "why": "nobody says it"}, "did you mean"),
        ({"assumed": "rgb"}, "'why'"),
        ({"assumed": "rgb", "why": ""}, "expected"),
        ({"assumed": "rgb", "why": "so", "more": 1}, "expected"),
        ({"assumed": {"unknown": "really"}, "why": "so"}, None),
    ],
)
def test_an_assumption_is_a_value_and_a_reason(value: Any, told: str | None) -> None:
    found = _problems(channels=value)
    assert (not found) if told is None else any(told in one for one in found), found


def test_assumptions_lie_in_each_other() -> None:
    document = {"a": [{"assumed": {"b": {"assumed": 1, "why": "in"}}, "why": "out"}]}
    assert resolve_assumptions(document) == {"a": [{"b": 1}]}
    assert [(one.path, one.why) for one in assumptions(document)] == [(("a", 0), "out")]
