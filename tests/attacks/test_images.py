"""Images that are small on the wire and large in memory, and headers that lie."""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tests.support.peer import greeted
from xpl import image_codec
from xpl.observation import ObservationError
from xpl_cli.serving import decoding
from xpl_cli.serving.launch import RunningServer, running_server

MODEL = """
    class Model:
        def __init__(self, config): pass
        def update_obs_batch(self, batch): pass
        def reset(self): pass
        def infer(self, observation):
            if "fifo" in observation:
                open(observation["fifo"]).read()
            return [camera["color"].shape for camera in observation["vision"].values()]
"""
SIDE = 5600
"""Pixels; a little below the largest square."""


@pytest.fixture(scope="module")
def server(write_adapter: Callable[..., Path]) -> Iterator[RunningServer]:
    """Serve a model that tells the shapes of images."""
    with running_server(write_adapter(MODEL), {"request_timeout_s": 60}) as running:
        yield running


def bomb(width: int, height: int) -> bytes:
    rows = zlib.compressobj(9)
    data = [rows.compress(bytes(1 + width)) for _ in range(height)]
    return png(struct.pack("!IIBBBBB", width, height, 8, 0, 0, 0, 0), b"".join([*data, rows.flush()]))


def png(header: bytes, data: bytes, *more: tuple[bytes, bytes]) -> bytes:
    """Return a PNG of a header, further chunks and compressed rows."""
    chunks = [(b"IHDR", header), *more, (b"IDAT", data), (b"IEND", b"")]
    body = (
        struct.pack("!I", len(content)) + kind + content + struct.pack("!I", zlib.crc32(kind + content))
        for kind, content in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


def seen(*colors: bytes) -> dict[str, Any]:
    return {"vision": {f"cam_{number}": {"color": color} for number, color in enumerate(colors)}}


def peak(server: RunningServer) -> int:
    """Return the most memory that the front end ever had, bytes."""
    text = Path(f"/proc/{server.pid}/status").read_text(encoding="ascii")
    found = re.search(r"VmHWM:\s+(\d+) kB", text)
    assert found is not None
    return 1024 * int(found[1])


def test_a_message_of_many_large_images_is_refused_before_one_is_decoded(server: RunningServer) -> None:
    """A few megabytes that would become some gigabytes."""
    before = peak(server)
    one = bomb(SIDE, SIDE)
    with greeted(server.url) as peer:
        answer = peer.ask("infer", {"observation": seen(*[one] * 24)})
        assert (answer.message_type, answer.payload["code"]) == ("error", "invalid_frame")
        assert "unpack to" in answer.payload["message"]
        answer = peer.ask("call", {"func_name": "update_obs_batch", "obs": [seen(one)] * 24})
        assert answer.payload["code"] == "invalid_frame"
        assert peer.ask("infer", {"observation": seen(bomb(4, 2))}).payload["actions"] == [[2, 4, 3]]
    assert peak(server) - before < 100 << 20


@pytest.mark.slow
def test_requests_that_wait_do_not_fill_the_memory(server: RunningServer, fifo: Path) -> None:
    """Decoded is what there is room for; the rest waits, and all are answered in their order."""
    before, one = peak(server), bomb(SIDE, SIDE)
    with greeted(server.url) as peer:
        sent = [peer.send("infer", {"observation": {**seen(bomb(3, 1)), "fifo": str(fifo)}}).message_id]
        sent += [peer.send("infer", {"observation": seen(one)}).message_id for _ in range(10)]
        fifo.write_text("go")
        answers = [peer.receive() for _ in sent]
    assert [answer.message_id for answer in answers] == sent
    assert {answer.message_type for answer in answers} == {"infer_result"}
    assert peak(server) - before < 5 * decoding.MAX_UNPACKED_BYTES


_SOF = b"\xff\xd8\xff\xc2\0\x0b\x08\x10\0\x10\0\x01\x01\x11\0"
_IHDR = struct.pack("!IIBBBBB", 2, 2, 8, 0, 0, 0, 0)
LIARS = {
    "a second header": png(
        _IHDR, zlib.compress(bytes(6)), (b"IHDR", struct.pack("!IIBBBBB", 9000, 9000, 8, 0, 0, 0, 0))
    ),
    "no pixels": png(struct.pack("!IIBBBBB", 0, 7, 8, 0, 0, 0, 0), b""),
    "all pixels": png(struct.pack("!IIBBBBB", 2**31 - 1, 2**31 - 1, 8, 0, 0, 0, 0), b""),
    "empty chunks": png(_IHDR, zlib.compress(bytes(6)), *[(b"teSt", b"")] * 70_000),
    "a WebP canvas": b"RIFF\x1e\0\0\0WEBPVP8X\x0a\0\0\0\x02\0\0\0" + b"\xff" * 6 + bytes(20),
    "fill bytes": b"\xff\xd8" + b"\xff" * 5_000_000,
    "fill bytes after a header": _SOF + b"\xff" * 5_000_000,
    "empty segments": b"\xff\xd8" + b"\xff\xfe\0\x02" * 1_000_000,
    "many passes": _SOF + b"\xff\xda\0\x08\x01\x01\0\0\0\0" * 5000,
    "a BMP of runs": b"BM" + bytes(12) + struct.pack("<IiiHHI", 40, 5000, 5000, 1, 8, 1) + bytes(24) + b"\x01\0" * 99,
    "numbers as text": b"P3 5000 5000 255 " + b"1 " * 1_000_000,
}


@pytest.mark.parametrize("data", LIARS.values(), ids=LIARS)
def test_a_header_that_lies_is_refused(data: bytes) -> None:
    """By a sentence, before memory is taken for what it claims."""
    with pytest.raises(ObservationError, match=r"image|passes") as refusal:
        image_codec.decode(data)
    assert len(str(refusal.value)) < 400


def test_the_passes_over_a_large_jpeg_are_few() -> None:
    """Each takes as long as the whole image; encoders make about ten, which is fine at any size that is read."""
    head = _SOF.replace(b"\x10\0\x10\0", struct.pack("!HH", 5600, 5600))
    with pytest.raises(ObservationError, match="5600 x 5600 pixels has 14 passes"):
        image_codec.decode(head + b"\xff\xda\0\x08\x01\x01\0\0\0\0" * 14)
    target = io.BytesIO()
    Image.new("RGB", (5600, 5600)).save(target, "JPEG", progressive=True)
    assert image_codec.decode(target.getvalue()).shape == (5600, 5600, 3)


def encoded(image: np.ndarray, kind: str) -> bytes:
    target = io.BytesIO()
    Image.fromarray(image).save(target, kind, **({"lossless": True} if kind == "WEBP" else {}))
    return target.getvalue()


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "BMP", "TIFF", "PPM"])
@settings(max_examples=8, deadline=None)
@given(width=st.integers(1, 80), height=st.integers(1, 80))
def test_the_size_in_a_header_is_that_of_the_image(kind: str, width: int, height: int) -> None:
    data = encoded(np.zeros((height, width, 3), np.uint8), kind)
    assert image_codec.size_of(data) == (width, height)
    assert image_codec.decode(data).shape == (height, width, 3)


ANIMATED = {"save_all": True, "append_images": [Image.new("RGB", (9, 4))]}


@pytest.mark.parametrize("options", [{}, {"lossless": True}, ANIMATED], ids=["lossy", "lossless", "animated"])
def test_every_kind_of_webp_tells_its_size(options: dict[str, Any]) -> None:
    target = io.BytesIO()
    Image.new("RGB", (9, 4), "red").save(target, "WEBP", **options)
    assert image_codec.size_of(target.getvalue()) == (9, 4)
