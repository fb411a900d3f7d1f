"""The time limit for the audit of one package (`--time-limit`)."""

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
class TimeLimit:
    """The time limit of an audit.

    Attributes:
        text: the option as the user wrote it.
        seconds: the limit, s.
        until: its end, s of `time.monotonic`; infinite until it is started.
    """

    text: str = _NO_LIMIT
    seconds: float = math.inf
    until: float = math.inf

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse `90s`, `60m`, `2h` or `none`.

        Raises:
            UserError: if it is none of these.
        """
        stripped = text.strip()
        if stripped.lower() == _NO_LIMIT:
            return cls()
        match = _TIME.fullmatch(stripped)
        if match is None or not float(match[1]):
            raise UserError(f"--time-limit takes a time such as 90s, 60m or 2h, or none; got {text!r}")
        return cls(stripped, float(match[1]) * _SECONDS[(match[2] or "").lower()])

    def started(self) -> TimeLimit:
        """Return the same limit, running from now."""
        return TimeLimit(self.text, self.seconds, time.monotonic() + self.seconds)

    @property
    def remaining(self) -> float:
        """Remaining seconds."""
        return self.until - time.monotonic()

    def check(self) -> None:
        """Stop a rule when the limit is reached.

        Raises:
            NotRun: if it is reached.
        """
        if self.remaining <= 0:
            raise NotRun(f"the audit's time is over: {self.text} for each package (--time-limit)")
