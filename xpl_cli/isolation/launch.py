"""Become a command that is kept apart from the machine, by bubblewrap or by namespaces of our own.

    python -I -S launch.py PLAN -- COMMAND [ARGUMENT]...

The plan (JSON, `xpl_cli.isolation.plan`) says what is to be done; this file only does it, in the order that it takes.
It runs by itself, with the standard library and nothing of the tool, so that it starts fast. The process that is
started waits: below it is the first process of a PID namespace, which reaps orphans, and below that the command. If any
of the two ends, the kernel ends everything in the namespace.

Sources: namespaces(7), user_namespaces(7), pid_namespaces(7), mount_setattr(2), capabilities(7), seccomp(2), keyctl(2),
landlock(7).
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import json
import os
import random
import resource
import signal
import socket
import stat
import struct
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

NEW_USER, NEW_MOUNTS, NEW_NET, NEW_PIDS = 1 << 28, 1 << 17, 1 << 30, 1 << 29
NEW_IPC, NEW_UTS = 1 << 27, 1 << 26
FAILED = 125
"""Exit code of a process that could not be confined."""

_NOSUID, _NODEV, _NOEXEC = 2, 4, 8
_BIND, _REC, _PRIVATE, _SLAVE = 1 << 12, 1 << 14, 1 << 18, 1 << 19
_MOUNT_SETATTR = 442  # the same number on every architecture; glibc has had a name for it since 2.36 only
_HERE, _RECURSIVE, _READ_ONLY = -100, 1 << 15, 1
_GET_FLAGS, _SET_FLAGS, _UP = 0x8913, 0x8914, 1
_SET_PDEATHSIG, _SET_DUMPABLE, _SET_SECCOMP, _CAPBSET_DROP, _SET_NO_NEW_PRIVS, _CAP_AMBIENT = 1, 4, 22, 24, 38, 47
_FILTER, _CLEAR_ALL = 2, 4
_CAPABILITY_VERSION = 0x20080522
_JOIN_SESSION_KEYRING = 1
_LANDLOCK_CREATE, _LANDLOCK_ADD, _LANDLOCK_RESTRICT, _WRITE_FILE = 444, 445, 446, 1 << 1  # on every architecture
_PROCESSES = 8192
_PIDS = range(300, 30_000)
_DESCRIPTORS = 1 << 16

_libc = ctypes.CDLL(None, use_errno=True)


def main(arguments: Sequence[str]) -> NoReturn:
    """Confine, then become or start the command."""
    split = arguments.index("--")
    plan, command = json.loads(arguments[0]), list(arguments[split + 1 :])
    try:
        if "writable" in plan:  # the last step, inside of bubblewrap
            _write_only_below(plan["writable"])
            os.execvp(command[0], command)  # noqa: S606 - it is what this file is for
        _prctl(_SET_PDEATHSIG, signal.SIGKILL, "die with parent")
        if plan["isolate"]:
            _bound(plan["keyctl"])
        if plan["bubblewrap"]:
            _by_bubblewrap(plan, command)
        _by_namespaces(plan, command)
    except OSError as error:
        _give_up(error)


def _give_up(error: OSError) -> NoReturn:
    sys.stderr.write(f"error: no isolation: {error.strerror} ({error.filename})\n")
    sys.stderr.flush()
    os._exit(FAILED)


# -- bubblewrap --------------------------------------------------------------------------------------------------------


def _by_bubblewrap(plan: Mapping[str, Any], command: Sequence[str]) -> NoReturn:
    program, *options = plan["bubblewrap"]
    needed = _needed(plan, command)
    if plan["isolate"]:
        last_step = [sys.executable, "-I", "-S", __file__, json.dumps({"writable": _writable(plan)}), "--"]
        needed = sorted({*needed, *_needed(plan, last_step)})
        command = [*last_step, *command]
    for path in needed:
        options += ["--ro-bind", path, path]
    options += plan["last"]
    if plan["filter"]:
        file = os.memfd_create("filter", 0)
        os.write(file, bytes.fromhex(plan["filter"]))
        os.lseek(file, 0, os.SEEK_SET)
        options += ["--seccomp", str(file)]
    options += ["--chdir", str(Path.cwd())]
    os.execv(program, [program, *options, "--", *command])  # noqa: S606 - it is what this file is for


# -- namespaces --------------------------------------------------------------------------------------------------------


def _by_namespaces(plan: Mapping[str, Any], command: Sequence[str]) -> NoReturn:
    """Enter namespaces, have a child be the first process there, and end as the command ends."""
    user, group = os.getuid(), os.getgid()
    flags = NEW_MOUNTS | NEW_PIDS
    if plan["isolate"]:
        flags |= NEW_NET | NEW_IPC | NEW_UTS
    if plan["isolate"] or _libc.unshare(flags) != 0:  # who may do without a user namespace keeps what it may
        _check(_libc.unshare(flags | NEW_USER), "unshare")
        for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
            _write(f"/proc/self/{name}", text)
    alive, held = os.pipe()
    first = os.fork()
    if first == 0:
        os.close(held)
        try:
            _first_process(plan, command, alive)
        except OSError as error:
            _give_up(error)
    os.close(alive)
    os.closerange(3, held)
    os.closerange(held + 1, _DESCRIPTORS)
    os._exit(_exit_code(os.waitpid(first, 0)[1]))


def _first_process(plan: Mapping[str, Any], command: Sequence[str], alive: int) -> NoReturn:
    """Arrange what is seen in the namespaces, start the command, and reap what loses its parent."""
    _follow(alive)
    here = Path.cwd()
    if plan["isolate"]:
        _private_view(plan, _needed(plan, command))
        _loopback_up()
    else:
        _mount("none", "/", _REC | _SLAVE)
        _fresh_proc()
    # Numbers that differ from run to run, as they do on the whole machine: a seed made of them must not seem fixed.
    with contextlib.suppress(OSError):
        _write("/proc/sys/kernel/ns_last_pid", str(random.SystemRandom().choice(_PIDS)))
    for path in (*plan["covered"], "/proc/1") if plan["isolate"] else ():
        _cover(path)
    os.chdir(here)  # what is mounted there now
    started = os.fork()
    if plan["isolate"]:
        _drop_privileges()
    if started == 0:
        os.setsid()
        if plan["isolate"]:
            _write_only_below(_writable(plan))
        if plan["filter"]:
            _filter(bytes.fromhex(plan["filter"]))
        os.execvp(command[0], list(command))  # noqa: S606 - it is what this file is for
    _prctl(_SET_DUMPABLE, 0, "dumpable")
    os.closerange(3, _DESCRIPTORS)
    if plan["filter"]:
        _filter(bytes.fromhex(plan["filter"]))
    while True:
        pid, status = os.wait()
        if pid == started:
            os._exit(_exit_code(status))


def _follow(alive: int) -> None:
    """End when the parent ends, which holds the other end of a pipe; now, if it has ended already."""
    _prctl(_SET_PDEATHSIG, signal.SIGKILL, "die with parent")
    os.set_blocking(alive, False)
    with contextlib.suppress(BlockingIOError):
        if not os.read(alive, 1):
            os._exit(FAILED)
    os.close(alive)


def _exit_code(status: int) -> int:
    """Return how a process ended as a shell tells it: 128 and more for a signal."""
    code = os.waitstatus_to_exitcode(status)
    return code if code >= 0 else 128 - code


def _private_view(plan: Mapping[str, Any], needed: Sequence[str]) -> None:
    """Make everything read-only, and put places of its own where programs meet: devices, temporary files, sockets."""
    checkout, folder, masked = plan["checkout"], plan["folder"], plan["masked"]
    _mount("none", "/", _REC | _PRIVATE)
    _mount(folder, folder, _BIND | _REC)
    _set_attributes("/", _READ_ONLY | _NOSUID | _NODEV, whole=True)
    _set_read_only(folder, on=False)
    # Held open, because they may lie below what is masked.
    again = {path: os.open(path, os.O_PATH | os.O_CLOEXEC) for path in (*needed, folder, checkout)}
    devices = {path: os.open(path, os.O_PATH | os.O_CLOEXEC) for path in plan["devices"]}
    for path in masked:
        _temporary(path, "mode=755,size=1m")
    _temporary("/dev", "mode=755,size=1m")
    for path, file in devices.items():
        _show(path, file)
        _set_attributes(path, without=_NODEV)
    for name, target in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        Path(f"/dev/{name}").symlink_to(f"/proc/self/fd{target}")
    Path("/dev/shm").mkdir()  # noqa: S108 - the place that programs expect, private here
    for path, file in again.items():
        if any(_is_below(path, place) for place in (*masked, "/dev")):
            _show(path, file)
    _set_read_only(folder, on=False)
    for path in (*masked, "/dev"):
        _set_read_only(path, on=True)
    _temporary("/dev/shm", f"mode=1777,size={plan['shared_bytes']}")  # noqa: S108
    _fresh_proc()
    for file in (*again.values(), *devices.values()):
        os.close(file)


def _fresh_proc() -> None:
    """Mount /proc anew: it shows the processes of the namespace."""
    _mount("proc", "/proc", _NOSUID | _NODEV | _NOEXEC, "proc")


def _cover(path: str) -> None:
    """Make a part of /proc read-only."""
    _mount(path, path, _BIND | _REC)
    _set_read_only(path, on=True)


def _temporary(path: str, options: str) -> None:
    _mount("tmpfs", path, _NOSUID | _NODEV, "tmpfs", options)


def _show(path: str, file: int) -> None:
    """Put what a descriptor stands for at a path of a file system that is still empty there."""
    target = Path(path)
    if not target.exists():
        is_folder = stat.S_ISDIR(os.fstat(file).st_mode)
        (target if is_folder else target.parent).mkdir(parents=True, exist_ok=True)
        if not is_folder:
            target.touch()
    _mount(f"/proc/self/fd/{file}", path, _BIND | _REC)


def _needed(plan: Mapping[str, Any], command: Sequence[str]) -> list[str]:
    """Return what the command needs and would not see any more: its interpreter, and files that it is given."""
    program = Path(command[0])
    working = Path.cwd()
    asked = [program.parent.parent, program.resolve().parent.parent, working] if program.is_absolute() else [working]
    asked += [
        Path(word) for word in command[1:] if word.startswith("/") and len(word) < os.pathconf("/", "PC_PATH_MAX")
    ]
    inside = [path for path in asked if any(_is_below(str(path), place) for place in plan["masked"])]
    given = (plan["checkout"], plan["folder"])
    found = {str(path) for path in inside if path.exists() and not any(_is_below(str(path), one) for one in given)}
    return sorted(found - set(plan["masked"]))


def _is_below(path: str, place: str) -> bool:
    return path == place or path.startswith(place + "/")


# -- what a process may do ---------------------------------------------------------------------------------------------


def _bound(keyctl: int | None) -> None:
    """Take away limits that could be used against others, and the keys of the session."""
    for limit in (resource.RLIMIT_CORE, resource.RLIMIT_NICE, resource.RLIMIT_RTPRIO):
        resource.setrlimit(limit, (0, 0))
    _, hard = resource.getrlimit(resource.RLIMIT_NPROC)
    most = _PROCESSES if hard == resource.RLIM_INFINITY else min(hard, _PROCESSES)
    resource.setrlimit(resource.RLIMIT_NPROC, (most, most))
    if keyctl is not None:  # fails where the kernel has no keys, and then there is nothing to hide
        _libc.syscall(ctypes.c_long(keyctl), ctypes.c_long(_JOIN_SESSION_KEYRING), None)


def _drop_privileges() -> None:
    """Drop every capability for good."""
    _prctl(_SET_NO_NEW_PRIVS, 1, "no_new_privs")
    for capability in range(int(Path("/proc/sys/kernel/cap_last_cap").read_text(encoding="ascii")) + 1):
        _prctl(_CAPBSET_DROP, capability, "capability bounding set")
    _prctl(_CAP_AMBIENT, _CLEAR_ALL, "ambient capabilities")
    header, none = struct.pack("=Ii", _CAPABILITY_VERSION, 0), bytes(24)
    _check(_libc.capset(header, none), "capset")


def _writable(plan: Mapping[str, Any]) -> list[str]:
    """Return below which folders something may be written to at all."""
    return [plan["folder"], "/dev", "/proc"]


def _write_only_below(folders: Sequence[str]) -> None:
    """Refuse to open anything elsewhere for writing (Landlock): named pipes, which a read-only mount leaves open."""
    _prctl(_SET_NO_NEW_PRIVS, 1, "no_new_privs")
    handled = struct.pack("=Q", _WRITE_FILE)
    rules = _libc.syscall(ctypes.c_long(_LANDLOCK_CREATE), handled, ctypes.c_size_t(len(handled)), ctypes.c_uint(0))
    if rules < 0:  # a kernel without Landlock; docs/serving.md says what is not promised then
        return
    for folder in folders:
        file = os.open(folder, os.O_PATH | os.O_CLOEXEC)
        rule = struct.pack("=Qi", _WRITE_FILE, file)
        told = _libc.syscall(ctypes.c_long(_LANDLOCK_ADD), ctypes.c_int(rules), ctypes.c_int(1), rule, ctypes.c_uint(0))
        os.close(file)
        _check(told, f"landlock {folder}")
    _check(_libc.syscall(ctypes.c_long(_LANDLOCK_RESTRICT), ctypes.c_int(rules), ctypes.c_uint(0)), "landlock")
    os.close(rules)


def _filter(program: bytes) -> None:
    lines = ctypes.create_string_buffer(program, len(program))
    whole = struct.pack("@HP", len(program) // 8, ctypes.addressof(lines))
    address = ctypes.create_string_buffer(whole, len(whole))
    _prctl(_SET_NO_NEW_PRIVS, 1, "no_new_privs")
    _check(
        _libc.prctl(_SET_SECCOMP, ctypes.c_ulong(_FILTER), ctypes.c_ulong(ctypes.addressof(address)), 0, 0), "seccomp"
    )


# -- the kernel --------------------------------------------------------------------------------------------------------


def _prctl(option: int, value: int, told: str) -> None:
    _check(_libc.prctl(option, ctypes.c_ulong(value), *[ctypes.c_ulong(0)] * 3), told)


def _mount(source: str, target: str, flags: int, kind: str | None = None, options: str | None = None) -> None:
    given = [None if text is None else os.fsencode(text) for text in (source, target, kind)]
    data = None if options is None else options.encode()
    _check(_libc.mount(*given, ctypes.c_ulong(flags), data), f"mount {target}")


def _set_read_only(path: str, *, on: bool) -> None:
    _set_attributes(path, _READ_ONLY * on, without=_READ_ONLY * (not on))


def _set_attributes(path: str, attributes: int = 0, *, without: int = 0, whole: bool = False) -> None:
    """Set and clear attributes of a mount, of all below it too if it is whole; MOUNT_ATTR_* are MS_* for these."""
    asked = struct.pack("=4Q", attributes, without, 0, 0)
    result = _libc.syscall(
        ctypes.c_long(_MOUNT_SETATTR),
        ctypes.c_int(_HERE),
        os.fsencode(path),
        ctypes.c_uint(_RECURSIVE * whole),
        asked,
        ctypes.c_size_t(len(asked)),
    )
    _check(result, f"mount_setattr {path}")


def _loopback_up() -> None:
    """Bring the loopback interface up: libraries talk to themselves there, and to nobody else."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sH22x", b"lo", 0)
        flags = struct.unpack_from("H", fcntl.ioctl(any_socket, _GET_FLAGS, request), 16)[0]
        fcntl.ioctl(any_socket, _SET_FLAGS, struct.pack("16sH22x", b"lo", flags | _UP))


def _write(path: str, text: str) -> None:
    Path(path).write_text(text, encoding="ascii")


def _check(result: int, told: str) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), told)


if __name__ == "__main__":
    main(sys.argv[1:])
