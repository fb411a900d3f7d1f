"""The websockets library with nothing on top: the same bytes as raw TCP, one binary message each way.

Setting `sync` asks with its threaded client, `async` with its asyncio client; the server is the asyncio one.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from websockets.asyncio.client import connect as connect_async
from websockets.asyncio.server import ServerConnection
from websockets.asyncio.server import serve as serve_async
from websockets.sync.client import connect as connect_sync

from benchmarks.serving_bench.payloads import HEAD, Payload, actions

if TYPE_CHECKING:
    from benchmarks.serving_bench.ends import Ask, Ready
    from benchmarks.serving_bench.model import Model


def serve(model: Model, setting: str, ready: Ready) -> None:  # noqa: ARG001 - the setting is the client's
    """Serve on a free port of this host."""

    async def answer(connection: ServerConnection) -> None:
        async for message in connection:
            assert isinstance(message, bytes)
            _, batch = HEAD.unpack_from(message)
            model.think(batch)
            await connection.send(actions(batch).tobytes())

    async def run() -> None:
        async with serve_async(answer, "127.0.0.1", 0, compression=None, max_size=None) as server:
            ready(f"ws://127.0.0.1:{next(iter(server.sockets)).getsockname()[1]}")
            await server.serve_forever()

    asyncio.run(run())


class SyncConnection:
    """The threaded client."""

    def __init__(self, address: str) -> None:
        self._socket = connect_sync(address, compression=None, max_size=None, proxy=None)

    def asking(self, payload: Payload) -> Ask:
        """Return the function that sends the payload's bytes."""
        request = payload.raw

        async def ask() -> Any:
            self._socket.send(request)
            return self._socket.recv()

        return ask

    async def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class AsyncConnection:
    """The asyncio client."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket

    def asking(self, payload: Payload) -> Ask:
        """Return the function that sends the payload's bytes."""
        request = payload.raw

        async def ask() -> Any:
            await self._socket.send(request)
            return await self._socket.recv()

        return ask

    async def close(self) -> None:
        """Close the connection."""
        await self._socket.close()


async def connect(address: str, setting: str) -> SyncConnection | AsyncConnection:
    """Connect with the client that the setting names."""
    if setting == "sync":
        return SyncConnection(address)
    return AsyncConnection(await connect_async(address, compression=None, max_size=None, proxy=None))
