"""XPL166: What policy.yml declares is what the code does."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Any, Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.adapter import ACTING, LOADING, OBSERVING, Adapter
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.manifests import key_line, required_input
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import (
    always_raises,
    called,
    constant,
    dotted,
    key_read,
    last,
    names,
    parameters,
    self_attribute,
    targets,
    texts,
)

_HELPERS: Final = {
    "get_instruction": (sdk.Obs.INSTRUCTION,),
    "pack_state": tuple(
        f"{sdk.Obs.STATE}.{leaf}" for leaf in (sdk.State.ARM_JOINT_STATE, sdk.State.EE_POSE, sdk.State.EE_JOINT_STATE)
    ),
}
_PARTS: Final = {
    "joints": (sdk.State.ARM_JOINT_STATE,),
    "gripper": (sdk.State.EE_JOINT_STATE,),
    "hand": (sdk.State.EE_JOINT_STATE,),
    "position": (sdk.State.EE_POSE,),
    "rotation": (sdk.State.EE_POSE,),
}
_CAMERAS: Final = {camera for cameras in sdk.CAMERAS.values() for camera in cameras} | set(sdk.OPTIONAL_CAMERAS)
_CHUNK: Final = re.compile(r"(?:action_)?chunk(?:_size|_len(?:gth)?)?")
_EXECUTED: Final = re.compile(r"exec(?:uted?|ution)?_(?:.*_)?(?:chunk|horizon|steps)(?:_size|_len(?:gth)?)?")
_CHOICES: Final = {
    "action_types": re.compile(sdk.Deploy.ACTION_TYPE),
    "embodiments": re.compile(rf"{sdk.Deploy.ENV_CFG_TYPE}|embodiment(?:\.name)?|robot(?:_type|_name)?"),
}


@rule(code="XPL166", requirement="XPL-CFG-9")
def declared_otherwise(source: Source) -> Iterator[Finding]:
    """policy.yml declares something else than the code does.

    ## What it does
    Compares the manifest with the class: inputs that are declared and never read, inputs that are read and not
    declared, kinds of action and robots that are declared and refused, a chunk length that the code or `deploy.yml`
    gives another value, a history of which only the last observation is used. Code that reads names made at run time,
    or hands observations on as a whole, may read any input; what the block `native` names is read.

    ## Why it matters
    The manifest decides where the policy is evaluated, what environments send, and what comparisons print. A camera
    that is read and not declared is missing on the day; one that is declared and not read makes the policy look as if
    it saw.

    ## Example
    `inputs: {required: [vision.cam_wrist]}` and `get_image(obs, "cam_head")` in `encode`.

    ## Use instead
    Declare what the code reads, under `required`, `optional` or `unused`.

    ## Fix safety
    Changing the manifest changes where the policy is evaluated, not how it acts.
    """
    if source.is_ecosystem:
        raise NotApplicable("an adapter without policy.yml declares nothing")
    adapter = Adapter.of(source)
    yield from _inputs(source, adapter)
    yield from _refused(source, adapter)
    yield from _chunk(source, adapter)
    yield from _history(source, adapter)


def _inputs(source: Source, adapter: Adapter) -> Iterator[Finding]:
    inputs = source.manifest.get("inputs")
    inputs = inputs if isinstance(inputs, dict) else {}
    declared = {name: kind for kind in ("unused", "optional", "required") for name in _texts(inputs.get(kind))}
    functions = adapter.reach(*OBSERVING, *ACTING)
    read = {name: entry for function in functions for name, entry in _read(function)}
    for name, (function, node) in read.items():
        if declared.get(name, "unused") == "unused":
            told = "declares unused" if name in declared else "does not declare"
            yield Finding(
                f"the code reads {name}, which policy.yml {told}: environments without it are let through, and fail",
                **source.at(function.file, node),
                expected=f"{name} under inputs.required or inputs.optional",
                got=ast.unparse(node)[:80],
                fix=required_input(source, name),
            )
    words = {word for function in adapter.reach(*adapter.methods) for word in _words(function)}
    words |= {text for file in source.python_files if source.parses(file) for text in texts(source.tree(file))}
    words |= {str(value) for value in source.deploy.values()}  # a list of cameras is searched as text
    words |= set(_native(source.manifest.get("native")))
    for name, kind in declared.items():
        if kind == "unused" or _is_read(name, words) or _is_open(functions, name.partition(".")[0]):
            continue
        yield _manifest(source, "inputs", f"{name} is declared {kind} and never read: the policy does not see it", name)


def _read(function: Function) -> Iterator[tuple[str, tuple[Function, ast.AST]]]:
    """Yield the inputs that a function reads by a constant name, from something that is an observation."""
    for node in function.nodes:
        name = last(called(node))
        if isinstance(node, ast.Call) and name == "get_instruction":
            yield sdk.Obs.INSTRUCTION, (function, node)
        elif isinstance(node, ast.Call) and name == "get_image" and len(node.args) > 1:
            camera = constant(node.args[1])
            if isinstance(camera, str) and camera in _CAMERAS:
                yield f"{sdk.Obs.VISION}.{camera}", (function, node)
        elif (read := key_read(node)) is not None and read.required:
            outer = key_read(read.owner)
            if outer is not None and outer.key == sdk.Obs.VISION and read.key in _CAMERAS:
                yield f"{sdk.Obs.VISION}.{read.key}", (function, node)


def _words(function: Function) -> Iterator[str]:
    """Yield what a function mentions: names of the SDK's constants and helpers, in the words of the standard."""
    for node in function.nodes:
        if isinstance(node, ast.Attribute) and node.attr.isupper():
            yield node.attr.lower()
        elif isinstance(node, ast.Call):
            for name in _HELPERS.get(last(called(node)), ()):
                yield name.rpartition(".")[2]


def _native(block: object) -> Iterator[str]:
    """Yield what conversions that are compiled from the block `native` read, in the words of the standard."""
    if isinstance(block, dict):
        yield from (key for key in block if key == sdk.Obs.INSTRUCTION and block[key])
        for key, value in block.items():
            yield from _PARTS.get(key, ())
            yield from _native(value)
    elif isinstance(block, list):
        for entry in block:
            yield from [entry] if isinstance(entry, str) and entry in _CAMERAS else _native(entry)


def _is_read(name: str, words: set[str]) -> bool:
    leaf = name.rpartition(".")[2]
    return any(leaf in word for word in words)


def _is_open(functions: list[Function], group: str) -> bool:
    """Tell whether code may read any input of a group: by names made at run time, or elsewhere."""
    return any(_may_read(node, function, group) for function in functions for node in function.nodes)


def _may_read(node: ast.AST, function: Function, group: str) -> bool:
    if isinstance(node, ast.Call) and last(called(node)) == "get_image":
        return group == sdk.Obs.VISION and constant(node.args[-1] if node.args else None) is ...
    if isinstance(node, ast.Call) and last(called(node)) not in _HELPERS:
        known = parameters(function.node)
        given = (
            known[:1] if function.name in OBSERVING else [name for name in known if name.startswith(sdk.Payload.OBS)]
        )
        is_own = dotted(node.func).count(".") == 1 and dotted(node.func).startswith("self.")
        return not is_own and any(isinstance(entry, ast.Name) and entry.id in given for entry in node.args)
    if isinstance(node, ast.Subscript) and not isinstance(
        node.slice, (ast.Constant, ast.Slice, ast.Tuple, ast.UnaryOp)
    ):
        return group in _mentioned(node.value)
    return isinstance(node, (ast.For, ast.comprehension)) and group in _mentioned(node.iter)


def _mentioned(node: ast.AST) -> set[str]:
    attributes = {child.attr.lower() for child in ast.walk(node) if isinstance(child, ast.Attribute)}
    return texts(node) | names(node) | attributes


def _refused(source: Source, adapter: Adapter) -> Iterator[Finding]:
    """Yield kinds of action and robots that the manifest declares and the code raises on."""
    for function in adapter.reach(*LOADING):
        for node in function.nodes:
            if not isinstance(node, ast.If) or not isinstance(node.test, ast.Compare) or not always_raises(node.body):
                continue
            accepted = _accepted(node.test)
            left = key_read(node.test.left)
            subject = left.key if left else dotted(node.test.left).removeprefix("self.")
            for key, pattern in _CHOICES.items():
                refused = [name for name in _texts(source.manifest.get(key)) if accepted and name not in accepted]
                if pattern.fullmatch(subject) and refused:
                    yield Finding(
                        f"policy.yml declares {', '.join(refused)}, and the policy refuses to start with it",
                        **source.start(function.file, node),
                        expected=f"{key}: [{', '.join(sorted(accepted))}], or code that serves the others",
                        got=ast.unparse(node.test),
                        fix=Fix("advice", f"take {', '.join(refused)} out of {key}"),
                    )


def _accepted(test: ast.Compare) -> set[str]:
    """Return the values with which a test that refuses is false: `!= "joint"`, `not in ("joint", "ee")`."""
    right = test.comparators[0]
    if isinstance(test.ops[0], ast.NotEq) and isinstance(constant(right), str):
        return {str(constant(right))}
    if isinstance(test.ops[0], ast.NotIn) and isinstance(right, (ast.Tuple, ast.List, ast.Set)):
        return {str(value) for value in map(constant, right.elts) if isinstance(value, str)}
    return set()


def _chunk(source: Source, adapter: Adapter) -> Iterator[Finding]:
    declared = _temporal(source).get("chunk")
    if not isinstance(declared, int):
        return
    if any(_EXECUTED.fullmatch(str(key)) and value == declared for key, value in source.deploy.items()):
        return  # what the model predicts may be longer than what is handed out
    message = "the chunk is {} long here and {} in policy.yml: every answer is refused"
    for key, value in source.deploy.items():
        if _CHUNK.fullmatch(str(key)) and type(value) is int and value != declared:
            line = key_line(source, sdk.File.DEPLOY_YML, key)
            at: dict[str, Any] = {"path": sdk.File.DEPLOY_YML, "line": line, "column": 1}
            yield _length(message.format(value, declared), at, declared, f"{key}: {value}")
    for function in adapter.reach(*LOADING, *ACTING):
        for node in function.nodes:
            value = constant(node.value) if isinstance(node, ast.Assign) else ...
            if isinstance(node, ast.Assign) and type(value) is int and value != declared:
                for target in targets(node):
                    name = target.id if isinstance(target, ast.Name) else self_attribute(target) or ""
                    if _CHUNK.fullmatch(name):
                        at = source.at(function.file, node)
                        yield _length(message.format(value, declared), at, declared, ast.unparse(node))


def _length(message: str, at: dict[str, Any], declared: int, got: str) -> Finding:
    return Finding(message, **at, expected=f"{declared}, or self.chunk", got=got, fix=Fix("advice", "use self.chunk"))


def _history(source: Source, adapter: Adapter) -> Iterator[Finding]:
    """Yield a history that is declared, and of which only the last observation is used."""
    declared = _temporal(source).get("history", 1)
    function = adapter.method("predict")
    if not isinstance(declared, int) or declared < 2 or function is None or not adapter.is_sdk:
        return
    given = set(parameters(function.node)[:1])
    frames = {
        name
        for node in function.nodes
        if isinstance(node, (ast.For, ast.comprehension)) and names(node.iter) & given
        for name in names(node.target)
    }
    newest, uses = 0, 0
    for node in function.nodes:
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id in frames:
            newest += constant(node.slice) == -1
        uses += isinstance(node, ast.Name) and node.id in frames and isinstance(node.ctx, ast.Load)
    if uses and newest == uses:
        message = f"of the {declared} observations that policy.yml declares the policy uses the last one only"
        yield _manifest(source, "temporal", message, f"history: {declared}")


def _temporal(source: Source) -> dict[str, Any]:
    temporal = source.manifest.get("temporal")
    return temporal if isinstance(temporal, dict) else {}


def _texts(value: object) -> list[str]:
    return [entry for entry in value if isinstance(entry, str)] if isinstance(value, list) else []


def _manifest(source: Source, key: str, message: str, got: str) -> Finding:
    return Finding(
        message,
        path=sdk.File.POLICY_YML,
        line=key_line(source, sdk.File.POLICY_YML, key),
        column=1,
        expected=f"{key} as the code has it",
        got=got,
        fix=Fix("advice", f"change {key} in policy.yml, or the code"),
    )
