"""Variables of the adapter template: the author's answers, and facts of the spec."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypedDict

from xpl import _spec as sdk
from xpl import robots
from xpl.manifest import Manifest
from xpl_cli.scaffold import kinds, model_io_block, reference
from xpl_cli.scaffold.template import as_yaml
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.contract import Entry
    from xpl_cli.scaffold.answers import AdapterAnswers

_GRIPPER = "parallel_gripper"


def context(answers: AdapterAnswers) -> dict[str, Any]:
    """Return the template's variables: the author's answers, and facts of the spec."""
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
        "reference_py": reference.reference_context(_manifest(answers, inputs, model_io)) if answers.reference else {},
        "gripper_commands": _gripper_commands(),
        "environment": environment,
        "environment_as_json": {key: json.dumps(value, ensure_ascii=False) for key, value in environment.items()},
        "scripts": scripts,
        "usage": {name: " ".join([name, *(item["label"] for item in items)]) for name, items in scripts.items()},
    }


def _model_io(answers: AdapterAnswers) -> dict[str, list[Any]]:
    """Return the images and the parts of the model_io block."""
    return {"images": model_io_block.images(answers), "parts": model_io_block.parts(answers)}


def _manifest(answers: AdapterAnswers, inputs: Mapping[str, Any], model_io: Entry | None) -> Manifest:
    """Return the part of the manifest that reference.py has to match."""
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


def _has_gripper(answers: AdapterAnswers) -> bool:
    return bool(robots.entries()[answers.embodiment]["end_effector"]["kind"] == _GRIPPER)


def _flow(value: object) -> str:
    """Return a value as YAML on one line."""
    import yaml

    text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=math.inf)
    return text.strip()


def _settings() -> dict[str, Any]:
    properties: dict[str, Any] = spec.schema("deploy")["properties"]
    return properties


class Argument(TypedDict):
    """A positional argument of a script; `setting` is how deploy.yml takes it: `text`, `value`, or None."""

    name: str
    label: str
    position: int
    optional: bool
    setting: str | None


def _arguments(names: list[str], settings: Mapping[str, Any]) -> list[Argument]:
    result = []
    for position, label in enumerate(names, start=1):
        name = label.strip("[]")
        kind = None
        if name in settings:
            kind = "text" if _takes_text(settings[name]) else "value"
        result.append(Argument(name=name, label=label, position=position, optional=label != name, setting=kind))
    return result


def _takes_text(entry: Entry) -> bool:
    """Tell whether a setting is text: then an argument such as `007` or `null` must not be parsed as YAML."""
    types = entry.get("type", "string")  # an entry without a type refers to a definition or lists its values
    return "string" in ([types] if isinstance(types, str) else types)


def _deploy_entries(answers: AdapterAnswers, kind: kinds.AdapterKind) -> list[dict[str, str]]:
    """Return the lines of deploy.yml: required keys, keys that locate a checkpoint, and keys of the kind."""
    settings = _settings()
    own_values = {
        sdk.Deploy.POLICY_NAME: answers.name,
        sdk.Deploy.ENV_CFG_TYPE: answers.embodiment,
        sdk.Deploy.ACTION_TYPE: answers.action_type,
    }
    keys = [key for key in settings if key in spec.schema("deploy")["required"]]
    keys += [key for key in spec.data("conventions")["checkpoint"]["run_name"] if key not in keys]
    entries = {
        key: kinds.DeploySetting(own_values.get(key, settings[key].get("default")), settings[key]["description"])
        for key in keys
    }
    return [
        {"key": key, "value": as_yaml(line.value), "description": line.description}
        for key, line in {**entries, **kind.settings}.items()
    ]


def _gripper_commands() -> list[str]:
    """Return the possible meanings of a gripper command."""
    return list(spec.schema("policy")["$defs"]["gripper"]["properties"]["command"]["enum"])
