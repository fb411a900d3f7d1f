"""XPL152: Keys of an action are those of the robot's arms."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.function import Function
from xpl_cli.audit.static.model_class import ACTING, ModelClass
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import always_raises, constant, enclosing, names, targets, texts

_KEYS = (sdk.State.ARM_JOINT_STATE, sdk.State.EE_JOINT_STATE, sdk.State.EE_POSE)
_LEFT = sdk.ARM_PREFIXES[2][0]
_COUNTS = ("num_arm", "n_arm", "arm_dim", "ee_dim", "arms", "is_dual", "dual", "single", "bimanual", "prefix")


@rule(code="XPL152", requirement="XPL-ACT-1")
def arm_keys(source: Source) -> Iterator[Finding]:
    """The adapter uses the left arm's key for a robot with one arm.

    ## What it does
    Looks for functions that write action keys with the prefix of the left arm and also serve robots with one arm: their
    loop over the arms stops after the first one, or skips the second. Not reported if `get_action` or what it calls
    writes keys without a prefix, or raises an error for one arm.

    ## Why it matters
    A robot with one arm has keys without a prefix. The environment refuses `left_arm_joint_state`, or gets no command
    for its arm and does not move it.

    ## Example
    `for side, arm in (("left", 0), ("right", 1)): if arm >= num_arms: break`, then `action[f"{side}_arm_joint_state"]`.

    ## Use instead
    `self.embodiment.prefixes`, or `xpl.action.unpack`, which writes the keys.

    ## Fix safety
    No automatic fix.
    """
    adapter = ModelClass.of(source)
    functions = adapter.reach(*ACTING)
    writes = [(function, written) for function in functions if (written := _written(function)) is not None]
    if not writes or any(map(_writes_plain, functions)) or _refuses(adapter):
        return
    for function, written in writes:
        if _serves_one(function):
            key, key_text = written
            yield Finding(
                f"the only arm of a one-armed robot gets {key_text}: the environment refuses it, or moves nothing",
                **source.at(function.file, key),
                expected="keys without a prefix for a robot with one arm",
                got=ast.unparse(key),
                fix=Fix("advice", "take prefixes from the embodiment: ('',) for one arm; xpl.action.unpack does"),
                must=False,  # of public adapters' findings, too few were right (docs/calibration.md)
            )


def _keys(function: Function) -> Iterator[ast.expr]:
    """Yield the keys of maps that a function writes."""
    for node in function.of(ast.Dict, ast.Subscript):
        if isinstance(node, ast.Dict):
            yield from (key for key in node.keys if key is not None)
        elif isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
            yield node.slice


def _writes_plain(function: Function) -> bool:
    """Tell whether a key without a prefix is written, or one whose prefix is computed: `f"{prefix}ee_pose"`."""
    return any(
        constant(key) in _KEYS or (isinstance(key, ast.JoinedStr) and bool(texts(key) & set(_KEYS)))
        or isinstance(key, (ast.BinOp, ast.Call))
        for key in _keys(function)
    )  # fmt: skip


def _written(function: Function) -> tuple[ast.expr, str] | None:
    """Return the first key for a left arm that a function writes: constant, or made of the word "left"."""
    lefts = {_LEFT, _LEFT.rstrip("_")}
    for key in _keys(function):
        text = constant(key)
        if isinstance(text, str) and text.startswith(_LEFT) and text.endswith(_KEYS):
            return key, text
        if isinstance(key, ast.JoinedStr) and any(part.strip("_") in _KEYS for part in texts(key)):
            loops = [node for node in enclosing(key, function.up) if isinstance(node, ast.For)]
            if any(texts(loop.iter) & lefts and names(key) & _bound(loop) for loop in loops):
                return key, _LEFT + next(part.strip("_") for part in texts(key) if part.strip("_") in _KEYS)
    return None


def _bound(loop: ast.For) -> set[str]:
    return {target.id for target in targets(loop) if isinstance(target, ast.Name)}


def _serves_one(function: Function) -> bool:
    """Tell whether a function has a case for fewer than two arms that is not an error."""
    for node in function.of(ast.If):
        if always_raises(node.body):
            continue
        words = {text.lower() for text in names(node.test) | texts(node.test)}
        words |= {child.attr.lower() for child in ast.walk(node.test) if isinstance(child, ast.Attribute)}
        if any(count in word for word in words for count in _COUNTS) and any(
            isinstance(child, ast.Compare) for child in ast.walk(node.test)
        ):
            return True
    return False


def _refuses(adapter: ModelClass) -> bool:
    """Tell whether the adapter raises for robots with another number of arms."""
    for function in adapter.reach(*adapter.methods):
        for node in function.of(ast.If):
            if always_raises(node.body):
                test = ast.unparse(node.test)
                if "arm" in test and ("len(" in test or "num" in test) and ("2" in test or "1" in test):
                    return True
    return False
