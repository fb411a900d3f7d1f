"""Test an isolation from inside by trying to break out; print the promises that do not hold.

    python -I -S proof.py EXPECTED

`EXPECTED` (JSON) holds facts from outside: `checkout`, `folder`, `hidden` (a file that must be invisible), `port` (one
with a listener), `namespaces` (outside's, by name), `calls` (numbers of system calls to be refused). Exits with 0, or
with a sentence on standard error. Standard library only.
"""

from __future__ import annotations

import ctypes
import errno
import json
import os
import socket
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

_VSOCK = 40
_libc = ctypes.CDLL(None, use_errno=True)


def broken(expected: dict[str, Any]) -> Iterator[str]:
    """Yield the broken promises."""
    for name, outside in expected["namespaces"].items():
        if Path(f"/proc/self/ns/{name}").readlink().name == outside:
            yield f"the {name} namespace is the machine's"
    yield from _files(expected)
    if _goes(lambda: socket.create_connection(("127.0.0.1", expected["port"]), 1.0)):
        yield "the network stays in reach"
    yield from _rights()
    for family in (socket.AF_UNIX, _VSOCK):
        if _goes(partial(socket.socket, family, socket.SOCK_STREAM)):
            yield f"sockets of family {int(family)} can be made"
    for name, number in expected["calls"].items():
        if _libc.syscall(ctypes.c_long(number), *[ctypes.c_long(-1)] * 5) == 0 or ctypes.get_errno() != errno.EPERM:
            yield f"the system call {name} is not refused"


def _files(expected: dict[str, Any]) -> Iterator[str]:
    for path in (expected["checkout"], "/", "/tmp", "/dev", "/proc/sys/kernel/core_pattern", "/sys"):  # noqa: S108
        if os.access(path, os.W_OK):
            yield f"{path} stays writable"
    if not os.access(expected["folder"], os.W_OK):
        yield "the temporary folder is not writable"
    if Path(expected["hidden"]).exists():
        yield f"{Path(expected['hidden']).parent} is the machine's"


def _rights() -> Iterator[str]:
    status = dict(line.split(":\t", 1) for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines())
    for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb"):
        if int(status[name], 16):
            yield f"capabilities are left ({name} {status[name]})"
    for name, expected in (("NoNewPrivs", "1"), ("Seccomp", "2")):
        if status.get(name) != expected:
            yield f"{name} is {status.get(name)}, not {expected}"
    if _goes(lambda: os.nice(-1)):
        yield "the priority can be raised"


def _goes(attempt: Callable[[], object]) -> bool:
    try:
        attempt()
    except OSError:
        return False
    return True


if __name__ == "__main__":
    sys.exit("; ".join(broken(json.loads(sys.argv[1]))) or 0)  # noqa: TID251 - written by the parent
