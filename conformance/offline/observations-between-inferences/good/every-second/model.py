"""What the model_io block converts, blended."""

import numpy as np

from xpl import Policy


class Model(Policy):
    """Mostly where it is, a little where it was two steps ago."""

    def predict(self, inputs, envs):
        """Return (B, H, 8)."""
        was, now = np.moveaxis(inputs["state"], 1, 0)
        return np.repeat((0.9 * now + 0.1 * was)[:, None], self.chunk, axis=1)
