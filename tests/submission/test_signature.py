"""Signatures of bundles: who vouches for one can be told from anybody, and what was changed is not vouched for."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.commands import xpl
from tests.support.recordings import bundles
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.submission import signature

KEYGEN = shutil.which("ssh-keygen") or "ssh-keygen"

pytestmark = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="not run: OpenSSH is not installed")


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return two private keys, whose public halves lie beside them."""
    folder = tmp_path_factory.mktemp("keys")
    for name in ("organiser", "stranger"):
        command = [KEYGEN, "-q", "-t", "ed25519", "-N", "", "-C", name, "-f", str(folder / name)]
        subprocess.run(command, check=True)
    return folder / "organiser", folder / "stranger"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Return a file to sign."""
    path = tmp_path / "Foo.xpl.zip"
    path.write_bytes(bytes(range(256)))
    return path


def _public(key: Path) -> Path:
    return key.with_name(f"{key.name}.pub")


def test_what_was_signed_is_known_by_its_key(file: Path, keys: tuple[Path, Path]) -> None:
    """The key is named by its fingerprint, and may be one of several in the file."""
    assert signature.sign(file, keys[0]) == file.with_name("Foo.xpl.zip.sig")
    listed = subprocess.run([KEYGEN, "-lf", _public(keys[0])], capture_output=True, text=True, check=True).stdout
    assert signature.verify(file, _public(keys[0])).split()[1] == listed.split()[1]
    both = file.with_name("keys")
    both.write_text(f"# keys\n\n{_public(keys[1]).read_text()}{_public(keys[0]).read_text()}", encoding="utf-8")
    assert signature.verify(file, both) == signature.verify(file, _public(keys[0]))


def test_openssh_alone_says_the_same(file: Path, keys: tuple[Path, Path]) -> None:
    """A signature that ssh-keygen made is accepted, and one of ours is by ssh-keygen."""
    subprocess.run([KEYGEN, "-q", "-Y", "sign", "-f", keys[0], "-n", "xpl-bundle", file], check=True)
    assert signature.verify(file, _public(keys[0]))
    signature.sign(file, keys[0])
    allowed = file.with_name("allowed")
    allowed.write_text(f"somebody {_public(keys[0]).read_text()}", encoding="utf-8")
    command: list[str | Path] = [KEYGEN, "-Y", "verify", "-f", allowed, "-I", "somebody", "-n", "xpl-bundle"]
    with file.open("rb") as stream:
        subprocess.run([*command, "-s", signature.beside(file)], stdin=stream, check=True, capture_output=True)


def test_nothing_else_passes(file: Path, keys: tuple[Path, Path]) -> None:
    """Other bytes, another key, another purpose, damage, and no signature at all."""
    signature.sign(file, keys[0])
    sound = signature.beside(file).read_bytes()

    def refused(key: Path = keys[0]) -> None:
        with pytest.raises(UserError) as raised:
            signature.verify(file, _public(key))
        assert raised.value.code is ExitCode.FINDINGS

    refused(keys[1])
    file.write_bytes(file.read_bytes() + b"x")
    refused()
    file.write_bytes(bytes(range(256)))
    for given in (b"", b"x", sound[:-60], sound.replace(b"U1NI", b"U1NJ"), bytes(1000)):
        signature.beside(file).write_bytes(given)
        refused()
    signature.beside(file).unlink()
    subprocess.run([KEYGEN, "-q", "-Y", "sign", "-f", keys[0], "-n", "git", file], check=True)
    refused()
    signature.beside(file).unlink()
    with pytest.raises(NotFoundError, match="no signature"):
        signature.verify(file, _public(keys[0]))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# nothing",
        "ssh-ed25519",
        "ssh-ed25519 AAAA",
        "ssh-ed25519 !!!!",
        "cert-authority ssh-ed25519 AAAA",
        'x" ssh-ed25519 AAAA',
        "\0",
        "-----BEGIN OPENSSH PRIVATE KEY-----",
    ],
)
def test_what_is_no_public_key_is_refused(text: str, file: Path, tmp_path: Path) -> None:
    """Before it becomes a line for ssh-keygen."""
    signer = tmp_path / "keys.pub"
    signer.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match="no file of public keys"):
        signature.verify(file, signer)


def test_a_bundle_that_is_not_signed_so_is_not_even_opened(keys: tuple[Path, Path], tmp_path: Path) -> None:
    """`xpl verify --signer`: exit code 1 before the archive is read, a check of its own where the signature fits."""
    path = tmp_path / "Foo.xpl.zip"
    path.write_bytes(b"no archive at all")
    signature.sign(path, keys[1])
    ended = xpl("verify", path, "--signer", _public(keys[0]))
    assert (ended.code, "is not signed by" in ended.stderr) == (1, True)
    files = bundles.made(tmp_path)
    bundles.archived(path, files, bundles.manifest(files, tmp_path))
    signature.sign(path, keys[0])
    ended = xpl("verify", path, "--signer", _public(keys[0]), "--sample", "0", "--json")
    assert json.loads(ended.stdout)["checks"][0] == {"name": "signature", "problems": []}


def test_a_key_that_is_not_there_is_told_before_the_work(keys: tuple[Path, Path], tmp_path: Path) -> None:
    """`xpl submit --sign`."""
    assert keys
    ended = xpl("submit", "--check", bundles.ADAPTER, tmp_path, "--sign", tmp_path / "none")
    assert (ended.code, "no key" in ended.stderr) == (3, True)
