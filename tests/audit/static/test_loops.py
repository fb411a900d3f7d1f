"""Evaluation loops beside the reference: what changes nothing passes, what changes something is named."""

from __future__ import annotations

import textwrap
from contextlib import suppress
from pathlib import Path

import pytest

from tests.support.adapters.rules import made_adapter
from xpl_cli.audit.engine import engine
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import Outcome, Result
from xpl_cli.audit.rules.options import Options
from xpl_cli.audit.static.loops.functions import loops
from xpl_cli.audit.static.loops.judge import differences
from xpl_cli.audit.static.loops.values import Unclear
from xpl_cli.audit.static.source import Source
from xpl_cli.basics.content import room

SINGLE = """
def eval_one_episode(TASK_ENV, model_client):
    model_client.call(func_name="reset")
    while not TASK_ENV.is_episode_end():
        model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
        actions = model_client.call(func_name="get_action")
        for index, action in enumerate(actions):
            TASK_ENV.take_action(action)
            if TASK_ENV.is_episode_end() or index + 1 == len(actions):
                break
            model_client.call(func_name="update_obs", obs=TASK_ENV.get_obs())
"""
LIMITED = """for _ in range(LIMIT // 8):
        if TASK_ENV.is_episode_end():
            break
"""


def told(folder: Path, text: str) -> list[str]:
    """Return the consequences of what a loop does otherwise."""
    (folder / "deploy.py").write_text(textwrap.dedent(text))
    source = Source(folder)
    return [one.consequence for function in loops(source) for one in differences(function, source)]


def edited(old: str, new: str) -> str:
    """Return the reference with a piece replaced."""
    assert old in SINGLE
    return SINGLE.replace(old, new)


def audited(folder: Path) -> Result:
    """Return what the rule says of an adapter."""
    report = engine.audit(folder, "policy", Options(gates=(Gate.STATIC,), names=("XPL169",)))
    return report.gates[0].results[0]


def test_the_scaffold_and_the_reference_do_the_same(tmp_path: Path) -> None:
    """They are written differently: one shows observations after the action, the other before the chunk."""
    source = Source(made_adapter(tmp_path / "Foo"))
    assert len(loops(source)) == 2
    assert not [one for function in loops(source) for one in differences(function, source)]
    assert not told(tmp_path, (room("templates") / "loop/v1/deploy.py").read_text())


@pytest.mark.parametrize(
    "text",
    [
        edited("actions = model_client.call", "print('asking'); actions = model_client.call"),
        edited("enumerate(actions)", "enumerate(tqdm(actions, desc='chunk'))"),
        edited("        for", "        if actions is None:\n            raise RuntimeError('no answer')\n        for"),
        edited("    while", "    started = time.time()\n    while"),
        edited("TASK_ENV.take_action(action)", "result = TASK_ENV.take_action(dict(action))"),
        edited("obs=TASK_ENV.get_obs())\n        act", "obs={**TASK_ENV.get_obs()})\n        act"),
        edited("    while", "    if os.environ.get('DEBUG'): breakpoint()\n    while"),
        edited("while not TASK_ENV.is_episode_end():", "while True:\n        if TASK_ENV.is_episode_end(): return"),
        edited("    while", "    log = []\n    while").replace("index + 1 ==", "log.append(index) or index + 1 =="),
        edited('"reset")\n', '"reset")\n    with torch.no_grad(), open("log") as log:\n        log.write("x")\n'),
        edited('        actions = model_client.call(func_name="get_action")\n', """
        try:
            actions = model_client.call(func_name="get_action")
        except TimeoutError as error:
            print(error)
            raise
        finally:
            print("asked")
"""),
    ],
)  # fmt: skip
def test_a_difference_that_changes_nothing_passes(tmp_path: Path, text: str) -> None:
    """Logging, progress, timing, copies, other ways to say the same."""
    assert told(tmp_path, text) == []


@pytest.mark.parametrize(
    ("text", "consequence"),
    [
        (edited("obs=TASK_ENV.get_obs())\n        act", "obs=resize(TASK_ENV.get_obs()))\n        act"), "observed"),
        (edited("TASK_ENV.get_obs())\n        act", '{**TASK_ENV.get_obs(), "t": 1})\n        act'), "observed"),
        (edited("TASK_ENV.take_action(action)", "TASK_ENV.take_action(smooth(action))"), "policy answered"),
        (edited("enumerate(actions)", "enumerate(reversed(actions))"), "another order"),
        (edited("enumerate(actions)", "enumerate(actions[::2])"), "another order"),
        (edited("is_episode_end():", "is_episode_end() and not TASK_ENV.success:"), "uses success"),
        (edited("    while", "    TASK_ENV.close()\n    while"), "closes the environment"),
        (edited("while not TASK_ENV.is_episode_end():", "for _ in range(100):"), "goes on when"),
        (f"LIMIT = 300\n{edited('while not TASK_ENV.is_episode_end():', LIMITED)}", "ends while the episode goes on"),
        (edited('    model_client.call(func_name="reset")\n', ""), "does not begin with a reset"),
        (edited("TASK_ENV.take_action(action)\n", "TASK_ENV.take_action(actions[0])\n"), "order"),
    ],
)  # fmt: skip
def test_a_difference_that_changes_something_is_named(tmp_path: Path, text: str, consequence: str) -> None:
    """By what the policy or the environment gets from it."""
    assert any(consequence in one for one in told(tmp_path, text)), told(tmp_path, text)


@pytest.mark.parametrize(
    "body",
    [
        "while True:\n        pass",
        "x = 9\n    while True:\n        x = x * x * x",
        "x = [0] * 10 ** 10",
        "x = list(range(10 ** 12))",
        "x = [1]\n    while True:\n        x = x + x",
        "return eval_one_episode(TASK_ENV, model_client)",
        "yield TASK_ENV.get_obs()",
        "helper.run(TASK_ENV)",
        "match TASK_ENV:\n        case _: pass",
        "model_client.call(func_name=NAMES[0])",
        "TASK_ENV.get_obs_batch(1, 2, 3, 4)",
    ],
)
def test_what_cannot_be_followed_is_left_alone(tmp_path: Path, body: str) -> None:
    """In bounded time and space, and without a verdict."""
    (tmp_path / "deploy.py").write_text(f"def eval_one_episode(TASK_ENV, model_client):\n    {body}\n")
    source = Source(tmp_path)
    with suppress(Unclear):
        list(differences(loops(source)[0], source))


def test_nothing_of_the_loop_is_executed(tmp_path: Path) -> None:
    """Not at import, not in a default, not in a loop."""
    trace = tmp_path / "trace"
    touch = f"open({str(trace)!r}, 'w').close()"
    text = SINGLE.replace(
        "    while", f"    {touch}; __import__('os').system('touch {trace}'); exec({touch!r})\n    while"
    )
    assert told(tmp_path, f"{touch}\n{text}") == []
    assert not trace.exists()


def test_helpers_of_other_files_are_followed(tmp_path: Path) -> None:
    """And what they do is told at its place."""
    adapter = made_adapter(tmp_path / "Foo")
    (adapter / "frames.py").write_text(
        "def frame(env):\n    seen = env.get_obs()\n    seen['extra'] = 1\n    return seen\n"
    )
    batch = (adapter / "deploy.py").read_text().partition("def eval_one_episode_batch")[2]
    text = "from .frames import frame\n" + SINGLE.replace("TASK_ENV.get_obs()", "frame(TASK_ENV)")
    (adapter / "deploy.py").write_text(f"{text}\n\ndef eval_one_episode_batch{batch}".replace(": Any", ""))
    result = audited(adapter)
    (finding,) = result.findings
    assert result.outcome is Outcome.WARN
    assert "something else than the environment observed" in finding.message
    assert finding.evidence is not None
    assert 0 < finding.evidence["tree"]["without_counterpart"] < finding.evidence["tree"]["nodes"]


def test_what_another_rule_names_is_left_to_it(tmp_path: Path) -> None:
    """One difference is one finding."""
    adapter = made_adapter(tmp_path / "Foo")
    text = (adapter / "deploy.py").read_text()
    old = "            if TASK_ENV.is_episode_end():  # it may end anywhere in a chunk\n                break\n"
    assert old in text
    (adapter / "deploy.py").write_text(text.replace(old, ""))
    result = audited(adapter)
    assert result.outcome is Outcome.NOT_APPLICABLE
    assert result.reason == "XPL134 names what eval_one_episode does otherwise"
