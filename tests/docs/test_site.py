"""The site of docs/: it builds without a warning, needs nothing from elsewhere, and a broken one does not build."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.support import pages
from tests.support.checkout import ROOT, copy

pytestmark = pytest.mark.slow


def _build(config: Path, out: Path) -> subprocess.CompletedProcess[str]:
    options = ["--strict", "--config-file", str(config), "--site-dir", str(out)]
    command = [sys.executable, "-m", "properdocs", "build", *options]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the built site."""
    folder = tmp_path_factory.mktemp("site")
    source = copy(tmp_path_factory.mktemp("source"), "mkdocs.yml", "docs/**")
    done = _build(source / "mkdocs.yml", folder)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


def test_every_page_is_built(site: Path) -> None:
    for path in pages.DOCS:
        name = path.relative_to(ROOT / "docs").with_suffix(".html")
        built = site / (name.with_stem("index") if name.stem == "README" else name)
        text = built.read_text(encoding="utf-8")
        assert "<h1" in text
        assert not re.search(r"<p>[^<]*\n(- |\d\. |\|)", text), f"{built}: a list or table without an empty line above"


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    loading = re.compile(
        r'<(?:script|img|iframe|source)\b[^>]*\bsrc="([^"]*)"|<link\b(?![^>]*rel="canonical")[^>]*\bhref="([^"]*)"'
    )
    for page in site.rglob("*.html"):
        sources = [source or linked for source, linked in loading.findall(page.read_text(encoding="utf-8"))]
        assert sources
        assert [name for name in sources if "//" in name] == [], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//", sheet.read_text(encoding="utf-8")), sheet


def test_a_broken_site_is_not_built(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    broken = "# Page\n\n[link](none.md) [anchor](other.md#none) ![picture](none.png) [outside](../README.md)\n"
    (tmp_path / "docs" / "index.md").write_text(broken)
    for name in ("other", "forgotten"):
        (tmp_path / "docs" / f"{name}.md").write_text("# Page\n")
    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    config |= {"nav": ["index.md", "other.md", "too-much.md"], "extra_css": []}
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(config))
    done = _build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert done.returncode != 0
    for named in ("none.md", "#none", "none.png", "../README.md", "forgotten.md", "too-much.md"):
        assert named in done.stderr
