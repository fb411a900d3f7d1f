"""Which observations an input of the model shows: how many, how far apart, in which order, and what stands for none."""

from __future__ import annotations

from dataclasses import dataclass

from xpl.document import Document, many, one


@dataclass(frozen=True)
class History(Document):
    """Earlier observations that the model sees, too; what is open has its default."""

    length: int = one(int, 1)
    stride: int = one(int, 1)
    order: str = one(str, "oldest_first")
    pad: str = one(str, "repeat")
    mask: str | None = one(str)
    of: tuple[str, ...] = many(str, ("images", "state"))

    @property
    def reach(self) -> int:
        """Control steps that it reaches over, the newest observation included."""
        return (self.length - 1) * self.stride + 1

    @property
    def newest(self) -> int:
        """Which of its observations is the newest: 0, or -1 for the last."""
        return 0 if self.order == "newest_first" else -1

    @property
    def ages(self) -> list[int]:
        """How many control steps ago each of its observations was, in its own order; the newest has 0."""
        ages = [index * self.stride for index in range(self.length)]
        return ages if self.newest == 0 else ages[::-1]

    @property
    def pads_with_zeros(self) -> bool:
        """Whether zeros stand for what was before the first observation; else that one is repeated."""
        return self.pad == "zeros"
