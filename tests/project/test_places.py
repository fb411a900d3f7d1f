"""What is tested is what belongs to the checkout: files that using it leaves there change nothing."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import places
from tests.support.places import tracked

LEFT = {
    "benchmarks/.peers/some/docs/runtimes.md": "# [Broken](nowhere.md)\n\n`xpl no-such-command`\n",
    "benchmarks/.peers/some/module.py": "# as docs/runtimes.md says\n",
    "conformance/static/XPL299-planted/rule.txt": "no rule yet\n",
    "docs/note.md": "# Note\n\n[broken](nowhere.md), and `pip install xpl-cli`\n\n```bash\nxpl no-such-command\n```\n",
    "envs/planted/env.yml": "name: 3\n",
    "envs/planted/README.md": "[broken](nowhere.md) `xpl no-such-command`\n",
    "policy/Planted/policy.yml": "xpl: [\n",
    "policy/Planted/deploy.yml": "xpl: [\n",
    "policy/Planted/model.py": "from xpl_cli.basics import no_such_name\nCAMERA = 'cam_head'\n",
    "xpl/spec_planted.py": "from xpl_cli import main\nCAMERA = 'cam_head'\n",
    "xpl_cli/basics/planted.py": "import xpl_cli.main\nROBOT = ['git', 'franka_single']\n",
    "xpl_cli/planted/note.py": "NAME = 'xpl.planted/1'\n",
}
"""Files of all kinds that tests look at, each wrong in their eyes."""

LOOKING = (
    "tests/docs/test_pages.py",
    "tests/docs/test_installing.py",
    "tests/docs/test_told_commands.py",
    "tests/project/test_layers.py",
    "tests/project/test_rooms.py",
    "tests/scaffold/test_new_policy.py::test_our_own_policies_have_no_placeholder_left",
    "tests/sdk/test_limits.py",
    "tests/standard/test_answers.py::test_no_schema_name_stands_in_code_and_not_in_the_list",
    "tests/standard/test_spec.py",
    "tests/standard/test_versions.py::test_everything_that_follows_from_the_standard_is_up_to_date",
)
"""Tests that look at the files of the checkout."""


def _git(folder: Path, *arguments: str) -> None:
    subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True)  # noqa: S607 - the user's


def _plant(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


def test_what_nobody_added_does_not_belong_to_the_checkout(tmp_path: Path) -> None:
    """Nor does a file that was deleted, or a folder's name that looks like one; patterns are those of `Path.glob`."""
    files = ("docs/a.md", "docs/deep/b.md", "docs/deep/er/c.md", "docs/gone.md", "docs/d.txt")
    _plant(tmp_path, dict.fromkeys(files, ""))
    _git(tmp_path, "init", "--quiet")
    _git(tmp_path, "add", ".")
    _plant(tmp_path, dict.fromkeys(("docs/left.md", "docs/deep/left.md"), ""))
    (tmp_path / "docs/gone.md").unlink()

    def found(*patterns: str) -> list[str]:
        return [path.relative_to(tmp_path).as_posix() for path in tracked(*patterns, root=tmp_path)]

    assert found("docs/**/*.md") == ["docs/a.md", "docs/deep/b.md", "docs/deep/er/c.md"]
    assert found("docs/*.md", "docs/*") == ["docs/a.md", "docs/d.txt"]
    assert found("docs/*/*.md") == ["docs/deep/b.md"]
    copied = places.copy(tmp_path / "copy", "docs/deep/**", root=tmp_path)
    assert sorted(path.name for path in copied.rglob("*.*")) == ["b.md", "c.md"]

    shutil.rmtree(tmp_path / ".git")
    assert found("docs/**/*.md") == [
        "docs/a.md", "docs/deep/b.md", "docs/deep/er/c.md", "docs/deep/left.md", "docs/left.md",
    ]  # fmt: skip


def _looks(path: Path) -> list[str]:
    """Return where a test lists a folder of the checkout itself."""
    listing = {"glob", "rglob", "iterdir", "walk", "copytree"}
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in listing:
            where = [one for part in (node.func.value, *node.args[:1]) for one in ast.walk(part)]
            named = {one.id for one in where if isinstance(one, ast.Name)}
            named |= {f".{one.attr}" for one in where if isinstance(one, ast.Attribute)}
            if named & {"ROOT", ".ROOT", ".room"}:
                found.append(f"{path.name}:{node.lineno}")
    return found


def test_no_test_lists_a_folder_of_the_checkout_itself(tmp_path: Path) -> None:
    """All ask `tests.support.places`, which knows what belongs to it."""
    tests = [path for path in tracked("tests/**/*.py") if path != Path(places.__file__)]
    assert len(tests) > 100
    assert [look for path in tests for look in _looks(path)] == []
    planted = tmp_path / "planted.py"
    planted.write_text(
        "(ROOT / 'docs').rglob('*.md')\nshutil.copytree(ROOT / 'xpl', there)\nROOT.glob('x')\nthere.glob('ROOT')\n"
    )
    assert _looks(planted) == ["planted.py:1", "planted.py:2", "planted.py:3"]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_files_that_lie_around_disturb_no_test(tmp_path: Path) -> None:
    """Pages, modules, packages and notes of a checkout in use: those that look at its files see none of them."""
    clone = places.copy(tmp_path / "a clone", "*", "*/**", ".*/**")
    _git(clone, "init", "--quiet")
    _git(clone, "add", "--all")
    _plant(clone, LEFT)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *LOOKING]
    done = subprocess.run(command, cwd=clone, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
