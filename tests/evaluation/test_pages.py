"""The pages of `xpl report` and `xpl leaderboard` in a real browser; not run if there is none."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from tests.support.outside.browser import Page, browser
from tests.support.peer import wait_until
from tests.support.recordings.runs import Faults, synthetic_run
from xpl_cli.evaluation.leaderboard import comparable_runs, ranking
from xpl_cli.evaluation.leaderboard import leaderboard_files as board
from xpl_cli.evaluation.records import records
from xpl_cli.evaluation.report import report_files

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LOOKS = [(1280, False), (390, True)]
HOSTILE = '</script><script>document.title="taken"</script><img src=x onerror="document.title=\'taken\'">'


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    """Yield a tab; nothing that it showed may have complained."""
    with browser() as tab:
        yield tab
        assert tab.complaints == []


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run with all kinds of failures, films and curves."""
    folder = tmp_path_factory.mktemp("runs") / "foo"
    return synthetic_run(folder, episodes=30, traces=2, films=2, faults=Faults(0.1, 0.05, 0.1))


@pytest.fixture(scope="module")
def url(run: Path) -> str:
    """Return the address of the run's page, which is a file."""
    report_files.write(records.read(run), run / report_files.FOLDER, 1 << 30)
    return (run / report_files.FOLDER / report_files.PAGE).as_uri()


def _fits(page: Page) -> bool:
    return bool(page("document.documentElement.scrollWidth <= innerWidth"))


def _background(page: Page) -> int:
    """Return how light the page is, 0 to 255."""
    colour: str = page("getComputedStyle(document.body).backgroundColor")
    return max(int(part) for part in colour.strip("rgb()").split(",")[:3])


def _text(page: Page, selector: str) -> str:
    text: str = page(f"document.querySelector({json.dumps(selector)}).innerText")
    return text


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("width", "dark"), LOOKS)
def test_the_page_fits_desk_and_phone_by_day_and_night(page: Page, url: str, width: int, dark: bool) -> None:
    """Nothing is wider than the screen, an open episode included, and the page follows the reader's light."""
    page.open(url, width, dark=dark)
    page("document.querySelector('#episode-0').click()")
    assert _fits(page)
    assert (_background(page) < 60) is dark
    assert page("[...document.querySelectorAll('section')].every(one => one.offsetHeight > 40)")


def test_an_episode_opens_with_film_and_curves(page: Page, url: str) -> None:
    """Each joint has a panel with what was measured, what was commanded, and where chunks begin."""
    page.requests.clear()
    page.open(url)
    page("document.querySelector('#episode-0').click()")
    wait_until(lambda: page("document.querySelector('.look img').naturalWidth") > 0, "the film is shown")
    assert set(page.requests) == {url}  # the page asks nobody for anything
    page("document.querySelector('#episode-0').click()")
    page("document.querySelector('#episode-1').click()")
    assert page("document.querySelectorAll('.panel').length") == 14
    assert page("document.querySelectorAll('.panel path.state').length") == 14
    assert page("document.querySelectorAll('.panel path.action').length") == 14
    chunks = page("document.querySelector('.panel path.chunk').getAttribute('d').split('M').length - 1")
    assert f"chunk begins ({chunks})" in _text(page, ".detail .legend")
    assert page("location.hash") == "#episode-1"
    page("document.querySelector('#episode-1').click()")
    assert page("document.querySelector('.detail')") is None


def test_an_address_leads_to_an_episode(page: Page, url: str) -> None:
    page.open(f"{url}#episode-77")
    assert page("document.querySelector('tr.open').id") == "episode-77"
    assert _text(page, "#place").startswith("51 to 100 of ")


def test_the_list_can_be_narrowed(page: Page, url: str, run: Path) -> None:
    """By outcome, by what was recorded, by seed, and by an error that the page names."""
    finals = list(records.read(run).finals.values())
    page.open(url)
    choose = "const box = document.querySelector('#{0}'); box.value = '{1}'; box.dispatchEvent(new Event('{2}'));"
    page(f"{{ {choose.format('outcome', 'policy', 'change')} }}")
    failed = sum(one.failure == "policy" for one in finals)
    assert _text(page, "#place") == f"1 to {failed} of {failed}"
    page(f"{{ {choose.format('outcome', '', 'change')} }}")
    page(f"{{ {choose.format('media', 'film', 'change')} }}")
    assert _text(page, "#place") == "1 to 2 of 2"
    page(f"{{ {choose.format('media', '', 'change')} }}")
    page(f"{{ {choose.format('search', '29', 'input')} }}")
    rows = page("[...document.querySelectorAll('#list tr.episode')].map(row => row.id)")
    expected = [one.index for one in finals if 29 in (one.seed, one.index)]
    assert rows == [f"episode-{index}" for index in expected]
    page("document.querySelector('button.link').click()")
    assert page("document.querySelector('#search').value") in {one.error or one.end_reason for one in finals}


def test_texts_of_others_stay_texts(page: Page, tmp_path: Path) -> None:
    """Markup in names, errors and instructions is displayed, not interpreted."""
    folder = synthetic_run(tmp_path / "foo", ["lift_cube", HOSTILE], episodes=4, policy=HOSTILE, faults=Faults(1.0))
    text = (folder / records.FILE).read_text()
    sentence = "left_arm_joint_state holds a value that is no number"
    (folder / records.FILE).write_text(text.replace(json.dumps(sentence), json.dumps(f"{sentence} {HOSTILE}")))
    report_files.write(records.read(folder), folder / report_files.FOLDER, 0)
    page.open((folder / report_files.FOLDER / report_files.PAGE).as_uri(), 390)
    page("document.querySelector('#episode-0').click()")
    assert HOSTILE in page("document.title")
    assert _text(page, "h1") == HOSTILE
    assert HOSTILE in _text(page, ".detail")
    assert HOSTILE in _text(page, "#failures")
    assert _fits(page)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("width", "dark"), LOOKS)
def test_the_leaderboard_fits_too(page: Page, tmp_path: Path, width: int, dark: bool) -> None:
    folders = [
        synthetic_run(tmp_path / name, episodes=20, policy=name, rate=rate) for name, rate in (("A", 0.2), ("B", 0.9))
    ]
    board.write(ranking.rank(comparable_runs.gather([records.read(folder) for folder in folders])), tmp_path / "board")
    page.open((tmp_path / "board/leaderboard.html").as_uri(), width, dark=dark)
    assert _fits(page)
    assert (_background(page) < 60) is dark
    assert page("document.querySelectorAll('.row svg .whisker').length") == 2
    assert "behind the first" in _text(page, ".rows")
