"""Facts that rules need, injected by parameter name and computed once per target.

A provider is a function or a class whose parameters name the facts that it needs, or its path, `module:name`. A
generator cleans up after its yield, when the gate that first needed it has ended.
"""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any, Self

Provider = Callable[..., Any] | str
"""What computes a fact, or its path."""


class Facts:
    """The facts of one target.

    Args:
        initial: the first facts, by name.
        providers: the providers of all others, by name.
    """

    def __init__(self, initial: Mapping[str, Any], providers: Mapping[str, Provider]) -> None:
        self._values = dict(initial)
        self._failed: dict[str, Exception] = {}
        self._providers = providers
        self._cleanup = ExitStack()

    def add(self, name: str, value: Any) -> None:
        """Add a fact."""
        self._values[name] = value

    def get(self, name: str) -> Any:
        """Return a fact, computing it on first use.

        Raises:
            NotRun: if it is not available; or another exception of its provider. Every rule that needs it gets the same
                one.
        """
        if name in self._values:
            return self._values[name]
        if name in self._failed:
            raise self._failed[name]
        if name not in self._providers:
            message = f"no provider for the fact {name!r}; there are {', '.join(sorted(self._providers))}"
            raise LookupError(message)
        try:
            self._values[name] = self._compute(self._providers[name])
        except Exception as error:
            self._failed[name] = error
            raise
        return self._values[name]

    def computed(self, name: str) -> Any:
        """Return a fact if it was computed or added, else None."""
        return self._values.get(name)

    def records(self) -> list[str]:
        """Return the records of the target's behaviour by the computed facts (their `record`), for the digest."""
        recorded = ((name, getattr(fact, "record", None)) for name, fact in sorted(self._values.items()))
        return [f"{name} {record()}" for name, record in recorded if callable(record)]

    def call(self, function: Callable[..., Any]) -> Any:
        """Call a function with the facts that its parameters name."""
        return function(**{name: self.get(name) for name in fact_names(function)})

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
        self._values.clear()  # facts may refer to each other; this frees large ones without the garbage collector


def fact_names(function: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of the facts that a function needs."""
    return tuple(inspect.signature(function).parameters)
