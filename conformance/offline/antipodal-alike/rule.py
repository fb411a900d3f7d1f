"""XPL241: A quaternion and its negative, which are one rotation, are answered differently."""

from __future__ import annotations

from collections.abc import Iterator

from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.rotations import LARGE, rotation_difference
from xpl_cli.audit.offline.semantics import Episode, Semantics
from xpl_cli.audit.served.inputs import antipodal, turned
from xpl_cli.audit.served.probe import Probe, blame


@rule(code="XPL241", requirement="XPL-OBS-9", profile="full")
def antipodal_alike(probe: Probe, semantics: Semantics) -> Iterator[Finding]:
    """A quaternion and its negative, which are one rotation, are answered differently.

    ## What it does
    Shows the same poses once with q and once with -q: in the first observation of an episode, in a pose that is turned
    far, and in the second observation only. The actions must be the same motions.

    ## Why it matters
    Simulators and drivers change the sign at will, often in the middle of a motion. A policy that takes this for
    another pose jumps there; an average of both is no rotation at all.

    ## Example
    `state = np.concatenate([position, quaternion])`, given to a network that was trained with qw >= 0.

    ## Use instead
    One sign before encoding, `quaternion * np.sign(quaternion[0])`, or a rotation matrix (`xpl.rotation.to_matrix`).

    ## Fix safety
    No automatic fix.
    """
    probe.ready()
    probe.require_repeatable()
    if semantics.posed is None:
        raise NotApplicable("neither actions nor required inputs are poses")
    first, second = (semantics.posed_observation(step) for step in (0, 1))
    far = turned(first, LARGE)
    pairs: dict[str, tuple[Episode, Episode]] = {
        "in the first observation": ((first,), (antipodal(first),)),
        "where an end effector is turned far": ((far,), (antipodal(far),)),
        "from one observation to the next": ((first, second), (first, antipodal(second))),
    }
    answered = semantics.compare(list(pairs.values()), semantics.posed)
    for where, pair in zip(pairs, answered, strict=True):
        found = rotation_difference(*pair)
        if found is not None:
            yield blame(
                f"quaternions that change their sign {where} change the motion, although the poses are the same",
                expected="the same action, up to the sign of its quaternions",
                got=found,
                fix=Fix("advice", "bring quaternions to one sign in encode, or encode rotation matrices"),
            )
            return
