"""Attacks on an isolation from inside, run by itself: each returns what it got, or None where it was held.

    python -I -S breakout.py WHAT_THE_OUTSIDE_KNOWS

Prints a JSON map from the name of each attack to what came of it. Standard library only.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import functools
import json
import os
import platform
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

_KNOWN: dict[str, Any] = {}
_LIBC = ctypes.CDLL(None, use_errno=True)
ATTACKS: dict[str, Callable[[], str | None]] = {}


def attack(act: Callable[[], str | None]) -> Callable[[], str | None]:
    """Note an attack under its name."""
    ATTACKS[act.__name__.removeprefix("_")] = act
    return act


def _fails(act: Callable[[], Any]) -> str | None:
    """Return what an attempt returned, None if it was refused."""
    try:
        return f"returned {act()!r}"
    except OSError:
        return None


def _call(name: str, *arguments: Any) -> str | None:
    """Make a system call; held if it is refused as by a kernel that does not know us."""
    number = _KNOWN["calls"][name]
    if number is None:
        return None
    ctypes.set_errno(0)
    result = _LIBC.syscall(ctypes.c_long(number), *[ctypes.c_long(one) for one in (*arguments, 0, 0, 0, 0, 0)[:6]])
    if result == -1 and ctypes.get_errno() in (errno.EPERM, errno.ENOSYS):
        return None
    return f"{name} returned {result}, {os.strerror(ctypes.get_errno())}"


def _write(path: str) -> str | None:
    return _fails(lambda: Path(path).write_text("left", encoding="ascii"))


@attack
def _write_into_a_named_pipe() -> str | None:
    if not _KNOWN["landlock"]:
        return None
    return _fails(lambda: os.write(os.open(_KNOWN["pipe"], os.O_WRONLY | os.O_NONBLOCK), b"left"))


@attack
def _open_a_device_that_lies_elsewhere() -> str | None:
    return None if _KNOWN["device"] is None else _fails(lambda: os.open(_KNOWN["device"], os.O_RDONLY))


@attack
def _send_from_one_end_of_a_pair() -> str | None:
    for kind in (socket.SOCK_DGRAM, socket.SOCK_RAW, socket.SOCK_STREAM, socket.SOCK_SEQPACKET):
        for address in _KNOWN["mailboxes"]:
            for way in ("sendto", "connect", "sendmsg"):
                with contextlib.suppress(OSError):
                    one, other = socket.socketpair(socket.AF_UNIX, kind)
                    with one, other:
                        _address(one, way, address.replace("@", "\0"))
                        other.setblocking(False)
                        if kind == socket.SOCK_SEQPACKET and other.recv(8) == b"left":
                            continue  # these ignore an address: it went to the other end
                        return f"a pair of kind {int(kind)} reached {address}"
    return None


def _address(one: socket.socket, way: str, address: str) -> None:
    if way == "connect":
        one.connect(address)
    elif way == "sendto":
        one.sendto(b"left", address)
    else:
        one.sendmsg([b"left"], [], 0, address)


# -- files -------------------------------------------------------------------------------------------------------------


@attack
def _write_into_the_checkout() -> str | None:
    return _write(_KNOWN["checkout"] + "/left.txt") or _fails(lambda: Path(_KNOWN["checkout"], "model.py").unlink())


@attack
def _write_beside_the_checkout() -> str | None:
    return _write(str(Path(_KNOWN["checkout"]).parent / "left.txt"))


@attack
def _write_where_programs_meet() -> str | None:
    places = ("/tmp", "/var/tmp", "/run", "/dev", "/", "/etc", "/sys")  # noqa: S108 - what is tried
    tried = {place: _write(place + "/xpl-left") for place in places}
    return next((f"{place}: {got}" for place, got in tried.items() if got), None)


@attack
def _write_through_a_link() -> str | None:
    link = Path(_KNOWN["folder"], "link")
    link.symlink_to(_KNOWN["checkout"])
    return _write(str(link / "left.txt"))


@attack
def _see_what_others_left() -> str | None:
    return next((path for path in _KNOWN["hidden"] if Path(path).exists()), None)


@attack
def _write_to_the_kernel() -> str | None:
    """Everything of /proc and /sys that concerns the machine, core_pattern and sysrq-trigger among it."""
    for place in ("/proc", "/sys/kernel", "/sys/module", "/sys/fs", "/sys/power", "/sys/devices/system"):
        for folder, folders, files in os.walk(place):
            if folder == "/proc":
                folders[:] = [name for name in folders if not name.isdecimal() and name not in ("self", "thread-self")]
            for name in files:
                with contextlib.suppress(OSError):
                    os.close(os.open(f"{folder}/{name}", os.O_WRONLY | os.O_NONBLOCK))
                    return f"{folder}/{name} opened for writing"
    return None


@attack
def _give_a_file_to_somebody() -> str | None:
    mine = Path(_KNOWN["folder"], "mine")
    mine.touch()
    return _fails(lambda: os.chown(mine, 12345, 12345))


@attack
def _make_a_device() -> str | None:
    return _fails(lambda: os.mknod(_KNOWN["folder"] + "/disk", 0o60600, os.makedev(8, 0)))


@attack
def _use_a_device_of_the_machine() -> str | None:
    allowed = {"null", "zero", "full", "random", "urandom", "fd", "stdin", "stdout", "stderr", "shm", "pts", "ptmx"}
    allowed |= {"tty", "console", "mqueue", "core", *(Path(path).name for path in _KNOWN["gpu"])}
    return next((name for name in os.listdir("/dev") if name not in allowed), None)  # noqa: PTH208 - names


@attack
def _type_into_the_terminal() -> str | None:
    with contextlib.suppress(OSError), open("/dev/tty", "wb", buffering=0) as terminal:  # noqa: PTH123 - short
        return _fails(lambda: fcntl.ioctl(terminal, 0x5412, b"x"))
    return None


@attack
def _mount_something() -> str | None:
    return _call("mount") or _call("umount2") or _call("pivot_root") or _call("open_tree") or _call("fsopen")


@attack
def _leave_by_chroot() -> str | None:
    return _call("chroot") or _call("open_by_handle_at")


# -- other processes ---------------------------------------------------------------------------------------------------


@attack
def _see_another_process() -> str | None:
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if _KNOWN["victim"].encode() in path.read_bytes().split(b"\0"):
                return str(path)
    return None


@attack
def _signal_the_one_outside() -> str | None:
    if Path(f"/proc/{_KNOWN['pid']}").exists():
        return None  # a process of our own has that number
    return _fails(lambda: os.kill(_KNOWN["pid"], 0))


@attack
def _reach_the_first_process() -> str | None:
    """It lies inside as well, and whoever took it over would have gained nothing (`have_capabilities`)."""
    with contextlib.suppress(OSError):
        Path("/proc/1/oom_score_adj").write_text("777", encoding="ascii")  # the outside looks at its own
    return next((path for path in _KNOWN["hidden"] if os.path.exists(f"/proc/1/root{path}")), None)  # noqa: PTH110 - raises nothing


@attack
def _enter_another_namespace() -> str | None:
    return _call("setns") or _call("unshare", 1 << 28) or _call("clone", 1 << 28) or _call("clone3")


@attack
def _look_into_a_process() -> str | None:
    calls = ("ptrace", "process_vm_readv", "process_vm_writev", "pidfd_getfd", "kcmp")
    return next(filter(None, map(_call, calls)), None)


# -- the network -------------------------------------------------------------------------------------------------------


@attack
def _connect_by_ip() -> str | None:
    for address in (("127.0.0.1", _KNOWN["port"]), ("192.0.2.1", 80)):
        got = _fails(functools.partial(socket.create_connection, address, 1.0))
        if got:
            return got
    return None


@attack
def _connect_by_ip_6() -> str | None:
    return _fails(lambda: socket.create_connection(("::1", _KNOWN["port"]), 1.0))


@attack
def _send_a_datagram() -> str | None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        return _fails(lambda: sender.sendto(b"x", ("192.0.2.1", 53)))


@attack
def _connect_to_a_socket_of_the_host() -> str | None:
    for address in _KNOWN["sockets"]:
        with contextlib.suppress(OSError):
            socket.socket(socket.AF_UNIX).connect(address.replace("@", "\0", 1) if address[0] == "@" else address)
            return f"connected to {address}"
    return None


@attack
def _use_sockets_without_a_namespace() -> str | None:
    families = {"vsock": 40, "packet": 17, "alg": 38, "bluetooth": 31, "tipc": 30, "xdp": 44, "can": 29}
    for name, family in families.items():
        for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_RAW, socket.SOCK_SEQPACKET):
            with contextlib.suppress(OSError):
                socket.socket(family, kind)
                return name
    return None


@attack
def _talk_to_the_kernel_by_netlink() -> str | None:
    """Of its protocols only the one that tells of interfaces is needed, by the C library."""
    for protocol in range(1, 32):
        for kind in (socket.SOCK_RAW, socket.SOCK_DGRAM):
            with contextlib.suppress(OSError):
                socket.socket(socket.AF_NETLINK, kind, protocol)
                return f"protocol {protocol}"
    return None


@attack
def _forge_packets() -> str | None:
    return _fails(lambda: socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_ICMP))


# -- what outlives, and what is shared ---------------------------------------------------------------------------------


@attack
def _reach_shared_memory() -> str | None:
    """Memory of the host is not seen (`see_what_others_left`); what is made here must not be seen outside."""
    Path("/dev/shm/xpl-left").write_text("left", encoding="ascii")  # noqa: S108 - that is the question
    key = _LIBC.shmget(_KNOWN["shm_key"], 4096, 0o1600)
    return None if key != -1 else "no memory of its own"


@attack
def _reach_keys() -> str | None:
    return _call("keyctl") or _call("add_key") or _call("request_key")


@attack
def _raise_the_priority() -> str | None:
    return (
        _fails(lambda: os.nice(-1))
        or _fails(lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1)))
        or _fails(lambda: _raised(resource.RLIMIT_NICE))
        or _call("ioprio_set", 1, 0, 1 << 13)
    )


def _raised(limit: int) -> None:
    try:
        resource.setrlimit(limit, (40, 40))
    except ValueError as error:
        raise OSError(str(error)) from None


@attack
def _use_the_kernel_s_workshop() -> str | None:
    calls = "bpf perf_event_open userfaultfd io_uring_setup kexec_load init_module finit_module fanotify_init syslog"
    return next(
        filter(None, map(_call, f"{calls} settimeofday clock_settime sethostname swapon acct quotactl".split())), None
    )


@attack
def _use_another_table_of_calls() -> str | None:
    if platform.machine() != "x86_64":
        return None
    result = _LIBC.syscall(ctypes.c_long(0x40000000 + 39))  # x32's getpid
    return None if result == -1 else f"x32 answers {result}"


@attack
def _have_capabilities() -> str | None:
    for path in ("/proc/self/status", "/proc/1/status"):
        for line in Path(path).read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":\t")
            wanted = {"NoNewPrivs": "1", "Seccomp": "2"}
            if (name.startswith("Cap") and int(value, 16)) or wanted.get(name, value) != value:
                return f"{path}: {line}"
    return None


@attack
def _kill_everything() -> str | None:
    """The last: whoever else is in reach ends; this process and the outside live on."""
    for who in (1, os.getppid(), 0, -1):
        with contextlib.suppress(OSError):
            if who == 0:
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
            os.kill(who, signal.SIGTERM if who == 0 else signal.SIGKILL)
    return None


# -- what has to work all the same -------------------------------------------------------------------------------------


def _works() -> Iterator[str]:
    """Yield what an honest program misses."""
    import multiprocessing
    from multiprocessing import shared_memory

    Path(_KNOWN["folder"], "work").write_text("x", encoding="ascii")
    Path("/dev/null").write_text("x", encoding="ascii")
    if len(os.urandom(8)) != 8 or not Path("/dev/urandom").is_char_device():
        yield "random numbers"
    if not Path(_KNOWN["checkout"], "model.py").read_text(encoding="utf-8"):
        yield "its own code"
    for method in ("fork", "spawn"):
        if method == "spawn" and not Path(sys.executable).exists():
            continue
        context: Any = multiprocessing.get_context(method)
        left, right = context.Pipe()
        child = context.Process(target=right.send, args=("hello",))
        child.start()
        if left.recv() != "hello":
            yield method
        child.join()
    block = shared_memory.SharedMemory(create=True, size=64)
    block.close()
    block.unlink()
    if socket.if_nameindex() != [(1, "lo")]:
        yield "its interface alone"
    socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, 0).close()
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()):
        server.accept()[0].close()
    if subprocess.run([sys.executable, "-I", "-S", "-c", "pass"], check=False).returncode:
        yield "a child"
    if time.clock_gettime(time.CLOCK_MONOTONIC) <= 0:
        yield "the time"


def main() -> None:
    """Try everything and print what came of it."""
    _KNOWN.update(json.loads(sys.argv[1]))
    told: dict[str, Any] = {"work": list(_works())}
    for name, act in ATTACKS.items():
        try:
            told[name] = act()
        except Exception as error:  # noqa: BLE001 - an attack that breaks proves nothing
            told[name] = f"the attack itself failed: {type(error).__name__}: {error}"
    sys.stdout.write(json.dumps(told))


if __name__ == "__main__":
    main()
