"""What an adapter's documents tell: publication, upstream code, licences, family, robots, downloads."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import _spec as sdk
from xpl import robots as known
from xpl_cli.adopt.facts import Evidence, Finding, Question, certain, likely
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.static import reading
from xpl_cli.audit.static.manifests import key_line
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from xpl_cli.audit.static.source import Source

_ARXIV: Final = re.compile(r"https?://arxiv\.org/(?:abs|pdf)/(\d{4}\.\d{4,5})(?:v\d+)?")
_LABELLED: Final = re.compile(r"(?i)^(?:[-*>#]\s*)?\**\s*(?:paper|publication|title)\**\s*:\**\s*(.+?)\s*$")
_BIBTEX: Final = re.compile(r"(?i)\btitle\s*=\s*[{\"]+(.+?)[}\"]+\s*,?\s*$")
_ORIGIN: Final = re.compile(
    r"(?i)(?:original|official|upstream|source)\s+(?:code|repo(?:sitory)?|implementation)[^\n]{0,20}?(https?://[^\s)>\]|*`]+)"
)
_DOWNLOAD: Final = re.compile(
    r"(?:hf|huggingface-cli)\s+download\s+(?:--repo-type\s+model\s+)?([\w.-]+/[\w.-]+)([^\n`|]*)"
)
_COMMAND: Final = re.compile(r"\b(?:eval|train|process_data|setup_eval_\w+)\.sh\s+(.+)")
_ENVIRONMENT: Final = re.compile(r"conda activate\s+(?:<[^>]+>\s*#\s*e\.g\.,?\s*)?([A-Za-z0-9][\w.-]*)")
# Words of titles and names that tell a kind of policy; the more special kinds come first.
_FAMILIES: Final = (
    ("world_action_model", r"(?i:world[- ]action[- ]model)|(?:\b|_|[a-z])WAM\b"),
    ("vla", r"(?i:vision[- ]language[- ]action)|(?:\b|_|[a-z])VLA\b"),
    ("act", r"(?i:action chunking with transformers|fine-grained bimanual manipulation)|\bpolicy_class: ACT\b"),
    ("diffusion", r"(?i:diffusion[- _]policy)"),
)
# How the texts of common licences begin.
_LICENCES: Final = (
    ("Apache-2.0", r"Apache License\s+Version 2\.0"),
    ("MIT", r"MIT License|Permission is hereby granted, free of charge"),
    ("BSD-3-Clause", r"BSD 3-Clause|Redistributions in binary form[\s\S]*Neither the name"),
    ("BSD-2-Clause", r"BSD 2-Clause"),
    ("GPL-3.0-only", r"GNU GENERAL PUBLIC LICENSE\s+Version 3"),
    ("MPL-2.0", r"Mozilla Public License Version 2\.0"),
    ("CC-BY-NC-4.0", r"Attribution-NonCommercial 4\.0 International"),
    ("CC-BY-4.0", r"Attribution 4\.0 International"),
)
_HEAD: Final = 3000
_LONGEST_TITLE: Final = 200
_LONGEST_LINE: Final = 4000


class Documents:
    """The texts of a package, line by line; a file that cannot be read has none.

    Args:
        source: the package.
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        readme = sdk.File.README_MD
        self.readme = self.lines(readme)
        others = [name for name in source.text_files if name.endswith(".md") and name != readme]
        self.texts = {name: self.lines(name) for name in (readme, *others)}

    def lines(self, name: str) -> list[str]:
        """Return the lines of a file of the boundary; what is longer than any sentence is data."""
        try:
            return [line if len(line) < _LONGEST_LINE else "" for line in self.source.text(name).split("\n")]
        except NotRun:
            return []

    def find(self, pattern: re.Pattern[str]) -> Iterator[tuple[Evidence, re.Match[str]]]:
        """Yield every match with its place, the README's first."""
        for name, lines in self.texts.items():
            for number, line in enumerate(lines, start=1):
                for found in pattern.finditer(line):
                    yield Evidence(name, number, found.group().strip()[:80]), found


def publication(documents: Documents) -> Iterator[Finding]:
    """Yield the paper, where the README names it."""
    title, evidence = _title(documents)
    link = next(documents.find(_ARXIV), None)
    if title is None or evidence is None:
        seen = () if link is None else (link[0],)
        yield Question("paper", "{title: ..., url: ..., arxiv: ...}; null if there is none", seen=seen)
        return
    paper: dict[str, str | None] = {"title": title}
    if link is not None and link[0].file == evidence.file:
        paper |= {"url": link[1].group(), "arxiv": link[1].group(1)}
    yield likely("paper", paper, evidence, *([link[0]] if len(paper) > 1 and link is not None else []))


def _title(documents: Documents) -> tuple[str | None, Evidence | None]:
    for number, line in enumerate(documents.readme, start=1):
        for part in line.split(" | ") if line.count("**") > 1 else [line]:
            found = _LABELLED.match(part.strip()) or _BIBTEX.search(part)
            title = re.sub(r"\[([^\]]*)\]\([^)]*\)|[*`_]{1,2}(?=\W|$)", r"\1", found.group(1)).strip() if found else ""
            if title and not title.startswith("http") and len(title) < _LONGEST_TITLE:
                return title, Evidence(sdk.File.README_MD, number, f"says so: {title[:60]}")
    return None, None


def upstream(documents: Documents) -> Iterator[Finding]:
    """Yield the code that the adapter wraps, its licence, and the adapter's own."""
    found = next(documents.find(_ORIGIN), None)
    vendored = _vendored(documents.source)
    licence = next(filter(None, (_licence(documents.source.path, f"{folder}/") for folder in vendored)), None)
    if found is not None:
        value = {"repository": found[1].group(1).rstrip(".,;"), "revision": None}
        if licence is not None:
            value["license"] = licence[0]
        yield likely("upstream", value, found[0], *([licence[1]] if licence else []))
    else:
        links = documents.find(re.compile(r"https?://github\.com/[\w.-]+/[\w.-]+"))
        seen = tuple(evidence for evidence, _ in links)[:2] + ((licence[1],) if licence else ())
        meaning = "{repository: ..., revision: ..., license: ...} of the code that the adapter wraps"
        yield Question("upstream", meaning, seen=seen)
    own = _licence(documents.source.path, "")
    if own is not None:
        yield likely("license", *own)


def _vendored(source: Source) -> list[str]:
    """Return the folders of the package that look like a copy of somebody's repository."""
    marks = ("pyproject.toml", "setup.py", "requirements.txt")
    try:
        folders = sorted(entry for entry in source.path.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    except OSError:
        return []
    return [folder.name for folder in folders if any((folder / mark).is_file() for mark in marks)]


def _licence(package: Path, folder: str) -> tuple[str, Evidence] | None:
    for name in ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "COPYING"):
        try:
            text = reading.decoded(reading.read(package.resolve(), f"{folder}{name}"), python=False)[0][:_HEAD]
        except NotRun:
            continue
        for identifier, pattern in _LICENCES:
            if (found := re.search(pattern, text)) is not None:
                line = text.count("\n", 0, found.start()) + 1
                return identifier, Evidence(f"{folder}{name}", line, " ".join(found.group().split())[:40])
    return None


def family(documents: Documents, title: str) -> Iterator[Finding]:
    """Yield the kind of policy, where title, name or configuration say it."""
    source, kinds = documents.source, tuple(spec.schema("policy")["properties"]["family"]["enum"])
    deploy = sdk.File.DEPLOY_YML
    told = [Evidence(sdk.File.README_MD, None, title), Evidence("", None, f"the folder is called {source.path.name}")]
    told += [
        Evidence(deploy, key_line(source, deploy, key), f"{key}: {value}")
        for key, value in source.deploy.items()
        if isinstance(value, str)
    ]
    for kind, pattern in _FAMILIES:
        for evidence in told:
            if kind in kinds and re.search(pattern, evidence.what):
                yield likely("family", kind, evidence)
                return
    yield Question("family", "kind of policy", kinds)


def commands(documents: Documents) -> Iterator[tuple[Evidence, list[str]]]:
    """Yield the calls of the adapter's scripts that its documents show with real arguments."""
    for evidence, found in documents.find(_COMMAND):
        words = found.group(1).replace("\\", " ").split()
        if "<" not in found.group(1).partition(" <policy")[0] and len(words) > 1:
            yield Evidence(evidence.file, evidence.line, " ".join(found.group().split())[:80]), words


def robots(documents: Documents) -> Iterator[Finding]:
    """Yield the robots that deploy.yml or the documents' commands name."""
    aliases = known.names()
    deploy, source = sdk.File.DEPLOY_YML, documents.source
    given = source.deploy.get(sdk.Deploy.ENV_CFG_TYPE)
    if given in aliases:
        evidence = Evidence(
            deploy, key_line(source, deploy, sdk.Deploy.ENV_CFG_TYPE), f"{sdk.Deploy.ENV_CFG_TYPE}: {given}"
        )
        yield certain("embodiments", [aliases[given]], evidence)
        return
    found: dict[str, Evidence] = {}
    for evidence, words in commands(documents):
        for word in words:
            if word in aliases:
                found.setdefault(aliases[word], evidence)
    if found:
        yield likely("embodiments", list(found), *found.values())
    else:
        yield Question("embodiments", "robots that the policy drives", tuple(known.entries()))


def downloads(documents: Documents) -> Iterator[Finding]:
    """Yield the weights that the documents tell the user to download."""
    found: dict[str, Evidence] = {}
    for evidence, match in documents.find(_DOWNLOAD):
        if "--repo-type dataset" not in match.group(2):
            found.setdefault(match.group(1), evidence)
    if found:
        entries = [{"name": source.partition("/")[2], "source": f"hf://{source}"} for source in found]
        yield likely("checkpoints", entries, *found.values())


def environment_name(documents: Documents) -> tuple[str, Evidence] | None:
    """Return the conda environment that the README says to activate."""
    for evidence, found in documents.find(_ENVIRONMENT):
        return found.group(1), evidence
    return None
