"""What an audit is asked to do."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from xpl_cli.audit.model import Gate
from xpl_cli.progress import Progress


@dataclass(frozen=True)
class Options:
    """One request.

    Attributes:
        gates: gates to run, in order.
        names, ignore: codes, code prefixes and slugs of rules to run and to leave out.
        keep_going: run a gate although an earlier one failed.
        overrides: keys of deploy.yml for the gates that serve the adapter.
        python, env: interpreter of the adapter, as for `xpl serve`.
        cache: folder with passes of the static gate (`xpl_cli.audit.cache`); None to run every rule.
        progress: told what is being done, for a person who waits.
    """

    gates: tuple[Gate, ...] = tuple(Gate)
    names: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()
    keep_going: bool = False
    overrides: dict[str, Any] = field(default_factory=dict)
    python: str | None = None
    env: str | None = None
    cache: Path | None = None
    progress: Progress = field(default_factory=Progress)
