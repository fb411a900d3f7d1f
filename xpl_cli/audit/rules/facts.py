"""Facts: what rules need to know, injected by parameter name and computed once per target.

A provider is a function or a class whose parameters name the facts it needs, or the path of one, `module:name`. One
that yields cleans up after the yield, when the gate that first needed it has ended.
"""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any, Self

Provider = Callable[..., Any] | str
"""What computes a fact, or where it is found."""


class Facts:
    """The facts of one target.

    Args:
        given: facts that are known from the start, by name.
        providers: what computes further ones, by name.
    """

    def __init__(self, given: Mapping[str, Any], providers: Mapping[str, Provider]) -> None:
        self._known = dict(given)
        self._failed: dict[str, Exception] = {}
        self._providers = providers
        self._cleanup = ExitStack()

    def give(self, name: str, value: Any) -> None:
        """Add a fact that is known."""
        self._known[name] = value

    def get(self, name: str) -> Any:
        """Return a fact, computing it on first use.

        Raises:
            NotRun: if it cannot be had, or whatever else its provider raised; every rule that needs it hears the same.
        """
        if name in self._known:
            return self._known[name]
        if name in self._failed:
            raise self._failed[name]
        if name not in self._providers:
            message = f"no provider for the fact {name!r}; there are {', '.join(sorted(self._providers))}"
            raise LookupError(message)
        try:
            self._known[name] = self._compute(self._providers[name])
        except Exception as error:
            self._failed[name] = error
            raise
        return self._known[name]

    def known(self, name: str) -> Any:
        """Return a fact if it was computed or given, else None."""
        return self._known.get(name)

    def records(self) -> list[str]:
        """Return what the computed facts recorded of the target's behaviour (their `record`), for the digest."""
        recorded = ((name, getattr(fact, "record", None)) for name, fact in sorted(self._known.items()))
        return [f"{name} {record()}" for name, record in recorded if callable(record)]

    def call(self, function: Callable[..., Any]) -> Any:
        """Call a function with the facts that its parameters name."""
        return function(**{name: self.get(name) for name in wanted(function)})

    def _compute(self, provider: Provider) -> Any:
        compute: Callable[..., Any] = pkgutil.resolve_name(provider) if isinstance(provider, str) else provider
        if not inspect.isgeneratorfunction(compute):
            return self.call(compute)

        @contextmanager
        def managed() -> Iterator[Any]:
            yield from self.call(compute)

        return self._cleanup.enter_context(managed())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._cleanup.close()
        self._known.clear()  # facts may refer to each other; large ones shall not wait for the garbage collector


def wanted(function: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of the facts that a function asks for."""
    return tuple(inspect.signature(function).parameters)
