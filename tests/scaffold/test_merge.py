"""The three-way merge loses nothing: what an author wrote and what a template changed are both in the result."""

from __future__ import annotations

import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.examples import examples
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers
from xpl_cli.scaffold.merge import ConflictLabels, Merged, merge

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

LABELS = ConflictLabels("yours", "old", "new")
GIT = shutil.which("git")
LINES = st.lists(st.sampled_from([b"a\n", b"b\n", b"c\n", b"\n"]), max_size=8).map(b"".join)


def _merge(base: bytes, ours: bytes, theirs: bytes) -> Merged:
    return merge(base, ours, theirs, LABELS)


@given(LINES, LINES)
def test_the_side_that_changed_something_wins(base: bytes, changed: bytes) -> None:
    assert _merge(base, changed, base) == Merged(changed)
    assert _merge(base, base, changed) == Merged(changed)
    assert _merge(base, changed, changed) == Merged(changed)


@given(LINES, LINES, LINES)
def test_who_is_who_decides_nothing_but_the_labels(base: bytes, ours: bytes, theirs: bytes) -> None:
    one, other = _merge(base, ours, theirs), _merge(base, theirs, ours)
    assert one.conflicts == other.conflicts
    assert one.conflicts or one.content == other.content


@st.composite
def _edited(draw: st.DrawFn, base: list[bytes], tag: bytes, free: list[int]) -> tuple[list[bytes], list[bytes]]:
    """Return what each line of `base` became, and the lines that are new; only those at `free` places change."""
    result, new = list(base), []
    for position in draw(st.lists(st.sampled_from(free), max_size=4, unique=True)) if free else []:
        line = b"%s %d %d\n" % (tag, position, draw(st.integers(0, 9)))
        become = draw(st.sampled_from([line, b"", line + base[position], base[position] + line]))
        new += [line] if become else []
        result[position] = become
    return result, new


@given(st.data())
def test_edits_in_different_places_merge_exactly(data: st.DataObject) -> None:
    base = [b"line %d\n" % number for number in range(16)]
    taken = data.draw(st.lists(st.booleans(), min_size=4, max_size=4))
    mine = [place for place in range(16) if taken[place // 4] and place % 4 in (1, 2)]
    template = [place for place in range(16) if not taken[place // 4] and place % 4 in (1, 2)]
    ours, _ = data.draw(_edited(base, b"mine", mine))
    theirs, _ = data.draw(_edited(base, b"new", template))
    expected = [other if one == line else one for line, one, other in zip(base, ours, theirs, strict=True)]
    merged = _merge(b"".join(base), *(b"".join(text) for text in (ours, theirs)))
    assert merged == Merged(b"".join(expected))


@given(st.data())
def test_no_line_that_anybody_wrote_is_lost(data: st.DataObject) -> None:
    base = [b"line %d\n" % number for number in range(8)]
    ours, mine = data.draw(_edited(base, b"mine", list(range(8))))
    theirs, new = data.draw(_edited(base, b"new", list(range(8))))
    merged = _merge(b"".join(base), *(b"".join(text) for text in (ours, theirs)))
    assert set(mine) | set(new) <= set(merged.content.splitlines(keepends=True))
    assert merged.content.count(b"<<<<<<< yours\n") == merged.content.count(b">>>>>>> new\n") == merged.conflicts


@pytest.mark.skipif(GIT is None, reason="git is not installed")
@given(data=st.data())
@settings(max_examples=25)
def test_git_merges_clean_texts_alike(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    base = [b"line %d\n" % number for number in range(8)]
    ours, _ = data.draw(_edited(base, b"mine", list(range(8))))
    theirs, _ = data.draw(_edited(base, b"new", list(range(8))))
    texts = [b"".join(base), *(b"".join(text) for text in (ours, theirs))]
    merged = _merge(*texts)
    folder: Path = tmp_path_factory.mktemp("git")
    for name, text in zip(("base", "ours", "theirs"), texts, strict=True):
        (folder / name).write_bytes(text)
    command = [str(GIT), "merge-file", "-p", *(str(folder / name) for name in ("ours", "base", "theirs"))]
    completed = subprocess.run(command, capture_output=True, check=False)
    if not merged.conflicts and not completed.returncode:
        assert merged.content == completed.stdout
    assert bool(merged.conflicts) >= bool(completed.returncode), "git saw a conflict that was passed over"


def test_a_conflict_shows_all_three() -> None:
    merged = _merge(b"a\nold\nz", b"a\nmine\nz", b"a\nnew\nz")
    assert merged == Merged(b"a\n<<<<<<< yours\nmine\n||||||| old\nold\n=======\nnew\n>>>>>>> new\nz", 1)


@pytest.mark.parametrize(
    "lines",
    [
        lambda side: [b"a", b"b"][:: -1 if side == b"old" else 1] * 100_000,
        lambda side: [b"", side] * 100_000,
        lambda side: [line for number in range(100_000) for line in (b"%d" % number, side)],
    ],
    ids=["two lines", "every other one", "all different"],
)
def test_texts_that_take_for_ever_to_compare_are_one_conflict(lines: Callable[[bytes], list[bytes]]) -> None:
    """What an adapter says that it was rendered from is a stranger's text, too."""
    base, ours = (b"\n".join(lines(side)) + b"\n" for side in (b"old", b"mine"))
    merged = _merge(base, ours, b"new\n")
    assert merged.conflicts == 1
    assert merged.content == b"<<<<<<< yours\n" + ours + b"||||||| old\n" + base + b"=======\nnew\n>>>>>>> new\n"


def test_a_last_line_without_an_end_keeps_the_markers_apart() -> None:
    merged = _merge(b"old", b"mine", b"new")
    assert merged.content.splitlines() == [
        b"<<<<<<< yours", b"mine", b"||||||| old", b"old", b"=======", b"new", b">>>>>>> new"
    ]  # fmt: skip


def test_line_ends_stay_the_authors() -> None:
    assert _merge(b"a\nb\nc\n", b"a\r\nb\r\nmine\r\n", b"new\nb\nc\n") == Merged(b"new\r\nb\r\nmine\r\n")


@pytest.fixture(scope="module")
def renders() -> list[adapter.Files]:
    """Return what the template makes of answers that differ."""
    defaults = {"name": "Foo", **adapter.defaults()}
    others = {"block": False, "chunk": 1, "embodiment": "franka_single", "history": 2}
    return [adapter.render(AdapterAnswers(**{**defaults, **changes})) for changes in ({}, others)]


@given(data=st.data())
@settings(max_examples=examples(60))
def test_random_edits_of_a_real_adapter_survive_its_update(renders: list[adapter.Files], data: st.DataObject) -> None:
    old, new = renders
    name = data.draw(st.sampled_from(sorted({*old} & {*new})))
    lines = old[name].splitlines(keepends=True)
    ours, mine = data.draw(_edited(lines, b"# mine", list(range(len(lines)))))
    merged = _merge(old[name], b"".join(ours), new[name])
    assert set(mine) <= set(merged.content.splitlines(keepends=True))
    if old[name] == new[name]:
        assert merged == Merged(b"".join(ours))
