"""`xpl serve --renew` builds the model anew for every client, in the same process."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from xpl import Client
from xpl.client import ClientError
from xpl_cli.serving.launch import running_server

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

COUNTS = """
    {shelf}

    class Model:
        def __init__(self, config):
            shelf.built = getattr(shelf, "built", 0) + 1
            self.answered = 0
            if shelf.built > 1:
                raise RuntimeError("there is only one robot")

        def infer(self, observation):
            self.answered += 1
            return [shelf.built, self.answered]

        def reset(self):
            pass
"""


def _counting(write_adapter: Callable[..., Path], shelf: str) -> Path:
    adapter = write_adapter(COUNTS.format(shelf=shelf))
    (adapter / "shelf.py").touch()
    return adapter


def _asked(url: str) -> list[int]:
    """Ask once as a client of its own."""
    with Client(url) as client:
        client.reset()
        answer: list[int] = client.infer({})
        return answer


@pytest.mark.parametrize(("options", "second"), [((), [1, 2]), (("--renew",), [1, 1])])
def test_every_client_gets_a_model_that_was_just_built(
    options: tuple[str, ...], second: list[int], write_adapter: Callable[..., Path]
) -> None:
    """Neither the model nor its modules know of the client before; without the option the model goes on."""
    with running_server(_counting(write_adapter, "from . import shelf"), options=options) as server:
        assert [_asked(server.url) for _ in range(2)] == [[1, 1], second]


def test_a_model_that_cannot_be_built_twice_ends_the_server(write_adapter: Callable[..., Path]) -> None:
    """The client is told why; nobody is served by half a model."""
    with running_server(_counting(write_adapter, "import sys as shelf"), options=["--renew"]) as server:
        _asked(server.url)
        with pytest.raises(ClientError, match="only one robot"):
            _asked(server.url)
