"""Cameras drawn by MuJoCo's OpenGL renderer, for looks: shadows and reflections, but pixels that depend on the driver.

Needs PyOpenGL and a library that draws without a window: EGL or OSMesa. Geometry (intrinsics, extrinsics, depth) is the
same as the ray caster's.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from xpl.rendering import RendererMissingError

from .camera import Camera, Frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

_NEAR, _FAR = 0.005, 20.0  # m: nothing that is nearer is seen, and nothing in the room is farther
_MOST_GEOMS = 2000
_SHADOW_PIXELS, _SHADOW_HALF = 2048, 1.2  # of the shadow map; m around the axis of the light
_PLATFORM = "PYOPENGL_PLATFORM"
_NEEDS = {"egl": "libEGL (Debian: libegl1)", "osmesa": "libOSMesa (Debian: libosmesa6)"}


class Stage:
    """An OpenGL context with a model's geometry in it, shared by all cameras of an episode.

    Args:
        model: `mujoco.MjModel`; its visual settings are set to what exact pictures need.
        library: "egl" or "osmesa".

    Raises:
        RendererMissingError: PyOpenGL or the library is missing, or gives no context.
    """

    def __init__(self, model: Any, library: str) -> None:
        visual, extent = model.vis, float(model.stat.extent)
        visual.map.znear, visual.map.zfar = _NEAR / extent, _FAR / extent
        visual.map.shadowclip = _SHADOW_HALF / extent
        visual.quality.offsamples = 0  # a pixel shows what its centre sees
        visual.quality.shadowsize = _SHADOW_PIXELS
        self._window = _window(library)
        self.scene = mujoco.MjvScene(model, maxgeom=_MOST_GEOMS)
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def draw(self, width: int, height: int) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return the picture (height, width, 3) of the scene as it is set up, and its raw depth (height, width)."""
        self._window.make_current()
        room = self._context.offWidth, self._context.offHeight
        if width > room[0] or height > room[1]:
            mujoco.mjr_resizeOffscreen(max(width, room[0]), max(height, room[1]), self._context)
        area = mujoco.MjrRect(0, 0, width, height)
        color, depth = np.empty((height, width, 3), dtype=np.uint8), np.empty((height, width), dtype=np.float32)
        mujoco.mjr_render(area, self.scene, self._context)
        mujoco.mjr_readPixels(color, depth, area, self._context)
        return color[::-1], depth[::-1]  # OpenGL's first row is the lowest

    def close(self) -> None:
        """Free the context, in which a driver may allow only so many."""
        self._context.free()
        self._window.free()


class GlCamera(Camera):
    """A camera that OpenGL draws for.

    Args:
        stage: the context; it must have been made for the same model.
        model: `mujoco.MjModel`.
        name: the camera's name in the model.
        width: pixels.
        height: pixels.
    """

    def __init__(self, stage: Stage, model: Any, name: str, width: int, height: int) -> None:
        super().__init__(model, name, width, height)
        self._stage = stage
        self._options = mujoco.MjvOption()
        self._options.sitegroup[:] = 0  # frames, not things
        self._eye = mujoco.MjvCamera()
        self._eye.type, self._eye.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self.id

    def render(self, data: Any) -> Frame:
        """Return what the camera sees in the present state of `data`, whose kinematics must be up to date."""
        scene = self._stage.scene
        mujoco.mjv_updateScene(self.model, data, self._options, None, self._eye, mujoco.mjtCatBit.mjCAT_ALL, scene)
        color, _ = self._stage.draw(self.width, self.height)
        # Every geom in a colour of its own, without light and shadow; depth is more exact in this mode.
        flags = scene.flags.copy()
        scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = True
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        coded, raw = self._stage.draw(self.width, self.height)
        scene.flags[:] = flags
        segment = coded.astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], dtype=np.int32)
        drawn = [geom for geom in scene.geoms[: scene.ngeom] if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM]
        geoms = np.full(scene.ngeom + 1, -1, dtype=np.int32)
        geoms[[geom.segid + 1 for geom in drawn]] = [geom.objid for geom in drawn]
        # Reversed depth: 1 at the near plane, 0 at the far one, and linear in 1 / z between them.
        with np.errstate(divide="ignore"):
            depth = 1.0 / (1.0 / _FAR + raw.astype(np.float64) * (1.0 / _NEAR - 1.0 / _FAR))
        return Frame(
            color=np.ascontiguousarray(color),
            depth=np.where(raw > 0.0, depth, 0.0).astype(np.float32),
            segmentation=geoms[segment],
        )


def _window(library: str) -> Any:
    """Return an OpenGL context of a library, made current; pictures are drawn into a buffer of their own."""
    platform = os.environ.get(_PLATFORM)
    if platform not in (None, library):
        raise RendererMissingError(
            f"cannot draw with {library} in this process, which draws with {platform} ({_PLATFORM}): "
            f"a process has one OpenGL library; draw with {library} in another one"
        )
    try:
        window = importlib.import_module(f"mujoco.{library}").GLContext(1, 1)
        window.make_current()
    except Exception as error:  # import, attribute and driver errors of three libraries
        if platform is None:  # MuJoCo has set it, and would not try another library after that
            os.environ.pop(_PLATFORM, None)
        raise RendererMissingError(
            f"cannot draw with {library}: {type(error).__name__}: {error}. "
            f"It needs PyOpenGL and {_NEEDS[library]}; the ray caster needs neither"
        ) from error
    return window
