"""Each tutorial is followed in an empty folder: its files are written, its commands run, its outputs compared."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import pages
from tests.support.checkout import ROOT, tracked

TUTORIALS = tracked("docs/tutorials/*.md")
_TIMEOUT_S = 300
_EXITS = re.compile(r"exits (\d+)")


class Reader:
    """Follows a tutorial.

    Args:
        folder: an empty folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._output = ""
        self._environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}

    def follow(self, block: pages.Block) -> None:
        """Do what a block says: write a file, change one, run commands, or look for lines in the last output."""
        if block.language == "console":
            exits = _EXITS.fullmatch(block.mark)
            self._run(block, int(exits[1]) if exits else 0)
        elif block.language == "text":
            missing = [line for line in block.text.splitlines() if line.strip() not in self._output]
            assert missing == [], f"{block}: not in the output: {missing}\n{self._output}"
        elif block.language == "diff":
            self._change(self.folder / block.title, block.text)
        elif block.title:
            self._write(block)

    def _run(self, block: pages.Block, expected: int) -> None:
        self._output = ""
        for line in pages.entered(block.text):
            program, *words = next(iter(pages.shell(line)), [""])
            if not program:
                continue
            settings = dict(re.findall(r"^([A-Z_]+)=(\S+) ", line))
            command = {"xpl": [sys.executable, "-m", "xpl_cli"], "python": [sys.executable]}.get(program, [program])
            done = subprocess.run(
                [*command, *words],
                cwd=self.folder,
                env={**self._environment, **settings},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                check=False,
                timeout=_TIMEOUT_S,
            )
            self._output += done.stdout
            assert done.returncode == expected, f"{block}: {line} ended with {done.returncode}\n{done.stdout}"

    def _write(self, block: pages.Block) -> None:
        """Write a file, or with `FILE#KEY` replace a key at the top of a YAML file and what belongs to it."""
        name, _, key = block.title.partition("#")
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not key:
            path.write_text(block.text)
            return
        entry = re.compile(rf"^{key}:.*\n(?:(?:[ #-].*)?\n)*", re.MULTILINE)
        text, count = entry.subn(lambda _: block.text, path.read_text())
        assert count == 1, f"{block}: {count} entries {key} in {name}"
        path.write_text(text)

    @staticmethod
    def _change(path: Path, difference: str) -> None:
        lines = difference.splitlines(keepends=True)
        old = "".join(line[1:] for line in lines if line[0] in " -")
        new = "".join(line[1:] for line in lines if line[0] in " +")
        text = path.read_text()
        assert text.count(old) == 1, f"{path}: {text.count(old)} times {old!r}"
        path.write_text(text.replace(old, new))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_goes_as_it_says(page: Path, tmp_path: Path) -> None:
    reader = Reader(tmp_path)
    for block in pages.blocks([page]):
        reader.follow(block)
