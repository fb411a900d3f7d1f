"""XPL162: Versions of installed libraries are pinned."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, Location, NotApplicable, rule
from xpl_cli.audit.static import vendored
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.audit.static.scripts.flow import executed_words, word_location
from xpl_cli.audit.static.shell import ShellCommand, ShellWord
from xpl_cli.audit.static.source import Source

REQUIREMENTS: Final = "requirements.txt"
_NUMERICAL: Final = frozenset(
    ("accelerate", "deepspeed", "diffusers", "flash-attn", "flax", "jax", "jaxlib", "lerobot", "numpy", "peft", "scipy")
) | frozenset(
    ("tensorflow", "timm", "tokenizers", "torch", "torchaudio", "torchvision", "transformer-engine", "transformers")
)
"""Libraries that compute the actions or read the weights, so that another version may give other ones."""

_OF_TORCH: Final = frozenset(("torchaudio", "torchvision"))
"""What asks for one version of torch, so that pinning torch pins it."""

_REPOSITORY: Final = re.compile(r"git\+\S+?://[^@\s]+$|git\+ssh://[^@\s]+@[^@\s]+$")
_PROJECTS: Final = frozenset(("pyproject.toml", "setup.cfg", "setup.py"))
_VERSIONED: Final = re.compile(
    r"^[\s\"',\[]*([A-Za-z][\w.-]*)(?:\[[\w,]*\])?\s*(?:==|~=|<|>=?[^,\n]*,\s*<)", re.MULTILINE
)
_LONGEST: Final = 500
_NAME: Final = re.compile(r"([A-Za-z][\w.-]*)(?:\[[^\]]*\])?(.*)")
_WITH_VALUE: Final = frozenset(("-r", "-c", "-i", "-e", "-f", "-t", "--target", "--python", "-p"))


@rule(code="XPL162", requirement="XPL-PKG-14")
def unpinned_install(source: Source) -> Iterator[Finding]:
    """The installation takes the newest version of a library.

    ## What it does
    Reads `install.sh`, `requirements.txt` and the requirements in `policy.yml`, and looks for libraries that compute
    actions or read weights without any version, and for repositories without a revision. A library counts as pinned if
    a pyproject.toml, setup.py or list of requirements in the package, a vendored one too, bounds its version.

    ## Why it matters
    The tested environment cannot be reproduced. With another version, weights do not load, or they load and the actions
    differ.

    ## Example
    `pip install torchvision git+https://host/project`, without `==` and without `@revision`.

    ## Use instead
    `torchvision==0.19.1`, `git+https://host/project@<commit>`; or a lockfile.

    ## Fix safety
    Safe: pinning the tested version changes nothing on machines that have it.
    """
    files = [name for name in (sdk.File.INSTALL_SH, REQUIREMENTS) if source.has(name)]
    if not files and source.is_ecosystem:
        raise NotApplicable("the adapter installs nothing")
    if source.has(sdk.File.INSTALL_SH):
        yield from _script(source)
    if source.has(REQUIREMENTS):
        lines = source.text(REQUIREMENTS).split("\n")
        loose = [(name, number) for number, line in enumerate(lines, start=1) for name in _loose(line.split(" #")[0])]
        if loose:
            yield _finding({"path": REQUIREMENTS, "line": loose[0][1], "column": 1}, [name for name, _ in loose])
    declared = source.manifest.environment
    requirements = declared.requirements if declared.manager != "none" else ()
    loose_names = [name for text in requirements for name in _loose(text)]
    if loose_names:
        line = key_line(source, sdk.File.POLICY_YML, "environment")
        yield _finding({"path": sdk.File.POLICY_YML, "line": line, "column": 1}, loose_names)


def _script(source: Source) -> Iterator[Finding]:
    """Yield one finding for all that install.sh installs loosely and does not pin elsewhere."""
    commands = [command for command in source.commands(sdk.File.INSTALL_SH) if _is_install(command)]
    words = [word for command in commands for word in _wanted(command)]
    pinned = {_plain(match.group(1)) for word in words if (match := _NAME.fullmatch(word.text)) and match.group(2)}
    pinned |= _declared(source)
    if "torch" in pinned:
        pinned |= _OF_TORCH
    loose = [(name, word) for word in words for name in _loose(word.text) if name not in pinned]
    if loose:
        yield _finding(word_location(sdk.File.INSTALL_SH, loose[0][1]), list(dict.fromkeys(name for name, _ in loose)))


def _declared(source: Source) -> set[str]:
    """Return what a project in the package, its own or a vendored one, or a list of requirements bounds."""
    own = ((name, source.text(name)) for name in source.text_files if "/" not in name)
    bounded: set[str] = set()
    for name, text in (*own, *vendored.texts(source)):
        short = name.rpartition("/")[2]
        if short in _PROJECTS or (short.startswith(("requirements", "constraints")) and short.endswith(".txt")):
            bounded |= {_plain(entry) for entry in _VERSIONED.findall(text)}
    return bounded


def _is_install(command: ShellCommand) -> bool:
    texts = [word.text.rpartition("/")[2] for word in executed_words(command)[:5]]
    return "install" in texts and bool({"pip", "pip3"} & set(texts))


def _wanted(command: ShellCommand) -> Iterator[ShellWord]:
    """Yield the words of a `pip install` that name what is to be installed."""
    words = executed_words(command)
    start = next(number for number, word in enumerate(words) if word.text == "install") + 1
    for word, before in zip(words[start:], words[start - 1 :], strict=False):
        takes_value = before.text in _WITH_VALUE or (before.text.startswith("--") and "url" in before.text)
        if not takes_value and not word.text.startswith("-"):
            yield word


def _loose(text: str) -> list[str]:
    """Return what a requirement names without a version, if its version matters."""
    text = text[:_LONGEST].strip()
    if _REPOSITORY.search(text):
        return [text.rpartition("/")[2].removesuffix(".git")]
    match = _NAME.fullmatch(text)
    is_loose = match is not None and not match.group(2).strip() and _plain(match.group(1)) in _NUMERICAL
    return [_plain(match.group(1))] if match and is_loose else []


def _plain(name: str) -> str:
    return name.lower().replace("_", "-")


def _finding(at: Location, names: list[str]) -> Finding:
    listed = ", ".join(names)
    return Finding(
        f"a later installation gets other versions of {listed}: weights or actions may differ from those tested",
        **at,
        expected=f"{names[0]}==<version>, or @<commit> for a repository",
        got=f"{listed} without a version",
        fix=Fix("advice", "pin the versions of the tested environment"),
    )
