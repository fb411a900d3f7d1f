"""Errors that a user can act on, and the exit codes of every command."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from collections.abc import Iterable

_MOST_LISTED: Final = 40
_NEAR: Final = 0.5


class ExitCode(IntEnum):
    """Exit codes of `xpl`, the same for every command; source of help and documentation.

    Attributes:
        meaning: in a few words.
    """

    meaning: str

    def __new__(cls, value: int, meaning: str = "") -> Self:
        """Return a code with its meaning."""
        code = int.__new__(cls, value)
        code._value_ = value
        code.meaning = meaning
        return code

    CLEAN = 0, "clean"
    FINDINGS = 1, "findings"
    USAGE = 2, "usage"
    NOT_FOUND = 3, "target not found"
    NOT_RUN = 4, "a required check could not run"
    INTERNAL = 5, "internal error"
    INTERRUPTED = 130, "interrupted"


class UserError(Exception):
    """An error that the user can act on, explained in one sentence.

    Args:
        message: what was expected, what came and where.
        hint: what to do about it.
        code: exit code of the command.
    """

    def __init__(self, message: str, *, hint: str | None = None, code: ExitCode = ExitCode.USAGE) -> None:
        super().__init__(message)
        self.hint = hint
        self.code = code

    def details(self) -> dict[str, object]:
        """Return the additional entries of `xpl.error/1`."""
        return {}


class NotFoundError(UserError):
    """The target of a command does not exist."""

    def __init__(self, message: str, *, hint: str | None = None) -> None:
        super().__init__(message, hint=hint, code=ExitCode.NOT_FOUND)


class UnknownNameError(UserError):
    """An unknown name.

    Args:
        message: one sentence, which lists the known names if they are few.
        given: the name.
        known: the known names.
        listing: command that lists the known names.
    """

    ends_with = ExitCode.USAGE

    def __init__(self, message: str, given: str, known: Iterable[str], *, listing: str | None = None) -> None:
        self.given, self.known = given, tuple(known)
        self.nearest = nearest_of(given, self.known)
        lists = f"`{listing}` lists them" if listing else None
        hint = f"did you mean {' or '.join(self.nearest)}?" if self.nearest else lists
        UserError.__init__(self, message, hint=hint, code=self.ends_with)

    def details(self) -> dict[str, object]:
        """Return the name, the known names unless they are many, and the nearest of them."""
        return {
            "given": self.given,
            "choices": list(self.known) if len(self.known) <= _MOST_LISTED else [],
            "nearest": list(self.nearest),
        }


class UnknownTargetError(UnknownNameError, NotFoundError):
    """The target of a command is unknown."""

    ends_with = ExitCode.NOT_FOUND


def no_such(
    sentence: str,
    given: str,
    known: Iterable[str],
    *,
    listing: str | None = None,
    kind: type[UnknownNameError] = UnknownNameError,
) -> UnknownNameError:
    """Return the error for an unknown name; its message lists the known names if they are few."""
    known = tuple(known)
    names = ", ".join(known) or "none"
    message = sentence if len(known) > _MOST_LISTED else f"{sentence}; there are: {names}"
    return kind(message, given, known, listing=listing)


def one_of(option: str, given: str, known: Iterable[str]) -> str:
    """Validate the value of an option against a list of names.

    Raises:
        UnknownNameError: if it is not in the list.
    """
    known = tuple(known)
    if given not in known:
        raise UnknownNameError(f"{option} must be one of {', '.join(known)}; got {given!r}", given, known)
    return given


def nearest_of(given: str, known: Iterable[str], most: int = 3) -> tuple[str, ...]:
    """Return the most similar known names, the nearest first."""
    from xpl.nearest import nearest

    return tuple(nearest(given, known, most, _NEAR))
