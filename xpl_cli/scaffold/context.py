"""What the template of adapters may say: the author's answers, and the facts of the spec."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypedDict

from xpl import _spec as sdk
from xpl import robots
from xpl.manifest import Manifest
from xpl_cli.scaffold import block, kinds, reference
from xpl_cli.scaffold.template import as_yaml
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.contract import Entry
    from xpl_cli.scaffold.answers import Answers

_GRIPPER = "parallel_gripper"


def context(answers: Answers) -> dict[str, Any]:
    """Return all that the template may say: the author's answers, and the facts of the spec."""
    conventions, package = spec.data("conventions"), spec.data("package")
    manifest = spec.schema("policy")["properties"]
    settings = _settings()
    kind = kinds.kinds()[answers.kind]
    environment = kind.python(answers.python)
    inputs = kinds.inputs(kind, answers.cameras, answers.embodiment, answers.action_type)
    model_io = _model_io(answers) if answers.block and kind.block else None
    scripts = {name: _arguments(names, settings) for name, names in package["scripts"].items()}
    return {
        **asdict(answers),
        "yaml_name": as_yaml(answers.name),
        "spec_version": spec.VERSION,
        "placeholder": package["placeholder"],
        "model_class": package["model_class"],
        "eval_loop": package["loop"],
        "eval_env_type": package["eval_env_type"],
        "checkpoint_directory": conventions["checkpoint"]["directory"],
        "deploy": {key: entry.get("default") for key, entry in settings.items()},
        "deploy_entries": _deploy_entries(answers, kind),
        "evaluation_only": answers.eval_only or kind.evaluation_only,
        "camera_entries": [asdict(kinds.camera(text)) for text in answers.cameras],
        "families": manifest["family"]["enum"],
        "temporal_kinds": manifest["temporal"]["properties"]["kind"]["enum"],
        "managers": manifest["environment"]["properties"]["manager"]["enum"],
        "inputs": inputs,
        "has_gripper": _has_gripper(answers),
        "model_io": model_io and {name: list(map(_flow, entries)) for name, entries in model_io.items()},
        "second": reference.said(_manifest(answers, inputs, model_io)) if answers.reference else {},
        "gripper_commands": _gripper_commands(),
        "environment": environment,
        "environment_as_json": {key: json.dumps(value, ensure_ascii=False) for key, value in environment.items()},
        "scripts": scripts,
        "usage": {name: " ".join([name, *(item["shown"] for item in items)]) for name, items in scripts.items()},
    }


def _model_io(answers: Answers) -> dict[str, list[Any]]:
    """Return the images and the parts of the model_io block."""
    return {"images": block.images(answers), "parts": block.parts(answers)}


def _manifest(answers: Answers, inputs: Mapping[str, Any], model_io: Entry | None) -> Manifest:
    """Return what of the manifest reference.py has to agree with."""
    manifest: dict[str, Any] = {
        "name": answers.name,
        "inputs": inputs,
        "embodiments": [answers.embodiment],
        "action_types": [answers.action_type],
        "gripper": {"command": _gripper_commands()[0]} if _has_gripper(answers) else None,
        "temporal": {"history": answers.history, "chunk": answers.chunk},
    }
    if model_io is not None:
        vector, history = {"parts": model_io["parts"]}, {"length": answers.history}
        manifest["model_io"] = {"images": model_io["images"], "state": [vector], "history": history, "action": vector}
    return Manifest.parse(manifest)


def _has_gripper(answers: Answers) -> bool:
    return bool(robots.entries()[answers.embodiment]["end_effector"]["kind"] == _GRIPPER)


def _flow(value: object) -> str:
    """Return a value as YAML writes it on one line."""
    import yaml

    text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=math.inf)
    return text.strip()


def _settings() -> dict[str, Any]:
    properties: dict[str, Any] = spec.schema("deploy")["properties"]
    return properties


class Argument(TypedDict):
    """A positional argument of a script; `setting` tells how deploy.yml takes it, if it does."""

    name: str
    shown: str
    position: int
    optional: bool
    setting: str | None


def _arguments(names: list[str], settings: Mapping[str, Any]) -> list[Argument]:
    result = []
    for position, shown in enumerate(names, start=1):
        name = shown.strip("[]")
        kind = None
        if name in settings:
            kind = "text" if _takes_text(settings[name]) else "value"
        result.append(Argument(name=name, shown=shown, position=position, optional=shown != name, setting=kind))
    return result


def _takes_text(entry: Entry) -> bool:
    """Tell whether a setting is text, so that an argument such as `007` or `null` must not be read as YAML."""
    types = entry.get("type", "string")  # what is not typed here refers to a definition or lists its words
    return "string" in ([types] if isinstance(types, str) else types)


def _deploy_entries(answers: Answers, kind: kinds.Kind) -> list[dict[str, str]]:
    """Return the lines of deploy.yml: required keys, those that find a checkpoint, and those of the kind."""
    settings = _settings()
    chosen = {
        sdk.Deploy.POLICY_NAME: answers.name,
        sdk.Deploy.ENV_CFG_TYPE: answers.embodiment,
        sdk.Deploy.ACTION_TYPE: answers.action_type,
    }
    wanted = [key for key in settings if key in spec.schema("deploy")["required"]]
    wanted += [key for key in spec.data("conventions")["checkpoint"]["run_name"] if key not in wanted]
    told = {
        key: kinds.Setting(chosen.get(key, settings[key].get("default")), settings[key]["description"])
        for key in wanted
    }
    return [
        {"key": key, "value": as_yaml(line.value), "description": line.description}
        for key, line in {**told, **kind.settings}.items()
    ]


def _gripper_commands() -> list[str]:
    """Return what a gripper's command may mean."""
    return list(spec.schema("policy")["$defs"]["gripper"]["properties"]["command"]["enum"])
