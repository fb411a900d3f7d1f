"""What an audit is asked to do."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.audit.rules.clock import Clock
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.basics.progress import Progress
from xpl_cli.isolation.isolation_settings import IsolationSettings

if TYPE_CHECKING:
    from xpl.contract import Config
    from xpl_cli.audit.rules.profiles import Profile

PATIENCE_S = 30.0


@dataclass(frozen=True)
class Options:
    """One request.

    Attributes:
        gates: gates to run, in order.
        names, ignore: codes, code prefixes and slugs of rules to run and to leave out.
        keep_going: run a gate although an earlier one failed.
        overrides: keys of deploy.yml for the gates that serve the adapter.
        python, env: interpreter of the adapter, as for `xpl serve`.
        profile: what the gates that serve the adapter run on; None for the full one, or where the model cannot be
            loaded here for want of something, the shadow.
        profile_reason: why an earlier gate chose the shadow; None if it was asked for.
        memory_limit: what the adapter's processes may hold, as for `xpl serve`.
        isolate: keep the adapter from the network and from writing.
        bounds: what it is kept from in this gate, as far as the machine allows.
        patience: how long it may be silent while it loads or answers, s.
        clock: how long the audit of one package may take.
        tasks: tasks in which the physics gate drives the adapter; empty for its own choice.
        episodes: whole episodes over which it measures success; None for what the manifest claims, or else a few.
        move: whether environments that may be robots are reset and moved.
        demos: folder or file of recorded episodes that a policy is held against; None for what the package names.
        pictures: folder for pictures of findings; None to write none.
        video: folder for films of what it plays; None to film nothing.
        cache: folder with passes of the static gate (`xpl_cli.audit.engine.cache`); None to run every rule.
        progress: told what is being done, for a person who waits.
    """

    gates: tuple[Gate, ...] = tuple(Gate)
    names: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    keep_going: bool = False
    overrides: Config = field(default_factory=dict)
    python: str | None = None
    env: str | None = None
    profile: Profile | None = None
    profile_reason: str | None = None
    memory_limit: str = "none"
    isolate: bool = False
    bounds: IsolationSettings = field(default_factory=IsolationSettings)
    patience: float = PATIENCE_S
    clock: Clock = field(default_factory=Clock)
    tasks: tuple[str, ...] = ()
    episodes: int | None = None
    move: bool = False
    demos: Path | None = None
    pictures: Path | None = None
    video: Path | None = None
    cache: Path | None = None
    progress: Progress = field(default_factory=Progress)

    @property
    def variant(self) -> str | None:
        """The variant of policy.yml that is audited; None for what deploy.yml says, or else the policy itself."""
        return self.overrides.get(sdk.Deploy.VARIANT)

    @property
    def confinement(self) -> tuple[str, ...]:
        """Options of `xpl serve` that keep the adapter within bounds."""
        return ("--memory-limit", self.memory_limit, "--patience", f"{self.patience:g}", *self.bounds.flags)
