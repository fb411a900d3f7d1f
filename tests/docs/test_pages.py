"""What the pages show is right: commands, code, manifests, links. What they show is run where that is harmless."""

from __future__ import annotations

import ast
import importlib
import itertools
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command

from tests.support import pages
from tests.support.peer import xpl
from tests.support.places import ROOT, tracked
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.basics.errors import ExitCode
from xpl_cli.basics.formats import REPORTS
from xpl_cli.derived import commands, compiler, rules
from xpl_cli.main import app
from xpl_cli.standard import answers, spec, unknown
from xpl_cli.standard.validate import validate

SHELL = ("bash", "console")
LANGUAGES = {*SHELL, "python", "yaml", "json", "diff", "toml", "dockerfile", "text"}
"""Languages of blocks. What stands in `text` is output, and no command."""

PROGRAMS = {
    "bash",
    "cd",
    "curl",
    "docker",
    "find",
    "git",
    "pip",
    "python",
    "sha256sum",
    "sort",
    "tr",
    "xargs",
}
"""Commands of others that pages show: a misspelt `xpl` is none of them."""

FOREIGN = (
    {"on", "permissions", "jobs"},
    {"repos"},
    {"args"},
    {"template", "answers", "generated", "seeded", "free"},
    {"server", "wire", "openpi"},
    {"hand_over"},
)
"""Keys of YAML that is no manifest: a workflow, hooks before a commit, arguments of one, a lock file that we write; and
of an adapter's own keys, those of one that forwards; and a launcher, whose form its own reader checks."""

MANIFESTS = ("policy", "deploy", "env")
BLOCKS = list(pages.blocks())


def _of(*languages: str) -> list[pages.Block]:
    return [block for block in BLOCKS if block.language in languages]


def _commands() -> list[tuple[str, list[str]]]:
    """Return every command of `xpl` that a page shows, without that word, and where it stands."""
    return [
        (str(block), words[words.index("xpl") + 1 :])
        for block in _of(*SHELL)
        for words in pages.shell(block.text)
        if words[0] == "xpl" or words[:2] == ["./dev", "xpl"]
    ]


COMMANDS = _commands()


def _is_harmless(words: list[str]) -> bool:
    """Tell whether a command only tells something, and soon."""
    reads = (["rules"], ["explain"], ["spec", "show"], ["spec", "check"], ["env", "list"])
    return "--help" in words or any(words[: len(start)] == start for start in reads)


HARMLESS = sorted(
    {tuple(words) for where, words in COMMANDS if _is_harmless(words) and not where.startswith("docs/extending.md")}
)
"""Those of one page need the package that it makes: test_extending.py runs them where it is installed."""


# -- blocks ------------------------------------------------------------------------------------------------------------


def test_no_block_escapes() -> None:
    assert [str(block) for block in BLOCKS if block.language not in LANGUAGES] == []
    assert [str(block) for block in _of("text") if re.search(r"^(\$ )?(xpl|\./dev) ", block.text, re.MULTILINE)] == []
    fences = sum(path.read_text(encoding="utf-8").count("```") for path in pages.written())
    assert len(BLOCKS) == fences / 2


@pytest.mark.parametrize(("where", "words"), COMMANDS, ids=lambda value: value if isinstance(value, str) else None)
def test_a_command_is_one(where: str, words: list[str]) -> None:
    if "--help" in words:
        assert pages.unknown(words) == []
        return
    given: dict[str, Any] = pages.parse(words).params
    if words[0] == "audit":
        registry.select(tuple(given["selected"]), tuple(given["ignored"]), tuple(Gate))
        assert set(given["gate"]) <= set(Gate)
        own = re.findall(
            r'^"report\.(\w+)" =', (ROOT / where.rpartition(":")[0]).read_text(encoding="utf-8"), re.MULTILINE
        )
        assert given["report_format"] in (*REPORTS, *own)  # a page may make a package that adds one


def test_wrong_commands_are_noticed() -> None:
    for line in ("adit", "audit --gat static", "spec sho", "explain", "eval Foo --seed one"):
        with pytest.raises(Exception, match=r"no command|No such option|[Mm]issing|valid integer"):
            pages.parse(line.split())
    assert pages.unknown(["audit", "--gat"]) == ["--gat"]
    assert pages.unknown(["spec", "sho"]) == ["sho"]


@pytest.mark.parametrize("words", HARMLESS, ids=" ".join)
def test_a_harmless_command_runs(words: tuple[str, ...]) -> None:
    done = xpl(*words, cwd=ROOT)
    assert (done.returncode, bool(done.stdout)) == (ExitCode.CLEAN, True), done.stderr


@pytest.mark.parametrize("block", _of(*SHELL), ids=str)
def test_a_shell_block_is_shell(block: pages.Block) -> None:
    found = pages.shell(block.text)
    assert found
    script = "\n".join(pages.entered(block.text))
    subprocess.run(["bash", "-n"], input=script, text=True, check=True)  # noqa: S607 - where it is, PATH knows
    helped = subprocess.run([ROOT / "dev", "help"], capture_output=True, text=True, check=True).stdout
    for words in found:
        if words[0] == "./dev":
            assert words[1] in re.findall(r"^  ([a-z]+) ", helped, re.MULTILINE)
        elif "/" in words[0]:
            assert os.access(ROOT / words[0], os.X_OK), f"{words[0]} is no program of the checkout"
        else:
            assert words[0] in {"xpl", *PROGRAMS}


PRESENT = [path for path in pages.written() if path.name != "CHANGELOG.md"]
"""Pages that tell what there is; the changelog also tells what went."""


@pytest.mark.parametrize("path", PRESENT, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_in_sentences_name_what_there_is(path: Path) -> None:
    for span in pages.spans(path):
        found = re.fullmatch(r"(?:\./dev )?xpl ([a-z].*)", span)
        if found:
            choices = [word.split("|") if re.fullmatch(r"[a-z|-]+", word) else [word] for word in found[1].split()]
            for words in itertools.product(*choices):
                assert pages.unknown(list(words)) == [], span


@pytest.mark.parametrize("block", _of("python"), ids=str)
def test_python_compiles_and_imports_what_there_is(block: pages.Block) -> None:
    tree = compile(block.text, str(block), "exec", ast.PyCF_ONLY_AST | ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "xpl":
            module = importlib.import_module(str(node.module))
            assert [name.name for name in node.names if not hasattr(module, name.name)] == []
    if block.mark == "runs":
        subprocess.run([sys.executable, "-c", block.text], cwd=ROOT, check=True)


@pytest.mark.parametrize("block", _of("yaml"), ids=str)
def test_yaml_is_a_part_of_a_manifest_or_known(block: pages.Block) -> None:
    part = yaml.load(block.text, yaml.BaseLoader)  # noqa: S506 - texts only; `on` stays a word
    if any(set(part) <= keys for keys in FOREIGN):
        return
    for key, value in unknown.known(yaml.safe_load(block.text)).items():
        owners = [name for name in (*MANIFESTS, "embodiment") if key in spec.schema(name)["properties"]]
        assert owners, f"{key} is no key of a manifest"
        assert [] in [validate(value, f"{name}#/properties/{key}") for name in owners]


@pytest.mark.parametrize("block", _of("json"), ids=str)
def test_json_is_a_document(block: pages.Block) -> None:
    document = json.loads(block.text)
    if "schema" in document:
        known = document["schema"] in answers.answers()
        standard = document["schema"].removeprefix("xpl.").partition("/")[0]
        assert (answers.problems(document) if known else validate(document, standard)) == []


# -- links -------------------------------------------------------------------------------------------------------------


def _linking() -> list[Path]:
    rooms = ("envs/*/README.md", "policy/*/README.md", "tests/*/README.md", "conformance/vectors/README.md")
    return [*pages.TOP, *pages.DOCS, *tracked(*rooms)]


@pytest.mark.parametrize("path", _linking(), ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(path: Path) -> None:
    for link in pages.links(path):
        if "://" in link:
            assert link.startswith("https://"), link
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        assert target.exists(), link
        assert target.is_relative_to(ROOT), link
        assert not anchor or anchor in pages.anchors(target), link


def test_anchors_and_commands_are_read_as_readers_do(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A `b` [c](d.md)!\n\n```bash\n# no heading\n```\n\n## A\n\n## A\n\n[x](y.md#z) `[no](link)`\n")
    assert pages.anchors(page) == {"a-b-c", "a", "a-1"}
    assert pages.links(page) == ["d.md", "y.md#z"]
    assert pages.shell("$ A=1 xpl a \\\n  b  # c\nout\n$ xpl 'd e' | f && g; h\n") == [
        ["xpl", "a", "b"], ["xpl", "d e"], ["f"], ["g"], ["h"],
    ]  # fmt: skip


PATHS = re.compile(r"[a-z_]+/[\w./-]*")
MADE_ELSEWHERE = re.compile(r"xpl_cli/_content/.*|policy/MyPolicy.*|.*\b(?:NAME|CODE)\b.*")
"""Paths in a wheel, and those that a reader makes."""
ROOMS = ("xpl/", "xpl_cli/", "spec/", "conformance/", "templates/", "docs/", "tests/", "benchmarks/")
"""Rooms of which a reader has none: a path of `policy/` or `envs/` may be the reader's own."""


@pytest.mark.parametrize("path", PRESENT, ids=lambda path: str(path.relative_to(ROOT)))
def test_modules_and_rooms_that_a_page_names_are_there(path: Path) -> None:
    named = [span for span in pages.spans(path) if PATHS.fullmatch(span) and span.startswith(ROOMS)]
    assert [span for span in named if not (ROOT / span).exists() and not MADE_ELSEWHERE.fullmatch(span)] == []


def test_pages_that_code_names_are_there() -> None:
    for path in tracked("xpl/**/*.py", "xpl_cli/**/*.py", "envs/**/*.py", "benchmarks/**/*.py"):
        for name in re.findall(r"\bdocs/[\w/-]+\.md\b", path.read_text(encoding="utf-8")):
            assert (ROOT / name).is_file(), f"{path.relative_to(ROOT)} names {name}"


# -- pages that are written from something else ------------------------------------------------------------------------


def test_a_page_that_follows_from_nothing_is_named(tmp_path: Path) -> None:
    ours = {path.relative_to(ROOT).as_posix() for path in tracked("docs/**/*.md")}
    assert ours.isdisjoint(compiler.left_over(ROOT))
    for folder in (compiler.REFERENCE, rules.FOLDER):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "gone.md").touch()
    assert compiler.left_over(tmp_path) == ["docs/reference/gone.md", "docs/rules/gone.md"]


def _headed(text: str) -> dict[str, list[str]]:
    """Return the commands that a help text lists, under their headings."""
    sections = re.findall(r"^(\w+):\n((?:  .*\n)+)", text, re.MULTILINE)
    return {head: re.findall(r"^  (\S+)", body, re.MULTILINE) for head, body in sections if head != "Options"}


def test_the_help_groups_commands_by_what_one_does() -> None:
    text = xpl("--help", cwd=ROOT).stdout
    headed = _headed(text)
    assert list(headed) == ["Scaffold", "Prove", "Run", "Data", "Report", "Agents", "Maintain"]
    for head, names in (("Scaffold", {"new-policy", "new-env"}), ("Prove", {"audit", "explain"}), ("Run", {"env"})):
        assert names <= set(headed[head])
    shown = {name for name, command in pages.command_line().commands.items() if not command.hidden}
    assert sorted(name for names in headed.values() for name in names) == sorted(shown)
    assert "--no-version" not in text
    assert "..." not in text.partition("Scaffold:")[2], "a command's first sentence does not fit into its line"


def test_the_page_of_commands_has_every_command_and_option() -> None:
    page = commands.page(get_command(app))
    parts = {part.partition("\n")[0]: part for part in page.split("\n### ")}
    listed = {heading: list(commands) for heading, commands in _headed(xpl("--help", cwd=ROOT).stdout).items()}
    told = {
        part.partition("\n")[0]: list(dict.fromkeys(re.findall(r"^### xpl (\S+)", part, re.MULTILINE)))
        for part in page.split("\n## ")[1:]
    }
    assert told == listed
    for words in (["audit"], ["checkpoint", "fetch"]):
        options = re.findall(r"^  (?:-\w, )?(--[a-z-]+)", xpl(*words, "--help", cwd=ROOT).stdout, re.MULTILINE)
        assert len(options) > 5
        assert [option for option in options if f"`{option}" not in parts[f"xpl {' '.join(words)}"]] == ["--help"]


def test_the_pages_of_rules_have_every_rule() -> None:
    written = rules.pages()
    index = written.pop("README.md")
    for rule in registry.rules():
        (entry,) = (page for page in written.values() if f"\n## {rule.code} {rule.slug}\n" in page)
        assert rule.requirement in entry
        (row,) = re.findall(rf"^\| \[{rule.code}\].*", index, re.MULTILINE)
        assert row.split(" | ")[1].strip() == rule.severity
