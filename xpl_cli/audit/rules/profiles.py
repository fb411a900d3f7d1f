"""What an audit serves: the real model, a shadow of it, or one whose missing modules are stubbed; and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from xpl_cli.serving.stand_in import StandIn


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
        stand_in: what is not real.
        reason: why not everything is; None if it is, or if no more was asked for.
        env: environment of the adapter in place of the one that its manifest names, as for `xpl serve --env`.
        stubbed: modules that were stubbed.
    """

    name: Profile = Profile.FULL
    stand_in: StandIn = field(default_factory=StandIn)
    reason: str | None = None
    env: str | None = None
    stubbed: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """What a reader of the report has to know; empty where everything is real."""
        what = []
        if self.stand_in.shadow:
            what.append("shadow mode: the model was not loaded, and rules that only the model can break do not apply")
        if self.stubbed:
            what.append(f"{'stand-ins for' if self.has_kit else 'stubbed:'} {', '.join(self.stubbed)}")
        return "; ".join(what) + (f" ({self.reason})" if what and self.reason else "")

    @property
    def briefly(self) -> str:
        """The same in a few words."""
        what = ["without the model"] if self.stand_in.shadow else []
        kind = "stand-ins" if self.has_kit else "stubs"
        return ", ".join([*what, *([f"{kind} for {', '.join(self.stubbed)}"] if self.stubbed else [])])

    @property
    def has_kit(self) -> bool:
        """Whether what was not here was stood in for by more than stubs (`xpl.worker.standins`)."""
        return self.stand_in.shadow and not self.stand_in.stub_missing

    @property
    def is_made_of_stubs(self) -> bool:
        """Whether a model was loaded, but not out of real modules only."""
        return bool(self.stubbed) and not self.stand_in.shadow

    @property
    def is_made_up(self) -> bool:
        """Whether what an adapter wraps was stood in for, so that nobody knows what the real one would answer."""
        return self.has_kit and bool(self.stubbed)

    @property
    def mark(self) -> str:
        """The end of a finish line; empty where everything is real."""
        shadow = f" profile={self.name}" if self.stand_in.shadow else ""
        return shadow + (f" stubbed={','.join(self.stubbed)}" if self.stubbed else "")
