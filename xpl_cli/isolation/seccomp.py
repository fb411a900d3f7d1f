"""System call filter of isolated adapters, as a seccomp program (seccomp(2), bpf(2)).

The filter also refuses calls that namespaces and dropped capabilities already forbid, so that kernel bugs behind them
are unreachable; calls without namespaces (keyrings, vsock, performance counters) are refused here only. A refused call
fails with EPERM, and a refused kind of socket with EAFNOSUPPORT, as on a kernel without it.

Sources: syscalls(2), Documentation/userspace-api/seccomp_filter.rst, and the profiles of Docker and Flatpak.
"""

from __future__ import annotations

import errno
import platform
import struct
from collections.abc import Sequence

SYSCALLS: dict[str, tuple[int | None, int | None]] = {
    # keys, memory and descriptors of other processes
    "keyctl": (250, 219),
    "add_key": (248, 217),
    "request_key": (249, 218),
    "ptrace": (101, 117),
    "process_vm_readv": (310, 270),
    "process_vm_writev": (311, 271),
    "kcmp": (312, 272),
    "pidfd_getfd": (438, 438),
    # file systems and namespaces
    "mount": (165, 40),
    "umount2": (166, 39),
    "pivot_root": (155, 41),
    "chroot": (161, 51),
    "move_mount": (429, 429),
    "open_tree": (428, 428),
    "open_tree_attr": (467, 467),
    "fsopen": (430, 430),
    "fsconfig": (431, 431),
    "fsmount": (432, 432),
    "fspick": (433, 433),
    "mount_setattr": (442, 442),
    "setns": (308, 268),
    "unshare": (272, 97),
    "name_to_handle_at": (303, 264),
    "open_by_handle_at": (304, 265),
    "fanotify_init": (300, 262),
    "quotactl": (179, 60),
    "quotactl_fd": (443, 443),
    # large and often broken: what Docker's and Flatpak's profiles refuse for that reason
    "bpf": (321, 280),
    "perf_event_open": (298, 241),
    "userfaultfd": (323, 282),
    "io_uring_setup": (425, 425),
    "io_uring_enter": (426, 426),
    "io_uring_register": (427, 427),
    # the machine itself
    "kexec_load": (246, 104),
    "kexec_file_load": (320, 294),
    "init_module": (175, 105),
    "finit_module": (313, 273),
    "delete_module": (176, 106),
    "reboot": (169, 142),
    "swapon": (167, 224),
    "swapoff": (168, 225),
    "syslog": (103, 116),
    "acct": (163, 89),
    "sethostname": (170, 161),
    "setdomainname": (171, 162),
    "settimeofday": (164, 170),
    "clock_settime": (227, 112),
    "vhangup": (153, 58),
    "nfsservctl": (180, 42),
    "lookup_dcookie": (212, 18),
    "iopl": (172, None),
    "ioperm": (173, None),
    "ioprio_set": (251, 30),
    # filtered by their arguments below
    "clone": (56, 220),
    "clone3": (435, 435),
    "socket": (41, 198),
    "socketpair": (53, 199),
    "ioctl": (16, 29),
}
"""Numbers on x86_64 and on aarch64; None where it has no such call."""

_CONDITIONAL = frozenset(("clone", "clone3", "socket", "socketpair", "ioctl"))
_MACHINES = {"x86_64": (0, 0xC000003E), "aarch64": (1, 0xC00000B7)}
"""For each machine the column of its numbers above, and its AUDIT_ARCH."""
_X32 = 0x40000000  # a second table of numbers on x86_64
_NEW_NAMESPACES = 0x7E020000  # CLONE_NEW*: cgroup, UTS, IPC, user, PID, network, mounts
_UNIX, _INET, _INET6, _NETLINK = 1, 2, 10, 16
_TERMINAL_INPUT = (0x5412, 0x541C)  # TIOCSTI, TIOCLINUX: typing into a user's terminal

_STREAM, _SEQUENCED, _KIND = 1, 5, 0xF  # SOCK_STREAM, SOCK_SEQPACKET, and the bits of a socket's kind
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _AND, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x54, 0x06
_ALLOW, _ERROR = 0x7FFF0000, 0x00050000
_NUMBER, _ARCHITECTURE, _FIRST, _SECOND, _THIRD = 0, 4, 16, 24, 32  # offsets in struct seccomp_data, little endian


def number(name: str) -> int | None:
    """Return the number of a call on this machine, or None."""
    machine = _MACHINES.get(platform.machine())
    return None if machine is None else SYSCALLS[name][machine[0]]


def program(*, cuda: bool = False) -> bytes | None:
    """Return the filter for this machine, as `struct sock_filter[]`; None for unknown machines.

    Args:
        cuda: allow the one kind of named socket without which CUDA does not start.
    """
    machine = _MACHINES.get(platform.machine())
    if machine is None:
        return None
    column, architecture = machine
    lines = [
        (_LOAD, 0, 0, _ARCHITECTURE),
        (_EQUAL, 1, 0, architecture),
        _refuse(errno.EPERM),
        (_LOAD, 0, 0, _NUMBER),
        *([(_AT_LEAST, 0, 1, _X32), _refuse(errno.EPERM)] if platform.machine() == "x86_64" else []),
    ]
    for name, numbers in SYSCALLS.items():
        call = numbers[column]
        if call is not None and name not in _CONDITIONAL:
            lines += [(_EQUAL, 0, 1, call), _refuse(errno.EPERM)]
    # Its flags are in memory, which a filter cannot read; libraries fall back to clone.
    lines += [(_EQUAL, 0, 1, SYSCALLS["clone3"][column]), _refuse(errno.ENOSYS)]
    lines += _filter_argument("clone", column, _FIRST, [(_ANY_BIT, 0, 1, _NEW_NAMESPACES), _refuse(errno.EPERM)])
    # A named socket could reach the host's sockets in the file system; pairs have no name.
    sockets = [*_INTERFACES, *_only(_INET, _INET6)]
    lines += _filter_argument("socket", column, _FIRST, [*(_CUDA_SOCKET if cuda else ()), *sockets])
    lines += _filter_argument("socketpair", column, _FIRST, _PAIRS)
    refused = [line for code in _TERMINAL_INPUT for line in ((_EQUAL, 0, 1, code), _refuse(errno.EPERM))]
    lines += _filter_argument("ioctl", column, _SECOND, refused)
    lines.append((_RETURN, 0, 0, _ALLOW))
    return b"".join(struct.pack("=HBBI", *line) for line in lines)


_Line = tuple[int, int, int, int | None]
# CUDA binds one such socket to an abstract name, which is the network namespace's. Few programs listen on such sockets,
# and those that do have theirs in /run.
_CUDA_SOCKET: tuple[_Line, ...] = (
    (_EQUAL, 0, 5, _UNIX),
    (_LOAD, 0, 0, _SECOND),
    (_AND, 0, 0, _KIND),
    (_EQUAL, 0, 1, _SEQUENCED),
    (_RETURN, 0, 0, _ALLOW),
    (_RETURN, 0, 0, _ERROR | errno.EAFNOSUPPORT),
)
# For the C library's list of interfaces; other netlink protocols reach more of the kernel.
_INTERFACES: tuple[_Line, ...] = (
    (_EQUAL, 0, 4, _NETLINK),
    (_LOAD, 0, 0, _THIRD),
    (_EQUAL, 0, 1, 0),  # NETLINK_ROUTE
    (_RETURN, 0, 0, _ALLOW),
    (_RETURN, 0, 0, _ERROR | errno.EAFNOSUPPORT),
)
# Pairs that stay connected to each other. One of datagrams could be pointed at any named socket of the host afterwards,
# by an address in memory, where a filter cannot read it.
_PAIRS: tuple[_Line, ...] = (
    (_EQUAL, 0, 4, _UNIX),
    (_LOAD, 0, 0, _SECOND),
    (_AND, 0, 0, _KIND),
    (_EQUAL, 2, 0, _STREAM),
    (_EQUAL, 1, 0, _SEQUENCED),
    (_RETURN, 0, 0, _ERROR | errno.EAFNOSUPPORT),
    (_RETURN, 0, 0, _ALLOW),
)


def _refuse(code: int) -> _Line:
    return (_RETURN, 0, 0, _ERROR | code)


def _only(*families: int) -> list[_Line]:
    """Allow these families of sockets and refuse all others."""
    allowed = [line for family in families for line in ((_EQUAL, 0, 1, family), (_RETURN, 0, 0, _ALLOW))]
    return [*allowed, _refuse(errno.EAFNOSUPPORT)]


def _filter_argument(name: str, column: int, argument: int, lines: Sequence[_Line]) -> list[_Line]:
    """Load an argument of a call and apply filter lines; by default the call is allowed."""
    body = [(_LOAD, 0, 0, argument), *lines, (_RETURN, 0, 0, _ALLOW)]
    return [(_EQUAL, 0, len(body), SYSCALLS[name][column]), *body]
