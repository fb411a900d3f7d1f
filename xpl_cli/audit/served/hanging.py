"""What an audit says of an adapter that hangs: where it stands, and when it is asked no more."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.isolation.life import HUNG

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_FRAME = re.compile(r'\s*File "(?P<file>.+)", line (?P<line>\d+) in (?P<name>.+)')
_THREAD = re.compile(r"(Current t|T)hread 0x[0-9a-f]+")
_OFTEN_ENOUGH = 2
_MOST_S = {
    sdk.Deploy.MAX_CONNECT_SECONDS: 600.0,
    sdk.Deploy.REQUEST_TIMEOUT_S: 300.0,
    sdk.Deploy.CONNECT_TIMEOUT_S: 30.0,
    sdk.Deploy.HANDSHAKE_TIMEOUT_S: 60.0,
    sdk.Deploy.CLOSE_TIMEOUT_S: 30.0,
}
"""Longest deadlines that an audit grants, s, whatever deploy.yml says."""


class Hangs:
    """Counts how often an adapter hung, each time for as long as one may wait."""

    def __init__(self) -> None:
        self._reasons: list[str] = []

    def note(self, reason: str | None) -> None:
        """Note why a server ended by itself, or did not start."""
        if reason is not None and any(words in reason for words in HUNG):
            self._reasons.append(reason)

    def check(self) -> None:
        """Stop a rule that would wait once more.

        Raises:
            NotRun: if the adapter has hung often enough.
        """
        if len(self._reasons) >= _OFTEN_ENOUGH:
            raise NotRun(f"the adapter hung {len(self._reasons)} times and is served no more: {self._reasons[-1]}")


def bounds(config: Mapping[str, Any]) -> dict[str, float]:
    """Return deadlines in place of those of a configuration that have no end, or one that is too far."""
    return {key: most for key, most in _MOST_S.items() if key in config and not _bounded(config[key], most)}


def _bounded(value: Any, most: float) -> bool:
    if value is None:
        return False
    return not isinstance(value, (int, float)) or 0 < value <= most  # what is no number is refused by the server


def where(log: Iterable[str], folder: Path) -> str | None:
    """Return where an adapter stood when it printed its stacks last: file, line and function; None if it did not.

    Args:
        log: lines of output, with what `faulthandler` prints.
        folder: the adapter's; its own innermost line counts for more than a library's.
    """
    stacks: list[list[str]] = []
    for line in log:
        if _THREAD.match(line):
            stacks.append([])
        elif stacks and (found := _FRAME.match(line)):
            file = Path(found["file"])
            own = file.is_relative_to(folder)
            shown = file.relative_to(folder) if own else file.name
            stacks[-1].append(f"{'' if own else ' '}{shown}:{found['line']} in {found['name']}")
    frames = [frame for stack in reversed(stacks) for frame in stack]  # the main thread comes last
    return next((frame for frame in frames if frame[0] != " "), None)
