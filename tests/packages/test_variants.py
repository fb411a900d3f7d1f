"""Variants: one adapter in several configurations, which a key of the run chooses."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from tests.support.checkout import copy
from tests.support.killable import Server
from tests.support.peer import xpl
from xpl import variants
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.packages import package
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from pathlib import Path

_OTHER = """

class Other(Model):
    def load(self, config):
        raise RuntimeError(f"here is the other one, {config['speed']}")
"""


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """Return a copy of the demo policy that has the variant `other`."""
    folder = copy(tmp_path, "policy/demo_policy/**") / "policy" / "demo_policy"
    patch = {"model_class": "Other", "action_types": ["joint"], "deploy": {"speed": 3, "action_type": "joint"}}
    with (folder / "policy.yml").open("a", encoding="utf-8") as stream:
        yaml.safe_dump({"variants": {"other": patch}}, stream)
    with (folder / "model.py").open("a", encoding="utf-8") as stream:
        stream.write(_OTHER)
    return folder


@pytest.mark.parametrize(
    ("document", "patch", "merged"),
    [
        ({"a": "b"}, {"a": "c"}, {"a": "c"}),
        ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
        ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}),
        ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
        ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}),
        ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
        ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}),
        (["a", "b"], ["c", "d"], ["c", "d"]),
        ({"a": "foo"}, "bar", "bar"),
        ({"e": None}, {"a": 1}, {"e": None, "a": 1}),
        ([1, 2], {"a": "b", "c": None}, {"a": "b"}),
        ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
    ],
)
def test_patches_are_those_of_rfc_7396(document: Any, patch: Any, merged: Any) -> None:
    """The examples of its appendix."""
    assert variants.merge_patch(document, patch) == merged


def test_a_variant_changes_manifest_and_run(adapter: Path) -> None:
    """And `--set` counts for more than it; without one all is as written."""
    plain, other = package.load(adapter), package.load(adapter, {"variant": "other"})
    assert (plain.manifest.model_class, plain.config().get("speed"), plain.config()["variant"]) == ("Model", None, None)
    assert (other.manifest.model_class, other.manifest.action_types) == ("Other", ("joint",))
    assert other.manifest.temporal == plain.manifest.temporal
    assert "variants" not in other.manifest.data
    config = other.config({"variant": "other", "speed": 4})
    assert (config["speed"], config["action_type"], config["variant"]) == (4, "joint", "other")


def test_deploy_yml_may_choose_one(adapter: Path) -> None:
    with (adapter / "deploy.yml").open("a", encoding="utf-8") as stream:
        stream.write("variant: other\n")
    assert package.load(adapter).manifest.model_class == "Other"
    assert package.load(adapter, {"variant": None}).manifest.model_class == "Model"


def test_a_variant_that_is_not_there_is_refused(adapter: Path) -> None:
    with pytest.raises(UserError, match="no variant 'nothing'; its variants: other"):
        package.load(adapter, {"variant": "nothing"})
    for command in (("serve", str(adapter)), ("audit", str(adapter), "--gate", "static")):
        done = xpl(*command, "--set", "variant=nothing", cwd=adapter)
        assert done.returncode == ExitCode.USAGE
        assert "its variants: other" in done.stderr


def test_the_class_of_a_variant_is_served(adapter: Path) -> None:
    """The policy itself loads, and the variant fails as its own class does, with its own settings."""
    with Server(adapter):
        pass
    done = xpl("serve", str(adapter), "--set", "variant=other", cwd=adapter)
    assert "here is the other one, 3" in done.stderr


def test_a_variant_is_held_against_the_schema(adapter: Path) -> None:
    """What is wrong only in it is told at its place; what is wrong in all is told once."""
    document = yaml.safe_load((adapter / "policy.yml").read_text(encoding="utf-8"))
    assert validate(document, "policy") == []
    document["variants"]["other"] |= {"temporal": {"chunk": 0}, "deploy": {"protocol": "telepathy"}}
    assert [problem.path for problem in validate(document, "policy")] == [
        ("variants", "other", "deploy", "protocol"),
        ("variants", "other", "temporal", "chunk"),
    ]
    document["family"] = 3
    assert [problem.path for problem in validate(document, "policy")].count(("family",)) == 1
    document["variants"] = {"other": {"name": "Other"}}  # which is the folder's
    assert ("variants", "other") in {problem.path for problem in validate(document, "policy")}


def test_an_audit_is_of_the_variant(adapter: Path) -> None:
    """The static gate reads its class: one that is not there is found."""
    text = (adapter / "model.py").read_text(encoding="utf-8").replace("class Other", "class Else")
    (adapter / "model.py").write_text(text, encoding="utf-8")
    answers = {}
    for chosen in ((), ("--set", "variant=other")):
        done = xpl("audit", str(adapter), "--gate", "static", "--json", *chosen, cwd=adapter)
        (target,) = json.loads(done.stdout)["targets"]
        findings = [finding for result in target["gates"][0]["results"] for finding in result["findings"]]
        answers[bool(chosen)] = [finding["message"] for finding in findings if "class Other" in finding["message"]]
    assert not answers[False]
    assert answers[True]
