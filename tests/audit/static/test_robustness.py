"""The static gate takes any folder: hostile, broken, huge or changing; it reads the boundary, and executes nothing."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import pytest

from tests.support.adapters.rules import made_adapter
from tests.support.checkout import ROOT
from tests.support.peer import DEADLINE_S
from xpl_cli.audit.engine import engine
from xpl_cli.audit.formats import ReportContext, render
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, TargetReport
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.static.file_reading import SIZE_LIMIT
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.formats import REPORTS

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """A fresh scaffold, to break."""
    return made_adapter(tmp_path / "policy" / "Foo")


def audit(path: Path, *names: str, cache: Path | None = None) -> TargetReport:
    """Run the static gate."""
    return engine.audit(path, "policy", AuditOptions(gates=(Gate.STATIC,), names=names, cache=cache))


def static(path: Path, *names: str) -> GateReport:
    """Run the static gate and see that no rule crashed."""
    report = audit(path, *names).gates[0]
    crashes = [f"{result.slug}: {result.reason}" for result in report.results if result.outcome is Outcome.ERROR]
    assert not crashes
    return report


def outcome(report: GateReport, slug: str) -> Outcome:
    """Return how a rule ended."""
    return next(result.outcome for result in report.results if result.slug == slug)


def messages(report: GateReport, slug: str) -> str:
    """Return what a rule said."""
    return "\n".join(finding.message for result in report.results if result.slug == slug for finding in result.findings)


# -- nothing is executed -----------------------------------------------------------------------------------------------

_WATCH = """
import json, os, sys
adapter, report = sys.argv[1:3]
opened, wrong = [], []
def watch(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        path = os.path.abspath(os.fsdecode(arguments[0]))
        if path.startswith(adapter + os.sep):
            opened.append(os.path.relpath(path, adapter))
            if isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                wrong.append("writes " + path)
    elif event == "import" and arguments[1] and os.path.abspath(str(arguments[1])).startswith(adapter):
        wrong.append("imports " + str(arguments[:2]))
    elif event == "exec" and getattr(arguments[0], "co_filename", "").startswith(adapter):
        wrong.append("executes " + arguments[0].co_filename)
    elif event == "subprocess.Popen" and arguments[1][0].endswith("/bash") and arguments[1][1:] == ["--norc", "-n"]:
        pass  # which reads a script from its input, and runs nothing of it
    elif event in {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect", "socket.bind"}:
        wrong.append(event + " " + repr(arguments))
sys.addaudithook(watch)
sys.argv = ["xpl", "audit", adapter, "--gate", "static", "--no-cache", "--format", "json"]
from xpl_cli.main import app
try:
    app()
finally:
    with open(report, "w") as stream:
        json.dump({"opened": opened, "wrong": wrong}, stream)
"""


def watched(adapter: Path, tmp_path: Path) -> dict[str, list[str]]:
    """Audit in a process of its own and return the files of the adapter that it opened, and what it must not do."""
    file = tmp_path / "watched.json"
    done = subprocess.run(
        [sys.executable, "-c", _WATCH, str(adapter), str(file)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode in {0, 1}, done.stderr
    found: dict[str, list[str]] = json.loads(file.read_text())
    return found


def test_the_interpreter_confirms_that_nothing_runs(adapter: Path, tmp_path: Path) -> None:
    """Audit hooks see every import, execution, process and connection of the whole command."""
    trace = tmp_path / "trace"
    for name in ("model.py", "deploy.py", "__init__.py", "sitecustomize.py", "numpy.py", "yaml.py"):
        text = (adapter / name).read_text() if (adapter / name).exists() else ""
        (adapter / name).write_text(f"{text}\nopen({str(trace)!r}, 'a').write({name!r})\n")
    seen = watched(adapter, tmp_path)
    assert seen["wrong"] == []
    assert "model.py" in seen["opened"]
    assert not trace.exists()


@pytest.mark.slow
def test_of_a_vendored_tree_small_text_is_opened_once_and_nothing_else(adapter: Path, tmp_path: Path) -> None:
    """800 files beside the adapter are searched for keys; data, links and what is hidden there are left alone."""
    vendor(adapter, 800)
    (adapter / "vendor/.cache").mkdir()
    (adapter / "vendor/.cache/kept.py").write_text("x = 1\n")
    (adapter / "vendor/weights.bin").write_bytes(b"0" * 100)
    (adapter / "vendor/table.py").write_text("x = 1\n" * 100_000)
    (adapter / "vendor/link.py").symlink_to(adapter / "vendor/used.py")
    with (adapter / "model.py").open("a") as model:
        model.write("\nfrom .vendor.used import VALUE\n")
    seen = watched(adapter, tmp_path)
    opened = [name for name in seen["opened"] if name.startswith("vendor")]
    assert len(opened) == len(set(opened)) == 801
    assert all(name == "vendor/used.py" or name.startswith("vendor/part") for name in opened)
    assert seen["wrong"] == []


def vendor(adapter: Path, count: int) -> None:
    """Put a tree of other people's code into an adapter."""
    for number in range(count):
        folder = adapter / "vendor" / f"part{number // 20}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"code{number}.py").write_text("import os\n" + "def f(x):\n    return x\n\n\n" * 100)
    (adapter / "vendor/used.py").write_text("from .part0 import code0\n\nVALUE = 1\n")


# -- what files hold ---------------------------------------------------------------------------------------------------

TEXT = "# größe\nNAME = 'größe'\n"


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("content", "fits"),
    [
        (TEXT.encode(), True),
        (b"\xef\xbb\xbf" + TEXT.encode(), True),
        (TEXT.replace("\n", "\r\n").encode(), True),
        (TEXT.replace("\n", "\r").encode(), True),
        (b"# coding: latin-1\n" + TEXT.encode("latin-1"), True),
        (b"# -*- coding: cp1252 -*-\n" + TEXT.encode("cp1252"), True),
        (TEXT.encode("latin-1"), False),
        (TEXT.encode("utf-16"), False),
        (TEXT.encode("utf-32-le"), False),
        (b"x = 1\n\0\n", False),
        (b"# coding: no-such-codec\nx = 1\n", False),
        (b"# coding: rot13\nk = 1\n", False),
        (b"# coding: utf-8\n\xff\n", False),
        (b"def broken(:\n", False),
        (b"(" * 100_000, False),
    ],
)
def test_python_is_read_as_python_reads_it(adapter: Path, content: bytes, fits: bool) -> None:
    """What the interpreter refuses is a finding about that file, and no reason to know less of the others."""
    (adapter / "helper.py").write_bytes(content)
    report = static(adapter)
    assert ("helper.py" not in str(told(report, "parses"))) == fits
    assert outcome(report, "contract-methods") is Outcome.PASS


def told(report: GateReport, slug: str) -> list[str | None]:
    """Return the files that the findings of a rule are about."""
    return [finding.path for result in report.results if result.slug == slug for finding in result.findings]


OF_THE_STANDARD = ("model.py", "deploy.py", "deploy.yml", "policy.yml", "eval.sh", "README.md")


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    ("name", "content"),
    [
        *(
            (name, content)
            for name in OF_THE_STANDARD
            for content in (TEXT.encode("utf-16"), b"\xff\xfe\0\1" * 99, b"")
        ),
        ("model.py", b"class Model(:\n"),
        ("model.py", b"x = " + b"-" * 50_000 + b"1\n"),
        (
            "model.py",
            b"class Model:\n    def get_action_batch(self, x):\n        for () in enumerate(x): a[()]; f''; open()\n",
        ),
        ("deploy.yml", b"a: [1, 2\n"),
        ("deploy.yml", b"- a list\n"),
        ("deploy.yml", b"1: 2\nnull: 3\n[a, b]: 4\n"),
        ("policy.yml", b"inputs: 3\nmethods: 4\nembodiments: {a: 1}\ntemporal: []\nevaluation_only: [x]\n"),
        ("policy.yml", b"inputs: {optional: 5, required: {a: 1}}\nembodiments: [[1], {}]\n"),
        ("policy.yml", b"{" * 3000),
        ("eval.sh", b'\x80\x81 "unclosed $( ${ `\n<<EOF\n'),
    ],
)
def test_a_file_that_cannot_be_read_crashes_no_rule_and_keeps_none_of_others_from_being_judged(
    adapter: Path, name: str, content: bytes
) -> None:
    (adapter / name).write_bytes(content)
    assert outcome(static(adapter), "required-files") is not Outcome.NOT_RUN


@pytest.mark.sampled(6)
@pytest.mark.parametrize(
    "content",
    [
        "x = " + "[" * 190 + "]" * 190,
        "x = " + "+".join(["1"] * 40_000),
        "x = a" + ".b" * 30_000,
        "x = a" + "(1)" * 30_000,
        "x = " + "not " * 20_000 + "a",
        "if a:\n    pass\n" + "elif b:\n    pass\n" * 12_000,
        "x = {" + "'k':{" * 90 + "}" * 90 + "}",
        "class Model:" + "".join(f"\n{' ' * depth} if a:" for depth in range(1, 99)) + " pass",
        ";".join(f"v{number}=f(v{number - 1},[{number}])" for number in range(9000)),
    ],
    ids=["brackets", "sum", "attributes", "calls", "not", "elif", "maps", "blocks", "one-line"],
)
@pytest.mark.parametrize("name", ["model.py", "helper.py"])
def test_code_that_no_person_wrote_crashes_no_rule(adapter: Path, name: str, content: str) -> None:
    """Generated and minified code of 200 kB nests deeper than the interpreter's stack."""
    with (adapter / name).open("a") as file:
        file.write(f"\n{content}\n")
    if name != "model.py":
        with (adapter / "model.py").open("a") as model:
            model.write("\nfrom . import helper\n")
    static(adapter)


def test_a_file_of_many_megabytes_is_not_held_in_memory(adapter: Path) -> None:
    for name in ("tables.py", "weights.bin", "run.log", "data.json", "notes.md"):
        with (adapter / name).open("wb") as file:
            file.truncate(80_000_000)
    assert "larger than" in messages(static(adapter), "parses")
    for read in ("model.py", "eval.sh", "deploy.yml"):
        with (adapter / read).open("ab") as stream:
            stream.truncate(SIZE_LIMIT + 1)
    static(adapter)


# -- what folders hold -------------------------------------------------------------------------------------------------


def test_links_lead_nowhere(adapter: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.py").write_text("def broken(:\n")
    links = {"loop.py": "loop.py", "a.py": "b.py", "b.py": "a.py", "up": "..", "here": ".", "gone.py": "nothing.py"}
    for name, target in {**links, "away.py": "../../secret.py", "root": "/", "device.py": "/dev/zero"}.items():
        (adapter / name).symlink_to(target)
    with (adapter / "model.py").open("a") as model:
        model.write("\nfrom . import a, away, device, gone, loop\nfrom .here.here.model import Model as Again\n")
        model.write("from .up.Foo.model import Model as Third\nfrom .root.etc import passwd\n")
    (adapter / "process_data.sh").write_text("python up/up/secret.py\npython here/here/away.py\npython device.py\n")
    report = static(adapter)
    assert outcome(report, "parses") is Outcome.PASS
    for file in ("README.md", "deploy.yml", "eval.sh"):
        (adapter / file).unlink()
        (adapter / file).symlink_to(file)
    static(adapter)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", ["model.py", "deploy.yml", "eval.sh", "pipe.py"])
def test_a_pipe_blocks_nothing(adapter: Path, name: str) -> None:
    """Opening one would wait for a writer that never comes."""
    (adapter / name).unlink(missing_ok=True)
    os.mkfifo(adapter / name)
    done, rescued = threading.Event(), threading.Event()

    def rescue() -> None:
        if not done.wait(DEADLINE_S):
            rescued.set()
            os.close(os.open(adapter / name, os.O_RDWR | os.O_NONBLOCK))

    threading.Thread(target=rescue, daemon=True).start()
    static(adapter)
    audit(adapter, cache=adapter.parent.parent / "cache")
    done.set()
    assert not rescued.is_set()


def test_a_folder_in_place_of_a_file_is_no_file(adapter: Path) -> None:
    """Some checkouts have one where a submodule should be."""
    for name in OF_THE_STANDARD:
        (adapter / name).unlink()
        (adapter / name).mkdir()
        static(adapter)


_AS_NOBODY = """
import os, sys
from pathlib import Path
from xpl_cli.audit.engine import engine
from xpl_cli.audit.formats import render
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.options import AuditOptions
adapter, options = Path(sys.argv[1]), AuditOptions(gates=(Gate.STATIC,))
engine.audit(adapter, "policy", options)  # imports what another user may be unable to read
for name in sys.argv[2:]:
    (adapter / name).chmod(0)
user = os.geteuid()
if user == 0:
    os.seteuid(65534)
report = engine.audit(adapter, "policy", options)
os.seteuid(user)
print(render("json", [report]))
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize("names", [["model.py", "eval.sh"], ["deploy.yml"], ["policy.yml"], ["README.md"], ["."]])
def test_a_file_that_may_not_be_read_is_told(adapter: Path, names: list[str]) -> None:
    """Whatever needs it could not run or is a finding, with the reason; nothing crashes. Root may read everything."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        shared = Path(shutil.copytree(adapter, Path(folder) / "Foo"))
        done = subprocess.run(
            [sys.executable, "-c", _AS_NOBODY, str(shared), *names],
            cwd=ROOT,
            check=False,
            capture_output=True,
            text=True,
        )
        shared.chmod(0o755)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    results = document["targets"][0]["gates"][0]["results"]
    assert [result for result in results if result["outcome"] == "error"] == []
    assert "ermission denied" in done.stdout
    assert document["exit_code"] in {1, 4}


# -- what happens meanwhile --------------------------------------------------------------------------------------------


class _Vanishing(Source):
    """Files that go away, or become something else, when they are about to be read."""

    damage: Callable[[Path], object] = staticmethod(lambda _path: None)

    def text(self, name: str) -> str:
        """Return the text of a file that has just changed."""
        if name not in self.files_read:
            type(self).damage(self.path / name)
        return super().text(name)


def _as_folder(file: Path) -> None:
    if not file.is_dir():
        file.unlink(missing_ok=True)
        file.mkdir()


@pytest.mark.parametrize(
    "damage",
    [lambda file: file.unlink(missing_ok=True), _as_folder, lambda file: file.is_file() and file.write_bytes(b"\0(")],
    ids=["gone", "folder", "rewritten"],
)
def test_files_may_go_while_they_are_read(
    adapter: Path, monkeypatch: pytest.MonkeyPatch, damage: Callable[[Path], object]
) -> None:
    monkeypatch.setattr("xpl_cli.audit.engine.engine.Source", _Vanishing)
    monkeypatch.setattr(_Vanishing, "damage", staticmethod(damage))
    static(adapter)


def test_an_adapter_that_is_rewritten_all_the_time_can_be_audited(adapter: Path, tmp_path: Path) -> None:
    """An editor saves, git switches branches: reports may tell either state, and no crash."""
    texts = [(adapter / "model.py").read_text(), "class Model(:\n", ""]
    stop = threading.Event()

    def rewrite() -> None:
        while not stop.is_set():
            for text in texts:
                with suppress(OSError):
                    (adapter / "new").write_text(text)
                    (adapter / "new").replace(adapter / "model.py")
                    (adapter / "helper.py").write_text(text)
                    (adapter / "helper.py").unlink()

    thread = threading.Thread(target=rewrite)
    thread.start()
    try:
        for _ in range(6):
            report = audit(adapter, cache=tmp_path / "cache")
            assert [result for result in report.results if result.outcome is Outcome.ERROR] == []
    finally:
        stop.set()
        thread.join()


# -- names -------------------------------------------------------------------------------------------------------------

NAMES = [
    b"with space.py",
    b"l\xfffig.py",
    b"two\nlines.py",
    b"100%.py",
    b"a]b.py",
    b"a::b.py",
    b"::error::x.py",
    b"-x.py",
]


@pytest.fixture
def strange(adapter: Path) -> Path:
    """An adapter whose files have names that formats have to escape, each with a finding."""
    for name in NAMES:
        (adapter / os.fsdecode(name)).write_text("def broken(:\n")
    return adapter.rename(adapter.with_name("a b%]::c"))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", REPORTS)
def test_every_name_is_escaped(strange: Path, name: str) -> None:
    """No name of a file ends a line, a command or a document of any format."""
    context = ReportContext(strange.parent.parent)
    report = engine.audit(strange, "policy", AuditOptions(gates=(Gate.STATIC,)), display_path="policy/a b%]::c")
    assert not any(result.outcome is Outcome.ERROR for result in report.results)
    assert len(told(report.gates[0], "parses")) == len(NAMES)
    text = render(name, [report], context)
    if name in {"json", "sarif", "rdjson"}:
        json.loads(text)
    elif name == "junit":
        ET.parse(io.StringIO(text))  # noqa: S314 - our own
    elif name == "github":
        assert all(line.startswith(("::error ", "::warning ", "::notice ")) for line in text.splitlines())
        assert all(line.count("::") == 2 or "::" not in line.split("::", 2)[1] for line in text.splitlines())
        assert "file=policy/a b%25]%3A%3Ac/" in text
    else:
        assert not any(line.startswith(("lines.py", "::")) for line in text.splitlines())
