"""One file over HTTP: goes on where it was cut, notices what changed meanwhile, and takes no more than it was told.

Whether the bytes are the right ones is not decided here, but by their digest.
"""

from __future__ import annotations

import http.client
import os
import re
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING
from urllib.parse import urlsplit

from xpl_cli import __version__
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

_BLOCK = 1 << 20
_AGAIN = frozenset((408, 425, 429, 500, 502, 503, 504))
_GONE = frozenset((404, 410))
_PARTIAL, _NO_SUCH_RANGE = 206, 416
_RANGE = re.compile(r"bytes (\d+)-\d+/(\d+|\*)")


@dataclass(frozen=True)
class Patience:
    """How long a transfer keeps trying.

    Attributes:
        attempts: attempts in a row that bring nothing.
        most: attempts in all.
        pause: wait after the first attempt that brought nothing, s; it doubles from there.
        timeout: longest silence of the other side, s.
    """

    attempts: int = 4
    most: int = 200
    pause: float = 0.5
    timeout: float = 60.0


@dataclass(frozen=True)
class Bounds:
    """What may arrive.

    Attributes:
        size: bytes that the file has, None if that is not known.
        limit: most bytes.
    """

    size: int | None
    limit: int

    def check(self, size: int, url: str) -> None:
        """Raise if a file of this many bytes is not what was expected.

        Raises:
            UserError: if it is too large, or of another size.
        """
        if self.size is not None and size != self.size:
            raise UserError(f"{url} has {size} bytes, expected {self.size}", code=ExitCode.FINDINGS)
        if size > self.limit:
            raise UserError(f"{url} has {size} bytes, more than the limit of {self.limit}", hint="raise --max-size")


class _CutError(Exception):
    """A transfer that ended early, or was put off; the next attempt may go on."""


def download(
    url: str, part: Path, bounds: Bounds, say: Callable[[int], None], patience: Patience | None = None
) -> bool:
    """Bring one file, going on with what `part` holds, and tell whether that was anything.

    Args:
        url: its address, http or https.
        part: the file to write; beside it a file that remembers which state of the source it is of.
        bounds: what may arrive.
        say: takes the number of bytes that are there.
        patience: how long to try.

    Raises:
        NotFoundError: if the source does not have it.
        UserError: if it cannot be had, or is not as large as it should be; what has arrived stays.
    """
    patience = patience or Patience()
    resumed = part.exists() and part.stat().st_size > 0
    idle = 0
    for attempt in range(patience.most):
        before = part.stat().st_size if part.exists() else 0
        try:
            _attempt(url, part, bounds, say, patience.timeout)
        except (_CutError, OSError, http.client.HTTPException) as error:
            grown = part.exists() and part.stat().st_size > before
            resumed = resumed or attempt > 0 or grown
            idle = 0 if grown else idle + 1
            if idle >= patience.attempts or attempt + 1 == patience.most:
                raise UserError(
                    f"{url} cannot be had: {_reason(error)}",
                    hint="run the same command again: it goes on where it stopped",
                    code=ExitCode.NOT_RUN,
                ) from None
            if idle:
                time.sleep(patience.pause * 2 ** (idle - 1))
        else:
            return resumed
    raise AssertionError("unreachable: the last attempt returns or raises")


def _attempt(url: str, part: Path, bounds: Bounds, say: Callable[[int], None], timeout: float) -> None:
    """Make one request and write what it brings; raises unless the file is complete then."""
    state = part.with_name(f"{part.name}.state")
    have = part.stat().st_size if part.exists() else 0
    validator = state.read_text(encoding="utf-8") if have and state.exists() else ""
    request = urllib.request.Request(url, headers=_headers(have, validator))  # noqa: S310 - the caller checked the scheme
    opener = urllib.request.build_opener(_Redirects)
    try:
        with opener.open(request, timeout=timeout) as answer:
            start, total = _extent(answer, have)
            if total is not None:
                bounds.check(total, url)
            state.write_text(_validator(answer.headers), encoding="utf-8")
            with part.open("r+b" if part.exists() else "wb") as stream:
                stream.truncate(start)
                stream.seek(start)
                _copy(answer, stream, bounds, url, say)
                os.fsync(stream.fileno())
                end = stream.tell()
    except urllib.error.HTTPError as error:
        with error:
            _refused(error, part, url)
        return
    if total is not None and end < total:
        raise _CutError(f"the connection was cut at byte {end} of {total}")
    bounds.check(end, url)
    state.unlink(missing_ok=True)


def _headers(have: int, validator: str) -> dict[str, str]:
    headers = {"User-Agent": f"xpl/{__version__}", "Accept-Encoding": "identity"}
    if have:
        headers["Range"] = f"bytes={have}-"
        if validator:
            headers["If-Range"] = validator
    return headers


def _validator(headers: http.client.HTTPMessage) -> str:
    """Return what names the state of a source: its strong entity tag, or else when it was changed."""
    tag = headers.get("ETag") or ""
    return tag if tag and not tag.startswith("W/") else headers.get("Last-Modified") or ""


def _extent(answer: http.client.HTTPResponse, have: int) -> tuple[int, int | None]:
    """Return at which byte an answer starts, and how many bytes the file has."""
    if answer.status != _PARTIAL:
        length = answer.headers.get("Content-Length")
        return 0, int(length) if length and length.isdigit() else None
    found = _RANGE.fullmatch((answer.headers.get("Content-Range") or "").strip())
    if found is None or int(found[1]) != have:
        raise _CutError(f"bytes from {have} on were asked for, and others came")
    return have, None if found[2] == "*" else int(found[2])


def _copy(
    answer: http.client.HTTPResponse, stream: IO[bytes], bounds: Bounds, url: str, say: Callable[[int], None]
) -> None:
    most = bounds.limit if bounds.size is None else min(bounds.size, bounds.limit)
    while block := answer.read1(_BLOCK):
        if stream.tell() + len(block) > most:
            stream.truncate(0)
            bounds.check(stream.tell() + len(block), url)
        stream.write(block)
        say(stream.tell())


def _refused(error: urllib.error.HTTPError, part: Path, url: str) -> None:
    """Judge an answer that is none: the file may be complete already, be gone, or come later."""
    if error.code == _NO_SUCH_RANGE:
        total = (error.headers.get("Content-Range") or "").rpartition("/")[2]
        if total.isdigit() and int(total) == part.stat().st_size:
            return
        part.unlink()  # of another state of the source
        raise _CutError("what had arrived is not the beginning of what is there now")
    if error.code in _AGAIN:
        raise _CutError(f"HTTP {error.code} {error.reason}")
    if error.code in _GONE:
        raise NotFoundError(f"{url} is not there (HTTP {error.code})")
    raise UserError(f"{url} was refused: HTTP {error.code} {error.reason}", code=ExitCode.NOT_RUN)


def _reason(error: Exception) -> str:
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    return str(reason) or type(reason).__name__


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows redirects, but from https to https only, and never to another kind of address."""

    def redirect_request(  # noqa: PLR0913, PLR0917 - the base class gives these
        self,
        req: urllib.request.Request,
        fp: IO[bytes],
        code: int,
        msg: str,
        headers: http.client.HTTPMessage,
        newurl: str,
    ) -> urllib.request.Request | None:
        """Return the request for the new address.

        Raises:
            UserError: if it is less safe than the old one.
        """
        old, new = urlsplit(req.full_url).scheme, urlsplit(newurl).scheme
        if new not in ("http", "https") or (old == "https" and new != "https"):
            raise UserError(f"{req.full_url} leads to {newurl}, which is less safe", code=ExitCode.NOT_RUN)
        return super().redirect_request(req, fp, code, msg, headers, newurl)
