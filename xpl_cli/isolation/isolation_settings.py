"""How far an adapter's processes are kept from the rest of the machine, as those who start them pass it on."""

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
"""How far an adapter is kept from what judges it."""


@dataclass(frozen=True)
class IsolationSettings:
    """What is asked for; nothing by default. May travel to another process.

    Attributes:
        isolate: no network, and nothing to write to but a temporary folder.
        apart: no other processes in sight, otherwise.
        proven: the way that was tried a moment ago, which need not be tried again.
    """

    isolate: bool = False
    apart: bool = False
    proven: str | None = None

    @classmethod
    def strictest(cls, folder: Path, *, isolate: bool) -> IsolationSettings:
        """Return the tightest bounds that this machine has, tried once; says so where adapters have to be trusted.

        Args:
            folder: a folder above the adapter's.
            isolate: whether it is to be isolated.

        Raises:
            UserError: if it is to be and cannot be; exit code 4.
        """
        return _strictest(folder, isolate)

    @property
    def name(self) -> str:
        """How episodes say it: `isolated`, `apart`, or `trusted` where neither can be had."""
        return ISOLATED if self.isolate else APART if self.apart else TRUSTED

    @property
    def flags(self) -> tuple[str, ...]:
        """The same as options of `xpl serve`."""
        kept = "--isolate" if self.isolate else "--apart"
        way = () if self.proven is None else ("--proven", self.proven)
        return (kept, *way) if self.isolate or self.apart else ()

    @contextlib.contextmanager
    def isolate_adapter(self, checkout: Path) -> Iterator[Isolation | None]:
        """Find the way to do it, for the length of a `with` block; None where nothing is asked for.

        Raises:
            UserError: if it cannot be had; exit code 4.
        """
        from xpl_cli.isolation import sandbox  # which is slow to import, and many only say that they ask for nothing

        if self.isolate:
            with sandbox.isolated(checkout, self.proven) as isolation:
                yield isolation
        else:
            yield sandbox.pid_isolation(checkout, self.proven) if self.apart else None


@cache
def _strictest(folder: Path, isolate: bool) -> IsolationSettings:  # noqa: FBT001 - what a cache is asked by
    from xpl_cli.basics import console

    try:
        with IsolationSettings(isolate=isolate, apart=not isolate).isolate_adapter(folder) as isolation:
            return IsolationSettings(isolate, not isolate, None if isolation is None else isolation.method)
    except UserError as error:
        if isolate:
            raise
        console.note(f"the adapter is trusted: {error}, so it may signal and end whatever you may")
        return IsolationSettings()
