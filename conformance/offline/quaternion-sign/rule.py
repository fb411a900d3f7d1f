"""XPL241: A quaternion and its negative give different actions, although the model always gets one sign."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.rotations import LARGE, rotation_difference, sign_sensitive_rotations
from xpl_cli.audit.offline.semantics import Episode, Semantics
from xpl_cli.audit.served.changed_inputs import antipodal, turned
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.model_io import names
from xpl_cli.packages.package import Package


@rule(code="XPL241", requirement="XPL-OBS-9", profile="full", tries="rotations")
def quaternion_sign(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A quaternion and its negative give different actions, although the model always gets one sign.

    ## What it does
    Applies if the block `model_io` of `policy.yml` declares which of q and -q the model gets (`sign: positive_w`,
    `sign: continuous`), or a form of rotation without a sign. Sends the same poses once with q and once with -q: in the
    first observation of an episode, in a pose that is rotated far, and in the second observation only. The actions must
    be the same motions. A model that was trained on unchanged signs may distinguish them. Without a block only
    `golden-parity` can judge.

    ## Why it matters
    Simulators and drivers change the sign arbitrarily, often in the middle of a motion. A model that was trained with w
    >= 0 treats the other sign as another pose, and jumps there.

    ## Example
    `state = np.concatenate([position, quaternion])` in `encode`, although the block declares `sign: positive_w`.

    ## Use instead
    The sign that the model was trained with: leave the conversion to the block, or write `quaternion if quaternion[0]
    >= 0 else -quaternion`. Do not change signs for a model that was trained on unchanged ones: for half of all poses
    its actions would differ from those of its authors' code.

    ## Fix safety
    No automatic fix.
    """
    _require_a_sign(probe.package)
    probe.require_answer()
    probe.require_repeatable()
    if semantics.posed is None:
        raise NotApplicable("neither actions nor required inputs are poses")
    first, second = (semantics.posed_observation(step) for step in (0, 1))
    far = turned(first, LARGE)
    pairs: dict[str, tuple[Episode, Episode]] = {
        "in the first observation": ((first,), (antipodal(first),)),
        "if an end effector is rotated far": ((far,), (antipodal(far),)),
        "from one observation to the next": ((first, second), (first, antipodal(second))),
    }
    answered = semantics.compare(list(pairs.values()), semantics.posed)
    if rotation_difference(answered[0][0], answered[1][0]) is None:
        raise NotApplicable("the actions do not depend on the orientation of an end effector, nor on its sign")
    for where, pair in zip(pairs, answered, strict=True):
        mismatch = rotation_difference(*pair)
        if mismatch is not None:
            yield blame(
                f"quaternions that change their sign {where} change the motion, although the model_io block "
                "declares that the model gets one sign",
                expected="the same action, up to the sign of its quaternions",
                got=mismatch,
                fix=Fix("advice", "convert to the block's sign in encode, or correct the block"),
            )
            return


def _require_a_sign(package: Package) -> None:
    """Stop where nobody says what sign the model was trained with.

    Raises:
        NotApplicable: if the block does not, or leaves poses to code.
    """
    model_io = package.manifest.model_io
    if not model_io and (package.path / names.PAIRS).is_file():
        raise NotApplicable("golden-parity compares the actions for both signs with the model's own")
    if not model_io:
        raise NotApplicable(
            "it is not declared how the model was trained on q and -q: no model_io block, no golden pairs"
        )
    state_parts = [part for entry in model_io.state for part in entry["parts"]]
    as_they_come = sign_sensitive_rotations(model_io)
    if as_they_come:
        raise NotApplicable(f"the model gets unchanged signs ({', '.join(as_they_come)}), and may distinguish them")
    if model_io.code and not any("rotation" in part for part in state_parts):
        raise NotApplicable("the model_io block leaves conversions to code, and does not declare their sign")
