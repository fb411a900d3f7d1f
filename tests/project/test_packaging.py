"""The distributions: what is in them, and that what is in them works where no checkout is."""

from __future__ import annotations

import csv
import functools
import io
import json
import operator
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path, PurePosixPath

import pytest
from packaging.requirements import Requirement

import xpl
from tests.support.checkout import ROOT
from tests.support.outside.wheels import numpy_wheel
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.lifecycle import sdk_wheel

ROOMS = {
    ".agents/skills": "skills",
    "conformance": "conformance",
    "envs": "envs",
    "policy": "policy",
    "spec": "spec",
    "templates": "templates",
}
"""Content rooms of the checkout, and their names under `xpl_cli/_content`."""

CONTENT = {
    ".agents/skills/planted/notes.md": "hidden parent",
    "conformance/planted/bad/model.py": "def broken(:\n",
    "conformance/planted/bad/.env": "a dot-file",
    "conformance/planted/bad/data/points.npy": "a folder that is ignored elsewhere",
    "conformance/planted/good/build/setup.sh": "#!/bin/sh",
    "envs/benchmark/env.yml": "name: benchmark\nenvironment: {manager: venv, requirements: [numpy==99.0]}\n",
    "templates/planted/.gitignore.jinja": "a dot-file template",
    "templates/planted/checkpoints/.gitkeep": "an empty file's usual name",
    "templates/planted/{{ name }}/deploy.yml.jinja": "a path with braces and a space",
}
"""Files that packaging tools like to lose."""

SCRIPT = "conformance/planted/good/build/setup.sh"
"""The one among them that is executable."""

JUNK = {
    "conformance/planted/__pycache__/rule.cpython-311.pyc": "bytecode",
    "envs/planted/client.pyc": "bytecode",
    "policy/planted/checkpoints/weights.safetensors": "downloaded",
    "policy/planted/data/episode.hdf5": "recorded",
    "policy/planted/logs/run.txt": "written by a run",
    "site/index.html": "the built documentation",
}
"""Files that using a checkout leaves behind, most of them in the content rooms."""


def _run(*command: str | Path, cwd: Path, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command that has to succeed; a failure shows all it printed."""
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command} ended with {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the checkout as a commit would hold it, with planted content and junk, in an awkward path."""
    if not (ROOT / ".git").exists():
        pytest.skip("what belongs to the checkout is git's knowledge, and this is no clone")
    copy = tmp_path_factory.mktemp("a folder with spaces") / "xpl"
    listed = _run("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", cwd=ROOT).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
    for name, text in {**CONTENT, **JUNK}.items():
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_text(text, encoding="utf-8")
    (copy / SCRIPT).chmod(0o755)
    return copy


def _hatch(target: str, source: Path, out: Path) -> Path:
    """Build one distribution of `source` in `out` with the backend that pip would call, offline."""
    env = {**os.environ, "SOURCE_DATE_EPOCH": "1700000000"}
    _run(sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", out, cwd=source, env=env)
    return next(out.iterdir())


@pytest.fixture(scope="module")
def wheel(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the wheel of the copy."""
    return _hatch("wheel", source, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def sdist(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the source distribution of the copy."""
    return _hatch("sdist", source, tmp_path_factory.mktemp("sdist"))


class Installation:
    """A fresh environment with one distribution in it; the dependencies are those of the running one.

    Attributes:
        scripts: folder of the commands.
        folder: an empty folder to run them in.
    """

    def __init__(self, folder: Path, distribution: Path) -> None:
        environment = folder / "env"
        venv.create(environment, symlinks=True)
        self.scripts = environment / "bin"
        self.folder = folder / "empty"
        self.folder.mkdir()
        python = self.scripts / "python"
        # A path file adds the folder without reading the path files inside it, so an editable checkout stays out.
        site = Path(
            _run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).stdout[:-1]
        )
        (site / "dependencies.pth").write_text(sysconfig.get_path("purelib"), encoding="utf-8")
        self.env = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        self.env["PATH"] = f"{self.scripts}{os.pathsep}{self.env['PATH']}"
        pip: list[str | Path] = [sys.executable, "-m", "pip", "--python", python, "install", "--no-index", "--no-deps"]
        # Modules are compiled as they are imported, which few of them are.
        _run(*pip, "--no-compile", distribution, cwd=folder, env=self.env)

    def run(self, *command: str | Path) -> subprocess.CompletedProcess[str]:
        """Run a command of the environment in the empty folder; it has to succeed."""
        return _run(self.scripts / command[0], *command[1:], cwd=self.folder, env=self.env)

    def answer(self, *command: str, **variables: object) -> str:
        """Return what a command of the environment prints, whatever its exit code."""
        env = {**self.env, **{name: str(value) for name, value in variables.items()}}
        words = [self.scripts / command[0], *command[1:]]
        done = subprocess.run(words, cwd=self.folder, env=env, capture_output=True, text=True, check=False)
        assert done.stdout, done.stderr
        return done.stdout.strip()


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installation:
    """Return an environment with the wheel installed."""
    return Installation(tmp_path_factory.mktemp("installed wheel"), wheel)


def _files(folder: Path) -> set[str]:
    """Return the names of all files below a folder but bytecode."""
    found = (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(folder).as_posix() for path in found}


def _names(wheel: Path) -> set[str]:
    return set(zipfile.ZipFile(wheel).namelist())


def _stays(file: Path) -> bool:
    """Tell whether a file stays in the checkout: what tries skills out, and policies that are trained."""
    return (file.is_relative_to(".agents/skills") and "evals" in file.parts) or (
        file.is_relative_to("policy") and (ROOT / "policy" / file.parts[1] / "train.py").is_file()
    )


def test_the_wheel_installs_no_generic_import_name(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        dist_info = f"xpl_cli-{xpl.__version__}.dist-info"
        record = list(csv.reader(io.StringIO(archive.read(f"{dist_info}/RECORD").decode())))
    assert {PurePosixPath(name).parts[0] for name, *_ in record} == {"xpl", "xpl_cli", dist_info}
    assert {name for name, *_ in record} == _names(wheel)


def test_the_wheel_holds_all_content_and_no_junk(source: Path, wheel: Path) -> None:
    expected = {
        str(PurePosixPath("xpl_cli/_content", shipped, file.relative_to(source / room)))
        for room, shipped in ROOMS.items()
        for file in (source / room).rglob("*")
        if file.is_file() and str(file.relative_to(source)) not in JUNK and not _stays(file.relative_to(source))
    }
    assert {name for name in _names(wheel) if name.startswith("xpl_cli/_content/")} == expected
    assert expected.issuperset(f"xpl_cli/_content/{name.replace('.agents/skills', 'skills')}" for name in CONTENT), (
        "the planted files were not found"
    )


def test_the_wheel_holds_both_packages_whole(source: Path, wheel: Path) -> None:
    expected = {
        str(file.relative_to(source)) for package in ("xpl", "xpl_cli") for file in (source / package).rglob("*.*")
    }
    assert expected <= _names(wheel)
    assert {"xpl/py.typed", "xpl_cli/py.typed"} <= expected


@pytest.mark.slow
def test_the_source_distribution_holds_the_pages_and_no_junk(source: Path, sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {str(PurePosixPath(*PurePosixPath(name).parts[1:])) for name in archive.getnames()}
    assert names.isdisjoint(JUNK)
    assert {"mkdocs.yml", *(str(page.relative_to(source)) for page in (source / "docs").rglob("*.*"))} <= names


@pytest.mark.slow
def test_the_source_distribution_builds_the_same_wheel(sdist: Path, wheel: Path, tmp_path: Path) -> None:
    """Nothing is lost on the way through an sdist, and the build is reproducible: the bytes are equal."""
    with tarfile.open(sdist) as archive:
        # As an argument, `filter` came with 3.11.4; set like this, older versions ignore it.
        archive.extraction_filter = tarfile.data_filter if hasattr(tarfile, "data_filter") else None
        archive.extractall(tmp_path)  # noqa: S202 - made by this test
    (unpacked,) = tmp_path.iterdir()
    assert _hatch("wheel", unpacked, tmp_path / "out").read_bytes() == wheel.read_bytes()


def test_the_installed_wheel_runs(installed: Installation) -> None:
    assert "audit" in installed.run("xpl", "--help").stdout
    code = (
        "import xpl; from xpl_cli.basics.content import content_folder; "
        "print(xpl.__file__, content_folder('spec'), content_folder('conformance'), sep='\\n')"
    )
    found = [Path(line) for line in installed.run("python", "-c", code).stdout.splitlines()]
    assert all(path.is_relative_to(installed.scripts.parent) and path.exists() for path in found)
    assert os.access(found[-1].parent / SCRIPT, os.X_OK)


def test_the_installed_tool_has_its_skills(installed: Installation) -> None:
    text = installed.run("xpl", "skills", "get", "xpl-audit-policy", "--full").stdout
    assert "references/reading.md" in text
    installed.run("xpl", "skills", "install", "xpl-audit-policy")
    assert (installed.folder / ".claude/skills/xpl-audit-policy/references/reading.md").is_file()


def _tour() -> list[list[str]]:
    """Return the commands of the README that end, as words."""
    told = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = [block.partition("```")[0] for block in told.split("```bash\n")[1:]]
    found = [shlex.split(line, comments=True) for block in blocks for line in block.splitlines()]
    assert {words[0] for words in found} == {"xpl"}
    return [words for words in found if words[1] != "serve"]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_every_command_of_the_readme_runs_in_an_empty_folder(wheel: Path, tmp_path: Path) -> None:
    installation = Installation(tmp_path, wheel)
    before = _files(installation.scripts.parent)
    for words in _tour():
        installation.run(*words)
    installation.run("xpl", "audit", "policy/Foo", "--select", "advice")
    assert {path.name for path in installation.folder.iterdir()} <= {"policy", "MUJOCO_LOG.TXT"}
    assert _files(installation.scripts.parent) == before


def test_the_benchmarks_of_the_page_are_found_by_name(installed: Installation) -> None:
    """In any folder: those that are installed, and the adapters that play them."""
    page = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    names = {name for name in re.findall(r"xpl install (\S+)", page) if name.islower()}
    assert names >= {"metaworld", "maniskill", "robotwin"}
    code = "import sys; from xpl_cli.packages.environments import find; print(*map(find, sys.argv[1:]), sep='\\n')"
    folders = installed.run("python", "-c", code, *sorted(names)).stdout.splitlines()
    assert [(Path(folder) / "env.yml").is_file() for folder in folders] == [True] * len(names)
    assert installed.answer("xpl", "install", "metaworld", "--check") == "metaworld: missing"
    (name, *_) = re.findall(r"xpl eval ([a-z]\S+)", page)
    assert installed.answer("xpl", "install", name, "--check") == f"{name}: given"


@pytest.mark.slow
def test_what_came_with_the_tool_is_installed_into_the_users_cache(
    installed: Installation, tmp_path_factory: pytest.TempPathFactory
) -> None:
    shelf, cache = tmp_path_factory.mktemp("wheels"), tmp_path_factory.mktemp("cache")
    numpy_wheel(shelf)
    before = _files(installed.scripts.parent)
    own = {"XPL_CACHE": cache, "PIP_NO_INDEX": 1, "PIP_FIND_LINKS": shelf, "UV_NO_INDEX": 1, "UV_FIND_LINKS": shelf}
    told = json.loads(installed.answer("xpl", "install", "benchmark", "--json", **own))
    assert told.get("state") == "made", told
    (folder,) = (cache / "environments").iterdir()
    assert folder.name.startswith("benchmark-")
    assert Path(told["python"]).is_relative_to(folder)
    assert installed.answer("xpl", "install", "benchmark", **own) == told["python"]
    assert installed.answer("xpl", "install", "benchmark", "--check", **own) == "benchmark: current"
    assert _files(installed.scripts.parent) == before


def test_a_path_that_is_not_there_names_what_came_with_the_tool(installed: Installation) -> None:
    told = json.loads(installed.answer("xpl", "install", "envs/metaworld", "--json"))
    assert "metaworld alone" in told["hint"]


@pytest.mark.slow
def test_the_installed_tool_builds_the_same_sdk(installed: Installation, tmp_path: Path) -> None:
    report = json.loads(installed.run("xpl", "sdk", "build", "--out", "sdk", "--json").stdout)
    assert Path(report["path"]).read_bytes() == sdk_wheel.build(tmp_path).path.read_bytes()
    assert Path(report["path"]).parent == installed.folder / "sdk"


def test_the_sdk_wheel_holds_the_sdk_and_its_licence_only(tmp_path: Path) -> None:
    archive = zipfile.ZipFile(sdk_wheel.build(tmp_path).path)
    dist_info = f"xpl_sdk-{xpl.__version__}.dist-info"
    assert {PurePosixPath(name).parts[0] for name in archive.namelist()} == {"xpl", dist_info}
    assert archive.read(f"{dist_info}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()
    fields = [line.partition(": ")[::2] for line in archive.read(f"{dist_info}/METADATA").decode().splitlines()]
    assert ("Requires-Python", ">=3.9") in fields
    requirements = [Requirement(value) for name, value in fields if name == "Requires-Dist"]
    assert [str(needed) for needed in requirements if not needed.marker] == ["numpy"]
    assert {value for name, value in fields if name == "Provides-Extra"} == {"client", "data", "images"}


def test_the_sdk_wheel_takes_its_time_stamps_from_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    archive = zipfile.ZipFile(sdk_wheel.build(tmp_path).path)
    assert {entry.date_time for entry in archive.infolist()} == {(2001, 9, 9, 1, 46, 40)}


def test_an_sdk_wheel_is_replaced_only_when_asked(tmp_path: Path) -> None:
    first = sdk_wheel.build(tmp_path)
    assert (first.state, sdk_wheel.build(tmp_path).state) == ("written", "unchanged")
    first.path.write_bytes(b"mine")
    with pytest.raises(UserError, match="other contents") as refused:
        sdk_wheel.build(tmp_path)
    assert refused.value.code == ExitCode.USAGE
    assert first.path.read_bytes() == b"mine"
    assert sdk_wheel.build(tmp_path, overwrite=True) == sdk_wheel.SdkWheel(first.path, first.sha256, "replaced")
    assert list(tmp_path.iterdir()) == [first.path]


def test_an_output_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "dist").write_text("a file", encoding="utf-8")
    with pytest.raises(UserError, match=r"cannot be written to .*dist"):
        sdk_wheel.build(tmp_path / "dist")


@pytest.mark.parametrize(
    ("lock", "further"),
    [
        ("requirements-dev.txt", [("dependency-groups", "dev"), ("dependency-groups", "docs")]),
        ("tests/evaluation/cluster/ray.lock.txt", [("project", "optional-dependencies", "ray")]),
    ],
)
def test_a_lock_fits_the_declared_dependencies(lock: str, further: list[tuple[str, ...]]) -> None:
    document = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    texts = [*document["project"]["dependencies"]]
    for path in further:
        texts += functools.reduce(operator.getitem, path, document)
    declared = [Requirement(text) for text in texts]
    lines = (ROOT / lock).read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if not line.startswith("#")]
    locked = {pin.name: pin for pin in pins if pin.marker is None or pin.marker.evaluate()}
    for needed in declared:
        (pin,) = locked[needed.name.lower()].specifier
        assert pin.operator == "=="
        assert needed.specifier.contains(pin.version), f"{needed} is locked to {pin.version}"
    assert not any(pin.url for pin in pins)
    assert not any("://" in line for line in lines)
