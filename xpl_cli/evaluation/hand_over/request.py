"""Request and plan of a hand-over to a benchmark's own launcher."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from xpl.contract import Config
    from xpl.manifest import EnvManifest
    from xpl_cli.evaluation.hand_over.launcher import Launcher
    from xpl_cli.packages.package import Package


@dataclass(frozen=True)
class HandOverRequest:
    """What to hand over.

    Attributes:
        package: the adapter.
        environment: name of the environment package, or its folder.
        task: of the benchmark; deploy.yml's or the first by default.
        episodes: number; the benchmark may have fewer.
        workspace: folder of the benchmark; None for the environment variable's.
        rehearse: whether to run the mock launcher.
        out: folder of the record; None for none.
        resume: whether the run in `out` continues.
        connect: address of a running policy server; None serves the adapter.
        overrides: keys of deploy.yml.
        python, env, gpu: interpreter and device of the adapter.
        eval_env: environment whose `python` the launcher finds first; None for no change.
        env_gpu: device of the simulator.
        hours: timeout of the launcher.
    """

    package: Package
    environment: str
    task: str | None = None
    episodes: int = 1
    workspace: Path | None = None
    rehearse: bool = False
    out: Path | None = None
    resume: bool = False
    connect: str | None = None
    overrides: Config = field(default_factory=dict)
    python: str | None = None
    env: str | None = None
    gpu: str | None = None
    eval_env: str | None = None
    env_gpu: str = "0"
    hours: float = 72.0


@dataclass(frozen=True)
class HandOverPlan:
    """What a hand-over would do.

    Attributes:
        folder: of the environment package.
        facts: its env.yml.
        launcher: as declared there.
        config: the adapter's configuration.
        values: values of the names in words, but for the server's address.
        workspace: folder of the benchmark; None for a rehearsal.
    """

    folder: Path
    facts: EnvManifest
    launcher: Launcher
    config: Config
    values: Mapping[str, str]
    workspace: Path | None

    def words(self, host: str, port: str) -> list[str]:
        """Return the command line."""
        values = {**self.values, "server_ip": host, "port": port}
        return self.launcher.words(values, rehearse=self.workspace is None)
