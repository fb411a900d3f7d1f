"""Launcher of isolated commands: exec bubblewrap, or start the command in a PID namespace.

    python -I -S launch.py PLAN -- COMMAND [ARGUMENT]...

The plan (JSON) is made by `xpl_cli.isolation.plan`. This file uses the standard library only, so that it starts fast.
The launcher waits: below it is the first process of a PID namespace, which reaps orphans, and below that the command.
If either ends, the kernel kills everything in the namespace.

Sources: bwrap(1), namespaces(7), user_namespaces(7), pid_namespaces(7), capabilities(7), keyctl(2), landlock(7).
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import json
import os
import random
import resource
import signal
import struct
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

NEW_USER, NEW_MOUNTS, NEW_PIDS = 1 << 28, 1 << 17, 1 << 29
FAILED = 125
"""Exit code of a process that could not be confined."""

_RDONLY, _NOSUID, _NODEV, _NOEXEC, _REMOUNT, _BIND = 1, 2, 4, 8, 1 << 5, 1 << 12
_REC, _SLAVE = 1 << 14, 1 << 19
_KEPT_FLAGS = {b"nosuid": _NOSUID, b"nodev": _NODEV, b"noexec": _NOEXEC}
_DETACH = 2
_OF_THE_KERNEL = frozenset(
    (
        "bpf",
        "cgroup",
        "cgroup2",
        "configfs",
        "debugfs",
        "efivarfs",
        "fusectl",
        "pstore",
        "securityfs",
        "sysfs",
        "tracefs",
    )
)
_SET_PDEATHSIG, _SET_DUMPABLE, _SET_NO_NEW_PRIVS = 1, 4, 38
_CAPABILITY_BOUND_DROP, _CAPABILITY_AMBIENT, _AMBIENT_CLEAR_ALL = 24, 47, 4
_CAPABILITY_VERSION_3 = 0x20080522
_JOIN_SESSION_KEYRING = 1
_LANDLOCK_CREATE, _LANDLOCK_ADD, _LANDLOCK_RESTRICT, _WRITE_FILE = 444, 445, 446, 1 << 1  # on every architecture
_PROCESSES = 8192
_PIDS = range(300, 30_000)
_DESCRIPTORS = 1 << 16

_libc = ctypes.CDLL(None, use_errno=True)


def main(arguments: Sequence[str]) -> NoReturn:
    """Confine, then become or start the command."""
    split = arguments.index("--")
    plan, command = json.loads(arguments[0]), list(arguments[split + 1 :])  # noqa: TID251 - written by the parent
    try:
        if "inside" in plan:  # the last step, behind bubblewrap
            _write_only_below(plan["inside"])
            os.execvp(command[0], command)  # noqa: S606 - the purpose of this file
        _prctl(_SET_PDEATHSIG, signal.SIGKILL, "die with parent")
        if "isolate" in plan:
            _isolate(plan, command)
        _keep_apart(command, plan["covered"])
    except OSError as error:
        _give_up(error)


def _give_up(error: OSError) -> NoReturn:
    sys.stderr.write(f"error: no isolation: {error.strerror} ({error.filename})\n")
    sys.stderr.flush()
    os._exit(FAILED)


# -- isolated ----------------------------------------------------------------------------------------------------------


def _isolate(plan: Mapping[str, Any], command: Sequence[str]) -> NoReturn:
    """Exec bubblewrap, with the command behind a last step of this file."""
    _bound(plan["keyctl"])
    program, *options = plan["isolate"]
    last_step = [sys.executable, "-I", "-S", __file__, json.dumps({"inside": plan["writable"]}), "--"]
    for path in sorted({*_needed(plan, command), *_needed(plan, last_step)}):
        options += ["--ro-bind", path, path]
    options += plan["last"]
    if plan["filter"]:
        file = os.memfd_create("filter", 0)
        os.write(file, bytes.fromhex(plan["filter"]))
        os.lseek(file, 0, os.SEEK_SET)
        options += ["--seccomp", str(file)]
    options += ["--chdir", str(Path.cwd())]
    os.execv(program, [program, *options, "--", *last_step, *command])  # noqa: S606 - the purpose of this file


def _needed(plan: Mapping[str, Any], command: Sequence[str]) -> list[str]:
    """Return hidden paths that the command needs: its interpreter, and files in its arguments."""
    program = Path(command[0])
    working = Path.cwd()
    candidates = (
        [program.parent.parent, program.resolve().parent.parent, working] if program.is_absolute() else [working]
    )
    candidates += [
        Path(word) for word in command[1:] if word.startswith("/") and len(word) < os.pathconf("/", "PC_PATH_MAX")
    ]
    hidden_paths = [path for path in candidates if any(_is_below(str(path), folder) for folder in plan["masked"])]
    visible = plan["given"]
    existing = {
        str(path) for path in hidden_paths if path.exists() and not any(_is_below(str(path), one) for one in visible)
    }
    return sorted(existing - set(plan["masked"]))


def _is_below(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder + "/")


def _bound(keyctl: int | None) -> None:
    """Lower resource limits, and leave the session's keyring."""
    for limit in (resource.RLIMIT_CORE, resource.RLIMIT_NICE, resource.RLIMIT_RTPRIO):
        resource.setrlimit(limit, (0, 0))
    _, hard = resource.getrlimit(resource.RLIMIT_NPROC)
    most = _PROCESSES if hard == resource.RLIM_INFINITY else min(hard, _PROCESSES)
    resource.setrlimit(resource.RLIMIT_NPROC, (most, most))
    if keyctl is not None:  # fails on kernels without keyrings, which have nothing to hide
        _libc.syscall(ctypes.c_long(keyctl), ctypes.c_long(_JOIN_SESSION_KEYRING), None)


def _write_only_below(folders: Sequence[str]) -> None:
    """Forbid opening other files for writing (Landlock), such as named pipes, which a read-only mount allows."""
    _prctl(_SET_NO_NEW_PRIVS, 1, "no_new_privs")
    handled = struct.pack("=Q", _WRITE_FILE)
    rules = _libc.syscall(ctypes.c_long(_LANDLOCK_CREATE), handled, ctypes.c_size_t(len(handled)), ctypes.c_uint(0))
    if rules < 0:  # a kernel without Landlock; docs/serving.md states the limits
        return
    for folder in folders:
        file = os.open(folder, os.O_PATH | os.O_CLOEXEC)
        rule = struct.pack("=Qi", _WRITE_FILE, file)
        result = _libc.syscall(
            ctypes.c_long(_LANDLOCK_ADD), ctypes.c_int(rules), ctypes.c_int(1), rule, ctypes.c_uint(0)
        )
        os.close(file)
        _check(result, f"landlock {folder}")
    _check(_libc.syscall(ctypes.c_long(_LANDLOCK_RESTRICT), ctypes.c_int(rules), ctypes.c_uint(0)), "landlock")
    os.close(rules)


# -- apart -------------------------------------------------------------------------------------------------------------


def _keep_apart(command: Sequence[str], covered: Sequence[str]) -> NoReturn:
    """Enter a PID namespace, fork its first process, and exit like the command."""
    user, group = os.getuid(), os.getgid()
    flags = NEW_MOUNTS | NEW_PIDS
    if _libc.unshare(flags) != 0:  # a privileged process needs no user namespace
        _check(_libc.unshare(flags | NEW_USER), "unshare")
        for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
            _write(f"/proc/self/{name}", text)
    alive, held = os.pipe()
    first = os.fork()
    if first == 0:
        os.close(held)
        try:
            _first_process(command, covered, alive)
        except OSError as error:
            _give_up(error)
    os.close(alive)
    os.closerange(3, held)
    os.closerange(held + 1, _DESCRIPTORS)
    os._exit(_exit_code(os.waitpid(first, 0)[1]))


def _first_process(command: Sequence[str], covered: Sequence[str], alive: int) -> NoReturn:
    """Mount /proc of the namespace, start the command, and reap orphans."""
    _follow(alive)
    here = Path.cwd()
    _mount("none", "/", _REC | _SLAVE)
    _mount("proc", "/proc", _NOSUID | _NODEV | _NOEXEC, "proc")
    # Random pids, as on the whole machine: a seed made from a pid must not be constant.
    with contextlib.suppress(OSError):
        _write("/proc/sys/kernel/ns_last_pid", str(random.SystemRandom().choice(_PIDS)))
    _read_only(covered)
    os.chdir(here)  # the new mount
    _drop_capabilities()
    started = os.fork()
    if started == 0:
        os.setsid()
        os.execvp(command[0], list(command))  # noqa: S606 - the purpose of this file
    _prctl(_SET_DUMPABLE, 0, "dumpable")
    os.closerange(3, _DESCRIPTORS)
    while True:
        pid, status = os.wait()
        if pid == started:
            os._exit(_exit_code(status))


def _read_only(covered: Sequence[str]) -> None:
    """Make files that control the machine read-only: root owns them and may write without capabilities.

    The core dump pattern names a program that the kernel runs, and control groups freeze and kill any process.
    Another /proc mount shows the processes of the machine.
    """
    for path in covered:
        _mount(path, path, _BIND | _REC)
        _mount("none", path, _REMOUNT | _BIND | _RDONLY | _NOSUID | _NODEV | _NOEXEC)
    hidden = [os.fsencode(path) for path in ("/proc", *covered)]
    for line in reversed(Path("/proc/self/mountinfo").read_bytes().splitlines()):  # the last mount is on top
        before, _, after = line.partition(b" - ")
        written, options, kind = before.split()[4], before.split()[5].split(b","), after.split()[0].decode()
        target = written.decode("unicode_escape").encode("latin-1")  # spaces and line breaks are octal escapes
        try:
            if kind == "proc" and target not in hidden:
                _check(_libc.umount2(target, _DETACH), f"unmount {target!r}")
            elif kind in _OF_THE_KERNEL:
                flags = sum(flag for name, flag in _KEPT_FLAGS.items() if name in options)
                _mount("none", target, _REMOUNT | _BIND | _RDONLY | flags)
        except OSError as error:  # a covered mount is unreachable
            if error.errno not in (errno.EINVAL, errno.ENOENT):
                raise


def _follow(alive: int) -> None:
    """Die with the parent, which holds the other end of a pipe; exit now if it has ended already."""
    _prctl(_SET_PDEATHSIG, signal.SIGKILL, "die with parent")
    os.set_blocking(alive, False)
    with contextlib.suppress(BlockingIOError):
        if not os.read(alive, 1):
            os._exit(FAILED)
    os.close(alive)


def _exit_code(status: int) -> int:
    """Return the exit code as a shell reports it: 128 plus the signal."""
    code = os.waitstatus_to_exitcode(status)
    return code if code >= 0 else 128 - code


# -- the kernel --------------------------------------------------------------------------------------------------------


def _prctl(option: int, value: int, what: str) -> None:
    _check(_libc.prctl(option, ctypes.c_ulong(value), *[ctypes.c_ulong(0)] * 3), what)


def _drop_capabilities() -> None:
    """Drop every capability for good, also root's, which could unmount /proc and reach the one below.

    Source: capabilities(7).
    """
    _prctl(_SET_NO_NEW_PRIVS, 1, "no_new_privs")
    _check(
        _libc.prctl(_CAPABILITY_AMBIENT, *map(ctypes.c_ulong, (_AMBIENT_CLEAR_ALL, 0, 0, 0))), "ambient capabilities"
    )
    last = int(Path("/proc/sys/kernel/cap_last_cap").read_text(encoding="ascii"))
    for capability in range(last + 1):
        _prctl(_CAPABILITY_BOUND_DROP, capability, f"bounding capability {capability}")
    header, none = struct.pack("=Ii", _CAPABILITY_VERSION_3, 0), bytes(24)
    _check(_libc.capset(header, none), "capset")


def _mount(source: str, target: str | bytes, flags: int, kind: str | None = None) -> None:
    arguments = [None if text is None else os.fsencode(text) for text in (source, target, kind)]
    _check(_libc.mount(*arguments, ctypes.c_ulong(flags), None), f"mount {target!r}")


def _write(path: str, text: str) -> None:
    Path(path).write_text(text, encoding="ascii")


def _check(result: int, what: str) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), what)


if __name__ == "__main__":
    main(sys.argv[1:])
