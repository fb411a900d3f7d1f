"""Who vouches for a bundle: a detached signature of OpenSSH beside it, `Foo.xpl.zip.sig`.

Made and checked by `ssh-keygen -Y`, as git signs commits: people have such keys already, on a token if they like, and
publish them (`https://github.com/NAME.keys`); nothing is asked of a network; and without xpl,

    ssh-keygen -Y verify -f allowed_signers -I NAME -n xpl-bundle -s Foo.xpl.zip.sig < Foo.xpl.zip

says the same. A signature is of the archive's bytes, so that nothing of a bundle is read before it fits.
"""

from __future__ import annotations

import base64
import re
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl_cli.basics import atomic, files
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import IO

NAMESPACE: Final = "xpl-bundle"
"""What the signature is for: one that a key made for something else, such as a commit, does not count."""
ENDING: Final = ".sig"

_PROGRAM: Final = "ssh-keygen"
_SIGNER: Final = "signer"
_KIND: Final = re.compile(r"(sk-)?(ssh|ecdsa)-[a-z0-9@.-]+")
_GOOD: Final = re.compile(r"with (\S+) key (SHA256:\S+)")
_MOST_BYTES: Final = 1 << 20
_MOST_BUNDLE: Final = 1 << 50
_LIMIT_S: Final = 600.0
"""Somebody may have to type a passphrase, or to touch a token."""


def beside(path: Path) -> Path:
    """Return where the signature of a bundle lies."""
    return path.with_name(path.name + ENDING)


def check_key(key: Path) -> None:
    """Raise a UserError unless somebody could sign with a key: before the work, not after it."""
    try:
        files.opened(key, _MOST_BYTES).close()
    except FileNotFoundError:
        raise NotFoundError(f"--sign: there is no key {key}", hint="`ssh-keygen -t ed25519 -f KEY` makes one") from None
    except OSError as error:
        raise UserError(f"--sign: {key} cannot be read: {error.strerror}") from None


def sign(path: Path, key: Path) -> Path:
    """Sign a bundle, and return the file of the signature, which appears whole or not at all.

    Args:
        path: the bundle.
        key: a private key of OpenSSH, or the public half of one that an agent holds.

    Raises:
        UserError: it cannot be signed with this key, or there is no ssh-keygen.
    """
    with files.opened(path, _MOST_BUNDLE) as stream:
        done = _run(["-Y", "sign", "-f", str(key.absolute()), "-n", NAMESPACE], stream)
    if done.returncode != 0 or not done.stdout.startswith(b"-----BEGIN SSH SIGNATURE-----"):
        raise UserError(f"{path} was written, but not signed with {key}: {_last(done.stderr)}", code=ExitCode.NOT_RUN)
    target = beside(path)
    try:
        atomic.write_file(target, done.stdout)
    except OSError as error:
        raise UserError(f"{target} cannot be written: {error.strerror}", code=ExitCode.NOT_RUN) from None
    return target


def verify(path: Path, signer: Path) -> str:
    """Return which key signed a bundle, such as `ED25519 SHA256:...`.

    Args:
        path: the bundle; its signature lies beside it.
        signer: public keys, one a line, as OpenSSH writes them; any of them may have signed.

    Raises:
        NotFoundError: there is no bundle, no signature or no such file of keys.
        UserError: none of the keys signed exactly this, or there is no ssh-keygen.
    """
    keys = _keys(signer)
    given = beside(path)
    try:
        content = files.content(given, _MOST_BYTES)
        bundle = files.opened(path, _MOST_BUNDLE)
    except FileNotFoundError as error:
        missing = "signature" if error.filename == str(given) else "bundle"
        raise NotFoundError(f"there is no {missing} {error.filename}") from None
    except OSError as error:
        raise UserError(f"{error.filename} cannot be read: {error.strerror}") from None
    with bundle, tempfile.TemporaryDirectory(prefix="xpl-signers-") as folder:
        allowed, kept = Path(folder) / "allowed_signers", Path(folder) / "signature"
        allowed.write_text("".join(f'{_SIGNER} namespaces="{NAMESPACE}" {key}\n' for key in keys), encoding="ascii")
        kept.write_bytes(content)
        arguments = ["-Y", "verify", "-f", str(allowed), "-I", _SIGNER, "-n", NAMESPACE, "-s", str(kept)]
        done = _run(arguments, bundle)
    found = _GOOD.search(done.stdout.decode(errors="replace"))
    if done.returncode != 0 or found is None:
        raise UserError(
            f"{path} is not signed by {'the key' if len(keys) == 1 else 'any of the keys'} in {signer}: "
            f"{given.name} is of other bytes, of another key, or for something else",
            code=ExitCode.FINDINGS,
        )
    return f"{found[1]} {found[2]}"


def _keys(signer: Path) -> list[str]:
    """Return the public keys in a file, without comments and options: kind and key each.

    Raises:
        NotFoundError: there is none.
        UserError: it holds anything else.
    """
    try:
        text = files.content(signer, _MOST_BYTES).decode("ascii", errors="replace")
    except FileNotFoundError:
        raise NotFoundError(f"--signer: there is no file {signer}") from None
    except OSError as error:
        raise UserError(f"--signer: {signer} cannot be read: {error.strerror}") from None
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines or not all(_is_key(line) for line in lines):
        raise UserError(
            f"--signer: {signer} is no file of public keys: expected lines such as `ssh-ed25519 AAAA... name`",
            hint="KEY.pub beside a private key is one, and https://github.com/NAME.keys",
        )
    return [" ".join(line[:2]) for line in lines]


def _is_key(words: Sequence[str]) -> bool:
    if len(words) < 2 or _KIND.fullmatch(words[0]) is None:
        return False
    try:
        return words[0].encode() in base64.b64decode(words[1], validate=True)
    except ValueError:
        return False


def _run(arguments: Sequence[str], stream: IO[bytes]) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run([_PROGRAM, *arguments], stdin=stream, capture_output=True, check=False, timeout=_LIMIT_S)
    except FileNotFoundError:
        raise UserError(
            f"signatures are made and checked by {_PROGRAM} (OpenSSH 8.2 or newer), which is not here",
            code=ExitCode.NOT_RUN,
        ) from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UserError(f"{_PROGRAM} does not run: {error}", code=ExitCode.NOT_RUN) from None


def _last(output: bytes) -> str:
    lines = output.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else "it says nothing"
