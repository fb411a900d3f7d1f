"""Choice of Vulkan's driver: SAPIEN loads the visuals of a scene even if no camera renders."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

from xpl.rendering.errors import RendererMissingError

VULKAN_COMPLAINTS = ("rendering device", "vk::")
"""Parts of SAPIEN's error messages if Vulkan has no device, or no driver."""

_MESA = "XPL_MESA"  # environment variable with the folder that `mesa.sh` installed into
_DEFAULT = "~/.cache/xpl/mesa"
_SCRIPT = 'bash "$(xpl env path maniskill)/mesa.sh"'
_DRIVER = "lvp_icd.json"
_OWN = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")  # Vulkan's variables, the second by its older name


def choose_vulkan() -> None:
    """Let Vulkan use Mesa's CPU driver if `mesa.sh` installed it, unless Vulkan's own variables name another driver.

    Call this before any import of SAPIEN. Without either, Vulkan searches the system's drivers.

    Raises:
        RendererMissingError: `XPL_MESA` names a folder without a driver.
    """
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")  # SAPIEN brings one
    if any(os.environ.get(name) for name in _OWN):
        return
    named = os.environ.get(_MESA)
    driver = Path(named or _DEFAULT).expanduser() / _DRIVER
    if driver.is_file():
        os.environ[_OWN[1]] = str(driver)
    elif named:
        raise RendererMissingError(f"{_MESA} names {named}, which has no {_DRIVER}: {_SCRIPT} installs one")


def no_vulkan(simulator: str, error: Exception) -> RendererMissingError:
    """Return the error of a machine on which SAPIEN finds no Vulkan device."""
    return RendererMissingError(
        f"{simulator} needs a Vulkan device even without cameras, and SAPIEN found none that it can use ({error}): "
        f"without a GPU, `{_SCRIPT}` installs Mesa's CPU driver (that of Debian 12 is too old)"
    )
