"""How an adapter's processes are isolated from the rest of the machine."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from xpl_cli.isolation.sandbox import Isolation


ISOLATED, APART, TRUSTED = "isolated", "apart", "trusted"
"""Levels of isolation between an adapter and the tool that judges it."""


@dataclass(frozen=True)
class IsolationSettings:
    """The requested isolation, none by default. Can be pickled.

    Attributes:
        isolate: no network, and write access to a temporary folder only.
        apart: a PID namespace: other processes are invisible.
        proven: a method that was tested before and is not tested again.
    """

    isolate: bool = False
    apart: bool = False
    proven: str | None = None

    @classmethod
    def strictest(cls, folder: Path, *, isolate: bool) -> IsolationSettings:
        """Return the strictest isolation of this machine, tested once; prints a note where adapters are trusted.

        Args:
            folder: a folder above the adapter's.
            isolate: whether full isolation is requested.

        Raises:
            UserError: if it is requested and impossible; exit code 4.
        """
        return _strictest(folder, isolate)

    @property
    def name(self) -> str:
        """Name in records of episodes: `isolated`, `apart`, or `trusted` without either."""
        return ISOLATED if self.isolate else APART if self.apart else TRUSTED

    @property
    def flags(self) -> tuple[str, ...]:
        """The settings as options of `xpl serve`."""
        option = "--isolate" if self.isolate else "--apart"
        method = () if self.proven is None else ("--proven", self.proven)
        return (option, *method) if self.isolate or self.apart else ()

    @contextlib.contextmanager
    def isolate_adapter(self, checkout: Path) -> Iterator[Isolation | None]:
        """Yield the isolation of an adapter for a `with` block; None where none is requested.

        Raises:
            UserError: if it is impossible; exit code 4.
        """
        from xpl_cli.isolation import sandbox  # slow to import, and often not needed

        if self.isolate:
            with sandbox.isolated(checkout, self.proven) as isolation:
                yield isolation
        else:
            yield sandbox.pid_isolation(checkout, self.proven) if self.apart else None


@cache
def _strictest(folder: Path, isolate: bool) -> IsolationSettings:  # noqa: FBT001 - cache key
    from xpl_cli.basics import console

    try:
        with IsolationSettings(isolate=isolate, apart=not isolate).isolate_adapter(folder) as isolation:
            return IsolationSettings(isolate, not isolate, None if isolation is None else isolation.method)
    except UserError as error:
        if isolate:
            raise
        console.note(f"the adapter is trusted: {error}, so it may signal and kill all your processes")
        return IsolationSettings()
