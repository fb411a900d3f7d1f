"""Test one way of offscreen rendering, and print its driver; runs in a process of its own.

Graphics drivers may crash the process that loads them. Plain Python: it needs neither MuJoCo nor OpenGL bindings.
"""

from __future__ import annotations

import ctypes
import sys

_DEVICES = 16
_EGL_VENDOR, _EGL_VERSION = 0x3053, 0x3054
_PLATFORM_DEVICE = 0x313F
_PLATFORM_SURFACELESS = 0x31DD
_RGBA = 0x1908
_GL_RENDERER = 0x1F01
_UNSIGNED_BYTE = 0x1401


def egl() -> str:
    """Return the display that EGL can open.

    Raises:
        OSError: if the library is missing.
        RuntimeError: if it opens no display.
    """
    library = ctypes.CDLL("libEGL.so.1")
    library.eglGetProcAddress.restype = ctypes.c_void_p
    library.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    library.eglQueryString.restype = ctypes.c_char_p
    library.eglQueryString.argtypes = [ctypes.c_void_p, ctypes.c_int]
    library.eglInitialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    opened = [display for display in _displays(library) if display and library.eglInitialize(display, None, None)]
    descriptions = [
        " ".join(_text(library.eglQueryString(one, name)) for name in (_EGL_VENDOR, _EGL_VERSION)) for one in opened
    ]
    if not descriptions:
        raise RuntimeError("the library is there, but opens no display")
    return ", ".join(sorted(set(descriptions)))


def _displays(library: ctypes.CDLL) -> list[int | None]:
    """Return the displays of all devices, and the surfaceless one."""
    address = library.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not address:
        return []
    kind = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)
    display_of = kind(address)
    displays: list[int | None] = []
    query = library.eglGetProcAddress(b"eglQueryDevicesEXT")
    if query:
        devices, count = (ctypes.c_void_p * _DEVICES)(), ctypes.c_int()
        ask = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(query)
        if ask(_DEVICES, devices, ctypes.byref(count)):
            displays += [display_of(_PLATFORM_DEVICE, device, None) for device in devices[: count.value]]
    return [*displays, display_of(_PLATFORM_SURFACELESS, None, None)]


def osmesa() -> str:
    """Return the renderer of OSMesa.

    Raises:
        OSError: if the library is missing.
        RuntimeError: if it cannot render.
    """
    library = _first("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
    library.OSMesaCreateContext.restype = ctypes.c_void_p
    library.OSMesaMakeCurrent.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_int]
    context = library.OSMesaCreateContext(_RGBA, None)
    pixels = (ctypes.c_ubyte * (16 * 16 * 4))()
    if not context or not library.OSMesaMakeCurrent(context, pixels, _UNSIGNED_BYTE, 16, 16):
        raise RuntimeError("the library is there, but makes no context")
    library.OSMesaGetProcAddress.restype = ctypes.c_void_p
    library.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
    text = ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_uint)(library.OSMesaGetProcAddress(b"glGetString"))
    return _text(text(_GL_RENDERER))


def _first(*names: str) -> ctypes.CDLL:
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError as error:
            last = error
    raise last


def _text(value: bytes | None) -> str:
    return (value or b"").decode(errors="replace").strip()


if __name__ == "__main__":
    try:
        print(egl() if sys.argv[1] == "egl" else osmesa())  # noqa: T201 - a process of its own, which answers so
    except (OSError, RuntimeError) as problem:
        sys.exit(str(problem))
