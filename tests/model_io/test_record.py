"""`xpl model-io record`: reference.py is asked in the policy's interpreter, and what it answers is written, or told."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.adapters import parity
from tests.support.peer import xpl
from xpl.embodiment import get_embodiment
from xpl.worker import reference as worker
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.lifecycle.python_env import sources
from xpl_cli.model_io import names, pairs, provenance, record
from xpl_cli.packages import package
from xpl_cli.standard import answers

if TYPE_CHECKING:
    from pathlib import Path


def recorded(folder: Path, **overrides: Any) -> record.RecordResult:
    return record.record(package.load(folder), record.RecordOptions(overrides=overrides))


def test_a_recording_is_written_and_told(tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo")
    done = xpl("model-io", "record", str(folder), "--json", cwd=tmp_path)
    assert done.returncode == ExitCode.CLEAN, done.stderr
    message = json.loads(done.stdout)
    assert answers.problems(message) == []
    assert (message["conventions"], len(message["assumed"])) == (13, 9)  # two are said to be, seven are not named
    assert message["assumed"][:3] == ["joint_order", "angle_unit", "camera"]
    found = pairs.read(folder)
    assert message["pairs"] == found.count >= 20
    assert set(found.provenance["reference"]) == {"reference.py", "network.py"}
    assert provenance.code_problems(folder, found.provenance) == []
    assert "numpy" in found.provenance["libraries"]
    assert found.noise == {"arm_joint_state": 0, "ee_joint_state": 0}
    (folder / "network.py").write_text(parity.NETWORK + "\n")
    assert provenance.code_problems(folder, found.provenance) == ["network.py was changed"]


def test_other_citations_leave_a_recording_as_it_is_and_other_code_of_the_authors_does_not(tmp_path: Path) -> None:
    """Citations change no answer; what they cite, where it is imported from, does."""
    code = RECURRENT.replace(
        "import numpy as np",
        'import msgpack\nimport numpy as np\n\nCONVENTIONS = {"chunk": "them/msgpack@v1:msgpack/fallback.py:3"}',
        1,
    )
    folder = parity.write_adapter(tmp_path / "Foo", code=code)
    message = recorded(folder, seed=5).pairs.provenance
    assert "msgpack/__init__.py" in message["authors"]
    assert provenance.code_problems(folder, message, sys.executable) == []
    (folder / "reference.py").write_text(code.replace("fallback.py:3", "ext.py:7"))
    assert provenance.code_problems(folder, message, sys.executable) == []
    (folder / "reference.py").write_text(code.replace("episode.rng.random()", "0.5"))
    assert provenance.code_problems(folder, message, sys.executable) == ["reference.py was changed"]
    (folder / "reference.py").write_text(code)
    changed = {**message, "authors": {**message["authors"], "msgpack/__init__.py": "0" * 64}}
    assert provenance.code_problems(folder, changed, sys.executable) == [
        "msgpack/__init__.py of the authors' code was changed"
    ]
    assert provenance.code_problems(folder, changed) == []


def test_code_on_the_path_is_compared_where_the_root_has_other_files_of_its_names(tmp_path: Path) -> None:
    """H-RDT has `models/` at its root, and other files of these names in the folder that its example runs in."""
    site, root = tmp_path / "env" / "lib" / "python3.12" / "site-packages", tmp_path / "env" / "src" / "them"
    example = root / "example"
    for folder, text in ((root, "answer = 1\n"), (example, "answer = 2\n")):
        (folder / "models").mkdir(parents=True)
        (folder / "models" / "net.py").write_text(text)
    site.mkdir(parents=True)
    python, recorded_there = str(tmp_path / "env" / "bin" / "python"), worker.code_digest(example / "models" / "net.py")
    message = {"reference": {}, "authors": {"models/net.py": recorded_there}}
    assert provenance.code_problems(tmp_path, message, python) != []
    (site / sources.ON_PATH).write_text(f"{example}\n{tmp_path}\n")
    assert provenance.code_problems(tmp_path, message, python) == []


def test_what_would_change_is_told_before_it_is_written(tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo")
    first = xpl("model-io", "record", str(folder), "--diff", cwd=tmp_path)
    assert (first.returncode, "is not there" in first.stdout) == (ExitCode.FINDINGS, True)
    assert not (folder / names.PAIRS).exists()
    xpl("model-io", "record", str(folder), cwd=tmp_path)
    same = xpl("model-io", "record", str(folder), "--diff", cwd=tmp_path)
    assert (same.returncode, same.stdout) == (ExitCode.CLEAN, "")
    before = (folder / names.PAIRS).read_bytes()
    code = (folder / "reference.py").read_text()
    (folder / "reference.py").write_text(code.replace('"ee_joint_state":', '"ee_joint_state": 0.5 *', 1))
    other = xpl("model-io", "record", str(folder), "--diff", cwd=tmp_path)
    assert other.returncode == ExitCode.FINDINGS, other.stderr
    assert re.search(
        r"\d+ of \d+ answers differ, ee_joint_state\[0\] by 0\.\d+ of its span; in ee_joint_state\[0\]", other.stdout
    )
    assert (folder / names.PAIRS).read_bytes() == before
    message = json.loads(xpl("model-io", "record", str(folder), "--json", cwd=tmp_path).stdout)
    assert message["changes"] == other.stdout.splitlines()


RECURRENT = """
import numpy as np


def answers(config):
    def answer(episode):
        drawn = episode.rng.random()
        total = sum(episode.observations[place]["state"]["ee_joint_state"][0] for place in episode.asked)
        joints = [len(episode.observations), episode.number, episode.env, drawn, total, config["seed"], 0]
        return [{"arm_joint_state": np.array(joints, np.float32), "ee_joint_state": np.ones(1, np.float32)}] * 2

    return answer
"""


def test_a_reference_is_told_the_episode_so_far(tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo", code=RECURRENT)
    found = recorded(folder, seed=5)
    (session,) = found.pairs.sessions
    assert (session.seed, found.pairs.provenance["settings"]) == (5, {"seed": 5})
    generators: dict[tuple[int, int], np.random.Generator] = {}
    for question in session.questions:
        shown, number, env, drawn, total, seed, _ = question.answer["arm_joint_state"][0, 0]
        assert (shown, number, env, seed) == (len(question.recipes), question.episode, question.env, 5)
        key = (question.episode, question.env)
        rng = generators.setdefault(key, np.random.default_rng([5, *key]))
        assert drawn == np.float32(rng.random())
        seen = [session.scene.observation(*question.recipes[place]) for place in question.asked_at]
        assert np.isclose(total, sum(obs["state"]["ee_joint_state"][0] for obs in seen))


def test_other_robots_and_action_types_are_asked_about_less(tmp_path: Path) -> None:
    folder = parity.write_adapter(
        tmp_path / "Foo", None, embodiments=["franka_single", "piper"], action_types=["joint", "ee"]
    )
    asked = list(record.sessions(package.load(folder), {}))
    assert [(one.embodiment, one.action_type) for one in asked] == [
        ("franka_single", "joint"),
        ("franka_single", "ee"),
        ("piper", "joint"),
        ("piper", "ee"),
    ]
    counts = [sum(len(call.ask) for call in one.calls) for one in asked]
    assert counts[0] >= 20 > max(counts[1:]) > 0
    free = parity.write_adapter(tmp_path / "Bar", parity.block(sampling="free"))
    assert {one.takes for one in record.sessions(package.load(free), {})} == {record.TAKES}


STEP = '{"arm_joint_state": np.zeros(7, np.float32), "ee_joint_state": np.ones(1, np.float32)}'
BODY = """import numpy as np
CALLS = []

def answers(config):
    def answer(episode):
        {}

    return answer
"""
BY_PATH = """import pathlib
import sys

sys.path.insert(0, str(pathlib.Path(__file__).parent))
import model


def answers(config): ...
"""
COUNTED = "{'arm_joint_state': np.full(7, len(CALLS), np.float32), 'ee_joint_state': np.ones(1)}"


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import xpl\n\n\ndef answers(config): ...\n", "reference.py imports xpl"),
        ("from xpl.rotation import rotate\n\n\ndef answers(config): ...\n", "reference.py imports xpl.rotation"),
        ("from .model import Model\n\n\ndef answers(config): ...\n", "the adapter's own model.py"),
        (BY_PATH, "the adapter's own model.py"),
        ("import no_such_library\n\n\ndef answers(config): ...\n", "no_such_library"),
        ("def answers(config):\n    return 3\n", "must return a function of an episode, got int"),
        ("def answer(config):\n    return 3\n", "defines no function answers(config)"),
        (
            BODY.format("raise KeyError(episode.env)"),
            "question 1, about environments [0]: KeyError: 0 (reference.py:6)",
        ),
        (BODY.format("return np.zeros((2, 8))"), "must be a list of action steps"),
        (BODY.format(f"CALLS.append(1); return [{STEP}] * len(CALLS)"), "expected a function of the episode alone"),
        (BODY.format(f"CALLS.append(1); return [{COUNTED}]"), "arm_joint_state by"),
        (BODY.format("import os; os._exit(3)"), "ended without an answer"),
        (BODY.format(f"return [{STEP}] * 1_000_000"), "may have 10000 action steps, got 1000000"),
    ],
)
def test_what_is_wrong_with_a_reference_is_told(code: str, message: str, tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo", None, code=code)
    with pytest.raises(UserError) as caught:
        recorded(folder)
    assert message in f"{caught.value} {caught.value.hint}"
    assert not (folder / names.PAIRS).exists()


GARBAGE = """import os

for name in os.listdir("/proc/self/fd"):
    try:
        os.write(int(name), b"\\xff" * 64 if int(name) > 2 else b"")
    except OSError:
        pass


def answers(config): ...
"""


def test_a_reference_that_writes_between_its_answers_is_told_so(tmp_path: Path) -> None:
    """No length that stands there is taken for one: the file is followed while the code runs."""
    folder = parity.write_adapter(tmp_path / "Foo", None, code=GARBAGE)
    with pytest.raises(UserError, match=r"reference\.py ended without an answer") as caught:
        recorded(folder)
    assert caught.value.code == ExitCode.NOT_RUN


def test_a_package_without_a_reference_is_told_so(tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo", code=None)
    with pytest.raises(UserError, match=r"has no reference\.py") as caught:
        recorded(folder)
    assert caught.value.code == ExitCode.NOT_FOUND


def test_weights_are_known_by_their_content(tmp_path: Path) -> None:
    folder = parity.write_adapter(tmp_path / "Foo")
    adapter = package.load(folder)
    config = {**adapter.config(), "ckpt_name": "demo"}
    assert provenance.weights(adapter, config) is None
    file = folder / "checkpoints/demo/step_1/weights.bin"
    file.parent.mkdir(parents=True)
    with file.open("wb") as stream:
        stream.truncate(65 << 20)
    first = provenance.weights(adapter, config)
    assert first is not None
    assert first["name"] == "demo"
    assert provenance.weights(adapter, config) == first
    with file.open("r+b") as stream:
        stream.seek(-1, 2)
        stream.write(b"1")
    second = provenance.weights(adapter, config)
    file.rename(file.with_name("other.bin"))
    assert len({entry["digest"] for entry in (first, second, provenance.weights(adapter, config)) if entry}) == 3


def test_the_commit_is_told_with_what_was_changed(tmp_path: Path) -> None:
    assert provenance.commit(tmp_path) is None
    git = ("git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org")
    (tmp_path / "reference.py").write_text("one")
    for command in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "one"]):
        subprocess.run([*git, *command], check=True)
    clean = provenance.commit(tmp_path)
    assert clean is not None
    assert len(clean) == 40
    (tmp_path / names.PAIRS).write_text("{}")
    assert provenance.commit(tmp_path) == clean
    (tmp_path / "reference.py").write_text("two")
    assert provenance.commit(tmp_path) == f"{clean}+"


def test_a_reference_cannot_change_what_the_next_question_shows() -> None:
    def answer(episode: worker.ReferenceEpisode) -> Any:
        episode.observations[0]["state"]["ee_joint_state"][:] += 1
        episode.asked.clear()
        value = episode.observations[0]["state"]["ee_joint_state"].copy()
        return [{"arm_joint_state": np.zeros(7, np.float32), "ee_joint_state": np.minimum(value - 0.5, 1)}]

    order = {
        "embodiment": "franka_single",
        "action_type": "joint",
        "seed": 0,
        "takes": 2,
        "rounds": 2,
        "policy_dir": "/",
    }
    obs = {"state": {"ee_joint_state": np.zeros(1, np.float32)}}
    calls = [{"show": [[0, obs]]}, {"ask": [0]}, {"ask": [0]}]
    message = list(worker.play(answer, {**order, "calls": calls}))
    assert len(message) == 4
    assert len(set(message)) == 1
    assert get_embodiment("franka_single").arms[0].dof == 7
