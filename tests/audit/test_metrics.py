"""`xpl metrics`: lines of model.py, the distance of evaluation loops to the reference, their picture."""

from __future__ import annotations

import json
import shutil
import textwrap
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.peer import xpl
from tests.support.places import ROOT, copy
from xpl_cli.audit.metrics import measure, plot
from xpl_cli.audit.rules.model import NotRun
from xpl_cli.audit.static.loops import distance as loop_distance
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.errors import ExitCode, NotFoundError
from xpl_cli.packages.targets import Target
from xpl_cli.standard.validate import validate

LOOP = (ROOT / "policy/demo_policy/deploy.py").read_text(encoding="utf-8")


def _adapter(folder: Path, model: str = "class Model:\n    pass\n", deploy: str = LOOP) -> Target:
    folder.mkdir(parents=True)
    (folder / "model.py").write_text(model, encoding="utf-8")
    (folder / "deploy.py").write_text(deploy, encoding="utf-8")
    return Target(folder, "policy", folder.name)


def _lines(tmp_path: Path, model: str) -> int | None:
    return measure.measure(_adapter(tmp_path / "Foo", textwrap.dedent(model))).lines


def _distance(tmp_path: Path, deploy: str) -> float:
    distance = measure.measure(_adapter(tmp_path / "Foo", deploy=textwrap.dedent(deploy))).distance
    assert distance is not None
    return distance


# --- Lines ------------------------------------------------------------------------------------------------------------


def test_blank_lines_comments_and_docstrings_do_not_count(tmp_path: Path) -> None:
    """What remains are the lines that hold code."""
    model = '''
        """Of the module,
        over lines."""
        # a comment

        import os  # counts

        class Model:
            """Of the class."""

            def reset(self):
                """Of the method,

                # with what looks like a comment
                """
                self.text = """counts

                counts"""
                return (
                    1,  # a statement over lines counts each of them
                )
    '''
    assert _lines(tmp_path, model) == 8


def test_code_beside_a_docstring_counts(tmp_path: Path) -> None:
    """A docstring does not hide its line."""
    assert _lines(tmp_path, 'def f(): "doc"\nclass A: "doc"; x = 1\n"not a docstring"\n') == 3


def test_old_encodings_and_line_ends_are_read(tmp_path: Path) -> None:
    """Lines are those of the text, whatever its bytes."""
    target = _adapter(tmp_path / "Foo")
    (target.path / "model.py").write_bytes(
        "# -*- coding: latin-1 -*-\r\nx = 'é'\r\n\r\ny = 1\x0c\r\n".encode("latin-1")
    )
    assert measure.measure(target).lines == 2


def test_files_that_the_model_imports_are_counted_beside_it(tmp_path: Path) -> None:
    """Moving code out of model.py does not hide it."""
    target = _adapter(tmp_path / "Foo", "from .helper import thing\n")
    (target.path / "helper.py").write_text("thing = 1\nother = 2\n")
    measured = measure.measure(target)
    assert (measured.lines, measured.reached) == (1, 3)


def test_nothing_is_executed(tmp_path: Path) -> None:
    """Measuring reads text."""
    mark = tmp_path / "executed"
    text = f"open({str(mark)!r}, 'w')\n"
    target = _adapter(tmp_path / "Foo", "from .helper import x\n" + text, text + LOOP)
    for name in ("helper.py", "__init__.py"):
        (target.path / name).write_text(text)
    measure.measure(target)
    assert not mark.exists()


# --- Distance ---------------------------------------------------------------------------------------------------------


def test_the_scaffolds_loop_has_no_distance(tmp_path: Path) -> None:
    """It is the reference."""
    assert _distance(tmp_path, LOOP) == 0


def test_the_contracts_loop_has_no_distance(tmp_path: Path) -> None:
    """It is the other form of the reference."""
    text = (ROOT / "templates/loop/v1/deploy.py").read_text(encoding="utf-8")
    measured = measure.measure(_adapter(tmp_path / "Foo", deploy=text))
    assert measured.distance == 0
    assert {entry.form for entry in measured.loop or ()} == {"contract"}


def test_how_a_loop_is_written_does_not_count(tmp_path: Path) -> None:
    """Names, comments, docstrings, layout, positions of arguments and names for a single use are gone."""
    deploy = """
        def eval_one_episode(env, policy):
            policy.reset()
            first = env.get_obs()  # named for the next line alone
            policy.update_obs(first)
            while not env.is_episode_end():
                '''Text is no statement.'''
                for step in policy.call("get_action"):
                    env.take_action(step)
                    if env.is_episode_end():
                        break
                    seen: dict = env.get_obs()
                    policy.call("update_obs", seen)
                    pass
    """
    measured = measure.measure(_adapter(tmp_path / "Foo", deploy=textwrap.dedent(deploy).replace("seen: dict", "seen")))
    one, batch = measured.loop or ()
    assert one.distance == 0
    assert batch.distance == 1, "the batched function is missing"
    assert 0 < (measured.distance or 0) < 1


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("            if TASK_ENV.is_episode_end():  # it may end anywhere in a chunk\n                break\n", ""),
        ('    model_client.call(func_name="reset")\n', ""),
        ('call(func_name="get_action_batch", obs=running)', 'call(func_name="get_action_batch", obs=chunks)'),
        ("take_action(action)", "take_action(action); import time; time.sleep(1)"),
        ("chunks[env][step] for env", "chunks[env][0] for env"),
    ],
)
def test_what_a_loop_does_counts(tmp_path: Path, old: str, new: str) -> None:
    """A difference that changes what happens is a distance, and a small one."""
    assert old in LOOP
    assert 0 < _distance(tmp_path, LOOP.replace(old, new)) < 0.2


def test_moving_a_statement_out_of_a_block_counts(tmp_path: Path) -> None:
    """The same statements in the same order, nested in another way."""
    last = '            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())\n'
    assert last in LOOP
    assert _distance(tmp_path, LOOP.replace(last, last.removeprefix("    "))) > 0


def test_functions_that_a_loop_calls_are_part_of_it(tmp_path: Path) -> None:
    """Code does not get nearer to the reference by moving it into a helper."""
    helper = (
        "\ndef _see(env):\n    while True:\n        seen = env.get_obs()\n        if seen:\n            return seen\n"
    )
    called = LOOP.replace("TASK_ENV.get_obs()", "_see(TASK_ENV)")
    assert _distance(tmp_path / "a", called + helper) > _distance(tmp_path / "b", called) > 0


def test_a_loop_that_only_hands_on_is_measured_where_it_is(tmp_path: Path) -> None:
    """The environment and the client are known by what the helper is given."""
    body = (
        LOOP.replace("def eval_one_episode(", "def _run(").replace("TASK_ENV", "world").replace("model_client", "brain")
    )
    handed = _distance(tmp_path, body + "\ndef eval_one_episode(a, b):\n    return _run(a, b)\n")
    assert 0 < handed < 0.1


@given(st.lists(st.sampled_from("abc")), st.lists(st.sampled_from("abc")))
def test_unmatched_is_the_edit_distance_without_replacement(one: list[str], other: list[str]) -> None:
    """The bits give what the table gives."""
    row = list(range(len(other) + 1))
    for i, left in enumerate(one, start=1):
        before, row = row, [i]
        for j, right in enumerate(other, start=1):
            row.append(before[j - 1] if left == right else 1 + min(before[j], row[j - 1]))
    assert loop_distance.unmatched(one, other) == row[-1]


# --- Distribution -----------------------------------------------------------------------------------------------------


def test_quantiles_are_interpolated() -> None:
    """As numpy's default does."""
    assert measure.Distribution.of([4, 1, 3, 2, 0]) == measure.Distribution(5, 0, 2, 3.6, 4)
    assert measure.Distribution.of([0, 1]) == measure.Distribution(2, 0, 0.5, 0.9, 1)
    assert measure.Distribution.of([7]) == measure.Distribution(1, 7, 7, 7, 7)
    assert measure.Distribution.of([]) is None


def test_what_cannot_be_measured_says_why(tmp_path: Path) -> None:
    """A broken adapter leaves the others' figures alone."""
    broken = _adapter(tmp_path / "Broken", "def f(:\n", LOOP)
    (broken.path / "deploy.py").unlink()
    measured = [measure.measure(broken), measure.measure(_adapter(tmp_path / "Foo", "x = 1\n"))]
    assert (measured[0].lines, measured[0].distance) == (None, None)
    assert [reason.partition(" ")[0] for reason in measured[0].reasons] == ["model.py", "there"]
    lines, distances = measure.distributions(measured)
    assert lines is not None
    assert distances is not None
    assert (lines.count, distances.count) == (1, 1)
    assert validate(measure.document(measured), "metrics") == []
    assert measure.document(measured)["next"][0] == "xpl audit --gate static Broken"


def test_a_file_that_does_not_parse_is_not_run(tmp_path: Path) -> None:
    """The figure is missing rather than wrong."""
    target = _adapter(tmp_path / "Foo", "x = (\n")
    with pytest.raises(NotRun, match=r"model\.py does not parse"):
        measure.code_lines(Source(target.path), "model.py")


def test_environments_are_refused() -> None:
    """They have neither model.py nor a loop."""
    with pytest.raises(NotFoundError, match="is an environment"):
        measure.policies([ROOT / "envs/mujoco"])


# --- Command ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two policies: the demo's, and one of the ecosystem's layout in a folder with an odd name."""
    folder = tmp_path_factory.mktemp("a workspace")
    copy(folder, "policy/demo_policy/**")
    shutil.copytree(folder / "policy/demo_policy", folder / "policy/it's <odd> & $(touch executed)")
    (folder / "policy/it's <odd> & $(touch executed)/policy.yml").unlink()
    (folder / "policy/notes").mkdir()
    (folder / "policy/README.md").write_text("not a policy\n")
    return folder


def test_all_measures_every_policy(workspace: Path) -> None:
    """Folders without an adapter are passed over; the answer is what its schema says."""
    done = xpl("metrics", "--all", "--json", cwd=workspace)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    answer = json.loads(done.stdout)
    assert validate(answer, "metrics") == []
    assert [entry["layout"] for entry in answer["adapters"]] == ["xpl", "ecosystem"]
    assert answer["distribution"]["model_lines"]["count"] == 2
    assert answer["next"]


def test_the_report_for_people_ends_with_a_command(workspace: Path) -> None:
    """A table with one line for each adapter, the distribution, and what to run next."""
    done = xpl("metrics", "policy/demo_policy", "policy/it's <odd> & $(touch executed)", cwd=workspace)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    assert "it's <odd> & $(touch executed)" in done.stdout
    assert [line.split()[0] for line in done.stdout.splitlines()[4:8]] == ["min", "median", "p90", "max"]
    assert done.stdout.splitlines()[-1].startswith("Next: xpl audit --gate static ")


def test_the_plot_is_a_well_formed_picture(workspace: Path) -> None:
    """Two bars and two tracks for each adapter; hostile names are text."""
    done = xpl("metrics", "--all", "--plot", "out.svg", cwd=workspace)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    picture = ET.parse(workspace / "out.svg").getroot()  # noqa: S314 - our own file
    space = "{http://www.w3.org/2000/svg}"
    assert len(picture.findall(f"{space}rect")) == 8
    assert any(entry.text and entry.text.startswith("it's <odd>") for entry in picture.findall(f"{space}text"))


def test_a_plot_shows_what_was_not_measured(tmp_path: Path) -> None:
    """Nothing is drawn as zero that is not known, and control characters do not break the picture."""
    unknown = measure.Metrics("bad\x07name", "x", ecosystem=True, lines=None, reached=None, loop=None, reasons=("why",))
    picture = plot.svg([unknown])
    ET.fromstring(picture)  # noqa: S314 - our own text
    assert picture.count("not measured") == 2


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        ([], ExitCode.USAGE, "--all"),
        (["demo_policy", "--all"], ExitCode.USAGE, "one of the two"),
        (["nowhere"], ExitCode.NOT_FOUND, "no adapter at nowhere"),
        (["demo_policy", "--plot", "out.png"], ExitCode.USAGE, "--plot out.svg"),
        (["demo_policy", "--plot", "missing/out.svg"], ExitCode.USAGE, "cannot be written"),
    ],
)
def test_mistakes_are_one_sentence(workspace: Path, arguments: list[str], code: ExitCode, says: str) -> None:
    """What to do instead is part of it."""
    done = xpl("metrics", *arguments, cwd=workspace)
    assert done.returncode == code
    assert says in done.stderr
    assert "Traceback" not in done.stderr


def test_an_adapter_that_cannot_be_measured_fails_the_command(workspace: Path, tmp_path: Path) -> None:
    """What is not known is never green."""
    _adapter(tmp_path / "policy/Broken", "def f(:\n")
    done = xpl("metrics", "--all", cwd=tmp_path)
    assert done.returncode == ExitCode.NOT_RUN
    assert "Broken: model.py does not parse" in done.stdout
