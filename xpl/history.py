"""Observation history of a model input: length, stride, order and padding."""

from __future__ import annotations

from dataclasses import dataclass

from xpl.document import Document, list_field, value_field


@dataclass(frozen=True)
class History(Document):
    """History of a model input; a missing value has its default."""

    length: int = value_field(int, 1)
    stride: int = value_field(int, 1)
    order: str = value_field(str, "oldest_first")
    pad: str = value_field(str, "repeat")
    mask: str | None = value_field(str)
    of: tuple[str, ...] = list_field(str, ("images", "state"))

    @property
    def reach(self) -> int:
        """Number of control steps that it spans, including the newest observation."""
        return (self.length - 1) * self.stride + 1

    @property
    def newest(self) -> int:
        """Index of its newest observation: 0 or -1."""
        return 0 if self.order == "newest_first" else -1

    @property
    def ages(self) -> list[int]:
        """Age of each of its observations in control steps, in its order; the newest has 0."""
        ages = [index * self.stride for index in range(self.length)]
        return ages if self.newest == 0 else ages[::-1]

    @property
    def pads_with_zeros(self) -> bool:
        """Whether padding before the first observation is zeros; otherwise that observation is repeated."""
        return self.pad == "zeros"
