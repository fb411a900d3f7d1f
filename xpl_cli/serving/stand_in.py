"""What stands in for a model, or for modules that are not there, while an adapter is served."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class StandIn:
    """What is not real; nothing by default.

    Attributes:
        shadow: the model is not loaded, a function of its inputs answers (`xpl.worker.shadow`).
        stub_missing: third-party modules that cannot be imported are stubbed (`xpl.worker.stubs`).
    """

    shadow: bool = False
    stub_missing: bool = False

    @property
    def message(self) -> dict[str, bool]:
        """What the worker is told when it loads the adapter."""
        return {name: True for name, wanted in asdict(self).items() if wanted}

    @property
    def flags(self) -> list[str]:
        """Options of `xpl serve`."""
        return [f"--{name.replace('_', '-')}" for name in self.message]
