"""XPL187: The manifest says what gripper commands mean, for the robots that have a gripper."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl import robots as known
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.audit.static.source import Source

_NAME = sdk.File.POLICY_YML
_KEY = "gripper"
_HAND = "hand"


@rule(code="XPL187", requirement="XPL-CFG-14", after=("manifest",))
def gripper_meaning(source: Source) -> Iterator[Finding]:
    """The manifest does not say what gripper commands mean, or says it of robots that have no gripper.

    ## What it does
    Compares `gripper` in `policy.yml` with the embodiments: it is null exactly where all of them have hands. Where
    `model_io` tells what the model itself speaks, closed and open are two values.

    ## Why it matters
    Between closed and open, one policy commands an opening and another means nothing. A gripper that knows two states
    only has to round the first and may take the second as it is.

    ## Example
    `gripper: null` for a robot with parallel grippers.

    ## Use instead
    `gripper: {command: position}`, or `command: binary` where only closed and open are meant.

    ## Fix safety
    No automatic fix: only you know what the model was trained on.
    """
    if source.is_ecosystem:
        raise NotApplicable("an adapter without policy.yml declares nothing")
    kinds = {word: known.entries()[name]["end_effector"]["kind"] for word, name in known.names().items()}
    robots = source.manifest.embodiments
    with_gripper = [robot for robot in robots if kinds.get(robot, _HAND) != _HAND]
    declared = source.manifest.gripper
    if with_gripper and declared is None:
        yield _finding(
            source,
            f"what the policy's gripper commands mean on {', '.join(with_gripper)} is not said",
            expected="{command: position} or {command: binary}",
            got="null",
        )
    if declared is not None and robots and not with_gripper and all(robot in kinds for robot in robots):
        yield _finding(
            source,
            f"commands of a gripper are declared, and {', '.join(robots)} have hands",
            expected="null",
            got=f"command: {declared.command}",
        )
    model_io = None if declared is None else declared.model_io
    if model_io is not None and model_io.closed == model_io.open:
        yield _finding(
            source,
            "closed and open are one value for the model: no gripper command can be told from another",
            expected="two values",
            got=f"closed {model_io.closed}, open {model_io.open}",
        )


def _finding(source: Source, message: str, expected: str, got: str) -> Finding:
    return Finding(
        message,
        path=_NAME,
        line=key_line(source, _NAME, _KEY),
        column=1,
        expected=expected,
        got=got,
        fix=Fix("command", "xpl spec show policy"),
    )
