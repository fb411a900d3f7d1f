"""XPL130: The package contains no internal host, proxy, personal path, credential or hard-coded mirror."""

from __future__ import annotations

import ipaddress
import math
import re
from collections.abc import Iterator
from urllib.parse import urlsplit

from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static import vendored
from xpl_cli.audit.static.scripts.flow import is_candidate
from xpl_cli.audit.static.source import Source

_ADDRESS = re.compile(r"(?<![\w.])(?:\d{1,3}\.){3}\d{1,3}(?![\w.])")
_VERSION = re.compile(r"(?:[=<>~!]=|(?<!:)[-_v@]|version\S*\s*)$", re.IGNORECASE)
_DEFAULT = re.compile(r"\$\{\w+:?[-=][^}\s]*$")
"""What stands before the default of a variable in a script, as in `${HOST:-192.168.0.1}`."""
_HOME = re.compile(r"(?<![\w.$}])/(?:home|Users)/([\w.-]+)")
_PROXY = re.compile(r"\b(?:https?|all|ftp)_proxy\b\s*[=:]\s*[\"']?(\w+://[^\s\"'$]+|[\d.]+:\d+)", re.IGNORECASE)
_LINK = re.compile(r"https?://[^\s\"'<>)}\]`]+")
_SECRET = re.compile(
    r"(?:api_?key|access_?key|secret(?:_?key)?|token|passw(?:or)?d)[\"']?\]?\s*[=:]\s*[\"']?([\w+=-]{16,})",
    re.IGNORECASE,
)
_KEY = re.compile(
    r"(?:api|access|secret)_?key[\"']?\]?\s*[=:]\s*[\"']?([A-Za-z0-9+=-]{24,})[\"']?\s*(?:$|[#;,)])",
    re.IGNORECASE | re.MULTILINE,
)
"""What is certainly a credential also where others wrote the code: a key by its name, and long."""
_ISSUED = re.compile(r"\b(?:hf_[A-Za-z0-9]{30,}|sk-[A-Za-z0-9-]{20,}|gh[pousr]_[A-Za-z0-9]{30,}|AKIA[A-Z0-9]{16})\b")
_HINTS = (
    *("/home/", "/users/", "_proxy", "://", "key", "token", "secret", "passw", "hf_", "sk-", "akia"),
    *(f"gh{kind}_" for kind in "pousr"),
)
"""One of these stands, in small letters, in whatever the patterns find, but for addresses."""
_VENDORED_HINTS = (
    *(f"{kind}{joint}key" for kind in ("api", "access", "secret") for joint in ("_", "")),
    *("hf_", "sk-", "akia", "ghp_", "gho_"),
)
"""One of these stands, in small letters, in whatever `_ISSUED` and `_KEY` find."""
_ANYBODY = frozenset(
    ("user", "username", "you", "your", "your_name", "yourname", "me", "name", "xxx", "someone", "example")
)
_SUFFIXES = (".py", ".sh", ".yml", ".yaml", ".toml", ".cfg", ".txt")


@rule(code="XPL130", requirement="XPL-PKG-3")
def private_data(source: Source) -> Iterator[Finding]:
    """The package contains a host, a path, a proxy or a credential that only its author has.

    ## What it does
    Reads code, scripts and configuration, comments too, and looks for addresses of private networks, personal home
    folders, proxies, index mirrors, and literals that look like credentials. Their values are not printed. Vendored
    code is searched for keys and, in scripts, for private addresses as defaults; the first one of each is reported, an
    address as a warning, since the adapter may never run that script.

    ## Why it matters
    On other machines these hosts and paths do not exist: the installation hangs at a proxy, or takes packages from an
    unverified mirror. A credential in a repository is public from then on.

    ## Example
    `export HTTPS_PROXY=http://10.0.0.7:3128` in `install.sh`.

    ## Use instead
    Environment variables without a default; users have their own proxies and mirrors.

    ## Fix safety
    No automatic fix. A credential that was published has to be revoked; deleting the line is not enough.
    """
    for name in source.text_files:
        if not name.endswith(_SUFFIXES):
            continue
        for number, line in _lines(source.text(name)):
            for message, start, got, advice in _suspects(line[:2000]):
                if name.endswith(".sh") and message.startswith("a path") and is_candidate(source.text(name), number):
                    continue
                yield Finding(
                    message,
                    path=name,
                    line=number,
                    column=start + 1,
                    expected="nothing that exists only on the author's machines",
                    got=got,
                    fix=Fix("advice", advice),
                )
    yield from _vendored(source)


def _vendored(source: Source) -> Iterator[Finding]:
    """Yield the first credential in a vendored tree, and the first private address that a script falls back on."""
    key = address = False
    for name, text in vendored.texts(source):
        small = text.lower()
        may_hold = not key and any(hint in small for hint in _VENDORED_HINTS)
        may_lead = not address and name.endswith(".sh") and _ADDRESS.search(text) is not None
        for number, line in enumerate(text.split("\n"), start=1) if may_hold or may_lead else ():
            issued = (_ISSUED.search(line[:2000]) or _KEY.search(line[:2000])) if may_hold and not key else None
            if issued is not None and _is_random(issued.group(issued.lastindex or 0)):
                key = True
                yield Finding(
                    "what looks like a credential is published in a vendored file of the adapter",
                    path=name,
                    line=number,
                    column=issued.start() + 1,
                    expected="nothing that exists only on the author's machines",
                    got=f"a literal of {len(issued.group(issued.lastindex or 0))} characters",
                    fix=Fix("advice", "revoke it, and delete the line"),
                )
            for match in _ADDRESS.finditer(line[:2000]) if may_lead and not address else ():
                if _is_private(match.group()) and _DEFAULT.search(line[: match.start()]):
                    address = True
                    yield Finding(
                        "a vendored script falls back on a host of a private network; the adapter may never run it",
                        path=name,
                        line=number,
                        column=match.start() + 1,
                        expected="no default, or an argument",
                        got=match.group(),
                        fix=Fix("advice", "delete the default"),
                        must=False,
                    )
                    break


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines in which the patterns may find something, with their numbers."""
    small = text.lower()
    hints = [hint for hint in _HINTS if hint in small]
    has_address = _ADDRESS.search(text) is not None
    if not hints and not has_address:
        return
    for number, line in enumerate(text.split("\n"), start=1):
        small = line.lower()
        if any(hint in small for hint in hints) or (has_address and line.count(".") > 2):
            yield number, line


def _suspects(line: str) -> Iterator[tuple[str, int, str, str]]:
    proxy = _PROXY.search(line)
    if proxy is not None:
        yield "every download uses a proxy that users do not have", proxy.start(), "a proxy", "delete it"
    for match in _ADDRESS.finditer(line) if proxy is None else ():
        if _is_private(match.group()) and not _VERSION.search(line[: match.start()]):
            message = "a host of a private network is named: elsewhere it is unreachable, or another machine"
            yield message, match.start(), match.group(), "delete it, or read it from the configuration"
    for match in _HOME.finditer(line):
        if match.group(1).lower() not in _ANYBODY:
            message = f"a path in the home folder of {match.group(1)} exists on one machine only"
            yield message, match.start(), match.group(), "read the path from the configuration or the environment"
    for match in _LINK.finditer(line):
        if _is_mirror(match.group()) and not line.lstrip().startswith("#"):
            host = urlsplit(match.group()).hostname
            message = (
                f"packages and weights are downloaded from the mirror {host}, whether or not users trust and reach it"
            )
            yield message, match.start(), str(host), "delete it: users set a mirror in their own configuration"
    issued = _ISSUED.search(line) or _SECRET.search(line)
    if issued is not None and _is_random(issued.group(issued.lastindex or 0)):
        message = "what looks like a credential is published with the adapter"
        got = f"a literal of {len(issued.group(issued.lastindex or 0))} characters"
        yield message, issued.start(), got, "revoke it, and read it from the environment"


def _is_private(text: str) -> bool:
    try:
        address = ipaddress.IPv4Address(text)
    except ValueError:
        return False
    return address.is_private and not address.is_loopback and not address.is_unspecified and not text.startswith("0.")


def _is_mirror(link: str) -> bool:
    """Tell by its host's labels whether a link leads to a mirror of an index or a hub; no host is listed here."""
    try:
        labels = (urlsplit(link).hostname or "").split(".")
    except ValueError:
        return False
    words = {word for label in labels[:-1] for word in label.split("-")}
    return bool(words & {"mirror", "mirrors"}) or (
        "pypi" in words and len(labels) > 2 and link.rstrip("/").endswith("simple")
    )


def _is_random(text: str) -> bool:
    """Tell whether a literal looks drawn at random: letters and digits, of many kinds. Names and paths do not."""
    if not re.search(r"\d", text) or not re.search(r"[A-Za-z]", text) or "/" in text[:2] or text.count("_") > 2:
        return False
    shares = [text.count(character) / len(text) for character in set(text)]
    return -sum(share * math.log2(share) for share in shares) > 3.3
