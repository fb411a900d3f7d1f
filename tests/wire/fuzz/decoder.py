"""What reads bytes, as targets of fuzzers: each takes any bytes, and may refuse them in one way only.

As a script it runs under atheris, guided by coverage: `python tests/wire/fuzz/decoder.py -max_total_time=20 CORPUS`.
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from unittest import mock

from tests.support.checkout import ROOT


def read_frame(data: bytes) -> None:
    from xpl.wire import codec, packed

    with contextlib.suppress(codec.WireError, packed.PackingError):
        frame = codec.decode(data)
        codec.unpacked(frame.payload)
        codec.encode(frame)


def read_packed(data: bytes) -> None:
    """Read a packed value, without shared memory; what was read can be packed again."""
    from xpl.wire import packed

    with contextlib.suppress(packed.PackingError):
        packed.encode(packed.decode(data))


def read_stream(data: bytes) -> None:
    """Cut the stream of a worker into messages, and read them; it arrives in pieces of the first byte's size.

    Our own processes take memory for what they announce to each other, up to limits that are lowered here.
    """
    from xpl.process import link
    from xpl.wire import process_frame

    inbox, size, position = link.Inbox(), 1 + (data[0] if data else 0), 1
    lower = mock.patch.multiple(process_frame, HEADER_LIMIT=1 << 16, BODY_LIMIT=1 << 18)
    with contextlib.suppress(process_frame.PackingError), lower:
        while position < len(data):
            space = inbox.space()
            piece = data[position : position + min(size, len(space))]
            space[: len(piece)] = piece
            position += len(piece)
            for message in inbox.take(len(piece)):
                link.decode(message)


def read_hello(data: bytes) -> None:
    """Read what an environment announces of itself, and compare it with what a policy needs."""
    from xpl.client import agreement
    from xpl.wire import codec

    needed = {"embodiment": "arx_x5", "action_types": ["joint"], "inputs": ["vision.cam_head"], "control_frequency": 20}
    with contextlib.suppress(codec.WireError, agreement.AnnouncementError):
        announced = agreement.validate_announcement(codec.decode(data).payload.get("environment"))
        agreement.format_differences(agreement.differences(needed, announced))


def read_image_header(data: bytes) -> None:
    from xpl import image_codec
    from xpl.observation import ObservationError

    with contextlib.suppress(ObservationError):
        width, height = image_codec.size_of(data)
        assert 0 <= width * height <= image_codec.PIXELS


TARGETS: tuple[Callable[[bytes], None], ...] = (read_frame, read_packed, read_stream, read_hello, read_image_header)


def seeds() -> Iterator[tuple[int, bytes]]:
    import numpy as np

    from xpl import image_codec
    from xpl.process import link
    from xpl.wire import codec, packed

    empty = codec.encode(codec.Frame("call", "e", {}))
    for name in ("frames", "refused", "values", "lenient"):
        text = (ROOT / "conformance" / "vectors" / f"{name}.json").read_text(encoding="utf-8")
        for vector in json.loads(text)["vectors"]:
            data = b"".join(bytes.fromhex(piece) for piece, _ in vector["bytes"])
            yield 0, data if name in ("frames", "refused") else empty[:-1] + b"\x81\xa1v" + data
    step = {"arm_joint_state": np.zeros(7, np.float32), "ee_joint_state": np.ones(1, np.float32)}
    for value in (step, [step, step], [np.float32(1), 2j, "é", {"@": b"xy"}], np.zeros(2, [("f", "<i4")])):
        pieces = packed.encode({"obs": value})
        yield 0, codec.encode(codec.Frame("call", "e"), pieces)
        yield 1, b"".join(pieces)
        yield 2, b"\x07" + 2 * b"".join(link.encode({"op": "run"}, [b"".join(pieces), b"", b"x"]))
    frame = {"width": 640, "height": 480}
    announced = {"embodiment": "arx_x5", "control_frequency": 20.0, "inputs": ["a"], "cameras": {"cam_head": frame}}
    yield 3, codec.encode(codec.Frame("hello", "e", {"environment": announced}))
    yield 3, codec.encode(codec.Frame("hello", "e", {"environment": {"embodiment": np.arange(3)}}))
    picture = np.zeros((2, 3, 3), np.uint8)
    for data in (
        image_codec.encode_png(picture),
        image_codec.encode_jpeg(picture),
        b"RIFF\x1a\0\0\0WEBPVP8X" + bytes(20),
    ):
        yield 4, data


def one_input(data: bytes) -> None:
    if data:
        TARGETS[data[0] % len(TARGETS)](data[1:])


def main() -> None:
    import atheris

    sys.path.insert(0, str(ROOT))
    with atheris.instrument_imports(include=["xpl"]):
        from xpl import image_codec  # noqa: F401
        from xpl.client import agreement  # noqa: F401
        from xpl.wire import codec, packed  # noqa: F401 - instrumented as they are imported
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
