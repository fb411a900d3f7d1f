"""XPL262: Joints and poses that the authors recorded agree in the declared conventions."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from xpl import _spec as sdk
from xpl.convert import ConversionError
from xpl_cli.audit import Finding, Fix, NotApplicable, Proof, rule
from xpl_cli.audit.served.probe import Probe
from xpl_cli.model_io.kinematics import consistency, sample_verdicts
from xpl_cli.model_io.kinematics.consistency import KinematicsVerdict


@rule(code="XPL262", requirement="XPL-NAT-7", tries="golden pairs")
def kinematics_agree(probe: Probe) -> Iterator[Finding | Proof]:
    """Recorded joints and poses contradict each other in the declared conventions.

    ## What it does
    Reads the rows that `model_io.samples` names, computes the flange pose from their joints, and compares it with their
    poses: as declared, and in every other form, order, point, frame and unit. None of the adapter's code runs.

    ## Why it matters
    A quaternion in the wrong order, rotation columns read as rows or a TCP treated as the flange pass every check of
    shapes. The robot's kinematics decide: joints and pose of one moment agree in one convention.

    ## Example
    `form: quaternion_wxyz`, although the authors' rows agree within 0.0 degrees as `quaternion_xyzw`, and 131 as
    declared.

    ## Use instead
    The values that the finding names. If another tool or frame remains, convert it in `encode`, and declare it under
    `code`.

    ## Fix safety
    No automatic fix: what the model was trained on decides.
    """
    package = probe.package
    try:
        verdicts = sample_verdicts.judge_samples(package.manifest, [package.path])
    except sample_verdicts.NotJudgeableError as error:
        raise NotApplicable(str(error)) from None
    except ConversionError as error:
        what = {"expected": "rows that match the block and the robot", "got": "other ones"}
        yield _finding(str(error), "mend model_io.samples", **what)
        return
    if all(verdict.outcome == consistency.OPEN for verdict in verdicts):
        raise NotApplicable(f"kinematics cannot tell: {verdicts[0].because}")
    for verdict in verdicts:
        if verdict.outcome in {consistency.DIFFERS, consistency.ANSWERS, consistency.UNEXPLAINED}:
            yield _of(verdict)
    yield Proof({verdict.where: verdict.document() for verdict in verdicts})


def _of(verdict: KinematicsVerdict) -> Finding:
    if verdict.outcome == consistency.UNEXPLAINED:
        expected = "poses that follow from the joints"
        advice = "compare frame and tool with the authors' robot; convert in encode and decode what no value describes"
    else:
        expected = verdict.change
        advice = f"declare {verdict.change} in model_io, if the authors' code agrees"
    evidence = verdict.document()
    return _finding(verdict.sentence, advice, expected=expected, got=verdict.replaced, evidence=evidence)


def _finding(message: str, advice: str, **more: Any) -> Finding:
    return Finding(message, path=sdk.File.POLICY_YML, fix=Fix("advice", advice), **more)
