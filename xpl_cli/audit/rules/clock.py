"""How long the audit of one package may take in all."""

from __future__ import annotations

import math
import re
import time
from dataclasses import dataclass
from typing import Self

from xpl_cli.audit.rules.model import NotRun
from xpl_cli.basics.errors import UserError

_SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
_TIME = re.compile(r"(\d+(?:\.\d+)?)\s*(s|m|min|h)?", re.IGNORECASE)
_NO_LIMIT = "none"
DEFAULT = "60m"


@dataclass(frozen=True)
class Clock:
    """The time that an audit has.

    Attributes:
        asked: what the user wrote.
        seconds: the time in all.
        until: when it is over, s of `time.monotonic`; without end until it is started.
    """

    asked: str = _NO_LIMIT
    seconds: float = math.inf
    until: float = math.inf

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the clock that `90s`, `60m`, `2h` or `none` stands for.

        Raises:
            UserError: if it is none of these.
        """
        asked = text.strip()
        if asked.lower() == _NO_LIMIT:
            return cls()
        found = _TIME.fullmatch(asked)
        if found is None or not float(found[1]):
            raise UserError(f"--time-limit takes a time such as 90s, 60m or 2h, or none; got {text!r}")
        return cls(asked, float(found[1]) * _SECONDS[(found[2] or "").lower()])

    def started(self) -> Clock:
        """Return the same clock, running from now."""
        return Clock(self.asked, self.seconds, time.monotonic() + self.seconds)

    @property
    def left(self) -> float:
        """Seconds that are left."""
        return self.until - time.monotonic()

    def check(self) -> None:
        """Stop a rule when the time is over.

        Raises:
            NotRun: if it is.
        """
        if self.left <= 0:
            raise NotRun(f"the audit's time is over: {self.asked} for each package (--time-limit)")
