"""Run a command without network and on a read-only file system, by Linux namespaces; no privilege is needed.

    python -I -S namespaces.py CHECKOUT [WRITABLE]... -- COMMAND [ARGUMENT]...

The process stays the one that was started: it enters namespaces of its own and then becomes the command, so that its
number, its group and the descriptors that it inherits are what they were. A second pair of namespaces below the first
locks what was mounted: the command cannot make anything writable again. Standard library only, and nothing of the tool:
this file is run by itself, so that it starts fast.

Sources: user_namespaces(7), mount_namespaces(7), mount_setattr(2), netdevice(7).
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import socket
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

_NEW_USER, _NEW_MOUNTS, _NEW_NET = 1 << 28, 1 << 17, 1 << 30
_BIND, _REC, _PRIVATE = 1 << 12, 1 << 14, 1 << 18
_MOUNT_SETATTR = 442  # the same number on every architecture; glibc has had a name for it since 2.36 only
_HERE, _RECURSIVE = -100, 1 << 15
_READ_ONLY = 1
_GET_FLAGS, _SET_FLAGS = 0x8913, 0x8914
_UP = 1
_FAILED = 125
"""Exit code of a process that could not confine itself."""

_libc = ctypes.CDLL(None, use_errno=True)


def main(arguments: Sequence[str]) -> None:
    """Confine this process and become the command."""
    split = arguments.index("--")
    checkout, *writable = arguments[:split]
    try:
        confine(checkout, writable)
    except OSError as error:
        sys.stderr.write(f"error: no namespaces: {error.strerror} ({error.filename})\n")
        sys.exit(_FAILED)
    os.execvp(arguments[split + 1], list(arguments[split + 1 :]))  # noqa: S606 - it is what this file is for


def confine(checkout: str, writable: Sequence[str]) -> None:
    """Take the network and the right to write away from this process, whatever it becomes.

    Args:
        checkout: folder that stays read-only wherever it lies.
        writable: folders that stay writable.

    Raises:
        OSError: if the system does not allow it; `filename` says what.
    """
    user, group = os.getuid(), os.getgid()
    _unshare(_NEW_USER | _NEW_MOUNTS | _NEW_NET, "unshare")
    _map_identity(0, user, 0, group)
    _mount("none", "/", _REC | _PRIVATE)
    for path in (*writable, checkout):
        _mount(path, path, _BIND | _REC)
    _set_read_only("/", on=True)
    for path in ("/proc", *writable):
        _set_read_only(path, on=False)
    _set_read_only(checkout, on=True)
    _loopback_up()
    _unshare(_NEW_USER | _NEW_MOUNTS, "second unshare")
    _map_identity(user, 0, group, 0)
    os.chdir(Path.cwd())  # what is mounted there now


def _unshare(flags: int, told: str) -> None:
    _check(_libc.unshare(flags), told)


def _map_identity(user: int, outer_user: int, group: int, outer_group: int) -> None:
    for name, text in (
        ("setgroups", "deny"),
        ("uid_map", f"{user} {outer_user} 1"),
        ("gid_map", f"{group} {outer_group} 1"),
    ):
        Path(f"/proc/self/{name}").write_text(text, encoding="ascii")


def _mount(source: str, target: str, flags: int) -> None:
    _check(_libc.mount(source.encode(), os.fsencode(target), None, ctypes.c_ulong(flags), None), f"mount {target}")


def _set_read_only(path: str, *, on: bool) -> None:
    attributes = struct.pack("=4Q", _READ_ONLY * on, _READ_ONLY * (not on), 0, 0)
    result = _libc.syscall(
        ctypes.c_long(_MOUNT_SETATTR),
        ctypes.c_int(_HERE),
        os.fsencode(path),
        ctypes.c_uint(_RECURSIVE),
        attributes,
        ctypes.c_size_t(len(attributes)),
    )
    _check(result, f"mount_setattr {path}")


def _loopback_up() -> None:
    """Bring the loopback interface up: libraries talk to themselves there, and to nobody else."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sH22x", b"lo", 0)
        flags = struct.unpack_from("H", fcntl.ioctl(any_socket, _GET_FLAGS, request), 16)[0]
        fcntl.ioctl(any_socket, _SET_FLAGS, struct.pack("16sH22x", b"lo", flags | _UP))


def _check(result: int, told: str) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), told)


if __name__ == "__main__":
    main(sys.argv[1:])
