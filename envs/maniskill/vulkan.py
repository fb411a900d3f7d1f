"""Where ManiSkill's Vulkan driver comes from: SAPIEN loads what a scene looks like even where nobody looks at it."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

MESA = "XPL_MESA"
"""Variable with the folder that `mesa.sh` filled."""
COMPLAINTS = ("rendering device", "vk::")
"""What errors of SAPIEN say where Vulkan has no device, or no driver."""
_DEFAULT = "~/.cache/xpl/mesa"
_SCRIPT = 'bash "$(xpl env path maniskill)/mesa.sh"'
_DRIVER = "lvp_icd.json"
_OWN = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")  # Vulkan's variables, the second by its older name


class RendererMissingError(RuntimeError):
    """This machine lacks what the environment draws with."""


def choose_driver() -> None:
    """Let Vulkan find Mesa's driver for processors where `mesa.sh` put one, unless Vulkan's own variables name another.

    It has to be said before SAPIEN is imported. Where there is neither, Vulkan looks among the system's drivers.

    Raises:
        RendererMissingError: `XPL_MESA` names a folder without a driver.
    """
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")  # SAPIEN brings one
    if any(os.environ.get(name) for name in _OWN):
        return
    named = os.environ.get(MESA)
    driver = Path(named or _DEFAULT).expanduser() / _DRIVER
    if driver.is_file():
        os.environ[_OWN[1]] = str(driver)
    elif named:
        raise RendererMissingError(f"{MESA} names {named}, which has no {_DRIVER}: {_SCRIPT} makes one")


def missing(error: Exception) -> RendererMissingError:
    """Return what to say where SAPIEN finds nothing to draw with."""
    return RendererMissingError(
        f"ManiSkill needs a Vulkan device even without cameras, and SAPIEN found none that it can use ({error}): "
        f"without a GPU, `{_SCRIPT}` gets Mesa's driver for processors (Debian 12 has one that is too old)"
    )
