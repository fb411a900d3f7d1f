"""What the offline gate experiments with: a relay that cuts, pictures in every form, memory of processes, damage."""

from __future__ import annotations

import os
import queue
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.support.peer import DEADLINE_S
from xpl import _spec as spec
from xpl import images
from xpl.embodiment import get_embodiment
from xpl_cli.audit.offline import memory
from xpl_cli.audit.served import transports
from xpl_cli.audit.served.relay import PAUSE_S, Relay
from xpl_cli.packages import environments

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def echo() -> Iterator[tuple[str, queue.Queue[bytes]]]:
    """Return the address of a server that answers what it is sent, and what it was sent."""
    heard: queue.Queue[bytes] = queue.Queue()
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            while True:
                try:
                    client, _ = listening.accept()
                except OSError:
                    return
                with client:
                    while data := client.recv(1 << 16):
                        heard.put(data)
                        client.sendall(data)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"ws://127.0.0.1:{listening.getsockname()[1]}", heard
        listening.shutdown(socket.SHUT_RDWR)
        thread.join(DEADLINE_S)


def _dial(relay: Relay) -> socket.socket:
    return socket.create_connection(("127.0.0.1", int(relay.url.rpartition(":")[2])), timeout=DEADLINE_S)


def test_a_relay_passes_on_until_it_is_told_to_cut_an_answer(echo: tuple[str, queue.Queue[bytes]]) -> None:
    """The server has heard the request, the client hears nothing; who comes back waits, and gets through."""
    url, heard = echo
    with Relay(url) as relay:
        with _dial(relay) as client:
            client.sendall(b"one")
            assert client.recv(16) == b"one"
            started = time.monotonic()
            relay.cut_answer()
            client.sendall(b"two")
            assert client.recv(16) == b""
        with _dial(relay) as client:
            client.sendall(b"three")
            assert client.recv(16) == b"three"
        assert time.monotonic() - started > 0.5 * PAUSE_S
    assert [heard.get(timeout=DEADLINE_S) for _ in range(3)] == [b"one", b"two", b"three"]


def test_a_relay_cuts_in_the_middle_of_a_request(echo: tuple[str, queue.Queue[bytes]]) -> None:
    """Half of it gets through."""
    url, heard = echo
    with Relay(url) as relay, _dial(relay) as client:
        relay.cut_request()
        client.sendall(b"123456")
        assert client.recv(16) == b""
        assert heard.get(timeout=DEADLINE_S) == b"123"


@pytest.mark.parametrize("form", transports.FORMS)
def test_every_form_of_a_picture_is_read_as_rgb(form: str) -> None:
    """PNG exactly, JPEG within its error, which is far from exchanged colours; the original stays as it was."""
    obs = environments.module("offline", "scenario").observation(get_embodiment("arx_x5"))
    sent = transports.encoded(obs, form)
    for camera in sent[spec.Obs.VISION].values():
        color = camera[spec.Camera.COLOR]
        assert isinstance(color, bytes)
        assert images.has_marker(color) == (form == "marked JPEG")
    read = transports.decoded(sent)
    error = transports.error_of(obs, read)
    assert error == 0 if form == "true-RGB PNG" else 0 < error < 40
    exchanged = {**read[spec.Obs.VISION]["cam_head"]}
    exchanged[spec.Camera.COLOR] = exchanged[spec.Camera.COLOR][:, :, ::-1]
    wrong = {**read, spec.Obs.VISION: {**read[spec.Obs.VISION], "cam_head": exchanged}}
    assert transports.error_of(obs, wrong) > 100
    assert isinstance(obs[spec.Obs.VISION]["cam_head"][spec.Camera.COLOR], np.ndarray)


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="this system does not tell what memory a process uses")
def test_memory_is_that_of_the_children_and_theirs() -> None:
    """A grandchild that takes 30 MB is seen; what the process itself takes is not."""
    taking = "x = bytearray(b'1') * 30_000_000; print(flush=True); input()"
    starting = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {taking!r}])"
    before = memory.private_memory(os.getpid()) or 0
    with subprocess.Popen([sys.executable, "-c", starting], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()
        grown = (memory.private_memory(os.getpid()) or 0) - before
        child.communicate(b"\n")
    assert 30_000_000 < grown < 100_000_000


def test_a_process_without_children_has_no_memory_to_tell() -> None:
    """Nothing is found of a process that is not there either."""
    assert memory.private_memory(2**22 + 1) is None
