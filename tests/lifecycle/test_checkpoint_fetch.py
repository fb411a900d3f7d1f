"""`xpl checkpoint`: real transfers that are cut, real digests, and never half a checkpoint under its name."""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from tests.support.outside.web import Web, serving_files
from tests.support.peer import DEADLINE_S
from tests.support.places import ROOT
from xpl import Client
from xpl.checkpoint import resolve
from xpl_cli import main
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.basics.progress import Progress
from xpl_cli.basics.sizes import parse_size
from xpl_cli.lifecycle.checkpoints import fetch as fetching
from xpl_cli.lifecycle.checkpoints import sources, specification, transfer
from xpl_cli.lifecycle.checkpoints.specification import File, digest_of
from xpl_cli.lifecycle.checkpoints.store import Store
from xpl_cli.lifecycle.checkpoints.transfer import Bounds, Patience
from xpl_cli.packages import package
from xpl_cli.serving.launch import ServerStartError, serving

WEIGHTS = bytes(range(256)) * 4096  # a megabyte
CONFIG = b'{"layers": 2}'
BASH = shutil.which("bash") or "bash"
NO_WAIT = Patience(pause=0.0)
LARGE = 10**9


def sha(content: bytes) -> str:
    """Return the digest of a content."""
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def web() -> Iterator[Web]:
    """A web server with weights and a configuration."""
    with serving_files() as server:
        server.files.update({"/weights.bin": WEIGHTS, "/demo/weights.bin": WEIGHTS, "/demo/a b/config.json": CONFIG})
        yield server


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """An empty store."""
    return Store.at(tmp_path / "store")


def adapter(folder: Path, *checkpoints: dict[str, Any], **deploy: Any) -> Path:
    """Write an adapter that specifies checkpoints, and return its folder."""
    place = folder / "Subject"
    place.mkdir(exist_ok=True)
    (place / "deploy.yml").write_text(json.dumps({"env_cfg_type": "arx_x5", **deploy}), encoding="utf-8")
    (place / "policy.yml").write_text(json.dumps({"spec": "v1.1", "checkpoints": list(checkpoints)}), encoding="utf-8")
    return place


def specified(folder: Path, **entry: Any) -> specification.Specification:
    """Return the specification that an entry of policy.yml is."""
    return specification._parse(package.Package(folder, {}), {"name": "demo", **entry})


def fetch(
    one: specification.Specification, store: Store, *, limit: int = LARGE, mirror: Path | None = None, **order: Any
) -> fetching.Fetched:
    """Fetch a checkpoint without waiting between attempts."""
    wanted = fetching.Order(limit=limit, progress=Progress(), **order)
    return fetching.fetch(one, store, lambda: sources.source_of(one, mirror=mirror, patience=NO_WAIT), wanted)


def tree(root: Path) -> dict[str, bytes]:
    """Return the files below a folder."""
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


# -- one file over HTTP ------------------------------------------------------------------------------------------------


def test_a_transfer_goes_on_where_it_was_cut(web: Web, tmp_path: Path) -> None:
    """Each further request asks for the rest of the same state of the file."""
    web.cuts = [300_000, 200_000, 1]
    part = tmp_path / "part"
    assert transfer.download(f"{web.url}/weights.bin", part, Bounds(len(WEIGHTS), LARGE), lambda _: None, NO_WAIT)
    assert part.read_bytes() == WEIGHTS
    assert [item[1] for item in web.asked] == [None, "bytes=300000-", "bytes=500000-", "bytes=500001-"]
    assert len({item[2] for item in web.asked[1:]}) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["part"]


def test_a_file_that_changed_meanwhile_is_not_mixed(web: Web, tmp_path: Path) -> None:
    """The server says that the rest belongs to another state, and all of it is taken anew."""
    web.cuts = [300_000]
    part = tmp_path / "part"
    with pytest.raises(UserError, match="cut at byte 300000"):
        transfer.download(
            f"{web.url}/weights.bin", part, Bounds(None, LARGE), lambda _: None, Patience(most=1, pause=0.0)
        )
    web.files["/weights.bin"] = WEIGHTS[::-1]
    transfer.download(f"{web.url}/weights.bin", part, Bounds(None, LARGE), lambda _: None, NO_WAIT)
    assert part.read_bytes() == WEIGHTS[::-1]


def test_a_server_without_ranges_sends_all_of_it_again(web: Web, tmp_path: Path) -> None:
    """What it sends replaces what was there."""
    web.ranges, web.cuts = False, [300_000]
    part = tmp_path / "part"
    transfer.download(f"{web.url}/weights.bin", part, Bounds(None, LARGE), lambda _: None, NO_WAIT)
    assert part.read_bytes() == WEIGHTS


@pytest.mark.parametrize(("there", "asked"), [(WEIGHTS, 1), (WEIGHTS + b"more", 2)])
def test_a_part_that_is_complete_or_too_long(web: Web, tmp_path: Path, there: bytes, asked: int) -> None:
    """Nothing is after its end: it is whole, or not the beginning of what is there."""
    part = tmp_path / "part"
    part.write_bytes(there)
    transfer.download(f"{web.url}/weights.bin", part, Bounds(len(WEIGHTS), LARGE), lambda _: None, NO_WAIT)
    assert part.read_bytes() == WEIGHTS
    assert len(web.asked) == asked


def test_a_busy_server_is_asked_again_and_a_refusal_is_not(web: Web, tmp_path: Path) -> None:
    """503 passes, 403 does not, 404 is another error."""
    bounds = Bounds(None, LARGE)
    web.statuses = [503, 429]
    transfer.download(f"{web.url}/weights.bin", tmp_path / "part", bounds, lambda _: None, NO_WAIT)
    assert len(web.asked) == 3
    web.statuses = [403]
    with pytest.raises(UserError, match="HTTP 403"):
        transfer.download(f"{web.url}/weights.bin", tmp_path / "other", bounds, lambda _: None, NO_WAIT)
    assert len(web.asked) == 4
    with pytest.raises(NotFoundError, match="is not there"):
        transfer.download(f"{web.url}/nothing", tmp_path / "other", bounds, lambda _: None, NO_WAIT)


def test_a_server_that_brings_nothing_is_given_up(web: Web, tmp_path: Path) -> None:
    """After as many attempts in a row as were allowed, with the reason and what to do."""
    web.cuts = [0] * 10
    with pytest.raises(UserError, match="cut at byte 0") as caught:
        transfer.download(f"{web.url}/weights.bin", tmp_path / "part", Bounds(None, LARGE), lambda _: None, NO_WAIT)
    assert (len(web.asked), caught.value.code) == (NO_WAIT.attempts, ExitCode.NOT_RUN)
    assert "goes on where it stopped" in (caught.value.hint or "")


def test_redirects_stay_on_the_web(web: Web, tmp_path: Path) -> None:
    """Another address is followed, another kind of address is not, nor one that is less safe."""
    bounds = Bounds(None, LARGE)
    web.redirects = {"/moved": f"{web.url}/weights.bin", "/stolen": "file:///etc/hostname"}
    transfer.download(f"{web.url}/moved", tmp_path / "part", bounds, lambda _: None, NO_WAIT)
    assert (tmp_path / "part").read_bytes() == WEIGHTS
    with pytest.raises(UserError):
        transfer.download(f"{web.url}/stolen", tmp_path / "other", bounds, lambda _: None, NO_WAIT)
    assert not (tmp_path / "other").exists()
    request = transfer.urllib.request.Request("https://example.org/a")
    with pytest.raises(UserError, match="less safe"):
        transfer._Redirects().redirect_request(request, None, 302, "", None, "http://example.org/a")  # type: ignore[arg-type]


def test_no_more_arrives_than_was_said(web: Web, tmp_path: Path) -> None:
    """Another size is found before anything is written, and a limit holds."""
    part = tmp_path / "part"
    with pytest.raises(UserError, match="expected 7") as caught:
        transfer.download(f"{web.url}/weights.bin", part, Bounds(7, LARGE), lambda _: None, NO_WAIT)
    assert (caught.value.code, part.exists()) == (ExitCode.FINDINGS, False)
    with pytest.raises(UserError, match="more than the limit of 1000"):
        transfer.download(f"{web.url}/weights.bin", part, Bounds(None, 1000), lambda _: None, NO_WAIT)
    assert len(web.asked) == 2


# -- specifications ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"name": "../x", "source": "/x"}, "a name is one word"),
        ({"source": "ftp://host/x"}, "expected http"),
        ({"source": "https://host/folder/"}, "does not list"),
        ({"source": "https://host/x", "files": [{"path": "a"}]}, "ends with /"),
        ({"source": "https://me:secret@host/x"}, "others can read"),
        ({"source": "hf://model"}, "owner/repository"),
        ({"source": "hf://owner/../x"}, "no path"),
        ({"source": "/x", "files": [{"path": "a"}, {"path": "a"}]}, "twice"),
        ({"source": "/x", "files": [{"path": "a"}, {"path": "a/b"}]}, "below another"),
        ({"source": "/x", "sha256": "0" * 64, "files": [{"path": "a", "sha256": "1" * 64}]}, "but the list"),
        *(
            ({"source": "/x", "files": [{"path": path}]}, "no path")
            for path in ("../a", "/a", "a/../b", "a//b", "a\\b", ".hidden", "a/", "", "a\nb", "x" * 256)
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, entry: dict[str, Any], message: str) -> None:
    """Before anything is asked for; also what would leave the checkpoint's folder."""
    with pytest.raises(UserError, match=message):
        specified(tmp_path, **entry)


def test_the_digest_of_a_folder_is_that_of_common_tools(tmp_path: Path) -> None:
    """The documented shell line gives the same."""
    (tmp_path / "b").mkdir()
    for name, content in {"b/é z": b"1", "a": b"2", "b.txt": b""}.items():
        (tmp_path / name).write_bytes(content)
    (documented,) = re.findall("`(find .*)`", digest_of.__doc__ or "")
    told = subprocess.run([BASH, "-c", documented], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    files = [File("a", sha(b"2")), File("b/é z", sha(b"1")), File("b.txt", sha(b""))]
    assert told.split()[0] == digest_of(files) == digest_of(reversed(files))


def test_sizes_are_written_as_people_do() -> None:
    """Decimal and binary units, or a number of bytes."""
    assert [parse_size(text, "--x") for text in ("7", "2kB", "1.5 GB", "1GiB", "0")] == [
        7,
        2000,
        1500000000,
        1 << 30,
        0,
    ]
    with pytest.raises(UserError, match="--x takes a size"):
        parse_size("many", "--x")


# -- fetching ----------------------------------------------------------------------------------------------------------


def test_a_folder_from_the_web_is_kept_by_its_content(web: Web, store: Store, tmp_path: Path) -> None:
    """Files arrive whole, read-only and checked; a second fetch asks nobody."""
    files = [{"path": "weights.bin", "sha256": sha(WEIGHTS)}, {"path": "a b/config.json", "sha256": sha(CONFIG)}]
    one = specified(tmp_path, source=f"{web.url}/demo/", files=files)
    web.cuts = [1000]
    found = fetch(one, store)
    assert tree(found.path) == {"weights.bin": WEIGHTS, "a b/config.json": CONFIG}
    assert found.path == store.root / (one.digest or "")
    assert {path.stat().st_mode & 0o777 for path in found.path.rglob("*") if path.is_file()} == {0o444}
    count = len(web.asked)
    assert fetch(one, store).state == "there"
    assert len(web.asked) == count
    assert [path.name for path in (store.root / ".incoming").iterdir() if path.is_dir()] == []


def test_one_file_keeps_its_name(web: Web, store: Store, tmp_path: Path) -> None:
    """A checkpoint that is one file is that file."""
    one = specified(tmp_path, source=f"{web.url}/weights.bin", sha256=sha(WEIGHTS), size=len(WEIGHTS))
    found = fetch(one, store)
    assert found.path == store.root / sha(WEIGHTS) / "weights.bin"
    assert found.path.read_bytes() == WEIGHTS


@pytest.mark.parametrize("per_file", [True, False])
def test_other_bytes_are_never_a_checkpoint(web: Web, store: Store, tmp_path: Path, per_file: bool) -> None:
    """Neither as a file nor as a folder; they are thrown away, so that the next fetch begins anew."""
    files: list[dict[str, Any]] = [{"path": "weights.bin"}]
    whole = None
    if per_file:
        files[0]["sha256"] = "0" * 64
    else:
        whole = "0" * 64
    one = specified(tmp_path, source=f"{web.url}/demo/", files=files, sha256=whole)
    with pytest.raises(UserError, match=sha(WEIGHTS) if per_file else "not the one") as caught:
        fetch(one, store)
    assert caught.value.code == ExitCode.FINDINGS
    assert [path for path in store.root.rglob("*") if path.is_file() and path.suffix != ".lock"] == []


def test_what_an_earlier_attempt_left_cannot_spoil_it(web: Web, store: Store, tmp_path: Path) -> None:
    """A part of another content, of a server without tags, is noticed by the digest, and the file fetched anew."""
    web.tags = False
    one = specified(tmp_path, source=f"{web.url}/weights.bin", sha256=sha(WEIGHTS))
    with store.staging(fetching._key(one)) as staging:
        (staging.parts / "weights.bin").write_bytes(b"x" * 5000)
        (staging.whole / "other.bin").write_bytes(b"of another time")
    assert fetch(one, store).path.read_bytes() == WEIGHTS
    assert [asked[1] for asked in web.asked] == ["bytes=5000-", None]
    assert list(tree(store.root / sha(WEIGHTS))) == ["weights.bin"]


def test_without_a_digest_nothing_is_taken_unless_that_is_wanted(web: Web, store: Store, tmp_path: Path) -> None:
    """--unverified tells the digest that makes the next fetch a checked one."""
    entry: dict[str, Any] = {"source": f"{web.url}/demo/", "files": [{"path": "weights.bin"}]}
    with pytest.raises(UserError, match="no sha256") as caught:
        fetch(specified(tmp_path, **entry), store)
    assert "--unverified" in (caught.value.hint or "")
    assert web.asked == []
    found = fetch(specified(tmp_path, **entry), store, unverified=True)
    assert fetch(specified(tmp_path, **entry, sha256=found.digest), store).state == "there"


def test_limits_are_held_before_anything_is_brought(web: Web, store: Store, tmp_path: Path) -> None:
    """The declared size, the limit and the room on the disk."""
    source = tmp_path / "given"
    source.mkdir()
    (source / "weights.bin").write_bytes(WEIGHTS)
    digest = digest_of([File("weights.bin", sha(WEIGHTS))])
    with pytest.raises(UserError, match="more than the limit of"):
        fetch(specified(tmp_path, source="given", sha256=digest), store, limit=1000)
    with pytest.raises(UserError, match=r"but policy\.yml says 7"):
        fetch(specified(tmp_path, source="given", sha256=digest, size=7), store)
    huge = specified(tmp_path, source=f"{web.url}/demo/", sha256=digest, files=[{"path": "x"}], size=1 << 60)
    with pytest.raises(UserError, match="are free") as caught:
        fetch(huge, store, limit=1 << 62)
    assert caught.value.code == ExitCode.NOT_RUN
    with pytest.raises(UserError, match="more than the limit of 1000"):
        fetch(specified(tmp_path, source=f"{web.url}/weights.bin", sha256=sha(WEIGHTS)), store, limit=1000)
    assert len(web.asked) == 1


@pytest.mark.parametrize("under", ["digest", "name", "file"])
def test_a_mirror_answers_alone(web: Web, store: Store, tmp_path: Path, under: str) -> None:
    """A folder with the checkpoint under its digest or name, such as another store; the web is not asked."""
    one = specified(tmp_path, source=f"{web.url}/weights.bin", sha256=sha(WEIGHTS))
    mirror = tmp_path / "mirror"
    place = mirror / {"digest": f"{sha(WEIGHTS)}/weights.bin", "name": "demo/weights.bin", "file": "demo"}[under]
    place.parent.mkdir(parents=True)
    place.write_bytes(WEIGHTS)
    assert fetch(one, store, mirror=mirror).path.read_bytes() == WEIGHTS
    place.unlink()
    shutil.rmtree(store.root / sha(WEIGHTS))
    with pytest.raises(NotFoundError):
        fetch(one, store, mirror=tmp_path / "empty")
    assert web.asked == []


def test_a_folder_of_this_machine_is_copied_and_left_alone(store: Store, tmp_path: Path) -> None:
    """Hidden files are no part of it; a link to a folder may lead anywhere, and is refused."""
    source = tmp_path / "given"
    (source / "deep").mkdir(parents=True)
    (source / "deep" / "weights.bin").write_bytes(WEIGHTS)
    (source / ".git").mkdir()
    (source / ".git" / "config").write_text("x")
    before = tree(source)
    one = specified(tmp_path, source=source.as_uri(), sha256=digest_of([File("deep/weights.bin", sha(WEIGHTS))]))
    assert tree(fetch(one, store).path) == {"deep/weights.bin": WEIGHTS}
    assert tree(source) == before
    (source / "elsewhere").symlink_to("/etc")
    with pytest.raises(UserError, match="not followed"):
        fetch(one, store, again=True)


def test_the_hub_needs_a_commit(store: Store, tmp_path: Path) -> None:
    """Branches move."""
    one = specified(tmp_path, source="hf://owner/model", sha256="0" * 64, revision="main")
    with pytest.raises(UserError, match="expected the full commit"):
        fetch(one, store)


# -- the command -------------------------------------------------------------------------------------------------------


def run(command: str, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `xpl checkpoint` with a store beside the adapter, in this process: it starts no other."""
    line = ["checkpoint", command, str(folder / "Subject"), *arguments, "--cache", str(folder / "store")]
    out, told = io.StringIO(), io.StringIO()
    before = signal.getsignal(signal.SIGTERM)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(told):
        patch.setattr(sys, "argv", ["xpl", *line])
        try:
            main.run()
        except SystemExit as end:
            return subprocess.CompletedProcess(line, int(end.code or 0), out.getvalue(), told.getvalue())
        finally:
            signal.signal(signal.SIGTERM, before)
    raise AssertionError("the command line ends with an exit code")


def test_what_is_fetched_is_what_its_name_means(web: Web, tmp_path: Path) -> None:
    """`ckpt_name` in deploy.yml finds it by the ordinary way; path says where it is; verify sees damage."""
    entry = {
        "name": "demo", "source": f"{web.url}/demo/", "license": "MIT",
        "files": [{"path": "weights.bin", "sha256": sha(WEIGHTS), "size": len(WEIGHTS)}],
    }  # fmt: skip
    subject = adapter(tmp_path, entry, {"name": "other", "source": "/nowhere"}, ckpt_name="demo")

    missing = run("path", tmp_path)
    assert (missing.returncode, missing.stdout) == (ExitCode.NOT_FOUND, "")
    assert f"xpl checkpoint fetch {subject} demo" in missing.stderr

    done = run("fetch", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    (answer,) = json.loads(done.stdout)["checkpoints"]
    assert (answer["state"], answer["license"]) == ("fetched", "MIT")
    assert resolve({"ckpt_name": "demo"}, subject) == Path(answer["link"]) == subject / "checkpoints" / "demo"
    assert tree(subject / "checkpoints" / "demo") == {"weights.bin": WEIGHTS}
    assert run("path", tmp_path).stdout.strip() == answer["path"]
    assert run("verify", tmp_path).returncode == 0

    weights = Path(answer["path"]) / "weights.bin"
    weights.chmod(0o644)
    weights.write_bytes(WEIGHTS[:-1] + b"!")
    damaged = run("verify", tmp_path, "demo", "--json")
    (told,) = json.loads(damaged.stdout)["checkpoints"]
    assert damaged.returncode == ExitCode.FINDINGS
    assert [(item["path"], item["what"]) for item in told["differences"]] == [("weights.bin", "sha256")]
    assert run("fetch", tmp_path, "--force").returncode == 0
    assert run("verify", tmp_path).returncode == 0


def test_what_is_fetched_is_served(web: Web, tmp_path: Path) -> None:
    """A model that asks the resolver for its checkpoint reads the fetched bytes; before, it says what to do."""
    subject = adapter(
        tmp_path, {"name": "demo", "source": f"{web.url}/weights.bin", "sha256": sha(WEIGHTS)}, ckpt_name="demo"
    )
    (subject / "model.py").write_text(
        "from pathlib import Path\nfrom xpl import checkpoint\n"
        "class Model:\n"
        "    def __init__(self, config):\n"
        "        self.weights = checkpoint.resolve(config, Path(__file__).parent).read_bytes()\n"
        "    def infer(self, observation): return [len(self.weights)]\n"
    )
    with pytest.raises(ServerStartError, match="xpl checkpoint fetch"), serving(subject):
        pass
    assert run("fetch", tmp_path).returncode == 0
    with serving(subject) as server, Client(server.url) as client:
        assert client.infer({}) == [len(WEIGHTS)]


def test_which_checkpoint_is_meant(web: Web, tmp_path: Path) -> None:
    """One of several has to be named; none to speak of is an error, and with --all it is none."""
    adapter(tmp_path, {"name": "a", "source": "x"}, {"name": "b", "source": "y"})
    several = run("fetch", tmp_path)
    assert (several.returncode, "name one of a, b" in several.stderr) == (ExitCode.USAGE, True)
    assert run("fetch", tmp_path, "c").returncode == ExitCode.NOT_FOUND
    adapter(tmp_path)
    assert run("fetch", tmp_path).returncode == ExitCode.NOT_FOUND
    none = run("fetch", tmp_path, "--all")
    assert (none.returncode, none.stdout) == (0, "")


def test_an_authors_own_checkpoint_is_not_replaced(web: Web, tmp_path: Path) -> None:
    """What lies under the name already stays; the answer says so."""
    subject = adapter(tmp_path, {"name": "demo", "source": f"{web.url}/weights.bin", "sha256": sha(WEIGHTS)})
    (subject / "checkpoints" / "demo").mkdir(parents=True)
    done = run("fetch", tmp_path, "--json")
    assert (done.returncode, json.loads(done.stdout)["checkpoints"][0]["link"]) == (0, None)
    assert "it stays" in done.stderr
    assert not (subject / "checkpoints" / "demo").is_symlink()


def test_another_content_under_the_same_name_moves_the_link(web: Web, tmp_path: Path) -> None:
    """In one step; what the old one was stays in the store."""
    subject = adapter(tmp_path, {"name": "demo", "source": f"{web.url}/weights.bin", "sha256": sha(WEIGHTS)})
    run("fetch", tmp_path)
    adapter(tmp_path, {"name": "demo", "source": f"{web.url}/demo/a%20b/config.json", "sha256": sha(CONFIG)})
    assert run("fetch", tmp_path).returncode == 0
    assert (subject / "checkpoints" / "demo").read_bytes() == CONFIG
    assert (tmp_path / "store" / sha(WEIGHTS)).is_dir()


def test_a_killed_fetch_leaves_no_checkpoint_and_the_next_one_goes_on(web: Web, tmp_path: Path) -> None:
    """SIGKILL in the middle: nothing under the digest, and only the rest is asked for afterwards."""
    web.files["/large.bin"] = large = WEIGHTS * 64
    adapter(tmp_path, {"name": "demo", "source": f"{web.url}/large.bin", "sha256": sha(large)})
    stops = (
        "import os, signal, sys\n"
        "from xpl_cli.lifecycle.checkpoints import fetch\n"
        "say = fetch._Arrival._say\n"
        "def stop(self, file, size, there):\n"
        "    if there > 5_000_000:\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "fetch._Arrival._say = stop\n"
        "from xpl_cli import main; sys.argv[0] = 'xpl'; main.run()\n"
    )
    command = [sys.executable, "-c", stops, "checkpoint", "fetch", "Subject", "--cache", str(tmp_path / "store")]
    killed = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    store = tmp_path / "store"
    assert [path.name for path in store.iterdir()] == [".incoming"]
    (part,) = (path for path in store.rglob("large.bin"))
    there = part.stat().st_size
    assert 0 < there < len(large)
    assert run("fetch", tmp_path).returncode == 0
    assert web.asked[-1][1] == f"bytes={there}-"
    assert sha((store / sha(large) / "large.bin").read_bytes()) == sha(large)


def test_two_at_once_fetch_once(web: Web, store: Store, tmp_path: Path) -> None:
    """The second says that it waits for the first, and finds what it brought."""
    entry = {"name": "demo", "source": f"{web.url}/weights.bin", "sha256": sha(WEIGHTS)}
    one = specified(adapter(tmp_path, entry), **entry)
    command = [sys.executable, "-m", "xpl_cli", "checkpoint", "fetch", "Subject", "--json", "--cache", str(store.root)]
    with store.staging(fetching._key(one)) as staging:
        second = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert second.stderr is not None
        assert "another process fetches it; waiting" in second.stderr.readline()
        (staging.whole / "weights.bin").write_bytes(WEIGHTS)
        store.place(staging, sha(WEIGHTS))
    out, _ = second.communicate(timeout=DEADLINE_S)
    assert (second.returncode, json.loads(out)["checkpoints"][0]["state"]) == (0, "there")
    assert web.asked == []


def test_a_hub_without_its_client_is_a_clear_error(tmp_path: Path) -> None:
    """It is an extra: the error names it, and the mirror that needs none."""
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    (blocked / "huggingface_hub.py").write_text("raise ImportError('not here')")
    adapter(tmp_path, {"name": "demo", "source": "hf://owner/model", "revision": "0" * 40, "sha256": "0" * 64})
    done = subprocess.run(
        [sys.executable, "-m", "xpl_cli", "checkpoint", "fetch", "Subject", "--cache", str(tmp_path / "store")],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(blocked), str(ROOT)])},
    )  # fmt: skip
    assert done.returncode == ExitCode.NOT_RUN
    assert "pip install 'huggingface" in done.stderr
    assert "--mirror" in done.stderr


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    """A file that runs code when it is unpickled is bytes like any other."""
    source = tmp_path / "weights.pt"
    source.write_bytes(b"cos\nsystem\n(S'touch " + str(tmp_path / "ran").encode() + b"'\ntR.")
    adapter(tmp_path, {"name": "demo", "source": str(source), "sha256": sha(source.read_bytes())})
    assert run("fetch", tmp_path).returncode == run("verify", tmp_path).returncode == 0
    assert not (tmp_path / "ran").exists()
