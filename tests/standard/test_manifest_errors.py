"""What commands say of a manifest that is wrong: all that is wrong, where, and what was meant."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.adapters.rules import made_adapter
from tests.support.checkout import ROOT
from tests.support.commands import xpl
from tests.support.examples import examples
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.yaml import text as yaml_text
from xpl_cli.packages import manifests, package
from xpl_cli.standard.validate import validate_yaml, validate_yaml_file

POLICY = (ROOT / "policy" / "demo_policy" / "policy.yml").read_text(encoding="utf-8")
DEPLOY = (ROOT / "policy" / "demo_policy" / "deploy.yml").read_text(encoding="utf-8")


@pytest.fixture
def adapter(tmp_path: Path) -> Path:
    """A fresh adapter."""
    return made_adapter(tmp_path / "Foo")


def broken(adapter: Path) -> list[tuple[int, str]]:
    """Damage a manifest in four places; return line and key of each problem."""
    lines = (adapter / "policy.yml").read_text().split("\n")
    numbers = {}
    for number, line in enumerate(lines, start=1):
        for old, new, key in (
            ("family:", "famly:", "famly"),
            ("  chunk:", '  chunk: "16" #', "temporal.chunk"),
            ("action_types:", "action_types: [joints] #", "action_types[0]"),
            ("deterministic:", "deterministic: maybe #", "deterministic"),
        ):
            if line.startswith(old):
                lines[number - 1] = line.replace(old, new, 1)
                numbers[key] = number
    (adapter / "policy.yml").write_text("\n".join(lines))
    return sorted((number, key) for key, number in numbers.items())


@pytest.mark.parametrize(
    "command",
    [
        ("serve", "Foo"),
        ("eval", "Foo", "--env", "offline"),
        ("install", "Foo"),
        ("prepare", "Foo"),
        ("train", "Foo"),
        ("adopt", "Foo", "--merge"),
        ("spec", "validate", "Foo/policy.yml"),
    ],
)
def test_every_command_lists_every_problem_with_its_place(adapter: Path, command: tuple[str, ...]) -> None:
    """Nothing is started; file, line, column, key, what was expected, what came, the nearest name and the page."""
    places = broken(adapter)
    ended = xpl(*command, "--json", folder=adapter.parent)
    is_check = command[0] == "spec"
    assert ended.code == (ExitCode.FINDINGS if is_check else ExitCode.USAGE), ended.stderr
    answer = json.loads(ended.stdout)
    assert answer["schema"] == ("xpl.spec-validate/1" if is_check else "xpl.error/1")
    problems = [problem for problem in answer["problems"] if problem["missing"] is None]
    assert [(problem["line"], problem["key"]) for problem in problems] == places
    meant = {problem["key"]: problem["nearest"] for problem in problems}
    assert meant == {"famly": "family", "temporal.chunk": "16", "action_types[0]": "joint", "deterministic": None}
    first = next(problem for problem in problems if problem["key"] == "temporal.chunk")
    assert (first["file"], first["expected"], first["got"]) == ("Foo/policy.yml", "an integer", "the text '16'")
    page, _, anchor = first["page"].partition("#")
    assert (ROOT / page).is_file()
    assert anchor == "temporal"


def test_an_audit_reports_the_same_places(adapter: Path) -> None:
    """The static gate as findings of the rule about manifests, the offline gate as why nothing was served."""
    places = broken(adapter)
    gates = {}
    for gate, rule in (("static", "manifest"), ("offline", "XPL201")):
        ended = xpl("audit", "Foo", "--gate", gate, "--select", rule, "--json", folder=adapter.parent)
        assert ended.code != ExitCode.CLEAN
        gates[gate] = json.loads(ended.stdout)["targets"][0]["gates"][0]
    (result,) = gates["static"]["results"]
    assert {finding["line"] for finding in result["findings"]} >= {line for line, _ in places}
    told = json.dumps(gates["offline"])
    assert [line for line, _ in places if f"policy.yml:{line}:" not in told] == []


def test_a_wrong_deploy_yml_is_told_too_and_missing_keys_are_not(adapter: Path) -> None:
    """They have defaults; the audit asks for them."""
    (adapter / "deploy.yml").write_text("port: 70000\nseed: first\n")
    with pytest.raises(manifests.ManifestError) as caught:
        package.load(adapter)
    assert caught.value.code == ExitCode.USAGE
    assert [(one.line, one.column, one.path) for one in caught.value.problems] == [(1, 1, ("port",)), (2, 1, ("seed",))]
    (adapter / "deploy.yml").write_text("seed: 3\n")
    assert package.load(adapter).config()["seed"] == 3


def test_many_problems_are_bounded_for_people_and_not_for_programs(tmp_path: Path) -> None:
    file = tmp_path / "policy.yml"
    file.write_text("".join(f"key_{number}: 1\n" for number in range(100)))
    with pytest.raises(manifests.ManifestError) as caught:
        manifests.read(file, "policy")
    assert len(str(caught.value).split("\n")) == 22
    assert str(caught.value).endswith("and 80 more")
    assert len(caught.value.details()["problems"]) == 100


@pytest.mark.parametrize(
    ("text", "place", "told"),
    [
        ("a:\n\tb: 1\n", (2, 1), "a tab indents this line: YAML is indented by spaces"),
        ("a: [1, 2\nb: 3\n", (1, 4), "a list that is opened by [ is not closed by ]"),
        ("a: 'x\nb: 1\n", (1, 4), "a quotation that is not closed"),
        ("a: *x\n", (1, 4), "an alias (*name) without its anchor"),
        ("a: 1\n---\nb: 2\n", (2, 1), "a second document (---)"),
        ("a: b: c\n", (1, 5), "a second colon"),
        ("a: @b\n", (1, 4), "a character that no value may start with"),
        ("x:\n  day: 2024-99-99\n", (2, 8), "'2024-99-99' is no timestamp (quote it if it is text)"),
        ("a: !!bool maybe\n", (1, 4), "'maybe' is no bool"),
        ("? [1]\n: 2\n", (1, 3), "a list or a map as the key of a map"),
        ("a: &a [*a]\n", (1, 4), "an alias makes this contain itself"),
        ("a: " + "9" * 100_000, (1, 4), "a number of 100000 characters"),
        ("a: " + "1:" * 100_000 + "1", (1, 4), "a number of 200001 characters"),
        ("a: 1\nb: caf\xe9\n".encode("latin-1"), (2, 7), "the byte 0xe9 is not UTF-8"),
        ("a: 1".encode("utf-16"), (1, 1), "the file is UTF-16: expected UTF-8"),
        ("a: 1\nb: \x01\n", (2, 4), "the character '\\x01' is not allowed in YAML"),
        (b"a" * (yaml_text.MOST_BYTES + 1), (1, 1), "expected at most"),
        ("[" * 100_000, (1, 101), "nested more than 100 levels deep"),
        ("a: 1\nb: 2\na: 3\n", (3, 1), "the key 'a' is given twice, first in line 1"),
        ("", (1, 1), "the file is empty"),
        ("- 1\n", (1, 1), "expected a map"),
        ("3", (1, 1), "expected a map"),
        ("a: !!python/x 1", (1, 4), "tag"),
    ],
)
def test_what_is_no_manifest_is_told_in_plain_words(
    tmp_path: Path, text: str | bytes, place: tuple[int, int], told: str
) -> None:
    """At the line and column where it has to be mended, at once."""
    file = tmp_path / "deploy.yml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    problems = [problem for problem in validate_yaml_file(file, "deploy") if told in problem.message]
    assert [(problem.line, problem.column) for problem in problems] == [place]
    assert len(str(problems[0])) < 400
    with pytest.raises(UserError, match=r"deploy\.yml has"):
        manifests.read(file, "deploy")


def bomb(line: str, levels: int) -> str:
    """Return a document whose aliases unfold tenfold with each level."""
    text = "a0: &a0 {k: v}\n"
    for level in range(1, levels):
        text += line.format(name=f"a{level}", inner=", ".join([f"*a{level - 1}"] * 10)) + "\n"
    return text


@pytest.mark.parametrize("line", ["{name}: &{name} [{inner}]", "{name}: &{name} {{<<: [{inner}]}}"])
def test_aliases_that_unfold_without_end_are_refused_before_they_do(line: str) -> None:
    """In lists and in merged maps; a few aliases are YAML like any other."""
    with pytest.raises(yaml.YAMLError, match="aliases unfold into more than"):
        yaml_text.parse(bomb(line, 40))
    assert yaml_text.parse(bomb(line, 3))["a0"] == {"k": "v"}
    chain = "a0: &a0 [1]\n" + "".join(f"a{level}: &a{level} [*a{level - 1}]\n" for level in range(1, 5000))
    with pytest.raises(yaml.YAMLError, match="levels deep"):
        yaml_text.parse(chain)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("control_frequency: 1e1", "10.0"),
        ('evaluation_only: "false"', "false"),
        ("summary: 3", '"3"'),
        ("summary: yes", '"true"'),
        ("control_frequency: .nan", None),
        ("temporal: {kind: chunked, chunk: 3}", "chunk"),
        ("temporal: {knid: chunk, chunk: 3}", "kind"),
        ("inputs: {required: [vision.cam_hed]}", "vision.cam_head"),
        ("environment: {manager: cuda}", "conda"),
    ],
)
def test_what_was_meant_is_named(text: str, meant: str | None) -> None:
    """YAML takes 1e1 for a text and yes for a flag; names are misspelt."""
    problems = [problem for problem in validate_yaml(text.encode(), "policy.yml", "policy")[1] if not problem.missing]
    assert [problem.nearest for problem in problems] == [meant]


PIECES = ["\t", ":", "- ", "{", "}", "[", "]", "&a ", "*a", "<<: *a", "'", '"', "\n", "!!int ", "!!set ", "? ", "| "]
PIECES += ["---\n", "\x00", "\xff", "1e400", ".nan", "null", "2024-99-99", "0x", "~", "#", "%", "@", "`", "    "]
PIECES += ["\ufeff", "\u2028", "9" * 500, "{{"]


@settings(max_examples=examples(250), deadline=None, derandomize=True)
@given(
    schema=st.sampled_from(["policy", "deploy"]),
    seed=st.integers(0, 2**32),
    hits=st.integers(1, 6),
    raw=st.booleans(),
)
def test_random_damage_never_gives_anything_but_problems(
    tmp_path_factory: pytest.TempPathFactory, schema: str, seed: int, hits: int, *, raw: bool
) -> None:
    """Pieces are put in, taken out and moved; the answer is a map, or problems with places and a sentence each."""
    draw = random.Random(seed)  # noqa: S311 - repeatable damage
    content = (POLICY if schema == "policy" else DEPLOY).encode()
    for _ in range(hits):
        at, end = sorted(draw.randrange(len(content) + 1) for _ in range(2))
        piece = bytes([draw.randrange(256)]) if raw else draw.choice(PIECES).encode()
        cut = min(end, at + draw.randrange(12))
        content = draw.choice(
            [
                content[:at] + piece + content[at:],
                content[:at] + content[cut:],
                content[:at] + content[at:end] + content[at:],
            ]
        )
    file = tmp_path_factory.mktemp("damaged") / f"{schema}.yml"
    file.write_bytes(content)
    for problem in validate_yaml_file(file, schema):
        assert problem.message
        assert problem.line is not None
        assert str(problem).startswith(str(file))
    told: list[object] = [None]
    try:
        read = manifests.read(file, schema)
    except manifests.ManifestError as error:
        read, told = {}, json.loads(json.dumps(error.details()))["problems"]
    assert isinstance(read, dict)
    assert told
