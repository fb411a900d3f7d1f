"""`xpl new-policy`: what it renders is a valid, runnable adapter; how it writes leaves no half-made folder."""

from __future__ import annotations

import json
import os
import py_compile
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.support import forked
from tests.support.checkout import ROOT, tracked
from tests.support.peer import DEADLINE_S
from xpl.action import check_chunk
from xpl.embodiment import embodiment_names, get_embodiment
from xpl_cli.basics import atomic, content
from xpl_cli.basics.errors import UserError
from xpl_cli.scaffold import adapter as scaffold
from xpl_cli.scaffold import environment, lock
from xpl_cli.scaffold.answers import AdapterAnswers
from xpl_cli.standard import spec
from xpl_cli.standard.validate import validate_yaml_file

ACTION_TYPES = ("joint", "ee")
KEPT = {".xpl/lock.yml", ".xpl/rendered.json", ".xpl/deploy.schema.json", ".xpl/policy.schema.json"}
"""What xpl keeps in a package."""
BASH = shutil.which("bash") or "bash"


def _answers(**changes: Any) -> AdapterAnswers:
    return AdapterAnswers(**{"name": "Foo", **scaffold.defaults(), **changes})


@pytest.fixture(scope="session")
def adapter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an adapter that was scaffolded with nothing but a name; not to be changed."""
    target = tmp_path_factory.mktemp("default") / "policy" / "Foo"
    assert scaffold.write(scaffold.render(_answers()), target) == "written"
    return target


def _xpl(*arguments: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return forked.run("new-policy", *arguments, cwd=cwd, env={**os.environ, **environment})


def _tree(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# -- what is rendered --------------------------------------------------------------------------------------------------


def _state(robot: str) -> dict[str, Any]:
    """Return an observation with every state of a robot, each value another one, poses of unit length."""
    generator = np.random.default_rng(3)
    values: dict[str, Any] = {}
    for action_type in ACTION_TYPES:
        for key, dim in get_embodiment(robot).dims(action_type).items():
            values[key] = generator.uniform(0.1, 0.9, dim)
            if key.endswith("pose"):
                values[key][3:] /= np.linalg.norm(values[key][3:])
    return {"state": values}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("eval_only", [False, True])
@pytest.mark.parametrize("action_type", ACTION_TYPES)
@pytest.mark.parametrize("robot", embodiment_names())
def test_every_combination_is_a_valid_adapter_that_holds_the_pose(
    robot: str, action_type: str, eval_only: bool, tmp_path: Path
) -> None:
    target = tmp_path / "Foo"
    files = scaffold.render(_answers(embodiment=robot, action_type=action_type, eval_only=eval_only, chunk=3))
    scaffold.write(files, target)

    package = spec.data("package")["files"]
    expected = {*package["required"], package["manifest"], ".gitignore", *KEPT}
    assert set(files) == expected | (set() if eval_only else set(package["training"]))
    assert validate_yaml_file(target / "policy.yml", "policy") == []
    assert validate_yaml_file(target / "deploy.yml", "deploy") == []
    for script in target.glob("*.sh"):
        assert os.access(script, os.X_OK)
        subprocess.run([BASH, "-n", script], check=True)
    for module in target.glob("*.py"):
        py_compile.compile(str(module), cfile=str(tmp_path / "compiled"), doraise=True)

    config = yaml.safe_load((target / "deploy.yml").read_text())
    model = content.load_module(target / "model.py").Model(
        {**config, "manifest": yaml.safe_load((target / "policy.yml").read_text())}
    )
    observation = _state(robot)
    model.update_obs(observation)
    chunk = model.get_action()
    check_chunk(chunk, get_embodiment(robot), action_type)
    assert len(chunk) == 3
    for step in chunk:
        for key, value in step.items():
            np.testing.assert_allclose(value, observation["state"][key], atol=1e-6)


def test_rendered_python_keeps_to_the_rules_of_this_repository(adapter: Path, tmp_path: Path) -> None:
    """What authors start from has no finding of the linter, except of names and tests that are not ours."""
    ruff = shutil.which("ruff", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if ruff is None:
        pytest.skip("ruff is not installed")
    env = environment.render_env(environment.EnvAnswers(name="Bar", **environment.env_defaults()))
    scaffold.write(env, tmp_path / "Bar")
    config = ["--no-cache", "--config", str(ROOT / "pyproject.toml")]
    # ARG002 is off for the policy/ of this repository too: signatures of the contract are fixed.
    lint = [*config, "--config", 'lint.isort.known-first-party=["xpl"]', "--ignore", "N999,ARG002,INP001,S101"]
    for command in (["check", *lint], ["format", "--check", *config]):
        completed = subprocess.run(
            [ruff, *command, str(adapter), str(tmp_path / "Bar")], capture_output=True, text=True, check=False
        )
        assert completed.returncode == 0, completed.stdout


def test_scripts_are_clean_for_shellcheck(adapter: Path) -> None:
    shellcheck = shutil.which("shellcheck")
    if shellcheck is None:
        pytest.skip("shellcheck is not installed")
    completed = subprocess.run([shellcheck, *adapter.glob("*.sh")], capture_output=True, text=True, check=False)
    assert completed.returncode == 0, completed.stdout


def test_the_same_answers_give_the_same_bytes(adapter: Path) -> None:
    kept = lock.read(adapter)
    assert kept is not None
    assert kept.template == "policy"
    assert scaffold.render(scaffold.recorded_answers(kept)) == _tree(adapter)


@pytest.mark.parametrize("name", ["yes", "null", "NO", "_1", "e1"])
def test_a_name_that_yaml_takes_for_something_else_stays_a_name(name: str) -> None:
    files = scaffold.render(_answers(name=name))
    assert yaml.safe_load(files["policy.yml"])["name"] == yaml.safe_load(files["deploy.yml"])["policy_name"] == name


@pytest.mark.parametrize(
    ("python", "environment"),
    [
        ("", {"manager": "none"}),
        (">=3.9,<3.12", {"manager": "uv", "python": ">=3.9,<3.12"}),
        ("/opt/my env/bin/python", {"manager": "path", "python": "/opt/my env/bin/python"}),
    ],
)
def test_the_policys_own_python_is_declared(python: str, environment: dict[str, str], tmp_path: Path) -> None:
    scaffold.write(scaffold.render(_answers(python=python)), tmp_path / "Foo")
    assert yaml.safe_load((tmp_path / "Foo" / "policy.yml").read_text())["environment"] == environment
    assert validate_yaml_file(tmp_path / "Foo" / "policy.yml", "policy") == []


def test_placeholders_are_counted_with_their_place(adapter: Path) -> None:
    marker = spec.data("package")["placeholder"]
    placeholders = scaffold.placeholders(_tree(adapter))
    assert (
        len(placeholders)
        == sum(content.decode().count(marker) for name, content in _tree(adapter).items() if name not in KEPT)
        > 5
    )
    for placeholder in placeholders:
        line = (adapter / placeholder.file).read_text().splitlines()[placeholder.line - 1]
        assert f"{marker}: {placeholder.text}" in line


OURS = sorted(path.parent.name for path in tracked("policy/*/policy.yml"))


@pytest.mark.parametrize("name", OURS)
def test_scripts_of_our_own_policies_are_those_of_the_template(name: str) -> None:
    """Scripts and loop are rendered, never edited by hand; where a lock tells the template, all of it is of today."""
    folder = ROOT / "policy" / name
    package_lock = lock.read(folder)
    if package_lock is None:
        rendered = scaffold.render(scaffold.answers_of(**{**scaffold.defaults(), "name": name, "eval_only": True}))
        same = [file for file in rendered if file.endswith(".sh")] + ["deploy.py"]
    else:
        rendered = scaffold.render(scaffold.recorded_answers(package_lock))
        same = [file for file in rendered if file in {*package_lock.generated, "deploy.py", ".gitignore", lock.PATH}]
    assert [file for file in same if (folder / file).read_bytes() != rendered[file]] == []
    assert {path.name for path in tracked(f"policy/{name}/*.sh")} == {file for file in same if file.endswith(".sh")}


# -- the scripts -------------------------------------------------------------------------------------------------------


def _recorder(tmp_path: Path) -> Path:
    """Return a program that stands for xpl and writes down its arguments."""
    program = tmp_path / "record"
    program.write_text('#!/usr/bin/env bash\nprintf "%s\\0" "$@" >"$RECORD"\n')
    program.chmod(0o755)
    return program


def _run_script(script: Path, arguments: list[str], tmp_path: Path) -> list[str]:
    record = tmp_path / "arguments"
    environment = {**os.environ, "XPL": str(_recorder(tmp_path)), "RECORD": str(record)}
    # From another folder: a script finds its adapter wherever it is called from.
    subprocess.run([script, *arguments], check=True, env=environment, cwd=tmp_path)
    return record.read_text().split("\0")[:-1]


def _settings(recorded: list[str]) -> dict[str, Any]:
    pairs = [recorded[index + 1].partition("=") for index, word in enumerate(recorded) if word == "--set"]
    return {key: yaml.safe_load(value) for key, _, value in pairs}


AWKWARD = {"bench_name": 'it\'s a "bench" $HOME `x`', "task_name": "", "ckpt_name": "007", "env_cfg_type": "a: b # c"}


@pytest.mark.parametrize("script", list(spec.data("package")["scripts"]))
def test_arguments_reach_xpl_as_they_were_given(script: str, adapter: Path, tmp_path: Path) -> None:
    names = [name.strip("[]") for name in spec.data("package")["scripts"][script]]
    values = {name: AWKWARD.get(name, f"value of {name}") for name in names}
    values.update({"seed": "3", "action_type": "joint"})
    if "port" in values:
        values["port"] = "18000"
    recorded = _run_script(adapter / script, [*values.values(), "--extra", "more words"], tmp_path)

    assert recorded[1] == str(adapter)
    assert recorded[-2:] == ["--extra", "more words"]
    settings = _settings(recorded)
    known = spec.schema("deploy")["properties"]
    for name, value in values.items():
        if name in settings:
            assert name in known
            assert settings[name] == (3 if name == "seed" else value)
        elif name in ("port", "server_ip") and "--connect" in recorded:
            assert recorded[recorded.index("--connect") + 1] == f"ws://{values['server_ip']}:18000"
        else:
            assert value in recorded, name


@pytest.mark.parametrize("script", list(spec.data("package")["scripts"]))
def test_too_few_arguments_are_answered_by_the_list_of_them(script: str, adapter: Path) -> None:
    completed = subprocess.run([adapter / script, "one"], capture_output=True, text=True, check=False)
    assert (completed.returncode, completed.stdout) == (2, "")
    assert f"{script} {' '.join(spec.data('package')['scripts'][script])}" in completed.stderr


def test_optional_arguments_may_be_left_out(adapter: Path, tmp_path: Path) -> None:
    server = _run_script(adapter / "setup_eval_policy_server.sh", [*"abcdef0g", "18000"], tmp_path)
    assert "--host" not in server
    client = _run_script(adapter / "setup_eval_env_client.sh", [*"abcdef0gh", "18000"], tmp_path)
    assert client[client.index("--connect") + 1] == "ws://localhost:18000"


def test_install_calls_xpl_for_its_own_folder(adapter: Path, tmp_path: Path) -> None:
    assert _run_script(adapter / "install.sh", ["--extra"], tmp_path) == ["install", str(adapter), "--extra"]


# -- the evaluation loop -----------------------------------------------------------------------------------------------


class _Bench:
    """A task environment that counts: an environment ends after its number of steps."""

    def __init__(self, lengths: list[int]) -> None:
        self.lengths = lengths
        self.taken = [0] * len(lengths)
        self.log: list[tuple[str, Any]] = []

    def get_obs(self) -> str:
        return f"0@{self.taken[0]}"

    def get_obs_batch(self, env_idx_list: list[int]) -> list[str]:
        return [f"{env}@{self.taken[env]}" for env in env_idx_list]

    def take_action(self, action: str) -> None:
        self.take_action_batch([action], [0])

    def take_action_batch(self, actions: list[str], env_idx_list: list[int]) -> None:
        assert len(actions) == len(env_idx_list)
        assert set(env_idx_list) == set(self.get_running_env_idx_list()), "acted on an environment that has ended"
        for env in env_idx_list:
            self.taken[env] += 1
        self.log.append(("act", list(actions)))

    def is_episode_end(self) -> bool:
        return not self.get_running_env_idx_list()

    def get_running_env_idx_list(self) -> list[int]:
        return [env for env, length in enumerate(self.lengths) if self.taken[env] < length]

    def call(self, func_name: str, obs: Any = None) -> Any:
        self.log.append((func_name, obs))
        envs = obs if func_name == "get_action_batch" else [0]
        chunks = [[f"{env}:{self.taken[env] + step}" for step in range(3)] for env in envs]
        return {"get_action": chunks[0], "get_action_batch": chunks}.get(func_name)


def test_the_loop_stops_inside_a_chunk_and_shows_every_new_observation(adapter: Path) -> None:
    bench = _Bench([4])
    content.load_module(adapter / "deploy.py").eval_one_episode(bench, bench)
    names = [name for name, _ in bench.log]
    first = ["get_action", "act", "update_obs", "act", "update_obs", "act", "update_obs"]
    assert names == ["reset", "update_obs", *first, "get_action", "act"]
    assert [value for name, value in bench.log if name == "act"] == [["0:0"], ["0:1"], ["0:2"], ["0:3"]]


def test_the_batched_loop_drops_environments_as_they_end(adapter: Path) -> None:
    bench = _Bench([2, 4, 1])
    content.load_module(adapter / "deploy.py").eval_one_episode_batch(bench, bench)
    assert bench.log == [
        ("reset", None),
        ("update_obs_batch", ["0@0", "1@0", "2@0"]),
        ("get_action_batch", [0, 1, 2]),
        ("act", ["0:0", "1:0", "2:0"]),
        ("update_obs_batch", ["0@1", "1@1"]),
        ("act", ["0:1", "1:1"]),
        ("update_obs_batch", ["1@2"]),
        ("act", ["1:2"]),
        ("update_obs_batch", ["1@3"]),
        ("get_action_batch", [1]),
        ("act", ["1:3"]),
    ]


def test_a_loop_over_nothing_asks_for_nothing(adapter: Path) -> None:
    bench = _Bench([0, 0])
    content.load_module(adapter / "deploy.py").eval_one_episode_batch(bench, bench)
    assert [name for name, _ in bench.log] == ["reset"]


# -- names and options -------------------------------------------------------------------------------------------------


NAMES = [
    *("class", "None", "1abc", "my-policy", "..", "a/b", "/absolute", "json", "numpy", "xpl", "__init__"),
    *("naïve", "ﬁne", "", "a b", "a\n"),
]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_cannot_be_imported_is_refused_with_one_that_can(name: str) -> None:
    with pytest.raises(UserError) as caught:
        scaffold.check_name(name)
    scaffold.check_name(str(caught.value.hint).removeprefix("a valid name: "))


@given(st.text(max_size=200))
def test_every_suggestion_is_accepted(name: str) -> None:
    scaffold.check_name(scaffold.suggest_name(name))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--embodiment", "arx5"], "arx_x5"),
        (["--family", "difusion"], "diffusion"),
        (["--dir", "file"], "file"),
    ],
)
def test_an_option_that_is_not_allowed_is_a_usage_error(arguments: list[str], message: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    completed = _xpl("Foo", *arguments, cwd=tmp_path)
    assert (completed.returncode, completed.stdout) == (2, "")
    assert message in completed.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


# -- how it is written -------------------------------------------------------------------------------------------------


def test_json_tells_files_places_and_next_commands(tmp_path: Path) -> None:
    completed = _xpl("Foo", "--json", "--dir", "my policies", "--python", "3.10", cwd=tmp_path)
    answer = json.loads(completed.stdout)
    assert answer["schema"] == "xpl.new-policy/1"
    assert answer["path"] == "my policies/Foo"
    assert set(answer["files"]) == set(_tree(tmp_path / answer["path"]))
    assert set(answer["placeholders"][0]) == {"file", "line", "text"}
    assert [shlex.split(command) for command in answer["next"]] == [
        ["xpl", "install", "my policies/Foo"],
        ["xpl", "audit", "my policies/Foo"],
    ]


def test_a_second_run_changes_nothing(tmp_path: Path) -> None:
    _xpl("Foo", cwd=tmp_path)
    before = _tree(tmp_path)
    again = _xpl("Foo", cwd=tmp_path)
    assert (again.returncode, again.stdout.splitlines()[0][:38]) == (0, "policy/Foo: already there, unchanged, ")
    other = _xpl("Foo", "--chunk", "4", cwd=tmp_path)
    assert other.returncode == 2
    assert ".xpl/lock.yml, .xpl/rendered.json, README.md, model.py, policy.yml" in other.stderr
    assert _tree(tmp_path) == before


def test_a_dry_run_writes_nothing(tmp_path: Path) -> None:
    completed = _xpl("Foo", "--dry-run", cwd=tmp_path)
    assert (completed.returncode, list(tmp_path.iterdir())) == (0, [])
    assert "17 files would be written" in completed.stdout
    assert "+ policy/Foo/model.py" in completed.stderr


def test_overwriting_keeps_what_the_author_added(tmp_path: Path) -> None:
    target = tmp_path / "Foo"
    scaffold.write(scaffold.render(_answers()), target)
    (target / "model.py").write_text("mine")
    (target / "checkpoints" / "run").mkdir(parents=True)
    weights = target / "checkpoints" / "run" / "weights.bin"
    weights.write_bytes(b"large")
    (target / "data").symlink_to("/nowhere")
    inode = weights.stat().st_ino
    files = scaffold.render(_answers(chunk=4))
    with pytest.raises(UserError, match=r"differs from the template in 5 files"):
        scaffold.write(files, target)
    assert scaffold.write(files, target, overwrite=True) == "replaced"
    assert {name: content for name, content in _tree(target).items() if name in files} == files
    assert (weights.read_bytes(), weights.stat().st_ino) == (b"large", inode)
    assert (target / "data").readlink() == Path("/nowhere")
    assert [path.name for path in tmp_path.iterdir()] == ["Foo"]


def test_an_empty_folder_is_as_good_as_none(tmp_path: Path) -> None:
    (tmp_path / "Foo").mkdir()
    assert scaffold.write(scaffold.render(_answers()), tmp_path / "Foo") == "written"


@pytest.mark.parametrize("can_exchange", [True, False])
def test_a_failure_while_writing_leaves_everything_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, can_exchange: bool
) -> None:
    target = tmp_path / "deep" / "er" / "Foo"
    files = scaffold.render(_answers())

    def fail(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(atomic, "_put", fail)
        with pytest.raises(KeyboardInterrupt):
            scaffold.write(files, target)
    assert list(tmp_path.iterdir()) == []

    scaffold.write(files, target)
    (target / "mine.txt").write_text("mine")
    before = _tree(tmp_path)
    monkeypatch.setattr(atomic, "_exchange", fail if can_exchange else lambda *_: False)
    if not can_exchange:
        rename = Path.rename
        monkeypatch.setattr(Path, "rename", lambda self, to: fail() if self.name != "Foo" else rename(self, to))
    with pytest.raises(KeyboardInterrupt):
        scaffold.write(scaffold.render(_answers(chunk=2)), target, overwrite=True)
    assert _tree(tmp_path) == before


def test_folders_are_swapped_where_the_system_cannot_exchange_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atomic, "_exchange", lambda *_: False)
    scaffold.write(scaffold.render(_answers()), tmp_path / "Foo")
    files = scaffold.render(_answers(chunk=2))
    assert scaffold.write(files, tmp_path / "Foo", overwrite=True) == "replaced"
    assert _tree(tmp_path / "Foo") == files
    assert [path.name for path in tmp_path.iterdir()] == ["Foo"]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("trap", ["", 'trap "" INT; '], ids=["in front", "in the background"])
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_command_leaves_nothing_behind(kind: signal.Signals, trap: str, tmp_path: Path) -> None:
    """Stopped in the middle of writing: no folder, no temporary one, exit code 130; also where a shell ignored it."""
    stops = (
        "import os, signal; from xpl_cli import main; from xpl_cli.basics import atomic\n"
        f"atomic._put = lambda *_: os.kill(os.getpid(), {int(kind)})\n"
        "import sys; sys.argv = ['xpl', 'new-policy', 'Foo']; main.run()\n"
    )
    scratch = tmp_path / "scratch"
    work = tmp_path / "work"
    scratch.mkdir()
    work.mkdir()
    completed = subprocess.run(
        ["/bin/sh", "-c", f'{trap}exec "$@"', "sh", sys.executable, "-c", stops],
        check=False,
        capture_output=True,
        cwd=work,
        env={**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(scratch)},
    )
    assert completed.returncode == 130, completed.stderr
    assert list(work.iterdir()) == list(scratch.iterdir()) == []


def test_rendering_needs_no_git_and_reads_no_settings_of_the_user(tmp_path: Path) -> None:
    home = tmp_path / "home"
    settings = home / "copier" / "settings.yml"
    settings.parent.mkdir(parents=True)
    settings.write_text("defaults: {chunk: 99, name: Bar}\ntrust: ['/']\n")
    completed = _xpl("Foo", cwd=tmp_path, PATH="", XDG_CONFIG_HOME=str(home), HOME=str(home))
    assert completed.returncode == 0, completed.stderr
    assert _tree(tmp_path / "policy" / "Foo") == scaffold.render(_answers())
    assert {path.name for path in home.rglob("*")} == {"copier", "settings.yml"}


def test_a_person_at_a_terminal_is_asked_and_a_pipe_is_not(tmp_path: Path) -> None:
    import pty

    parent, child = pty.openpty()
    os.write(parent, b"nonsense\npiper\n\n\n")
    environment = {key: value for key, value in os.environ.items() if key != "CI"}
    with subprocess.Popen(
        [sys.executable, "-m", "xpl_cli", "new-policy", "Foo"],
        stdin=child,
        stdout=child,
        stderr=subprocess.PIPE,
        cwd=tmp_path,
        env={**environment, "PYTHONPATH": str(ROOT)},
    ) as process:
        os.close(child)
        assert process.wait(DEADLINE_S) == 0
        assert process.stderr is not None
        assert b"expected one of" in process.stderr.read()
    os.close(parent)
    answers = yaml.safe_load((tmp_path / "policy" / "Foo" / lock.PATH).read_text())["answers"]
    assert (answers["embodiment"], answers["action_type"]) == ("piper", "joint")
