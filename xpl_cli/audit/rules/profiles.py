"""Profiles of an audit: with the real model, or in shadow mode."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Profile(StrEnum):
    """Whether a gate serves the real model, which decides which rules are required.

    `full` loads the real model. `shadow` replaces `predict` by a function of the encoded inputs: rules about the values
    of actions then do not apply.
    """

    FULL = "full"
    SHADOW = "shadow"


@dataclass(frozen=True)
class ServedProfile:
    """The profile that a gate serves.

    Attributes:
        name: the profile.
        reason: why it is not the real model; None if it is, or if the user chose the shadow.
        env: environment of the adapter in place of the one that its manifest names, as for `xpl serve --env`.
        lacks: kinds of what the real model lacks here, such as `module`.
    """

    name: Profile = Profile.FULL
    reason: str | None = None
    env: str | None = None
    lacks: tuple[str, ...] = ()

    @property
    def is_shadow(self) -> bool:
        """Whether the model is replaced by a shadow."""
        return self.name is Profile.SHADOW

    @property
    def sentence(self) -> str:
        """A note for the report; empty with the real model."""
        if not self.is_shadow:
            return ""
        note = "shadow mode: the model was not loaded, and rules that only the model can break do not apply"
        return f"{note} ({self.reason})" if self.reason else note

    @property
    def short_note(self) -> str:
        """The same in a few words."""
        return "without the model" if self.is_shadow else ""

    @property
    def mark(self) -> str:
        """The end of a finish line; empty with the real model."""
        return f" profile={self.name}" if self.is_shadow else ""
