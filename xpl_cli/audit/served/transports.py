"""Encodings of images on the wire, and the error of each."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Final

import numpy as np

from xpl import _spec as sdk
from xpl import image_codec

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from xpl.contract import ObservationDict
    from xpl_cli.audit.served.probe import Probe


def _legacy_jpeg(image: np.ndarray) -> bytes:
    """Return a JPEG as older writers make it: without the marker, red and blue swapped."""
    from PIL import Image

    target = io.BytesIO()
    exchanged = np.ascontiguousarray(image[:, :, ::-1])
    Image.fromarray(exchanged).save(target, "JPEG", quality=image_codec.DEFAULT_QUALITY)
    return target.getvalue()


LEGACY: Final = "legacy JPEG"
"""The only encoding that adapters without the SDK get."""
FORMS: Final[Mapping[str, Callable[[np.ndarray], bytes]]] = {
    "marked JPEG": image_codec.encode_jpeg,
    LEGACY: _legacy_jpeg,
    "true-RGB PNG": image_codec.encode_png,
}
"""Encoders of (H, W, 3) uint8 RGB images by name."""


def encoded(obs: ObservationDict, form: str) -> ObservationDict:
    """Return an observation with every image in one of the `FORMS`."""
    encode = FORMS[form]
    return _each_picture(obs, encode)


def decoded(obs: ObservationDict) -> ObservationDict:
    """Return an observation with every image decoded as the standard says."""
    return _each_picture(obs, image_codec.decode)


def error_of(obs: ObservationDict, other: ObservationDict) -> int:
    """Return the largest difference between the images of two observations, 0 to 255."""
    pairs = ((camera, other[sdk.Obs.VISION][name]) for name, camera in obs[sdk.Obs.VISION].items())
    return max(
        int(np.abs(np.subtract(one[sdk.Camera.COLOR], two[sdk.Camera.COLOR], dtype=np.int16)).max())
        for one, two in pairs
    )


def sees_pictures(probe: Probe) -> bool:
    """Tell whether an adapter may read a camera: its manifest declares one, or declares no inputs."""
    inputs = probe.package.manifest.inputs
    if inputs is None:
        return True
    return any(name.partition(".")[0] == sdk.Obs.VISION for name in inputs.read)


def _each_picture(obs: ObservationDict, change: Callable[[np.ndarray], object]) -> ObservationDict:
    vision = {
        name: {**camera, sdk.Camera.COLOR: change(camera[sdk.Camera.COLOR])}
        for name, camera in obs[sdk.Obs.VISION].items()
    }
    return {**obs, sdk.Obs.VISION: vision}
