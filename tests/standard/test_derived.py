"""What follows from the standard: constants of the SDK, pages, schemas for editors; and `xpl spec`."""

from __future__ import annotations

import json
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from typer.main import get_command

from tests.support.checkout import ROOT, tracked
from tests.support.commands import xpl
from xpl_cli.audit.rules import registry
from xpl_cli.derived import compiler
from xpl_cli.main import app
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers
from xpl_cli.standard import robots, schemas, spec
from xpl_cli.standard.validate import validate


@pytest.mark.parametrize(
    ("cameras", "gripper", "fits"),
    [
        ({}, None, True),
        ({"cam_head": {"width": 640, "height": 480}}, {"command": "binary"}, True),
        ({"cam_head": {"width": None, "height": None, "exact": False}}, {"command": "position"}, True),
        ({"cam_head": {"width": 640}}, None, False),
        ({"cam_head": {"width": 0, "height": 480}}, None, False),
        ({"head": {"width": 640, "height": 480}}, None, False),
        ([], None, False),
        ({}, "position", False),
        ({}, {"command": "closed"}, False),
        ({}, {"command": "position", "model_io": {"closed": 0.0, "open": 0.08, "unit": "m"}}, True),
        ({}, {"command": "position", "model_io": {"closed": 0.0}}, False),
    ],
)
def test_what_is_asked_of_cameras_and_gripper(cameras: Any, gripper: Any, fits: bool) -> None:
    """Sizes are whole numbers or null, and a gripper's command is one of two."""
    problems = validate({**yaml.safe_load(_render()["policy.yml"]), "cameras": cameras, "gripper": gripper}, "policy")
    assert (problems == []) is fits, problems


def test_everything_that_follows_from_the_standard_is_up_to_date() -> None:
    """`xpl spec compile` writes the SDK's constants and the reference pages."""
    derived = compiler.generated_files(get_command(app))
    assert [name for name, content in derived.items() if (ROOT / name).read_bytes() != content] == []
    pages = {path.relative_to(ROOT).as_posix() for path in tracked(f"{compiler.REFERENCE}/*")}
    assert pages
    assert pages <= set(derived)


def test_the_reference_tells_all_of_the_standard() -> None:
    pages = {Path(name).stem: text.decode() for name, text in compiler.generated_files(get_command(app)).items()}
    assert all(f"| {name} |" in pages["requirements"] for name in spec.requirements())
    assert all(f"| `{name}` |" in pages["embodiments"] for name in robots.entries())
    for name in schemas.MANIFESTS:
        assert all(f"| `{key}` |" in pages[name] for key in spec.schema(name)["properties"])
    assert all(rule.code in pages["requirements"] for rule in registry.rules())


@pytest.mark.parametrize("name", schemas.MANIFESTS)
def test_a_schema_for_editors_refers_to_nothing_outside(name: str) -> None:
    """It is a schema of draft 7 on its own, and takes and refuses what ours does."""
    schema = schemas.bundle(name)
    jsonschema.Draft7Validator.check_schema(schema)
    text = json.dumps(schema)
    assert "xpl:" not in text
    assert "x-array" not in text
    assert {"gripper", "model_io.gripper"} <= schema["definitions"].keys() or "model_io" not in schema["properties"]
    file = {"env": ROOT / "envs" / "mujoco" / "env.yml"}.get(name)
    document = yaml.safe_load(_render()[f"{name}.yml"] if file is None else file.read_bytes())
    validator = jsonschema.Draft7Validator(schema)
    assert list(validator.iter_errors(document)) == []
    for key in schema["required"]:
        assert list(validator.iter_errors({other: value for other, value in document.items() if other != key}))


def test_a_package_names_the_schemas_it_carries() -> None:
    files = _render()
    for name in ("deploy", "policy"):
        line, _, _ = files[f"{name}.yml"].decode().partition("\n")
        assert line == f"# yaml-language-server: $schema={schemas.path(name)}"
        assert files[schemas.path(name)] == schemas.render(name)


def test_schemas_can_be_written_into_any_package(tmp_path: Path) -> None:
    shutil.copy(ROOT / "envs" / "mujoco" / "env.yml", tmp_path)
    assert xpl("spec", "schemas", tmp_path).code == 0
    assert json.loads((tmp_path / schemas.path("env")).read_text())["title"] == "env.yml"
    (tmp_path / "env.yml").unlink()
    assert xpl("spec", "schemas", tmp_path).code == 2


@cache
def _render() -> adapter.Files:
    return adapter.render(AdapterAnswers(**{"name": "Foo", **adapter.defaults()}))
