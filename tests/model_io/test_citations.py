"""Citations of the authors' code: read, looked up in the package or beside an interpreter, and held against values."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.support.checkout import ROOT
from tests.support.peer import xpl
from xpl_cli.basics.errors import ExitCode
from xpl_cli.model_io.citations import Citation, Quotation, contradiction, folders, lookup
from xpl_cli.packages.conventions import DeclaredValue


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("train.py:48", ("train.py", 48, 48, "", False)),
        ("authors/env.py:88-90 OPEN_WIDTH", ("authors/env.py", 88, 90, "OPEN_WIDTH", False)),
        ("them/policy@v1:src/a/b.py:7, `Model.act`", ("src/a/b.py", 7, 7, "Model.act", True)),
        ("https://host.example/them/policy/blob/4f1c2d0/run.py#L12 (n_steps)", (None, 12, 12, "", True)),
        ("as usual", None),
        ("version 1:2", ("1", 2, 2, "", False)),
    ],
)
def test_a_source_is_read_as_a_citation(text: str, expected: tuple[str | None, int, int, str, bool] | None) -> None:
    citation = Citation.parse(text)
    if expected is None:
        assert citation is None
        return
    assert citation is not None
    path, *rest = expected
    assert [citation.first, citation.last, citation.symbol, citation.is_foreign] == rest
    assert path in (None, citation.path)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a package with a file of its own, and a library beside an interpreter."""
    library = tmp_path / "env" / "lib" / "python3.11" / "site-packages" / "lib"
    library.mkdir(parents=True)
    (library / "utils.py").write_text("import cv2\n\n\ndef images(frame):\n    return frame[..., ::-1]  # BGR\n")
    folder = tmp_path / "Foo"
    folder.mkdir()
    (folder / "utils.py").write_text("own = 1\n")
    return folder


def _quoted(package: Path, text: str) -> Quotation | None:
    citation = Citation.parse(text)
    assert citation is not None
    return lookup(citation, folders(package, str(package.parent / "env" / "bin" / "python")))


def test_a_repository_s_file_is_found_where_it_is_installed(package: Path) -> None:
    """Without the folders that a repository has above it, and never as the package's own file of that name."""
    quotation = _quoted(package, "them/lib@v1:src/lib/utils.py:5")
    assert quotation is not None
    assert (quotation.text, quotation.problem) == (("return frame[..., ::-1]  # BGR",), None)
    assert _quoted(package, "them/lib@v1:utils.py:1") is None
    own = _quoted(package, "utils.py:1")
    assert own is not None
    assert own.text == ("own = 1",)


@pytest.mark.parametrize(
    ("cited", "problem"),
    [
        ("src/lib/utils.py:9", "has 5 lines"),
        ("src/lib/utils.py:2", "is empty"),
        ("src/lib/utils.py:1 getFrames", "nowhere"),
        ("src/lib/utils.py:1 cv_two", "nowhere"),
        ("src/lib/utils.py:5 images in the order of OpenCV", None),
    ],
)
def test_lines_that_do_not_hold_what_is_said_are_told(package: Path, cited: str, problem: str | None) -> None:
    quotation = _quoted(package, f"them/lib@v1:{cited}")
    assert quotation is not None
    assert (quotation.problem is None) if problem is None else problem in str(quotation.problem)


def test_links_out_of_a_package_are_not_followed(package: Path, tmp_path: Path) -> None:
    """What the static gate quotes of a package stands in the package."""
    (package / ".venv").symlink_to(tmp_path / "env")
    (package / "linked").symlink_to(tmp_path / "env" / "lib" / "python3.11" / "site-packages" / "lib")
    for text in ("them/lib@v1:src/lib/utils.py:5", "linked/utils.py:5", "../env/utils.py:1"):
        citation = Citation.parse(text)
        assert citation is not None
        assert lookup(citation, folders(package)) is None


@pytest.mark.parametrize(
    ("code", "definition", "word", "contradicted"),
    [
        ("# quaternion, xyzw", "form", "quaternion_wxyz", "the code says xyzw"),
        ("# quaternion, wxyz", "form", "quaternion_wxyz", None),
        ("q = q[[3, 0, 1, 2]]  # xyzw to wxyz", "form", "quaternion_wxyz", None),
        ("cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)", "channels", "rgb", None),
        ("frame = capture.read()  # BGR", "channels", "rgb", "the code says bgr"),
        ("np.deg2rad(angles)", "angle_unit", "deg", None),
        ("angles in degrees", "angle_unit", "rad", "the code says degrees"),
        ("nothing of that kind", "angle_unit", "rad", None),
        ("xyzw", "form", "rot6d_columns", None),
    ],
)
def test_code_that_says_another_value_is_a_contradiction(
    code: str, definition: str, word: str, contradicted: str | None
) -> None:
    quotation = contradiction(Quotation(Path("a.py"), (code,), code, None), [DeclaredValue(definition, word)])
    assert (quotation is None) if contradicted is None else contradicted in str(quotation)


def test_the_command_quotes_each_source_beside_its_convention(tmp_path: Path) -> None:
    folder = tmp_path / "policy" / "Tiny_VLA"
    shutil.copytree(ROOT / "policy/Tiny_VLA", folder, ignore=shutil.ignore_patterns("checkpoints", "weights"))
    done = xpl("model-io", "sources", str(folder), cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert "image_channels = rgb: process_data.py:25\n    windows" in done.stdout
    text = (folder / "reference.py").read_text()
    (folder / "reference.py").write_text(text.replace('"process_data.py:19"', '"process_data.py:9999"'))
    done = xpl("model-io", "sources", str(folder), cwd=tmp_path)
    assert done.returncode == ExitCode.FINDINGS
    assert "! process_data.py has" in done.stdout
