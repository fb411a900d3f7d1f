"""Where things come from, what they share, and what they are worth."""

from __future__ import annotations

from typing import Any, Callable, NoReturn

from xpl.worker.lacking import StandInError
from xpl.worker.standins import facts as known
from xpl.worker.standins.given import Given, Memory


class StubError(StandInError):
    """Something was asked of a stand-in that only the real one can give."""

    kind = "stub"


class World:
    """What all things of a process share.

    Attributes:
        facts: sizes, or None where things are mere stubs without any worth.
        serving: whether what is passed on now is what the adapter is shown, rather than its configuration.
        value: makes an array, or a tensor, of a thing that holds data; set by `xpl.worker.standins.values`.
        makes: what knows more of some names; finds a function for a dotted name.
        failed: what was asked in vain.
        documents: names that the adapter reads; what a map is taken to hold, where all of it is asked for.
    """

    def __init__(self) -> None:
        self.facts: known.Facts | None = None
        self.serving = False
        self.value: Callable[[Any], Any] | None = None
        self.makes: Callable[[str], Callable[..., Any] | None] = lambda _: None
        self.failed: list[str] = []
        self.documents: tuple[str, ...] = ()


WORLD = World()


class Origin:
    """Where a thing comes from.

    Attributes:
        name: dotted, with () for calls and [...] for elements.
        memory: what the object that it is a part of was given.
        given: what went into it, None where nothing did.
        keys: what was looked up in what a call gave.
        is_text: whether it was read from a file of text, which has lists for arrays.
        is_name: whether it was imported or is an attribute of what was, and was not made by a call.
    """

    __slots__ = ("given", "is_name", "is_text", "keys", "memory", "name")

    def __init__(
        self,
        name: str,
        memory: Memory,
        given: Given | None = None,
        keys: tuple[Any, ...] = (),
        *,
        is_name: bool = False,
        is_text: bool = False,
    ) -> None:
        self.name, self.memory, self.given, self.keys, self.is_name = name, memory, given, keys, is_name
        self.is_text = is_text

    @property
    def owner(self) -> str:
        """The class that an object was made of, also by `from_pretrained`; the last part of any other name."""
        return self.name.rpartition(".from_pretrained")[0].rpartition(".")[2] or self.last

    @property
    def last(self) -> str:
        """The last part of the name, without calls and elements."""
        if self.keys and isinstance(self.keys[-1], str):
            return self.keys[-1]
        return self.name.replace("[...]", "").rpartition(".")[2].partition("(")[0].partition("[")[0]


def refuse(name: str, what: str) -> NoReturn:
    """Raise, and remember it.

    Raises:
        StubError: always.
    """
    message = f"{name} has no {what}: {name.partition('.')[0]} is not installed here, and stubbed"
    WORLD.failed.append(message)
    raise StubError(message)


def origin(thing: Any) -> Origin:
    """Return where a thing comes from; what derives from one gets an origin when it is asked first."""
    found: Origin | None = thing.__dict__.get("_xpl_origin")
    if found is None:
        found = Origin(type(thing).__name__, Memory())
        thing.__dict__["_xpl_origin"] = found
    return found


def holds(thing: Any) -> bool:
    """Tell whether anything was put into a thing."""
    told = getattr(thing, "__dict__", {}).get("_xpl_origin") if not isinstance(thing, type) else None
    return told is not None and told.given is not None


def value(thing: Any) -> Any:
    """Return the array, the tensor or the number that a thing stands for, None if there is none."""
    told = origin(thing)
    if told.given is not None and WORLD.value is not None:
        return WORLD.value(thing)
    if WORLD.facts is None:
        return None
    last = str(told.keys[-1]) if told.keys and isinstance(told.keys[-1], str) else told.last
    found = WORLD.facts.worth(last, ".".join([told.name, *map(str, told.keys[:-1])]))
    return found.tolist() if told.is_text and hasattr(found, "tolist") else found
