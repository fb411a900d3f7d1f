"""Limits for adapters that hang: how often an audit tries, and how long it waits."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.isolation.hang_detector import HUNG

if TYPE_CHECKING:
    from collections.abc import Mapping

_OFTEN_ENOUGH = 2
_MOST_S = {
    sdk.Deploy.MAX_CONNECT_SECONDS: 600.0,
    sdk.Deploy.REQUEST_TIMEOUT_S: 300.0,
    sdk.Deploy.CONNECT_TIMEOUT_S: 30.0,
    sdk.Deploy.HANDSHAKE_TIMEOUT_S: 60.0,
    sdk.Deploy.CLOSE_TIMEOUT_S: 30.0,
}
"""Longest deadlines that an audit grants, s, whatever deploy.yml says."""


class HangCounter:
    """Counts how often an adapter hung until a timeout."""

    def __init__(self) -> None:
        self._reasons: list[str] = []

    def note(self, reason: str | None) -> None:
        """Record why a server ended by itself, or did not start."""
        if reason is not None and any(words in reason for words in HUNG):
            self._reasons.append(reason)

    def check(self) -> None:
        """Stop a rule that would wait once more.

        Raises:
            NotRun: if the adapter has hung often enough.
        """
        if len(self._reasons) >= _OFTEN_ENOUGH:
            raise NotRun(f"the adapter hung {len(self._reasons)} times and is served no more: {self._reasons[-1]}")


def bounded_timeouts(config: Mapping[str, object]) -> dict[str, float]:
    """Return limits for the timeouts of a configuration that are infinite or too long."""
    return {key: most for key, most in _MOST_S.items() if key in config and not _is_bounded(config[key], most)}


def _is_bounded(value: object, most: float) -> bool:
    if value is None:
        return False
    return not isinstance(value, (int, float)) or 0 < value <= most  # the server refuses values that are not numbers
