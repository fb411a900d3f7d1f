"""The authors' code of an environment: git repositories at a commit, from the network or from a folder of mirrors.

Git checks every object against its digest, so the commit determines the code. A patch of the package may follow; then
the code goes on the interpreter's path, is installed as a package, or replaces files of an installed package.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from xpl.manifest import CodeSource
    from xpl_cli.lifecycle.python_env.plan import EnvironmentPlan

MIRROR: Final = "XPL_MIRROR"
"""Variable with a folder of mirrors, OWNER/NAME or OWNER/NAME.git in it; git repositories come from there alone."""
ON_PATH: Final = "xpl-sources.pth"
"""File in site-packages with the folders of repositories that are on an interpreter's path, one a line."""
PATH, PACKAGE, OVERLAY = "path", "package", "overlay"
_FOLDER: Final = "src"
_PLAIN: Final = re.compile(r"[A-Za-z0-9][\w.-]*", re.ASCII)
_SAFE: Final = ("-c", "protocol.ext.allow=never", "-c", "core.hooksPath=/dev/null", "-c", "advice.detachedHead=false")


def add(plan: EnvironmentPlan, folder: Path, install: Callable[[Path], None]) -> list[dict[str, str]]:
    """Add the authors' code to an environment and return what was added: repository, commit and how.

    Args:
        plan: of the environment.
        folder: the environment.
        install: installs a folder as a package, without dependencies.

    Raises:
        NotFoundError: a repository has no mirror, or a subfolder or patch is not there.
        UserError: a repository cannot be had at its commit, or a patch does not apply.
    """
    on_path: list[str] = []
    applied: set[tuple[Path, str]] = set()
    for source in plan.sources:
        checkout = folder / _FOLDER / _name(source.git)
        if not checkout.exists():  # two sources of one repository are two parts of it
            _check_out(source, checkout)
        if source.patch and (checkout, source.patch) not in applied:
            _apply(plan.base / source.patch, checkout)
            applied.add((checkout, source.patch))
        root = _below(checkout, source.subfolder, f"{source.git} at {source.commit[:12]}")
        if source.install == PACKAGE:
            install(root)
        elif source.install == OVERLAY:
            _overlay(root, _site_packages(folder) / str(source.onto))
        else:
            on_path.append(str(root))
    if on_path:
        (_site_packages(folder) / ON_PATH).write_text("".join(f"{line}\n" for line in on_path), encoding="utf-8")
    return [{"git": one.git, "commit": one.commit, "install": one.install} for one in plan.sources]


def _name(address: str) -> str:
    """Return the name of a repository.

    Raises:
        UserError: it is none that can be a folder's.
    """
    name = address.rstrip("/").rpartition("/")[2].removesuffix(".git")
    if not _PLAIN.fullmatch(name):
        raise UserError(f"environment.sources: expected the address of a git repository, got {address!r}")
    return name


def _check_out(source: CodeSource, target: Path) -> None:
    """Check out a repository at its commit, without its history.

    Raises:
        UserError: it cannot be had.
    """
    address = _address(source.git)
    target.mkdir(parents=True)
    _git(target, "init", "--quiet")
    # A host gives a single commit if it is asked for it; a mirror may only give branches and tags.
    if _git(target, "fetch", "--quiet", "--depth", "1", address, source.commit, fails=True):
        everything = ("+refs/*:refs/remotes/mirror/*",)
        _git(target, "fetch", "--quiet", address, *everything)
    _git(target, "checkout", "--quiet", "--detach", source.commit)
    shutil.rmtree(target / ".git")


def _address(git: str) -> str:
    """Return where a repository comes from: its address, or its mirror if there is a folder of mirrors.

    Raises:
        NotFoundError: the folder has no mirror of it.
    """
    folder = os.environ.get(MIRROR)
    if not folder:
        return git
    owner, name = git.removesuffix(".git").rstrip("/").split("/")[-2:]
    candidates = [Path(folder) / owner / name, Path(folder) / owner / f"{name}.git"]
    found = next((path for path in candidates if path.is_dir()), None)
    if found is None:
        raise NotFoundError(
            f"{folder} has no mirror of {git}: expected {owner}/{name} in it",
            hint=f"`git clone --mirror {git}` there, or unset {MIRROR}",
        )
    return str(found.resolve())


def _apply(patch: Path, checkout: Path) -> None:
    if not patch.is_file():
        raise NotFoundError(f"environment.sources: there is no patch {patch}")
    _git(checkout, "apply", "--whitespace=nowarn", str(patch.resolve()))


def _below(checkout: Path, subfolder: str | None, where: str) -> Path:
    root = (checkout / (subfolder or "")).resolve()
    if not root.is_relative_to(checkout.resolve()) or not root.is_dir():
        raise NotFoundError(f"environment.sources: {where} has no folder {subfolder}")
    return root


def _overlay(source: Path, target: Path) -> None:
    """Replace files of an installed package; a file may share its content with other environments by a hard link."""
    if not target.is_dir():
        raise NotFoundError(f"environment.sources: {target.name} is not installed, so that no file of it is replaced")
    for path in _files(source):
        copy = target / path.relative_to(source)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.unlink(missing_ok=True)
        shutil.copyfile(path, copy)


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_symlink())


def _site_packages(folder: Path) -> Path:
    names = {"base": str(folder), "platbase": str(folder)}
    exact = Path(sysconfig.get_path("purelib", "posix_prefix", names))
    return next((path for path in sorted(folder.glob("lib/python3*/site-packages"))), exact)


def _git(folder: Path, *arguments: str, fails: bool = False) -> bool:
    """Run git in a folder and tell whether it failed.

    Raises:
        UserError: it failed, and that is not allowed.
    """
    program = shutil.which("git")
    if program is None:
        raise UserError("environment.sources needs git, which is not on PATH", code=ExitCode.NOT_RUN)
    command: Sequence[str] = (program, *_SAFE, *arguments)
    variables = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    done = subprocess.run(
        command,
        cwd=folder,
        env={**variables, "GIT_TERMINAL_PROMPT": "0", "GIT_LFS_SKIP_SMUDGE": "1"},
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    if done.returncode and not fails:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise UserError(f"environment.sources: git {arguments[0]}: {last}", code=ExitCode.NOT_RUN)
    return done.returncode != 0
