"""Packages that want to hang, exhaust or crash the static gate: it ends, and says what it refused."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.attacks.fuzz import texts
from tests.support.adapters.rules import made_adapter, made_room
from tests.support.examples import examples
from tests.support.peer import xpl
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.static import limits
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.errors import ExitCode
from xpl_cli.basics.yaml import text as yaml_text

FEW = settings(max_examples=examples(60), deadline=None)


@pytest.fixture(scope="module")
def scaffold(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_adapter(tmp_path_factory.mktemp("made") / "policy" / "Foo")


@pytest.fixture
def adapter(scaffold: Path, tmp_path: Path) -> Path:
    return shutil.copytree(scaffold, tmp_path / "policy" / "Foo")


def static(path: Path, *names: str) -> GateReport:
    """Run the static gate and see that no rule crashed."""
    report = engine.audit(path, "policy", AuditOptions(gates=(Gate.STATIC,), names=names)).gates[0]
    crashes = [f"{result.slug}: {result.reason}" for result in report.results if result.outcome is Outcome.ERROR]
    assert not crashes
    return report


def refused(report: GateReport) -> dict[str | None, str]:
    """Return what the rule `parses` said, by file."""
    return {
        finding.path: finding.message
        for result in report.results
        if result.slug == "parses"
        for finding in result.findings
    }


# -- bombs -------------------------------------------------------------------------------------------------------------

NESTED = 5000
REFUSED = {
    "idna.py": (b"# coding: idna\nx = 1\n", "idna is no encoding for source"),
    "punycode.py": (b"# coding: punycode\nx = 1\n" * 9000, "punycode is no encoding for source"),
    "undefined.py": (b"# coding: undefined\n", "undefined is no encoding for source"),
    "utf7.py": (b"# coding: utf-7\n+AGkAbQBwAG8AcgB0-\n", "utf-7 is no encoding for source"),
    "escapes.py": (b"# coding: unicode_escape\n", "unicode_escape is no encoding for source"),
    "unknown.py": (b"# coding: nonsense\n", "unknown encoding"),
    "zipped.py": (b"# coding: zlib\n", "zlib"),
    "parentheses.py": (b"x = " + b"(" * NESTED + b"1" + b")" * NESTED, "does not parse"),
    "sums.py": (b"x = " + b"1 + " * NESTED + b"1\n", "does not parse"),
    "ladder.py": (b"if a:\n  pass\n" + b"elif a:\n  pass\n" * 300, "nested more than 200 levels deep"),
    "calls.py": (b"x = a" + b"()" * 300, "nested more than 200 levels deep"),
    "digits.py": (b"x = " + b"9" * 100_000, "does not parse"),
    "statements.py": (b"x=1\n" * 65_000, "more than 250000 nodes of syntax"),
    "subshells.sh": (b"echo " + b"$(" * NESTED + b")" * NESTED, "does not parse"),
    "heredocs.sh": (b"cat " + b"<<A " * NESTED, "maximum here-document count exceeded"),  # bash says so
    "quotes.sh": (b"echo " + b'"$(' * NESTED, "does not parse"),
    "blocks.sh": (b"{ true\n" * NESTED, "does not parse"),
    "words.sh": (b"a " * 60_000, "more than 60000 characters"),
    "values.yml": (b"[" + b"1," * 110_000 + b"]", "more than 100000 values"),
    "aliases.yml": (
        b"a0: &a0 [1]\n" + b"".join(b"a%d: &a%d [*a%d, *a%d]\n" % (n, n, n - 1, n - 1) for n in range(1, 40)),
        "aliases unfold into more than 100000 values",
    ),
    "merges.yml": (
        b"a0: &a0 {x: 1}\n" + b"".join(b"a%d: &a%d {<<: [*a%d, *a%d]}\n" % (n, n, n - 1, n - 1) for n in range(1, 40)),
        "aliases unfold into more than 100000 values",
    ),
    "chain.yml": (
        b"a0: &a0 {x: 1}\n" + b"".join(b"a%d: &a%d {<<: *a%d}\n" % (n, n, n - 1) for n in range(1, 500)),
        "nested more than 100 levels deep",
    ),
    "digits.yml": (b"a: " + b"9" * NESTED, "a number of 5000 characters"),
    "hexadecimal.yml": (b"a: 0x" + b"f" * NESTED, "a number of 5002 characters"),
    "binary.yml": (b"a: 0b" + b"1" * NESTED, "a number of 5002 characters"),
    "deep.yml": (b"a: " + b"[" * NESTED + b"]" * NESTED, "nested more than 100 levels deep"),
}
DOUBLED = b"a0=x\n" + b"".join(b"a%d=$a%d$a%d\n" % (n, n - 1, n - 1) for n in range(1, 60)) + b"sh $a59.py\n"
TAKEN = {
    "defaults.sh": b"echo " + b"${a:-" * NESTED + b"}" * NESTED,
    "backticks.sh": b"echo " + b"`" * NESTED,
    "escapes.sh": b"echo " + b"\\\"'" * NESTED,
    "long.sh": b"python " + b"a" * NESTED + b".py\nbash " + b"a/" * NESTED + b"b.sh\n",
    "nul.sh": b"echo \0 \xff\xfe\n",
    "long.yml": b"a: '" + b"x" * 200_000 + b"'\n",
}


@pytest.mark.slow
def test_what_is_too_much_is_a_finding_of_its_own_file(adapter: Path) -> None:
    """Encodings that hide, trees and scripts that overflow, YAML that unfolds: each is named, and no rule crashes."""
    for name, content in (*((name, bomb) for name, (bomb, _) in REFUSED.items()), *TAKEN.items()):
        (adapter / name).write_bytes(content)
    found = refused(static(adapter))
    assert found.keys() == REFUSED.keys()
    for name, (_, message) in REFUSED.items():
        assert message in found[name], name


def test_many_files_are_bounded_in_sum(adapter: Path) -> None:
    """Each is smaller than what a file may be; what is beyond the sum is a finding, and takes no time."""
    names = [f"part{number}.py" for number in range(4)]
    for name in names:
        (adapter / name).write_text("# nothing\n" * 180_000)
    with (adapter / "model.py").open("a") as model:
        model.write("".join(f"from . import {name[:-3]}\n" for name in names))
    found = refused(static(adapter))
    assert found.keys() < set(names)
    assert all("more than 4194304 characters together" in message for message in found.values())


@pytest.mark.slow
def test_texts_are_bounded_in_sum(adapter: Path) -> None:
    names = [f"part{number}.md" for number in range(36)]
    for name in names:
        (adapter / name).write_text("nothing\n" * 250_000)
    found = refused(static(adapter, "parses"))
    assert found.keys() < set(names)
    assert all("more than 67108864 bytes of text together" in message for message in found.values())


def test_what_does_not_parse_is_not_kept_in_memory(adapter: Path) -> None:
    """The traceback of a refusal holds its frames, and these the tree."""
    (adapter / "large.py").write_text("x=1\n" * 65_000)
    error = Source(adapter).syntax_error("large.py")
    assert error is not None
    assert error.__traceback__ is None


def test_a_text_is_split_into_lines_once_however_much_is_found_in_it(
    adapter: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a file of ten thousand findings takes the square of that."""
    with (adapter / "model.py").open("a") as model:
        model.write("".join(f"import missing_{number}\n" for number in range(300)))
    read = []
    text = Source.text
    monkeypatch.setattr(Source, "text", lambda self, name: read.append(name) or text(self, name))
    result = next(found for found in static(adapter).results if found.code == "XPL108")
    assert len(result.findings) == 300
    assert read.count("model.py") < 50


@pytest.mark.parametrize(
    ("name", "added"),
    [
        ("process_data.sh", b"python " + b"a/" * NESTED + b"b.py " + b"c" * NESTED + b".py\n"),
        ("process_data.sh", DOUBLED),
        ("eval.sh", b"python " + b"a" * NESTED + b".py\npython x\0y.py\n"),
        ("model.py", b"\nimport " + b"a." * NESTED + b"a\n"),
        ("model.py", b"\nfrom " + b"." * NESTED + b"a import b\nfrom ." + b"a" * NESTED + b" import b\n"),
        ("model.py", b"\n    def helper(self):\n        return 1" + b" + 1" * 150 + b"\n"),
    ],
)  # fmt: skip
def test_names_that_no_system_takes_are_no_crash(adapter: Path, name: str, added: bytes) -> None:
    """Paths of thousands of parts, variables that double with each line, imports that climb out of every folder."""
    with (adapter / name).open("ab") as file:
        file.write(added)
    assert name not in refused(static(adapter))


def test_the_nodes_of_a_manifest_are_read_once(adapter: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads: list[bytes | str] = []
    real = yaml_text.read

    def counted(content: bytes | str) -> yaml_text.YamlDocument:
        reads.append(content)
        return real(content)

    monkeypatch.setattr(yaml_text, "read", counted)
    with (adapter / "deploy.yml").open("a", encoding="utf-8") as deploy:
        deploy.writelines(f"key_{number}: {number}\n" for number in range(500))
    report = static(adapter, "unread-settings")
    (finding,) = report.results[0].findings
    assert "key_19 and 480 more" in finding.message
    assert finding.fix is not None
    assert len(finding.fix.edits) == 500
    files = [(adapter / name).read_bytes() for name in ("deploy.yml", "policy.yml")]
    assert [reads.count(content) for content in files] == [1, 1]


def test_a_rule_that_takes_too_long_is_not_run(adapter: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bound that is no bound of time is a bug of ours; the audit ends all the same, and says which rule it was."""
    room = made_room(tmp_path / "room", monkeypatch)
    room.rule("endless", "while True:\n    pass\nyield", code="XPL199")
    monkeypatch.setattr("xpl_cli.audit.engine.checks.deadline", lambda _: limits.deadline(0.05))
    (result,) = static(adapter).results
    assert result.outcome is Outcome.NOT_RUN
    assert "not done within" in str(result.reason)
    assert signal.getsignal(signal.SIGVTALRM) is signal.SIG_DFL


def test_rules_share_the_time_that_a_package_has(
    adapter: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files without number, none of them too large, cost every rule its time; a hundred rules shall not add that up."""
    room = made_room(tmp_path / "room", monkeypatch)
    for number in range(3):
        room.rule(f"endless-{number}", "while True:\n    pass\nyield", code=f"XPL19{number}")
    given = list[float]()
    monkeypatch.setattr("xpl_cli.audit.engine.checks.LONGEST_S", 0.05)
    monkeypatch.setattr(
        "xpl_cli.audit.engine.checks.deadline", lambda seconds: given.append(seconds) or limits.deadline(seconds)
    )
    results = static(adapter).results
    assert [result.outcome for result in results] == [Outcome.NOT_RUN] * 3
    assert given[0] == 0.05
    assert given == sorted(given, reverse=True)
    assert given[1] < given[0]  # and the third may get as little as the second: on a busy machine nothing is left


def test_what_goes_wrong_with_one_package_costs_no_other_its_verdict(
    adapter: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only where a rule crashes, but wherever its files are read."""
    shutil.copytree(adapter, adapter.parent / "Bar")
    real = Source.record

    def broken(self: Source) -> str:
        if self.path.name == "Bar":
            raise RuntimeError("cannot be read")
        return real(self)

    monkeypatch.setattr(Source, "boundary_hash", broken)
    from xpl_cli.packages.targets import find_target

    targets = [find_target(adapter.parent / name) for name in ("Bar", "Foo")]
    lost, fine = engine.audit_all(targets, AuditOptions(gates=(Gate.STATIC,), names=("required-files",)))
    assert [result.outcome for result in lost.results] == [Outcome.ERROR]
    assert "RuntimeError: cannot be read" in str(lost.results[0].reason)
    assert [result.outcome for result in fine.results] == [Outcome.PASS]


def test_an_audit_of_all_gets_over_a_hostile_neighbour(adapter: Path) -> None:
    """From the command line: both have a verdict, and the findings are told."""
    evil = shutil.copytree(adapter, adapter.parent / "Evil")
    (evil / "helper.py").write_bytes(REFUSED["punycode.py"][0])
    done = xpl("audit", "--all", "--gate", "static", "--json", cwd=adapter.parents[1])
    assert done.returncode == ExitCode.FINDINGS
    assert {target["name"]: target["verdict"] for target in json.loads(done.stdout)["targets"]} == {
        "Evil": "red",
        "Foo": "open",
    }


# -- neighbours --------------------------------------------------------------------------------------------------------

SCALARS = st.sampled_from(["1", "x", "'y'", "010", "1:30", "2024-99-99", "!!int a", "!!float '.'", "~", "*a", "no"])
YAML = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4).map(lambda items: f"[{', '.join(items)}]"),
        st.lists(st.tuples(st.sampled_from(["a", "<<", "? b", "&a c", "[d]", "1"]), inner), max_size=4).map(
            lambda pairs: "{" + ", ".join(f"{key}: {value}" for key, value in pairs) + "}"
        ),
        inner.map(lambda value: f"&a {value}"),
        inner.map(lambda value: f"!!map {value}"),
    ),
    max_leaves=12,
)  # fmt: skip
SHELL = st.lists(
    st.one_of(
        st.sampled_from("\"'`\\(){};&|<>#!=\n\t\0a1é"),
        st.sampled_from(("$(", "${", "$((", "))", "<<E", "\nE\n", "<<<", ";;", "[[", "]]", "$1", "${2:-", "f()", "a=")),
        st.sampled_from(("if", "then", "fi", "for", "in", "do", "done", "while", "case", "esac", "function", "--b")),
    ),
    max_size=60,
).map(" ".join)
PYTHON = st.lists(
    st.one_of(
        st.sampled_from("()[]:=,*.a1\n"),
        st.sampled_from(("def f(self):", "class Model:", "\n    ", "return", "self.x", "config", "['a']", "'s'", "**")),
        st.sampled_from(("lambda", "for", "in", "if", "else", "import", "from", "f'{", "}'", "await")),
    ),
    max_size=50,
).map(" ".join)


@pytest.mark.parametrize(
    ("target", "strategy"), [(texts.read_yaml, YAML), (texts.read_shell, SHELL), (texts.read_python, PYTHON)]
)
def test_readers_take_or_refuse_what_is_made_up(
    target: Callable[[bytes], None], strategy: st.SearchStrategy[str]
) -> None:
    """Structures rather than bytes; each reader has one way to refuse."""

    @FEW
    @given(strategy)
    def read(text: str) -> None:
        target(text.encode())

    read()


@pytest.mark.parametrize(
    ("script", "line", "problem"),
    [
        ("echo 'a\n\n", 1, "matching `''"),
        ("a\nfi\n", 2, "`fi'"),
        ("while a; done\n", 1, "`done'"),
        ("\nif a; then\n  b\n", 4, "end of file"),
    ],
)
def test_a_broken_script_is_told_with_its_line(adapter: Path, script: str, line: int, problem: str) -> None:
    """The line at which bash stops, and what it says."""
    (adapter / "eval.sh").write_text(script, encoding="utf-8")
    (finding,) = next(result.findings for result in static(adapter, "parses").results)
    assert (finding.path, finding.line) == ("eval.sh", line)
    assert problem in finding.message


def test_a_script_is_read_by_bash_and_not_run(adapter: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the script nor what the environment names as a file to begin with; extended patterns are taken."""
    (tmp_path / "begin.sh").write_text("touch begun\n")
    monkeypatch.setenv("BASH_ENV", str(tmp_path / "begin.sh"))
    monkeypatch.chdir(tmp_path)
    (adapter / "eval.sh").write_text("touch ran\nshopt -s extglob\nrm -f !(a|b)\n")
    assert not next(result.findings for result in static(adapter, "parses").results)
    assert not (tmp_path / "ran").exists()
    assert not (tmp_path / "begun").exists()


@pytest.mark.parametrize("seed", [pytest.param(seed, id=str(number)) for number, seed in enumerate(texts.seeds())])
def test_readers_take_what_fuzzers_start_from(seed: tuple[int, bytes]) -> None:
    """Otherwise a fuzzer would stop at once."""
    target, data = seed
    texts.TARGETS[target](data)


@pytest.mark.slow
def test_the_gate_withstands_generated_packages(scaffold: Path, tmp_path: Path) -> None:
    """Every rule, on generated modules, scripts and manifests."""
    folder = shutil.copytree(scaffold, tmp_path / "policy" / "Foo")

    @settings(max_examples=examples(60), deadline=None)
    @given(PYTHON, SHELL, YAML)
    def audited(python: str, shell: str, yaml: str) -> None:
        for name, text in (("model.py", python), ("helper.py", python), ("eval.sh", shell), ("process_data.sh", shell)):
            (folder / name).write_text(text, encoding="utf-8")
        for name in ("deploy.yml", "policy.yml"):
            (folder / name).write_text(yaml, encoding="utf-8")
        static(folder)

    audited()


@pytest.mark.slow
def test_the_readers_withstand_a_fuzzer_that_sees_their_branches(tmp_path: Path) -> None:
    """For twenty seconds: no other error, no input that takes seconds, memory that is bounded."""
    if importlib.util.find_spec("atheris") is None:
        pytest.skip("not run: atheris is not installed")
    for number, (target, data) in enumerate(texts.seeds()):
        (tmp_path / f"seed-{number}").write_bytes(bytes([target]) + data)
    limits = [
        "-max_total_time=20",
        "-timeout=10",
        "-rss_limit_mb=4096",  # the peak of the process that starts it counts
        "-max_len=4096",
        "-print_final_stats=1",
    ]
    run = subprocess.run(
        [sys.executable, texts.__file__, *limits, f"-artifact_prefix={tmp_path}/", tmp_path],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-5000:]


def test_a_pipe_in_the_place_of_the_manifest_is_reported(adapter: Path) -> None:
    (adapter / "policy.yml").unlink()
    os.mkfifo(adapter / "policy.yml")
    [result] = static(adapter, "required-files").results
    assert [finding.message for finding in result.findings if "is not a regular file" in finding.message]
