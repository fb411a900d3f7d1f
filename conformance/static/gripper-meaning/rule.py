"""XPL187: The manifest declares the meaning of gripper commands for robots that have a gripper."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl import robots as robot_catalogue
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.audit.static.source import Source

_NAME = sdk.File.POLICY_YML
_KEY = "gripper"
_HAND = "hand"


@rule(code="XPL187", requirement="XPL-CFG-14", after=("manifest",))
def gripper_meaning(source: Source) -> Iterator[Finding]:
    """The manifest does not declare the meaning of gripper commands, or declares it for robots without a gripper.

    ## What it does
    Compares `gripper` in `policy.yml` with the embodiments: it is null exactly if all of them have hands. If `model_io`
    declares the model's own gripper values, closed and open must differ.

    ## Why it matters
    For one policy a command between closed and open is an opening; for another it has no meaning. A gripper with two
    states has to round the first, and may execute the second directly.

    ## Example
    `gripper: null` for a robot with parallel grippers.

    ## Use instead
    `gripper: {command: position}`, or `command: binary` if only closed and open are meant.

    ## Fix safety
    No automatic fix: only the author knows what the model was trained on.
    """
    if source.is_ecosystem:
        raise NotApplicable("an adapter without policy.yml declares nothing")
    kinds = {
        word: robot_catalogue.entries()[name]["end_effector"]["kind"] for word, name in robot_catalogue.names().items()
    }
    robots = source.manifest.embodiments
    with_gripper = [robot for robot in robots if kinds.get(robot, _HAND) != _HAND]
    declared = source.manifest.gripper
    if with_gripper and declared is None:
        yield _finding(
            source,
            f"the meaning of the policy's gripper commands on {', '.join(with_gripper)} is not declared",
            expected="{command: position} or {command: binary}",
            got="null",
        )
    if declared is not None and robots and not with_gripper and all(robot in kinds for robot in robots):
        yield _finding(
            source,
            f"gripper commands are declared, but {', '.join(robots)} have hands",
            expected="null",
            got=f"command: {declared.command}",
        )
    model_io = None if declared is None else declared.model_io
    if model_io is not None and model_io.closed == model_io.open:
        yield _finding(
            source,
            "closed and open are one value for the model: gripper commands cannot be distinguished",
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
