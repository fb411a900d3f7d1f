"""Rendering of simulators without a display, and their camera images in the standard's form."""

from __future__ import annotations

from xpl.rendering.errors import RendererMissingError
from xpl.rendering.mujoco import choose_opengl, mujoco_view
from xpl.rendering.vulkan import VULKAN_COMPLAINTS, choose_vulkan, no_vulkan

__all__ = ["VULKAN_COMPLAINTS", "RendererMissingError", "choose_opengl", "choose_vulkan", "mujoco_view", "no_vulkan"]
