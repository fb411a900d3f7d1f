"""Where Vulkan's driver comes from: SAPIEN loads what a scene looks like even where nobody looks at it."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

from xpl.rendering.errors import RendererMissingError

VULKAN_COMPLAINTS = ("rendering device", "vk::")
"""What errors of SAPIEN say where Vulkan has no device, or no driver."""

_MESA = "XPL_MESA"  # variable with the folder that `mesa.sh` filled
_DEFAULT = "~/.cache/xpl/mesa"
_SCRIPT = 'bash "$(xpl env path maniskill)/mesa.sh"'
_DRIVER = "lvp_icd.json"
_OWN = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")  # Vulkan's variables, the second by its older name


def choose_vulkan() -> None:
    """Let Vulkan find Mesa's driver for processors where `mesa.sh` put one, unless Vulkan's own variables name another.

    Call this before anything imports SAPIEN. Where there is neither, Vulkan looks among the system's drivers.

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
        raise RendererMissingError(f"{_MESA} names {named}, which has no {_DRIVER}: {_SCRIPT} makes one")


def no_vulkan(simulator: str, error: Exception) -> RendererMissingError:
    """Return what to say where SAPIEN finds nothing to draw with."""
    return RendererMissingError(
        f"{simulator} needs a Vulkan device even without cameras, and SAPIEN found none that it can use ({error}): "
        f"without a GPU, `{_SCRIPT}` gets Mesa's driver for processors (Debian 12 has one that is too old)"
    )
