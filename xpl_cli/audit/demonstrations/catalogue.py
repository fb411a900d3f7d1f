"""All checks of demonstrations, by code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from xpl_cli.audit.demonstrations import motion, numbers, pictures
from xpl_cli.basics.errors import no_such

if TYPE_CHECKING:
    from xpl_cli.audit.demonstrations.check import DemonstrationCheck

CHECKS: Final[tuple[type[DemonstrationCheck], ...]] = tuple(
    sorted(
        (
            *(
                numbers.EpisodeSchema,
                numbers.TimeGaps,
                numbers.FiniteNumbers,
                numbers.ActionIsState,
                numbers.Instructions,
                numbers.ConstantNumbers,
            ),
            *(motion.JointLimits, motion.GripperRange, motion.QuaternionNorm, motion.QuaternionSign),
            *(pictures.FrameCount, pictures.FrozenFrames, pictures.MirroredCamera, pictures.SwappedColours),
        ),
        key=lambda check: check.code,
    )
)


def lookup(name: str) -> type[DemonstrationCheck] | None:
    """Return a check by its code or slug, None if there is none."""
    return next((check for check in CHECKS if name.upper() == check.code or name.lower() == check.slug), None)


def find(name: str) -> type[DemonstrationCheck]:
    """Return a check by its code or slug.

    Raises:
        UserError: with the nearest names.
    """
    found = lookup(name)
    if found is None:
        names = [key for check in CHECKS for key in (check.code, check.slug)]
        raise no_such(f"there is no check {name!r}", name, names, listing="xpl explain")
    return found
