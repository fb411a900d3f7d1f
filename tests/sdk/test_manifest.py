"""The manifest classes hold what `spec/` declares, key by key, with its defaults."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xpl import manifest
from xpl.arms.episode import Care
from xpl.history import History
from xpl.manifest import EnvManifest, Manifest
from xpl_cli.standard import spec

_POLICY = spec.schema("policy")["properties"]
_ENV = spec.schema("env")["properties"]
_DATA = {"data", "assumed"}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


def declared(schema: dict[str, Any]) -> dict[str, Any]:
    if "$ref" in schema:
        document, _, pointer = schema["$ref"].partition("#/")
        found: Any = spec.schema(document.rpartition("/")[2] or "policy")
        for key in pointer.split("/"):
            found = found[key]
        return declared(found)
    for one in schema.get("anyOf", ()):
        if keys := declared(one):
            return keys
    if "items" in schema:
        return declared(schema["items"])
    return dict(schema.get("properties", {}))


@pytest.mark.parametrize(
    ("kind", "properties"),
    [
        (Manifest, _POLICY),
        (manifest.Temporal, declared(_POLICY["temporal"])),
        (manifest.Inputs, declared(_POLICY["inputs"])),
        (manifest.Checkpoint, declared(_POLICY["checkpoints"])),
        (manifest.CheckpointFile, declared(declared(_POLICY["checkpoints"])["files"])),
        (manifest.PythonEnvironment, declared(_POLICY["environment"])),
        (manifest.Serving, declared(_POLICY["serving"])),
        (manifest.Shadow, declared(_POLICY["shadow"])),
        (manifest.Claim, declared(_POLICY["claims"])),
        (manifest.Waiver, declared(_POLICY["waivers"])),
        (manifest.CameraNeeds, declared(_POLICY["cameras"]["additionalProperties"])),
        (manifest.Gripper, declared(_POLICY["gripper"])),
        (manifest.ModelIO, declared(spec.schema("model_io"))),
        (History, spec.schema("model_io")["$defs"]["history"]["properties"]),
        (History, {**spec.schema("model_io")["$defs"]["own_history"]["properties"], "of": {}}),
        (EnvManifest, _ENV),
        (manifest.Task, declared(_ENV["tasks"]["additionalProperties"])),
        (manifest.SeedRange, declared(_ENV["evaluation_seeds"])),
        (manifest.HandOver, declared(_ENV["hand_over"])),
        (manifest.Workspace, declared(declared(_ENV["hand_over"])["workspace"])),
        (manifest.ResultFile, declared(declared(_ENV["hand_over"])["result"])),
        (Care, declared(_ENV["robot"])),
    ],
)
def test_fields_are_those_of_the_schema(kind: type, properties: dict[str, Any]) -> None:
    """A key that the standard gains, loses or gives another default changes the class, too."""
    known = {item.name: item for item in fields(kind)}
    assert set(known) - _DATA == set(properties)
    for name, schema in properties.items():
        default = schema.get("default")
        if default is None or known[name].default is MISSING or name in {"requirements", "real_time"}:
            continue
        assert known[name].default == (tuple(default) if isinstance(default, list) else default), name


@given(JSON)
def test_any_document_is_read(data: object) -> None:
    keys = dict.fromkeys([*_POLICY, *_ENV], data)
    for kind in (Manifest, EnvManifest):
        found = kind.parse(keys)
        assert found.data == keys
        assert kind.parse(data if not isinstance(data, dict) else None) == kind()


def test_a_model_io_block_may_reach_farther_back_than_the_manifest_says() -> None:
    model_io = {"images": [{}], "state": [{}], "history": {"length": 2, "stride": 3, "of": ["images"]}}
    found = Manifest.parse({"temporal": {"kind": "history", "history": 2}, "model_io": model_io})
    assert found.model_io is not None
    assert (found.reach, found.model_io.remembered) == (4, ("images",))
    own = {**model_io, "images": [{"history": {"length": 1}}], "state": [{"history": {"length": 3, "stride": 2}}]}
    found = Manifest.parse({"model_io": {**own, "history": {"length": 2}}})
    assert found.model_io is not None
    assert (found.reach, found.model_io.remembered) == (5, ("state",))
    assert Manifest.parse({"model_io": {**model_io, "history": {"length": {"unknown": "?"}}}}).reach == 1
    assert (Manifest().reach, Manifest.parse({"temporal": {"history": 2}}).reach) == (1, 2)


def test_values_keep_their_types() -> None:
    found = Manifest.parse({"control_frequency": 25, "temporal": {"chunk": True}, "embodiments": ["arx_x5", 3]})
    assert found.control_frequency == 25.0
    assert found.temporal.chunk is None
    assert found.embodiments == ("arx_x5",)
    assert Manifest.parse(None) == Manifest()
    assert not Manifest.parse({})
