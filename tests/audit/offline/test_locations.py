"""Findings of a served adapter have a line: where it raised, or of the method that answered."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from xpl.wire.error_text import own_frames
from xpl_cli.audit.engine import engine
from xpl_cli.audit.engine.locations import located
from xpl_cli.audit.rules import registry
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import HANDLER, TRACEBACK, Finding
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.served.recorded_client import AnswerRecorder
from xpl_cli.audit.static.source import Source

if TYPE_CHECKING:
    from collections.abc import Callable

MODEL = """
    import numpy as np

    class Model:
        def __init__(self, config):
            self.reset()

        def reset(self):
            self.seen = {}
            self.last = []

        def update_obs(self, obs):
            self.update_obs_batch([obs])

        def update_obs_batch(self, obs_list):
            self.last = [obs["env_idx"] for obs in obs_list]
            self.seen.update({obs["env_idx"]: obs for obs in obs_list})

        def get_action(self):
            return self.chunk(self.last[0])

        def get_action_batch(self, env_idx_list=None):
            return [self.chunk(env) for env in sorted(env_idx_list or self.last)]

        def chunk(self, env):
            state = self.seen[env]["state"]
            return [self.step(np.array(state["arm_joint_state"])) for step in range(3)]

        def step(self, arm):
            return {"arm_joint_state": arm, "ee_joint_state": np.float32([0.5])}
"""


def line_of(folder: Path, text: str) -> int:
    """Return the line of model.py with a text."""
    lines = (folder / "model.py").read_text().splitlines()
    return next(number for number, line in enumerate(lines, 1) if text in line)


def findings(folder: Path, *rules: str) -> dict[str, list[tuple[str | None, int | None, str | None]]]:
    """Return file, line and what located them of the findings of an audit, by rule."""
    report = engine.audit(folder, "policy", AuditOptions(gates=(Gate.OFFLINE,), names=rules), display_path="Foo")
    return {
        result.code: [(found.path, found.line, found.located_by) for found in result.findings]
        for result in report.results
        if result.findings
    }


def test_a_served_fault_has_the_line_that_raised_or_the_method_that_answered(
    write_adapter: Callable[..., Path],
) -> None:
    """Without env_idx the adapter raises in one line; for [] and another order it only answers wrongly."""
    folder = write_adapter(MODEL)
    found = findings(folder, "XPL203", "XPL204", "XPL206")
    raised = line_of(folder, 'self.last = [obs["env_idx"]')
    answered = line_of(folder, "def get_action_batch")
    assert found["XPL206"][0] == ("model.py", raised, TRACEBACK)
    assert found["XPL203"] == [("model.py", answered, HANDLER)]
    assert set(found["XPL204"]) == {("model.py", answered, HANDLER)}


def test_a_model_that_does_not_load_is_blamed_at_its_line(write_adapter: Callable[..., Path]) -> None:
    """Also where the line is in a file that model.py imports."""
    broken = "from .helper import horizon\n\nclass Model:\n    def __init__(self, config):\n        horizon(config)\n"
    folder = write_adapter(broken)
    (folder / "helper.py").write_text('def horizon(config):\n    return config["horizon"]\n')
    assert findings(folder, "XPL201") == {"XPL201": [("helper.py", 2, TRACEBACK)]}


@pytest.mark.parametrize(
    ("rule", "message", "last", "method"),
    [
        ("XPL208", "an episode depends on the one before", "get_action", "def reset"),
        ("XPL203", "get_action_batch([9]) answers for environment 3", "update_obs", "def get_action_batch"),
        ("XPL212", "the image has no effect", "infer", "def get_action("),
        ("XPL213", "a missing input is replaced", "update_obs_batch", "def update_obs_batch"),
    ],
)
def test_without_an_error_the_line_is_that_of_a_method(
    write_adapter: Callable[..., Path], rule: str, message: str, last: str, method: str
) -> None:
    """Of the method that the rule is about, or else that the message names, or else that answered last."""
    folder = write_adapter(MODEL)
    recorder = AnswerRecorder()
    recorder.last = last
    found = located(Finding(message, "model.py"), registry.find(rule), Source(folder), recorder)
    assert (found.line, found.located_by) == (line_of(folder, method), HANDLER)


def test_an_error_that_a_finding_does_not_quote_locates_nothing(write_adapter: Callable[..., Path]) -> None:
    """A code alone is enough only where everything with this code was raised at one line."""
    folder, rule = write_adapter(MODEL), registry.find("XPL203")
    recorder = AnswerRecorder()
    recorder.note("KeyError: 'env_idx'", "call_failed", [["model.py", 5, "f"], ["lib/x.py", 3, "g"]])
    coded = Finding("fails", "model.py", got="an error (call_failed)")
    quoted = Finding("fails: KeyError: 'env_idx'", "model.py")
    fixed = Finding("KeyError: 'env_idx'", "model.py", 40)
    assert [located(one, rule, Source(folder), recorder).line for one in (coded, quoted, fixed)] == [5, 5, 40]
    recorder.note("ValueError: another", "call_failed", [["model.py", 7, "f"]])
    assert located(coded, rule, Source(folder), recorder).located_by == HANDLER
    recorder.note("KeyError", "call_failed", "no frames")
    assert len(recorder.errors) == 2


def test_frames_are_those_of_the_package_innermost_first(tmp_path: Path) -> None:
    """Neither of libraries nor of an environment that is installed in it; at most sixteen."""
    names = {"model.py": "calls", "site-packages/lib.py": "library"}
    functions: dict[str, Callable[..., object]] = {}
    for file, name in names.items():
        path = tmp_path / file
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"def {name}(depth, then):\n    return {name}(depth - 1, then) if depth else then()\n")
        space: dict[str, Callable[..., object]] = {}
        exec(compile(path.read_text(), str(path), "exec"), space)  # noqa: S102 - made here
        functions[name] = space[name]
    with pytest.raises(ZeroDivisionError) as caught:
        functions["calls"](1, lambda: functions["library"](0, lambda: 1 / 0))
    assert own_frames(caught.value, tmp_path) == [["model.py", 2, "calls"]] * 2
    with pytest.raises(ZeroDivisionError) as caught:
        functions["calls"](99, lambda: 1 / 0)
    assert len(own_frames(caught.value, tmp_path)) == 16
