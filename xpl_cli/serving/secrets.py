"""Secrets in files: bearer tokens and TLS certificates, for servers and clients."""

from __future__ import annotations

import ssl
import stat
from typing import TYPE_CHECKING

from xpl_cli.basics import files
from xpl_cli.basics.errors import UserError

if TYPE_CHECKING:
    from pathlib import Path

_TOKEN_BYTES = 16
_MOST_BYTES = 1 << 16


def read_token(path: Path) -> str:
    """Return the token in a file.

    Raises:
        UserError: if the file cannot be read, others may read it, or the token is too short to be a secret.
    """
    try:
        mode = path.stat().st_mode
        token = files.read_user_file(path, _MOST_BYTES).decode("ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"the token file {path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if stat.S_ISREG(mode) and mode & 0o077:
        raise UserError(f"others may read the token file {path}", hint=f"chmod 600 {path}")
    if len(token) < _TOKEN_BYTES or not token.isprintable() or " " in token:
        raise UserError(
            f"the token in {path} must be one word of at least {_TOKEN_BYTES} characters, got {len(token)}",
            hint=f"(umask 077; openssl rand -hex 32 > {path})",
        )
    return token


def server_tls_context(certificate: Path | None, key: Path | None) -> ssl.SSLContext | None:
    """Return the TLS context of a server, or None without a certificate.

    Raises:
        UserError: if only one of the files is given, or they do not make a pair.
    """
    if certificate is None and key is None:
        return None
    if certificate is None:
        raise UserError("--tls-key needs --tls-cert")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        # A key with a password would make the server wait for input.
        context.load_cert_chain(certificate, key, password=lambda: "")
    except (OSError, ssl.SSLError) as error:
        raise UserError(f"TLS: {certificate} and {key or certificate} cannot be used: {error}") from None
    return context


def client_tls_context(authority: Path) -> ssl.SSLContext:
    """Return the TLS context of a client that trusts one certificate authority, or one self-signed certificate.

    Raises:
        UserError: if the file holds none.
    """
    try:
        return ssl.create_default_context(cafile=authority)
    except (OSError, ssl.SSLError) as error:
        raise UserError(f"--ca-file: {authority} cannot be used: {error}") from None
