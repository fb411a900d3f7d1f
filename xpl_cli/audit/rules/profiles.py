"""What an audit serves: the real model, or a shadow of it; and why."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Profile(StrEnum):
    """What a gate that serves the adapter runs on, and with it which rules are required.

    `full` loads the real model. `shadow` skips that and puts a function of the encoded inputs in place of `predict`:
    rules about the values of actions have nothing to judge then.
    """

    FULL = "full"
    SHADOW = "shadow"


@dataclass(frozen=True)
class Choice:
    """What a gate serves.

    Attributes:
        name: the profile.
        reason: why it is not the real model; None if it is, or if no more was asked for.
        env: environment of the adapter in place of the one that its manifest names, as for `xpl serve --env`.
    """

    name: Profile = Profile.FULL
    reason: str | None = None
    env: str | None = None

    @property
    def is_shadow(self) -> bool:
        """Whether a shadow of the model answers."""
        return self.name is Profile.SHADOW

    @property
    def sentence(self) -> str:
        """What a reader of the report has to know; empty where everything is real."""
        if not self.is_shadow:
            return ""
        told = "shadow mode: the model was not loaded, and rules that only the model can break do not apply"
        return f"{told} ({self.reason})" if self.reason else told

    @property
    def briefly(self) -> str:
        """The same in a few words."""
        return "without the model" if self.is_shadow else ""

    @property
    def mark(self) -> str:
        """The end of a finish line; empty where everything is real."""
        return f" profile={self.name}" if self.is_shadow else ""
