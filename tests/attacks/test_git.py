"""Branches and packages that want to be run by git, or to hide from it. Real repositories, and the real git."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.checkout import ROOT, tracked
from tests.support.peer import xpl
from xpl_cli.agents.review.change import change_since
from xpl_cli.audit.engine.changed import select_changed
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.basics.git.command import Git
from xpl_cli.basics.git.history import Repository, unrecorded
from xpl_cli.packages.targets import find_target

MODEL = "class Model:\n    pass\n"
STATIC = ("--gate", "static", "--no-cache")


def git(folder: Path, *arguments: str, asked: str = "") -> str:
    """Run git as somebody, always at the same time: git walks through history by dates, and tests by its ways."""
    who = ["-c", "user.name=Somebody", "-c", "user.email=somebody@example.org", "-c", "commit.gpgsign=false"]
    command = [str(shutil.which("git")), *who, *arguments]
    env = {**os.environ, **dict.fromkeys(("GIT_AUTHOR_DATE", "GIT_COMMITTER_DATE"), "2026-01-01T00:00:00Z")}
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, input=asked, env=env)
    return done.stdout.strip()


def package(folder: Path, model: str = MODEL) -> Path:
    folder.mkdir(parents=True)
    (folder / "policy.yml").write_text("spec: v1\n")
    (folder / "model.py").write_text(model)
    return folder


def initial(root: Path) -> None:
    """Make a folder a repository whose first commit, on main, holds what is there."""
    git(root, "init", "--quiet", "--initial-branch=main")
    git(root, "add", ".")
    git(root, "commit", "--quiet", "-m", "start")


def branched(folder: Path) -> Path:
    """Return a repository with Foo and Bar on main, and a branch of it."""
    root = folder / "repository"
    for name in ("Foo", "Bar"):
        package(root / "policy" / name)
    initial(root)
    git(root, "switch", "--quiet", "-c", "work")
    return root


def marking(folder: Path) -> Path:
    """Return a program that says, by a file beside it, that it was run."""
    program = folder / "marker.sh"
    program.write_text(f"#!/bin/sh\ntouch '{folder}/ran'\ncat\n")
    program.chmod(0o755)
    return program


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository of that kind; the user stands at its top."""
    root = branched(tmp_path)
    monkeypatch.chdir(root)
    return root


@pytest.fixture
def marker(tmp_path: Path) -> Path:
    """A program of that kind."""
    return marking(tmp_path)


def ran(marker: Path) -> bool:
    return (marker.parent / "ran").exists()


def embed(folder: Path, marker: Path) -> None:
    """Make a folder a bare repository whose work tree it is, and which runs a program when git looks at it."""
    inner = folder.parent / "inner"
    git(folder.parent, "init", "--quiet", "--bare", "--initial-branch=main", str(inner))
    for name in ("HEAD", "objects", "refs"):
        shutil.move(inner / name, folder / name)
    shutil.rmtree(inner)
    (folder / "objects/keep").touch()  # git records no empty folders
    (folder / "refs/keep").touch()
    (folder / "config").write_text(
        f'[core]\n\trepositoryformatversion = 0\n\tbare = false\n\tworktree = .\n\tfsmonitor = "{marker}"\n'
    )


def changed(root: Path, ref: str = "main") -> list[str]:
    """Return the names of the packages that changed."""
    targets = [find_target(folder) for folder in sorted((root / "policy").iterdir())]
    return [target.path.name for target in select_changed(ref, targets)]


# -- repositories inside ----------------------------------------------------------------------------------------------


def test_the_attack_is_one(repository: Path, marker: Path) -> None:
    """Git itself, started in such a package, runs the program: else the tests below would prove nothing."""
    embed(repository / "policy/Foo", marker)
    git(repository / "policy/Foo", "-c", "safe.bareRepository=all", "status")
    assert ran(marker)


@pytest.fixture(scope="module")
def embedded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A repository whose branch brings such a package, and the program that it would run."""
    folder = tmp_path_factory.mktemp("embedded")
    root, marker = branched(folder), marking(folder)
    embed(root / "policy/Foo", marker)
    git(root, "add", ".")
    git(root, "commit", "--quiet", "-m", "evil")
    (root / "policy/Foo/model.py").write_text("import os\n")
    return root, marker


@pytest.mark.parametrize("place", [".", "policy", "policy/Foo", "policy/Foo/objects"])
@pytest.mark.parametrize("command", [("audit", "{foo}", "--changed-since", "main"), ("review", "--base", "main")])
def test_an_embedded_repository_runs_nothing_and_hides_nothing(
    embedded: tuple[Path, Path], place: str, command: tuple[str, ...]
) -> None:
    """Wherever the user stands: one sentence that names it, exit code 2."""
    root, marker = embedded
    done = xpl(*(word.format(foo=root / "policy/Foo") for word in command), *STATIC, cwd=root / place)
    assert not ran(marker)
    assert (done.returncode, done.stdout) == (ExitCode.USAGE, "")
    assert "policy/Foo lies in a repository of its own" in done.stderr


def test_auditing_all_runs_nothing_either(repository: Path, marker: Path) -> None:
    """The neighbours of such a package are compared, and it is told."""
    embed(repository / "policy/Foo", marker)
    done = xpl("audit", "--all", "--changed-since", "main", *STATIC, cwd=repository)
    assert not ran(marker)
    assert done.returncode == ExitCode.USAGE
    assert "policy/Foo lies in a repository of its own" in done.stderr
    assert xpl("audit", "--all", *STATIC, cwd=repository).returncode == ExitCode.FINDINGS
    assert not ran(marker)


def test_a_folder_above_that_looks_like_a_repository_is_none(repository: Path, marker: Path) -> None:
    embed(repository / "policy", marker)
    with pytest.raises(UserError, match="lies in a repository of its own"):
        select_changed("main", [find_target(repository / "policy/Foo")])
    assert unrecorded(repository / "policy/Foo") == []
    assert not ran(marker)


def test_a_folder_deep_in_a_package_that_looks_like_a_repository_is_files(repository: Path, marker: Path) -> None:
    """Whoever vendors one has changed the package, and no more."""
    (repository / "policy/Foo/vendor").mkdir()
    embed(repository / "policy/Foo/vendor", marker)
    assert changed(repository) == []  # nothing that the audit reads
    assert [touched.path for touched in change_since("main", Repository.of(repository)).packages] == ["policy/Foo"]
    assert not ran(marker)


@pytest.mark.parametrize("pointer", [False, True])
def test_a_package_with_a_repository_of_its_own_is_no_part_of_this_one(
    repository: Path, marker: Path, tmp_path: Path, pointer: bool
) -> None:
    """By a folder `.git` or a file that leads to one; from inside it is the user's, and still nothing runs."""
    evil = package(repository / "policy/Evil")
    initial(evil)
    git(evil, "config", "core.fsmonitor", str(marker))
    if pointer:
        shutil.move(evil / ".git", tmp_path / "elsewhere")
        (evil / ".git").write_text(f"gitdir: {tmp_path / 'elsewhere'}\n")
    with pytest.raises(UserError, match="policy/Evil lies in a repository of its own"):
        changed(repository)
    with pytest.raises(UserError, match="policy/Evil lies in a repository of its own"):
        change_since("main", Repository.of(repository))
    os.chdir(evil)
    assert select_changed("main", [find_target(evil)]) == []
    assert change_since("main", Repository.of(evil)).packages == ()
    assert not ran(marker)


def test_a_package_that_becomes_a_submodule_is_told(repository: Path, tmp_path: Path) -> None:
    """Its files are in no commit of the branch, so that nobody would look at them."""
    other = package(tmp_path / "other")
    initial(other)
    git(repository, "-c", "protocol.file.allow=always", "submodule", "--quiet", "add", str(other), "policy/Sub")
    git(repository, "commit", "--quiet", "-m", "submodule")
    with pytest.raises(UserError, match="policy/Sub lies in a repository of its own"):
        change_since("main", Repository.of(repository))


# -- what git could run ------------------------------------------------------------------------------------------------


def test_no_attribute_of_a_branch_runs_a_filter(repository: Path, marker: Path) -> None:
    """Neither clean nor smudge nor process, textconv nor a driver, although the user has them all."""
    for name in ("clean", "smudge", "process"):
        git(repository, "config", f"filter.evil.{name}", str(marker))
    for name in ("textconv", "command"):
        git(repository, "config", f"diff.evil.{name}", str(marker))
    (repository / ".gitattributes").write_text("* filter=evil diff=evil merge=evil text\n")
    (repository / "policy/Foo/model.py").write_text("VALUE = 2\n")
    assert changed(repository) == ["Foo"]
    found = change_since("main", Repository.of(repository))
    assert [touched.path for touched in found.packages] == ["policy/Foo"]
    assert unrecorded(repository / "policy/Foo") == ["policy/Foo/model.py"]
    assert not ran(marker)


def test_what_the_repositorys_own_settings_run_stays_unrun(repository: Path, marker: Path) -> None:
    """Also where they include a file that a branch brings, and where an object would have to be fetched."""
    (repository / "evil.cfg").write_text(
        "[core]\n"
        + "".join(f'\t{name} = "{marker}"\n' for name in ("fsmonitor", "pager", "sshCommand", "editor", "gitProxy"))
        + f'\thooksPath = {marker.parent}\n\talternateRefsCommand = "{marker}"\n'
        + "".join(
            f'[alias]\n\t{name} = "!{marker}"\n[pager]\n\t{name} = "{marker}"\n' for name in ("ls-files", "ls-tree")
        )
        + f'[diff]\n\texternal = "{marker}"\n[protocol]\n\tallow = always\n[protocol "file"]\n\tallow = always\n'
        + f'[remote "origin"]\n\turl = {marker.parent}/none\n\tpromisor = true\n\tuploadpack = "{marker}"\n'
        + "[extensions]\n\tpartialClone = origin\n"
    )
    git(repository, "config", "include.path", "../evil.cfg")
    for hook in ("post-index-change", "reference-transaction", "fsmonitor-watchman"):
        shutil.copy(marker, marker.parent / hook)
    blob = git(repository, "-c", "core.fsmonitor=false", "rev-parse", "main:policy/Foo/model.py")
    (marker.parent / "ran").unlink(missing_ok=True)
    (repository / ".git/objects" / blob[:2] / blob[2:]).unlink()
    (repository / "policy/Foo/model.py").write_text("VALUE = 2\n")
    tree = Repository.of(repository)
    assert changed(repository) == ["Foo"]
    assert tree.text(tree.base("main"), "policy/Foo/model.py") is None
    assert [touched.path for touched in change_since("main", tree).packages] == ["policy/Foo"]
    assert not ran(marker)


def test_what_the_caller_set_for_its_own_git_does_not_lead_elsewhere(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A hook of git sets GIT_DIR and its like."""
    (repository / "policy/Foo/model.py").write_text("VALUE = 2\n")
    monkeypatch.setenv("GIT_DIR", str(tmp_path / "nowhere"))
    monkeypatch.setenv("GIT_WORK_TREE", str(tmp_path))
    monkeypatch.setenv("GIT_INDEX_FILE", str(tmp_path / "index"))
    assert changed(repository) == ["Foo"]


def test_nothing_in_a_repository_moves_the_place_where_a_branch_began(repository: Path) -> None:
    """Grafts give a commit other parents, and replacements another content: what came before would be nobody's."""
    start = git(repository, "rev-parse", "main")
    (repository / "policy/Foo/model.py").write_text("VALUE = 2\n")
    git(repository, "commit", "--quiet", "-am", "evil")
    git(repository, "commit", "--quiet", "--allow-empty", "-m", "harmless")
    top = git(repository, "rev-parse", "HEAD")
    (repository / ".git/info").mkdir(exist_ok=True)
    (repository / ".git/info/grafts").write_text(f"{start} {top}\n")
    git(repository, "replace", f"{start}^{{tree}}", f"{top}^{{tree}}")
    assert git(repository, "merge-base", "main", "HEAD") == top, "the attack is one"
    assert changed(repository) == ["Foo"]
    assert [touched.path for touched in change_since("main", Repository.of(repository)).packages] == ["policy/Foo"]


@pytest.mark.parametrize("place", ["vendor/lib", "policy/Bar", "envs/bar"])
def test_a_package_that_is_run_has_changed_with_any_of_its_files(repository: Path, place: str) -> None:
    """The static gate reads its boundary only, but the model imports what it likes."""
    hidden = repository / "policy/Foo" / place / "model.py"
    hidden.parent.mkdir(parents=True)
    hidden.write_text("VALUE = 2\n")
    target = find_target(repository / "policy/Foo")
    assert select_changed("main", [target], is_run=True) == [target]
    assert select_changed("main", [target]) == []


def test_git_is_asked_for_nothing_that_writes_or_compares(repository: Path) -> None:
    """Whoever wants `git diff` has to argue with this test."""
    asked = Git(repository / ".git", repository)
    for command in ("diff", "status", "checkout", "fetch", "diff-files"):
        with pytest.raises(ValueError, match="not among the commands that only read"):
            asked.text(command)


def test_a_pattern_that_takes_for_ever_is_given_up(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (repository / ".gitignore").write_text("**/" * 2000 + "x\n")
    (repository / "a" / "b" / "c" / "d").mkdir(parents=True)
    (repository / "a" / "b" / "c" / "d" / "file").touch()
    monkeypatch.setattr("xpl_cli.basics.git.command._LONGEST_S", 0.5)
    with pytest.raises(UserError, match=r"did not end within .*\.gitignore") as caught:
        Repository.of(repository).changed("HEAD")
    assert caught.value.code == ExitCode.USAGE


def test_a_few_trees_that_stand_for_any_number_of_files_are_refused(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tree = git(repository, "rev-parse", "HEAD^{tree}")
    for _ in range(28):
        entries = "".join(f"040000 tree {tree}\t{name}\n" for name in "abc")
        tree = git(repository, "mktree", asked=entries)
    bomb = git(repository, "commit-tree", "-m", "many", tree)
    monkeypatch.setattr("xpl_cli.basics.git.command._MOST_BYTES", 1 << 20)
    with pytest.raises(UserError, match="ls-tree answers more than 1 MB") as caught:
        Repository.of(repository).changed(bomb)
    assert caught.value.code == ExitCode.USAGE


def test_content_that_a_repository_lacks_is_named(repository: Path, tmp_path: Path) -> None:
    blob = git(repository, "rev-parse", "main:policy/Foo/model.py")
    (repository / ".git" / "objects" / blob[:2] / blob[2:]).unlink()
    found = Repository.of(repository)
    with pytest.raises(UserError, match=r"lacks the content of 'policy/Foo/model\.py'") as caught:
        found.export("main", "policy/Foo", tmp_path / "base", largest=1 << 20)
    assert caught.value.code == ExitCode.USAGE
    with pytest.raises(UserError, match=f"lacks the content of object {blob}"):
        list(found._contents([blob]))


@pytest.mark.slow
def test_no_other_module_calls_git() -> None:
    """One place has the settings; `xpl doctor` asks for the version, in `programs.program`."""
    known = {"xpl_cli/basics/git/command.py", "xpl_cli/lifecycle/doctor/programs.py"}
    calling = set()
    rooms = ("xpl", "xpl_cli", "conformance", "templates", "policy", "envs")
    for file in tracked(*(f"{room}/**/*.py" for room in rooms)):
        if "bad" in file.parts or "good" in file.parts:
            continue
        nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        heads = [
            node.elts[0] if isinstance(node, (ast.List, ast.Tuple)) else node.args[0]
            for node in nodes
            if (isinstance(node, (ast.List, ast.Tuple)) and node.elts) or (isinstance(node, ast.Call) and node.args)
        ]
        if any(isinstance(head, ast.Constant) and str(head.value).split()[:1] == ["git"] for head in heads):
            calling.add(file.relative_to(ROOT).as_posix())
    assert calling == known


# -- what is the same --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", ["sha1", "sha256"])
def test_content_decides_whatever_git_noted_of_the_file(tmp_path: Path, algorithm: str) -> None:
    """Times, ignored files, line ends of DOS and promises count for nothing; programs and links do."""
    root = tmp_path / "repository"
    foo = package(root / "policy/Foo")
    (foo / "link").symlink_to("model.py")
    git(root, "init", "--quiet", "--initial-branch=main", f"--object-format={algorithm}")
    (root / ".gitignore").write_text("*.log\n")
    git(root, "add", ".")
    git(root, "commit", "--quiet", "-m", "start")
    tree = Repository.of(root)
    base = tree.base("main")

    os.utime(foo / "model.py", (0, 0))
    (foo / "policy.yml").write_bytes(b"spec: v1\r\n")
    (foo / "own.log").touch()
    assert tree.changed(base) == set()

    git(root, "update-index", "--assume-unchanged", "policy/Foo/model.py")
    (foo / "model.py").write_text("class Modem:\n    pass\n")  # as long as it was
    (foo / "policy.yml").write_bytes(b"spec: v1\n")
    (foo / "policy.yml").chmod(0o755)
    (foo / "link").unlink()
    (foo / "link").symlink_to("policy.yml")
    (foo / "new\n.py").touch()
    found = {path.name for path in tree.changed(base, [foo])}
    assert found == {"model.py", "policy.yml", "link", "new\n.py"}
    git(root, "config", "core.fileMode", "false")
    assert foo / "policy.yml" not in tree.changed(base)
    shutil.rmtree(foo)
    assert {path.name for path in tree.changed(base)} == {"model.py", "policy.yml", "link"}


def test_what_a_sparse_checkout_or_large_file_storage_keeps_elsewhere_is_the_same(repository: Path) -> None:
    """A pointer stands for its content, and a file that is not checked out for what was recorded."""
    weights = repository / "policy/Foo/weights.bin"
    digest = "2c26b46b68ffc68ff99b453c1d30413413422d706483bfa0f98a5e886266e7ae"  # of `foo`
    weights.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{digest}\nsize 3\n")
    git(repository, "add", ".")
    git(repository, "commit", "--quiet", "-m", "weights")
    tree = Repository.of(repository)
    weights.write_text("foo")
    assert tree.changed("HEAD") == set()
    weights.write_text("fox")
    assert tree.changed("HEAD") == {weights}
    weights.write_text("foo")
    git(repository, "update-index", "--skip-worktree", "policy/Bar/model.py")
    (repository / "policy/Bar/model.py").unlink()
    assert tree.changed("HEAD") == set()


def test_a_repository_without_a_commit_has_recorded_nothing(tmp_path: Path) -> None:
    """Every file of the package is told, ignored ones left out."""
    foo = package(tmp_path / "policy/Foo")
    git(tmp_path, "init", "--quiet")
    assert unrecorded(foo) == ["policy/Foo/model.py", "policy/Foo/policy.yml"]
    assert unrecorded(tmp_path.parent) == []
