"""Bundles that a stranger made: whatever they hold, `xpl verify` ends with one sentence and a known exit code."""

from __future__ import annotations

import copy
import json
import os
import random
import stat
import struct
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from importlib import util
from pathlib import Path
from typing import Any

import pytest

from tests.attacks.fuzz import bundles as fuzz
from tests.support.commands import problem, xpl
from tests.support.recordings import bundles
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.submission import archive, bundle

CODES = (1, 2, 4)
"""Findings, no bundle, or not to be read here: 0 would be a lie about each of these, and 5 about ourselves."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, bytes], dict[str, Any]]:
    """Return the files of a bundle that holds together, and its manifest."""
    folder = tmp_path_factory.mktemp("sound")
    files = bundles.write_bundle(folder)
    return files, bundles.manifest(files, folder)


@pytest.fixture(scope="module")
def packed(sound: tuple[dict[str, bytes], dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return bundles.archived(tmp_path_factory.mktemp("packed") / "sound.zip", *sound).read_bytes()


def _held(path: Path, codes: tuple[int, ...] = CODES) -> None:
    """Verify a bundle by reading it, and see that it ends as it should."""
    ended = xpl("verify", path, "--sample", "0")
    assert problem(ended, codes) is None, ended


# -- the archive -------------------------------------------------------------------------------------------------------


def _damaged(content: bytes, draw: random.Random) -> bytes:
    """Return an archive with random damage of some kind."""
    data = bytearray(content)
    kind = draw.randrange(6)
    for _ in range(draw.choice((1, 3, 30))):
        place = draw.randrange(len(data))
        if kind == 0:
            data[place] = draw.randrange(256)
        elif kind == 1:
            del data[place : place + draw.randrange(1, 200)]
        elif kind == 2:
            data[place:place] = draw.randbytes(draw.randrange(1, 200))
        elif kind == 3:  # the list of files and its end, where damage leads farthest
            data[-1 - draw.randrange(min(len(data), 3000))] = draw.choice((0, 1, 0x7F, 0x80, 0xFF))
        elif kind == 4:
            del data[place:]
        else:
            source = draw.randrange(len(data))
            data[place : place + 64] = data[source : source + 64]
        if not data:
            break
    return bytes(data)


def _try_damage(packed: bytes, folder: Path, seeds: range) -> None:
    for seed in seeds:
        data = _damaged(packed, random.Random(seed))  # noqa: S311 - made-up damage, no secret
        if data != packed:
            path = folder / f"{seed}.zip"
            path.write_bytes(data)
            # Damage between the files of an archive is none to what it holds; that bundle is as sound as it was.
            _held(path, CODES)
            path.unlink()


def test_random_damage_is_said(packed: bytes, tmp_path: Path) -> None:
    """Some of the damages that the slow test does."""
    _try_damage(packed, tmp_path, range(24))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_many_random_damages_are_said(packed: bytes, tmp_path: Path) -> None:
    """Bytes changed, cut out, put in, moved, in the files, in the list of files, at its end."""
    _try_damage(packed, tmp_path, range(24, 1000))


NAMES = [
    "../evil",
    "/etc/evil",
    "a/../../evil",
    "..",
    ".",
    "a//b",
    "a/",
    "C:evil",
    "a\\b",
    "a\0b",
    "a\nb",
    "\x1b[31m",
    "a" * 300,
    "/".join("d" * 40),
    "/".join(["a" * 150] * 30),
    "\u202eevil",
    "submission.json/x",
    "policy",
]


@pytest.mark.parametrize("name", NAMES, ids=[f"{name[:20]!r}, {len(name)}" for name in NAMES])
def test_odd_names_are_refused(name: str, packed: bytes, tmp_path: Path) -> None:
    """Names that lead elsewhere, that some system does not bear, that are a file here and a folder there."""
    path = tmp_path / "odd.zip"
    path.write_bytes(packed)
    with zipfile.ZipFile(path, "a") as odd:
        entry = zipfile.ZipInfo("x")
        entry.filename = name
        odd.writestr(entry, b"content")
    _held(path)
    assert not (tmp_path.parent / "evil").exists()


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFDIR, stat.S_IFSOCK])
def test_what_is_no_file_is_not_unpacked(kind: int, packed: bytes, tmp_path: Path) -> None:
    path = tmp_path / "link.zip"
    path.write_bytes(packed)
    with zipfile.ZipFile(path, "a") as odd:
        entry = zipfile.ZipInfo("link")
        entry.create_system, entry.external_attr = 3, (kind | 0o777) << 16
        odd.writestr(entry, b"/etc/passwd")
    _held(path, (2,))


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_name_comes_once(packed: bytes, tmp_path: Path) -> None:
    """Two files of one name: readers differ in which of them they see."""
    path = tmp_path / "twice.zip"
    path.write_bytes(packed)
    with zipfile.ZipFile(path, "a") as odd:
        odd.writestr(bundle.MANIFEST, b"{}")
    _held(path, (2,))


def test_bombs_are_not_unpacked(packed: bytes, tmp_path: Path) -> None:
    """A file of zeros, one that says it is small, and a list of files that is longer than any."""
    honest, lying, endless = tmp_path / "honest.zip", tmp_path / "lying.zip", tmp_path / "endless.zip"
    for path in (honest, lying):
        path.write_bytes(packed)
        with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as bomb:
            bomb.writestr("zeros", bytes(50_000_000))
    small = lying.read_bytes().replace(struct.pack("<I", 50_000_000), struct.pack("<I", 10))
    lying.write_bytes(small)
    ended = xpl("verify", honest, "--sample", "0", "--max-size", "10MB")
    assert (problem(ended, (2,)), "--max-size" in ended.stderr) == (None, True)
    _held(lying, (2,))
    end = struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 65535, 65535, 1 << 30, 0, 0)
    with endless.open("wb") as stream:
        stream.truncate(1 << 30)
        stream.seek(0, os.SEEK_END)
        stream.write(end)
    _held(endless, (2,))


def test_methods_and_locks_that_we_do_not_use_are_refused(packed: bytes, tmp_path: Path) -> None:
    """Other compressions, whose readers know no bounds, and encrypted files."""
    for number, method in enumerate((zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2)):
        path = tmp_path / f"{number}.zip"
        path.write_bytes(packed)
        with zipfile.ZipFile(path, "a", method) as odd:
            odd.writestr("odd", b"content")
        _held(path, (2,))
    locked = bytearray(packed)
    for mark, flags in ((b"PK\1\2", 8), (b"PK\3\4", 6)):
        place = locked.find(mark)
        while place >= 0:
            locked[place + flags] |= 1
            place = locked.find(mark, place + 1)
    (tmp_path / "locked.zip").write_bytes(locked)
    _held(tmp_path / "locked.zip", (2,))


@pytest.mark.parametrize("kind", ["folder", "pipe", "device", "loop"])
def test_what_is_no_file_is_no_bundle(kind: str, tmp_path: Path) -> None:
    """And nothing waits for it."""
    path = tmp_path / "odd.zip"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(path if kind == "loop" else "/dev/zero")
    _held(path, (2,))


# -- what it holds -----------------------------------------------------------------------------------------------------


def _with(sound: tuple[dict[str, bytes], dict[str, Any]], path: Path, name: str, content: bytes) -> Path:
    """Write a bundle that holds together but for one file, which its manifest names as it is."""
    files, told = sound
    return bundles.archived(path, {**files, name: content}, told)


BYTES = {
    "nothing": b"",
    "no JSON": b"{",
    "a list": b"[]",
    "a number": b"1",
    "null": b"null",
    "NaN": b"NaN",
    "an integer of 5,000 digits": b"9" * 5000,
    "deep": b"[" * 100_000,
    "deep and whole": b"[" * 900 + b"]" * 900,
    "no UTF-8": b'"\xff"',
    "zeros": bytes(50),
}


@pytest.mark.slow
@pytest.mark.sampled(1)
@pytest.mark.parametrize("kind", BYTES)
def test_documents_of_any_content_are_findings(
    kind: str, sound: tuple[dict[str, bytes], dict[str, Any]], tmp_path: Path
) -> None:
    """Audit, checkpoints, environment, records, and the adapter's own manifests."""
    documents = [name for name in sound[0] if name.endswith((".json", ".jsonl", ".yml"))]
    assert len(documents) >= 6
    for name in documents:
        _held(_with(sound, tmp_path / "changed.zip", name, BYTES[kind]), (1, 4))
    files, _ = sound
    archive.write(tmp_path / "manifest.zip", {**files, bundle.MANIFEST: BYTES[kind]})
    _held(tmp_path / "manifest.zip", (1, 2))


@pytest.mark.parametrize("name", [*bundle.DOCUMENTS, bundle.MANIFEST])
def test_documents_of_a_size_that_none_has_are_not_read(
    name: str, sound: tuple[dict[str, bytes], dict[str, Any]], tmp_path: Path
) -> None:
    """They are a few bytes in the archive, and holding them against a schema takes long."""
    files, told = sound
    huge = b"[" + b"0," * (17 << 20) + b"0]"
    if name == bundle.MANIFEST:
        archive.write(tmp_path / "huge.zip", {**files, name: huge})
    else:
        bundles.archived(tmp_path / "huge.zip", {**files, name: huge}, told)
    with pytest.raises(UserError, match=f"{name} of the bundle cannot be read.* more than the limit") as caught:
        list(bundle.open_bundle(tmp_path / "huge.zip", _empty(tmp_path), limit=1 << 30).problems())
    assert caught.value.code == ExitCode.FINDINGS


def _empty(tmp_path: Path) -> Path:
    folder = tmp_path / "unpacked"
    folder.mkdir()
    return folder


def _nested(levels: int) -> Any:
    value: Any = 0
    for _ in range(levels):
        value = [value]
    return value


ODD: list[Any] = [
    *(None, True, False, -1, 0, 1, 1.0, 1.5, 10**30, 1e300, float("nan"), float("inf")),
    *("", "x", "..", "/", "a/../b", "\0", "\x1b[31m", "\ud800", "<b>", "x" * 5000, "0" * 64, "green", "fail"),
    *([], {}, [[]], [None], {"": None}, {"x": {}}, [1, "a"], _nested(100)),
]


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every container in a document with each of its keys."""
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from _places(value[key])


def _try_values(sound: tuple[dict[str, bytes], dict[str, Any]], folder: Path, seeds: range) -> None:
    """Put odd values at random places of the documents of a bundle, whose digests are made to fit."""
    files, told = sound
    documents = [*(name for name in files if name.endswith(".json")), bundle.MANIFEST]
    for seed in seeds:
        draw = random.Random(seed)  # noqa: S311 - made-up documents, no secret
        name = draw.choice(documents)
        document = json.loads(files[name] if name in files else json.dumps(told))
        for _ in range(draw.choice((1, 1, 1, 5))):
            container, key = draw.choice(list(_places(document)) or [({"": 0}, "")])
            if isinstance(container, dict) and draw.random() < 0.2:
                container.pop(key)
            else:
                container[key] = copy.deepcopy(draw.choice(ODD))
        path, content = folder / f"{seed}.zip", json.dumps(document).encode()
        if name == bundle.MANIFEST:
            archive.write(path, {**files, name: content})
        else:
            bundles.archived(path, {**files, name: content}, told)
        _held(path)
        path.unlink()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_values_of_any_kind_are_findings(sound: tuple[dict[str, bytes], dict[str, Any]], tmp_path: Path) -> None:
    """Odd values anywhere in the manifest and in the documents, one or several at once."""
    _try_values(sound, tmp_path, range(1000))


@pytest.mark.slow
def test_the_reader_withstands_a_fuzzer_that_sees_its_branches(packed: bytes, tmp_path: Path) -> None:
    """For twenty seconds: no other error, nothing outside the folder, no input that takes seconds."""
    if util.find_spec("atheris") is None:
        pytest.skip("not run: atheris is not installed")
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    (corpus / "packed").write_bytes(packed)
    for number, name in enumerate(("submission.json", "a/b")):
        with zipfile.ZipFile(corpus / str(number), "w") as small:
            small.writestr(name, b"{}")
    limits = ["-max_total_time=20", "-timeout=10", "-rss_limit_mb=2048", "-max_len=65536"]
    run = subprocess.run(
        [sys.executable, fuzz.__file__, *limits, f"-artifact_prefix={tmp_path}/", corpus],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-5000:]


def test_the_damages_above_would_be_noticed(packed: bytes, tmp_path: Path) -> None:
    """The bundle that they begin with is in order, apart from the audit that nobody made."""
    path = tmp_path / "sound.zip"
    path.write_bytes(packed)
    ended = xpl("verify", path, "--sample", "0", "--json")
    found = {check["name"]: check["problems"] for check in json.loads(ended.stdout)["checks"]}
    assert {name for name, problems in found.items() if problems} == {"audit"}
