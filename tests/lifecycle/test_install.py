"""`xpl install`: a policy's own environment from its lock, swapped in one step; the tool's own is left alone."""

from __future__ import annotations

import functools
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import pytest

from tests.support import forked
from tests.support.checkout import ROOT
from tests.support.outside.wheels import numpy_wheel, pinned, wheel
from tests.support.peer import DEADLINE_S
from xpl import Client
from xpl.manifest import PythonEnvironment
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.lifecycle import interpreter
from xpl_cli.lifecycle.python_env import environments, installers, pythons
from xpl_cli.lifecycle.python_env.plan import EnvironmentPlan, plan_of
from xpl_cli.packages import package
from xpl_cli.serving.launch import running_server

INSTALLERS = [
    pytest.param("uv", marks=pytest.mark.skipif(not shutil.which("uv"), reason="uv is not on PATH")),
    "pip",
]
MODEL = """
import sys
from only_here import ANSWER

class Model:
    def __init__(self, config): pass
    def infer(self, observation): return [ANSWER, sys.prefix]
"""
CONDA = """#!/bin/sh
'''exec' "{python}" "$0" "$@"
' '''
import pathlib, subprocess, sys
# Stands in for conda: makes a plain environment where it is told to, and notes what it was told.
with open({notes!r}, "a") as notes:
    print(*sys.argv[1:], file=notes)
if "--version" in sys.argv:
    sys.exit(print("conda 25.1"))
folder = pathlib.Path(sys.argv[sys.argv.index("--prefix") + 1])
subprocess.run([{python!r}, "-m", "venv", "--without-pip", folder], check=True)
site = next(folder.glob("lib/python*/site-packages"))
lock = pathlib.Path(sys.argv[sys.argv.index("--file") + 1]).read_text()
if "broken" in lock:
    sys.exit("conda: the lock is broken")
if "numpy" in lock:
    (site / "alone.pth").write_text({alone!r})
(site / "only_here.py").write_text("ANSWER = 7")
"""


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of wheels: a numpy, and a package that is nowhere else."""
    folder = tmp_path_factory.mktemp("wheels")
    numpy_wheel(folder)
    wheel(folder, "only_here", "1.0", {"only_here.py": "ANSWER = 1\n"})
    wheel(folder, "only_here", "2.0", {"only_here.py": "ANSWER = 2\n"})
    return folder


@pytest.fixture
def surroundings(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Let installers find nothing but these wheels."""
    for name in ("PIP", "UV"):
        monkeypatch.setenv(f"{name}_NO_INDEX", "1")
        monkeypatch.setenv(f"{name}_FIND_LINKS", str(shelf))
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("UV_OFFLINE", "1")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    return monkeypatch


@pytest.fixture(params=INSTALLERS)
def installer(request: pytest.FixtureRequest, surroundings: pytest.MonkeyPatch) -> str:
    """Return what installs: uv, or pip where there is no uv."""
    if request.param == "pip":
        surroundings.setenv("PATH", without("uv"))
    return str(request.param)


def subject(folder: Path, text: str | None = None, **environment: Any) -> Path:
    """Write an adapter that declares an environment, with what its lock holds, and return its folder."""
    place_ = folder / "Subject"
    place_.mkdir(exist_ok=True)
    (place_ / "model.py").write_text(MODEL, encoding="utf-8")
    (place_ / "deploy.yml").write_text(json.dumps({"env_cfg_type": "arx_x5"}), encoding="utf-8")
    if text is not None:
        environment = {"lock": "requirements.lock.txt", **environment}
        (place_ / str(environment["lock"])).write_text(text, encoding="utf-8")
    manifest = {"spec": "v1", "environment": environment}
    (place_ / "policy.yml").write_text(json.dumps(manifest), encoding="utf-8")
    return place_


def planned(folder: Path, **environment: Any) -> EnvironmentPlan:
    """Return the plan of an adapter, which has one."""
    adapter = package.load(subject(folder, **environment))
    plan = plan_of(adapter.path, adapter.manifest.environment)
    assert plan is not None
    return plan


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked.run("install", "Subject", *arguments, cwd=cwd)


def listing(folder: Path) -> set[tuple[str, int]]:
    """Return the names below a folder, with their times."""
    found = (path for path in folder.rglob("*") if "__pycache__" not in path.parts)
    return {(path.relative_to(folder).as_posix(), path.lstat().st_mtime_ns) for path in found if not path.is_dir()}


def without(program: str) -> str:
    """Return a PATH on which a program is not."""
    folders = os.environ["PATH"].split(os.pathsep)
    return os.pathsep.join(folder for folder in folders if not (Path(folder) / program).exists())


# -- uv and pip --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_lock_becomes_an_environment_that_serves(
    installer: str, surroundings: pytest.MonkeyPatch, shelf: Path, tmp_path: Path
) -> None:
    """Exactly what the lock names, whatever variables say; a second time there is nothing to do."""
    trap = tmp_path / "trap"
    wheel(trap, "trap", "1.0", {})
    # What leads an installer elsewhere: into the tool's environment, or past the lock.
    for name, value in {
        "VIRTUAL_ENV": sys.prefix, "PIP_TARGET": str(trap / "target"), "PIP_PREFIX": sys.prefix, "PIP_USER": "1",
        "UV_PROJECT_ENVIRONMENT": sys.prefix, "UV_PYTHON": sys.executable, "UV_SYSTEM_PYTHON": "1",
        "PIP_CONSTRAINT": str(trap / "missing.txt"),
        "PIP_NO_COMPILE": "0", "UV_COMPILE_BYTECODE": "0", "PYTHONDONTWRITEBYTECODE": "1",
    }.items():  # fmt: skip
        surroundings.setenv(name, value)
    own = Path(sysconfig.get_paths()["purelib"])
    before = listing(own)
    lock = pinned(shelf / "numpy-99.0-py3-none-any.whl", shelf / "only_here-1.0-py3-none-any.whl")
    folder = subject(tmp_path, lock, manager="uv")

    done = run("--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["state"] == "made"
    assert answer["environment"]["installer"].startswith(installer)
    installed = set(answer["environment"]["installed"].items()) - {("trap", "1.0")}
    assert installed >= {("numpy", "99.0"), ("only_here", "1.0")}
    assert {name for name, _ in installed} <= {"numpy", "only_here", "pip", "setuptools"}
    assert (folder / ".venv").resolve() / "bin" / "python" == Path(answer["python"])
    assert list((folder / ".venv").resolve().glob("lib/python*/site-packages/__pycache__/only_here.*.pyc"))

    again = run(cwd=tmp_path)
    assert (again.returncode, again.stdout.strip()) == (0, answer["python"])
    assert listing(own) == before
    assert not (trap / "target").exists()

    surroundings.undo()
    surroundings.setenv("PYTHONPATH", str(ROOT))
    with running_server(folder) as server, Client(server.url) as client:
        assert client.infer({}) == [1, str((folder / ".venv").resolve())]


@pytest.mark.parametrize(
    ("with_numpy", "answer", "said"),
    [(True, "'stolen'", "is unchanged"), (False, "1", "add numpy to the lock")],
    ids=["a wheel of another digest", "no numpy, which the worker needs"],
)
@pytest.mark.slow
@pytest.mark.usefixtures("installer")
def test_what_is_not_the_lock_or_cannot_serve_is_not_put_in_use(
    with_numpy: bool, answer: str, said: str, shelf: Path, tmp_path: Path
) -> None:
    """Nothing of it stays."""
    wheels = [shelf / "numpy-99.0-py3-none-any.whl"] if with_numpy else []
    wheels.append(wheel(tmp_path / "other", "only_here", "1.0", {"only_here.py": f"ANSWER = {answer}\n"}))
    folder = subject(tmp_path, pinned(*wheels), manager="uv")
    done = run(cwd=tmp_path)
    assert (done.returncode, done.stdout) == (ExitCode.NOT_RUN, "")
    assert said in done.stderr
    assert list(folder.glob(".venv*")) == []


@pytest.mark.slow
def test_a_lock_is_taken_as_it_is(
    installer: str, surroundings: pytest.MonkeyPatch, shelf: Path, tmp_path: Path
) -> None:
    """What a package asks for beyond the lock is named in a warning, and not installed; without a lock it is."""
    wheel(shelf, "asks", "1.0", {"asks.py": ""}, ["only_here"])
    subject(tmp_path, "numpy==99.0\nasks==1.0\n", manager="uv")
    done = run("--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "only_here" not in json.loads(done.stdout)["environment"]["installed"]
    assert "do not fit together" in done.stderr
    subject(tmp_path, manager="uv", requirements=["numpy", "asks"])
    done = run("--json", cwd=tmp_path)
    answer = json.loads(done.stdout)
    assert answer["state"] == "replaced"
    assert answer["environment"]["installed"]["only_here"] == "2.0"


@pytest.mark.skipif(not shutil.which("uv"), reason="uv is not on PATH")
def test_a_lock_of_uv(surroundings: pytest.MonkeyPatch, shelf: Path, tmp_path: Path) -> None:
    """uv.lock and pyproject.toml beside the adapter; the adapter itself is not installed."""
    folder = subject(tmp_path, "", manager="uv", lock="uv.lock")
    minor = f"{sys.version_info.major}.{sys.version_info.minor}"
    (folder / "pyproject.toml").write_text(
        f"[project]\nname = 'subject'\nversion = '1'\nrequires-python = '=={minor}.*'\n"
        "dependencies = ['numpy', 'only_here<2']\n"
    )
    (folder / "uv.lock").unlink()
    subprocess.run([shutil.which("uv") or "uv", "lock", "--quiet"], cwd=folder, check=True)
    done = run("--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["environment"]["installed"] == {"numpy": "99.0", "only_here": "1.0"}


def test_a_lock_of_uv_needs_uv(surroundings: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = subject(tmp_path, "version = 1\n", manager="venv", lock="uv.lock")
    (folder / "pyproject.toml").write_text("[project]\nname = 'subject'\nversion = '1'\n")
    surroundings.setenv("PATH", without("uv"))
    done = run(cwd=tmp_path)
    assert (done.returncode, "uv is not on PATH" in done.stderr) == (ExitCode.NOT_RUN, True)


# -- how it is put in use: the same for every installer, tried with one that is fast ----------------------------------


@pytest.fixture
def conda(shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a program in the place of conda on PATH; return the file with what it was told."""
    programs, notes = tmp_path / "programs", tmp_path / "told"
    programs.mkdir()
    text = CONDA.format(python=sys.executable, notes=str(notes), alone=f"{shelf / 'numpy-alone'}\n")
    (programs / "conda").write_text(text)
    (programs / "conda").chmod(0o755)
    monkeypatch.setenv("PATH", str(programs), prepend=os.pathsep)
    return notes


def test_conda_gets_its_lock(conda: Path, tmp_path: Path) -> None:
    """A description is solved, an explicit list is taken as it is; the environment lies in the package's folder."""
    plan = _conda_plan(tmp_path, "dependencies: [numpy]\n")
    folder = plan.base
    environments.install(plan)
    assert conda.read_text().startswith(f"env create --quiet --prefix {folder}/.conda-")
    assert interpreter.resolve(folder, package.load(folder).manifest.environment).startswith(f"{folder}/.conda-")
    conda.unlink()
    subject(tmp_path, "@EXPLICIT\nnumpy\n", manager="conda", lock="conda.txt")
    environments.install(planned(tmp_path, manager="conda", lock="conda.txt"))
    assert conda.read_text().startswith(f"create --yes --quiet --prefix {folder}/.conda-")


def test_a_change_is_noticed_and_replaces(conda: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """`--check` and serving say so; then the link moves, and the old environment goes."""
    declare = functools.partial(_conda_plan, tmp_path)
    assert environments.condition(declare("numpy")) == "missing"
    first = environments.install(declare("numpy"))
    assert (first.state, environments.condition(declare("numpy"))) == ("made", "current")
    assert environments.install(declare("numpy")).state == "unchanged"

    changed = declare("numpy 2")
    assert environments.condition(changed) == "outdated"
    interpreter.resolve(changed.base, package.load(changed.base).manifest.environment)
    interpreter.resolve(changed.base, package.load(changed.base).manifest.environment)
    assert capfd.readouterr().err.count("is not the declared one") == 1
    second = environments.install(changed)
    assert (second.state, second.folder != first.folder, first.folder.exists()) == ("replaced", True, False)
    assert environments.install(changed, force=True).folder != second.folder
    assert min(path.name for path in changed.base.glob(".conda*")) == ".conda"
    assert len(list(changed.base.glob(".conda*"))) == 2


def test_a_failure_leaves_the_old_one_in_use(conda: Path, tmp_path: Path) -> None:
    first = environments.install(_conda_plan(tmp_path, "numpy"))
    for lock, message in {"broken": "cannot be created", "nothing": "numpy"}.items():
        with pytest.raises(UserError, match=message) as caught:
            environments.install(_conda_plan(tmp_path, lock))
        assert caught.value.code == ExitCode.NOT_RUN
    assert environments.install(_conda_plan(tmp_path, "numpy")).folder == first.folder
    assert len(list((tmp_path / "Subject").glob(".conda*"))) == 2


@pytest.mark.slow
def test_whoever_runs_in_the_old_one_goes_on(conda: Path, tmp_path: Path) -> None:
    """An environment stays as long as a process runs from it, and goes with the next installation."""
    first = environments.install(_conda_plan(tmp_path, "numpy"))
    code = "print('up', flush=True); input(); import only_here; print(only_here.ANSWER)"
    process = subprocess.Popen([first.python, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    environments.install(_conda_plan(tmp_path, "numpy 2"))
    assert first.folder.exists()
    assert process.communicate("\n", timeout=DEADLINE_S)[0] == "7\n"
    environments.install(_conda_plan(tmp_path, "numpy 3"))
    assert not first.folder.exists()


@pytest.mark.slow
def test_a_killed_installation_is_cleared_by_the_next(conda: Path, tmp_path: Path) -> None:
    """SIGKILL after the environment is made and before it is in use: the old one is still in use."""
    first = environments.install(_conda_plan(tmp_path, "numpy"))
    _conda_plan(tmp_path, "numpy 2")
    stops = (
        "import os, signal, sys\n"
        "from xpl_cli.lifecycle.python_env import place\n"
        "place._use = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        "from xpl_cli import main; sys.argv[0] = 'xpl'; main.run()\n"
    )
    command = [sys.executable, "-c", stops, "install", "Subject"]
    killed = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, check=False
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    folder = tmp_path / "Subject"
    assert (folder / ".conda").resolve() == first.folder
    assert len(list(folder.glob(".conda*"))) == 3
    second = environments.install(_conda_plan(tmp_path, "numpy 3"))
    assert (folder / ".conda").resolve() == second.folder
    assert len(list(folder.glob(".conda*"))) == 2


def test_the_command_tells_the_condition(conda: Path, tmp_path: Path) -> None:
    """`--check` installs nothing and ends with 1 unless all is as declared."""
    _conda_plan(tmp_path, "numpy")
    missing = run("--check", cwd=tmp_path)
    assert (missing.returncode, missing.stdout) == (ExitCode.FINDINGS, "Subject: missing\n")
    subject(tmp_path, manager="none")
    given = run("--check", "--json", cwd=tmp_path)
    assert (given.returncode, json.loads(given.stdout)["state"]) == (0, "given")
    done = run(cwd=tmp_path)
    assert done.stdout.strip() == sys.executable
    assert "nothing to install" in done.stderr


def _conda_plan(folder: Path, lock: str) -> EnvironmentPlan:
    subject(folder, lock, manager="conda", lock="environment.yml")
    return planned(folder, manager="conda", lock="environment.yml")


# -- what is declared --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({"manager": "uv", "lock": "../lock.txt"}, "must lie in the package"),
        ({"manager": "uv", "lock": "/lock.txt"}, "must lie in the package"),
        ({"manager": "uv", "lock": "deep/uv.lock"}, "beside"),
        ({"manager": "uv", "lock": "environment.yml"}, r"pip's format"),
        ({"manager": "conda", "lock": "uv.lock"}, r"environment\.yml"),
        ({"manager": "none", "lock": "lock.txt"}, "needs the manager"),
        ({"manager": "path", "python": "/x", "lock": "lock.txt"}, "needs the manager"),
        ({"manager": "uv", "requirements": ["--index-url=x"]}, "is an option"),
        ({"manager": "uv", "name": sys.prefix}, "xpl itself"),
        ({"manager": "uv", "name": str(Path(sys.prefix) / "inside")}, "xpl itself"),
        ({"manager": "uv", "name": str(Path(sys.prefix).parent)}, "xpl itself"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, environment: dict[str, Any], message: str) -> None:
    """Above all, an environment never takes the place of the tool's own."""
    with pytest.raises(UserError, match=message):
        plan_of(tmp_path, PythonEnvironment.parse(environment))


def test_what_others_made_is_not_touched(tmp_path: Path) -> None:
    """A folder under the environment's name that has no record of ours."""
    folder = subject(tmp_path, manager="venv")
    (folder / ".venv").mkdir()
    (folder / ".venv" / "mine").touch()
    done = run(cwd=tmp_path)
    assert (done.returncode, "did not create it" in done.stderr) == (ExitCode.USAGE, True)
    assert [path.name for path in (folder / ".venv").iterdir()] == ["mine"]


def test_a_missing_lock_is_an_error(tmp_path: Path) -> None:
    """It is named; nothing is installed from memory."""
    plan = planned(tmp_path, manager="uv", lock="missing.txt")
    with pytest.raises(NotFoundError, match=r"missing\.txt"):
        environments.install(plan)


def test_interpreters_are_found_by_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """3.11 is every 3.11; a range takes what lies in it; what PATH has not is an error with what it has."""
    (tmp_path / "python3").symlink_to(os.path.realpath(sys.executable))
    (tmp_path / "python3.10").write_text("#!/bin/sh\nexit 127\n")  # the shim of a version that nobody installed
    (tmp_path / "python3.10").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    own = ".".join(map(str, sys.version_info[:3]))
    assert pythons.find(None) == sys.executable
    for wanted in (own, own.rpartition(".")[0], f">={own},<4", "3"):
        assert pythons.find(wanted) == sys.executable
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    assert pythons.find(own) == str(tmp_path / "python3")
    for wanted in ("3.10", "3.99"):
        with pytest.raises(UserError, match=rf"there is no Python {re.escape(wanted)} .*PATH has {own}") as caught:
            pythons.find(wanted)
        assert caught.value.code == ExitCode.NOT_RUN
    with pytest.raises(UserError, match="expected a version"):
        pythons.find("three")


def test_interpreters_of_pyenv_are_found_without_its_shims(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A version that there is not goes to uv as it is, because uv can bring it."""
    own = ".".join(map(str, sys.version_info[:3]))
    there = tmp_path / "versions" / own / "bin" / "python3"
    there.parent.mkdir(parents=True)
    there.symlink_to(os.path.realpath(sys.executable))
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    assert pythons.find(own) == pythons.for_uv(own) == str(there)
    assert pythons.for_uv("3.99") == "3.99"


def test_files_that_replace_others_have_current_bytecode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise each process that may not write compiles them again."""
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "python").symlink_to(sys.executable)
    module = tmp_path / "src" / "library.py"
    module.parent.mkdir()
    module.write_text("ANSWER = 1\n")
    os.utime(module, (0, 0))
    installers.compile_bytecode(tmp_path)
    module.write_text("ANSWER = 22\n")
    (tmp_path / "src" / "template.py").write_text("{{ name }} = \n")
    installers.compile_bytecode(tmp_path)
    compiled = Path(importlib.util.cache_from_source(str(module))).read_bytes()
    assert int.from_bytes(compiled[12:16], "little") == module.stat().st_size


def test_an_interpreter_may_be_named_as_in_a_shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What has no slash is looked for on PATH, from an option and from policy.yml."""
    (tmp_path / "bin").mkdir()
    named = tmp_path / "bin" / "python-of-mine"
    named.symlink_to(sys.executable)
    declared = PythonEnvironment(manager="path", python=named.name)
    for said in ({"python": named.name}, {}):
        with pytest.raises(UserError, match=f"there is no interpreter at {named.name}"):
            interpreter.resolve(tmp_path, declared, **said)
    monkeypatch.setenv("PATH", str(named.parent))
    for said in ({"python": named.name}, {}):
        assert interpreter.resolve(tmp_path, declared, **said) == str(named)


def test_the_command_line_comes_before_the_manifest(tmp_path: Path) -> None:
    """`--python`, then `--env`, then policy.yml; an argument of a launch script that says nothing is none."""
    folder = subject(tmp_path, manager="path", python=sys.executable)
    declared = PythonEnvironment(manager="path", python="/nowhere/python")
    assert interpreter.resolve(folder, declared, python=sys.executable, env="uv:nowhere") == sys.executable
    assert interpreter.resolve(folder, declared, env="none") == sys.executable
    for env in (None, "", "-", "null"):
        with pytest.raises(UserError, match="/nowhere/python"):
            interpreter.resolve(folder, declared, env=env)
    with pytest.raises(UserError, match="uv-env") as caught:
        interpreter.resolve(folder, declared, env="uv:uv-env")
    assert caught.value.hint == f"`xpl install {folder}`"


def test_variables_that_lead_elsewhere_do_not_reach_installers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where packages come from is the user's choice, where they go is not."""
    for name in ("PIP_INDEX_URL", "UV_INDEX_URL", "PIP_TARGET", "UV_PROJECT_ENVIRONMENT", "PYTHONPATH", "VIRTUAL_ENV"):
        monkeypatch.setenv(name, "x")
    kept = installers.environment()
    assert {name for name, value in kept.items() if value == "x"} == {"PIP_INDEX_URL", "UV_INDEX_URL"}
