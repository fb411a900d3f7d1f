"""What a recording is played against: an adapter that is served for it, or a server that runs already."""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from xpl import Client
from xpl_cli.audit.served.servers import PATIENCE
from xpl_cli.serving.launch import serving

if TYPE_CHECKING:
    import ssl
    from collections.abc import Iterator, Mapping, Sequence

    from xpl_cli.packages.package import Package

_FLAGS = frozenset(("--shadow", "--stub-missing", "--watch", "--renew"))
_UNSET, _CHDIR = "--unset", "--chdir"
"""Options with a value: a key of deploy.yml that is left out, and a working directory other than the adapter's."""


class Counterpart(Protocol):
    """What a recording is played against."""

    @property
    def name(self) -> str:
        """How reports name it."""

    def server(
        self, overrides: Mapping[str, Any], options: Sequence[str]
    ) -> contextlib.AbstractContextManager[str] | None:
        """Return a server, which yields its address, or None if there is none like it.

        Args:
            overrides: keys of deploy.yml.
            options: further options of `xpl serve`.
        """

    def client(self, url: str, wishes: Mapping[str, Any]) -> Client:
        """Return a client of a server."""


@dataclass(frozen=True)
class Adapter:
    """An adapter that is served for every server of the recording, as that was.

    Attributes:
        package: the adapter.
        overrides: keys of deploy.yml that count besides the recorded ones.
        python, env: its interpreter, as for `xpl serve`.
    """

    package: Package
    overrides: Mapping[str, Any] = field(default_factory=dict)
    python: str | None = None
    env: str | None = None

    @property
    def name(self) -> str:
        """How reports name it."""
        return str(self.package.path)

    def server(self, overrides: Mapping[str, Any], options: Sequence[str]) -> contextlib.AbstractContextManager[str]:
        """Return the adapter served with these values of deploy.yml, and those that count besides.

        Raises:
            LookupError: if an option is not one that recordings have: they may come from anywhere.
        """
        return self._served({**overrides, **self.overrides}, _parsed(options))

    def client(self, url: str, wishes: Mapping[str, Any]) -> Client:
        """Return a client of a server."""
        return Client(url, config=self.package.config(self.overrides) | PATIENCE, **wishes)

    @contextlib.contextmanager
    def _served(self, overrides: Mapping[str, Any], asked: _Asked) -> Iterator[str]:
        # As in an audit: without the model, its environment is not needed either.
        env = "none" if "--shadow" in asked.options and not (self.python or self.env) else self.env
        with contextlib.ExitStack() as opened:
            options = asked.options
            if asked.elsewhere:
                folder = opened.enter_context(tempfile.TemporaryDirectory(prefix="xpl-elsewhere-"))
                options = (*options, _CHDIR, folder)
            started = serving(self.package.path, overrides, python=self.python, env=env, options=options)
            yield opened.enter_context(started).url


@dataclass(frozen=True)
class _Asked:
    """How a recorded server was started.

    Attributes:
        options: of `xpl serve`, to be given again.
        elsewhere: whether its adapter ran in another, empty folder. Which one is of no interest: that one is gone, and
            a recording chooses no folder of this machine.
    """

    options: tuple[str, ...]
    elsewhere: bool


def _parsed(options: Sequence[str]) -> _Asked:
    """Return what the recorded options of a server ask for.

    Raises:
        LookupError: if one of them is not one that recordings have.
    """
    kept: list[str] = []
    elsewhere = False
    waiting = iter(options)
    for option in waiting:
        if option in _FLAGS:
            kept.append(option)
        elif option in (_UNSET, _CHDIR):
            value = next(waiting, None)
            if not isinstance(value, str) or value.startswith("-"):
                raise LookupError(f"the recorded option {option!r} has no value")
            elsewhere = elsewhere or option == _CHDIR
            kept += [option, value] if option == _UNSET else []
        else:
            raise LookupError(f"recorded servers have no option {option!r}")
    return _Asked(tuple(kept), elsewhere)


@dataclass(frozen=True)
class Remote:
    """A server that runs already, with one configuration.

    Attributes:
        url: where it answers.
        overrides: the keys of deploy.yml that it is taken to be served with; servers with others cannot be played.
        token, ssl_context: as for `xpl.Client`.
    """

    url: str
    overrides: Mapping[str, Any]
    token: str | None = None
    ssl_context: ssl.SSLContext | None = None

    @property
    def name(self) -> str:
        """How reports name it."""
        return self.url

    def server(
        self, overrides: Mapping[str, Any], options: Sequence[str]
    ) -> contextlib.AbstractContextManager[str] | None:
        """Return the server if it is taken to be like this one."""
        alike = dict(overrides) == dict(self.overrides) and not options
        return contextlib.nullcontext(self.url) if alike else None

    def client(self, url: str, wishes: Mapping[str, Any]) -> Client:
        """Return a client of the server."""
        return Client(url, config=PATIENCE, token=self.token, ssl_context=self.ssl_context, **wishes)
