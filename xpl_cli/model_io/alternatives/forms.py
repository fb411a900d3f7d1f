"""What pixels are to models: the numbers of black and white, as they were met."""

from __future__ import annotations

MEANS: dict[str, tuple[list[float], list[float]]] = {
    "ImageNet's": ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]),
    "CLIP's": ([0.48145466, 0.4578275, 0.40821073], [0.26862954, 0.26130258, 0.27577711]),
    "0.5": ([0.5, 0.5, 0.5], [0.5, 0.5, 0.5]),
}
"""Mean and standard deviation by channel, red first."""

RANGES: tuple[tuple[int, list[float]], ...] = (
    (0, [0, 1]),
    (0, [-1, 1]),
    (1, [0, 255]),
    (2, [-0.5, 0.5]),
)
"""By likelihood, what 0 and 255 become."""
