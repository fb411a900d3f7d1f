"""`./dev`, the script of the checkout. A stand-in for uv keeps the network out; bash and the script are real."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.checkout import ROOT
from tests.support.peer import DEADLINE_S

UV = """#!/bin/bash
# Stands for uv: notes its arguments; `uv venv ... FOLDER` makes the folder's interpreter.
printf '%s\\n' "$*" >>"{log}"
if [[ $1 == venv ]]; then mkdir -p "${{@: -1}}/bin" && ln -sf "{python}" "${{@: -1}}/bin/python"; exit; fi
[[ -e "{log}.fails" ]] && {{ echo "no such package"; exit 3; }}
exit 0
"""

XPL = """#!/bin/bash
printf '<%s>' "$PWD" "$$" "$@"
exit 7
"""


class Checkout:
    """A copy of what `./dev` reads, and a PATH on which uv is the stand-in.

    Attributes:
        folder: the copy.
        calls: file with one line for each call of uv.
    """

    def __init__(self, parent: Path) -> None:
        self.folder = parent / "a check out"
        self.folder.mkdir()
        for name in ("dev", "pyproject.toml", "requirements-dev.txt"):
            shutil.copy2(ROOT / name, self.folder / name)
        self.calls = parent / "uv.log"
        self.tools = parent / "tools"
        self.tools.mkdir()
        for tool in ("bash", "basename", "cat", "dirname", "head", "ln", "mkdir", "mv", "rm"):
            (self.tools / tool).symlink_to(shutil.which(tool) or tool)
        self.script(self.tools / "uv", UV.format(log=self.calls, python=sys.executable))
        (self.tools / "python3").symlink_to(sys.executable)

    @staticmethod
    def script(path: Path, text: str) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        path.chmod(0o755)

    def start(self, *arguments: str, **env: str) -> subprocess.Popen[str]:
        """Start `./dev` from another folder, in an environment of its own."""
        return subprocess.Popen(
            [self.folder / "dev", *arguments],
            cwd=self.folder.parent,
            env={"PATH": str(self.tools), "HOME": os.environ.get("HOME", "/"), **env},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def dev(self, *arguments: str, **env: str) -> tuple[int, str, str]:
        """Run `./dev` from another folder; return the exit code, stdout and stderr."""
        process = self.start(*arguments, **env)
        out, err = process.communicate(timeout=DEADLINE_S)
        return process.returncode, out, err


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path)


@pytest.fixture(scope="module")
def ready(tmp_path_factory: pytest.TempPathFactory) -> Checkout:
    """Return a copy that is set up; tests put programs into it."""
    checkout = Checkout(tmp_path_factory.mktemp("ready"))
    assert checkout.dev("setup")[0] == 0
    return checkout


def test_the_set_up_runs_once_and_again_after_a_change(checkout: Checkout) -> None:
    assert checkout.dev("setup")[0] == 0
    once = checkout.calls.read_text(encoding="utf-8")
    assert [line.split()[0] for line in once.splitlines()] == ["venv", "pip", "pip"]
    assert checkout.dev("setup") == (0, "", "")
    assert checkout.calls.read_text(encoding="utf-8") == once
    with (checkout.folder / "requirements-dev.txt").open("a", encoding="utf-8") as lock:
        lock.write("one-more==1.0\n")
    assert checkout.dev("setup")[0] == 0
    assert checkout.calls.read_text(encoding="utf-8") == once * 2


def test_a_moved_checkout_is_set_up_anew(checkout: Checkout) -> None:
    """An environment cannot be moved, so the old one goes."""
    checkout.dev("setup")
    (checkout.folder / ".venv/old").touch()
    checkout.folder = checkout.folder.rename(checkout.folder.with_name("moved"))
    assert checkout.dev("setup")[0] == 0
    assert not (checkout.folder / ".venv/old").exists()


def test_a_failed_set_up_shows_why_and_is_tried_again(checkout: Checkout) -> None:
    fails = Path(f"{checkout.calls}.fails")
    fails.touch()
    code, out, err = checkout.dev("xpl", "--help")
    assert (code, out) == (3, "")
    assert "no such package" in err
    fails.unlink()
    assert checkout.dev("setup")[0] == 0


def test_a_machine_without_a_new_python_gets_one_clear_error(checkout: Checkout) -> None:
    (checkout.tools / "python3").unlink()
    checkout.script(checkout.tools / "python3.11", "#!/bin/bash\nexit 127\n")  # a shim of a version that is not there
    code, out, err = checkout.dev("setup")
    assert (code, out) == (1, "")
    assert "Python 3.11 or newer" in err
    assert "PYTHON=" in err
    assert not (checkout.folder / ".venv").exists()


def test_a_named_interpreter_is_not_replaced_by_another(checkout: Checkout) -> None:
    code, _, err = checkout.dev("setup", PYTHON="/no/such/python")
    assert (code, "tried /no/such/python." in err) == (1, True)


def test_a_command_keeps_folder_arguments_exit_code_and_process(ready: Checkout) -> None:
    """`./dev xpl` becomes the tool: same process, so that signals reach it, and nothing is lost on the way."""
    ready.script(ready.folder / ".venv/bin/xpl", XPL)
    process = ready.start("xpl", "audit", "policy/My Policy", "*")
    out, _ = process.communicate(timeout=DEADLINE_S)
    assert out == f"<{ready.folder.parent}><{process.pid}><audit><policy/My Policy><*>"
    assert process.returncode == 7
    assert ready.dev("demo", "--json")[1].endswith("<demo><--json>")


def test_the_tests_get_their_markers_and_arguments(ready: Checkout) -> None:
    ready.script(ready.folder / ".venv/bin/pytest", XPL)
    code, out, _ = ready.dev("test", "slow", "-k", "a or b")
    assert code == 7
    assert out.startswith(f"<{ready.folder}>")
    assert out.endswith("<-m><><--timeout><1800><-k><a or b>")
    assert "<-m>" not in ready.dev("test", "-x")[1]


def test_lint_runs_all_tools_and_remembers_a_failure(ready: Checkout) -> None:
    ready.script(ready.folder / ".venv/bin/ruff", "#!/bin/bash\necho ruff $1\n[[ $1 != check ]]\n")
    ready.script(ready.folder / ".venv/bin/lint-imports", "#!/bin/bash\necho layers\n")
    ready.script(ready.folder / ".venv/bin/mypy", "#!/bin/bash\necho mypy $1; cat $1/*.py\n")
    ready.script(ready.folder / "conformance/static/no-hang/rule.py", "rule\n")
    code, out, _ = ready.dev("lint")
    assert (code, out) == (1, "ruff check\nruff format\nlayers\nmypy\nmypy .mypy_cache/rules\nrule\n")


def test_the_site_is_built_strictly_or_shown(ready: Checkout) -> None:
    ready.script(ready.folder / ".venv/bin/properdocs", XPL)
    for arguments, action in ((("docs",), "build"), (("docs", "serve", "--open"), "serve")):
        code, out, _ = ready.dev(*arguments)
        assert code == 7
        assert out.startswith(f"<{ready.folder}>")
        assert f"<{action}><--strict><--config-file><mkdocs.yml>" in out
    assert out.endswith("<--open>")


def test_benchmarks_run_by_name_or_all(ready: Checkout) -> None:
    for name, code in {"fast": 0, "slow": 4}.items():
        ready.script(ready.folder / f"benchmarks/{name}.py", f"raise SystemExit({code})")
    code, out, _ = ready.dev("bench")
    assert (code, out) == (4, "== benchmarks/fast.py\n== benchmarks/slow.py\n")
    assert ready.dev("bench", "fast")[0] == 0
    assert ready.dev("bench", "none")[0] == 3


def test_an_unknown_command_is_a_usage_error(checkout: Checkout) -> None:
    code, out, err = checkout.dev("tset")
    assert (code, out) == (2, "")
    assert "unknown command: tset" in err
    assert checkout.dev("help")[:2] == (0, checkout.dev()[1])
    assert not checkout.calls.exists()
