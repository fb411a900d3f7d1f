"""`xpl container`: the Dockerfile is well formed, follows good practice, and its pieces work; nothing is built here."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.peer import xpl
from xpl_cli import __version__
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import UserError
from xpl_cli.lifecycle import container
from xpl_cli.packages import package
from xpl_cli.serving.launch import running_server

INSTRUCTIONS = frozenset(
    ("ARG", "CMD", "COPY", "ENTRYPOINT", "ENV", "EXPOSE", "FROM", "HEALTHCHECK", "RUN", "STOPSIGNAL", "USER", "VOLUME",
     "WORKDIR")
)  # fmt: skip


def instructions(text: str) -> list[tuple[str, str]]:
    """Return the instructions of a Dockerfile, with lines that go on joined."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n\s*", "", "\n".join(lines))
    return [(word, rest) for word, _, rest in (line.partition(" ") for line in joined.splitlines())]


def adapter(folder: Path, environment: dict[str, Any], **manifest: Any) -> package.Package:
    place = folder / "My_Policy"
    place.mkdir()
    (place / "deploy.yml").write_text("env_cfg_type: arx_x5\n")
    (place / "policy.yml").write_text(json.dumps({"spec": "v1", "environment": environment, **manifest}))
    return package.load(place)


CASES: dict[str, dict[str, Any]] = {
    "none": {"manager": "none", "requirements": ["numpy>=2", "torch"]},
    "lock": {"manager": "uv", "python": "3.10", "lock": "locks/requirements.txt"},
    "uv": {"manager": "uv", "lock": "uv.lock"},
}


@pytest.mark.parametrize("case", CASES)
def test_the_recipe_is_sound(case: str, tmp_path: Path) -> None:
    """Known instructions, a pinned base, pinned tools, no shell tricks, an ordinary user, JSON where it is due."""
    text = container.recipe(adapter(tmp_path, CASES[case]))[container.DOCKERFILE]
    found = instructions(text)
    words = [word for word, _ in found]
    assert set(words) <= INSTRUCTIONS
    assert words[0] == "ARG"
    empty, base = (rest for word, rest in found if word == "FROM")
    assert empty == "scratch AS xpl"
    assert ":" in base
    assert "latest" not in base
    assert [rest for word, rest in found if word == "USER"][-1] == "policy"
    assert text.endswith("\n")
    assert "{{" not in text
    runs = [rest for word, rest in found if word == "RUN"]
    assert not any(re.search(r"sudo|curl|wget|\| *sh|apt ", run) for run in runs)
    declared = dict(re.findall(r'ARG (\w+)="?([^"\n]+)"?', text))
    assert set(re.findall(r"\$\{(\w+)\}", text)) == set(declared)
    assert "==" in declared["UV"]
    for word, rest in found:
        if word == "ENTRYPOINT":
            program = json.loads(rest)
            assert subprocess.run(["/bin/sh", "-n", "-c", program[2]], check=False).returncode == 0
        if word == "RUN":
            assert subprocess.run(["/bin/sh", "-n", "-c", _shell(rest)], check=False).returncode == 0


def test_the_environment_is_made_before_the_rest_is_copied(tmp_path: Path) -> None:
    """So that a change of the code costs no installation; the lock lies where policy.yml says."""
    text = container.recipe(adapter(tmp_path, CASES["lock"]))[container.DOCKERFILE]
    found = [f"{word} {rest}" for word, rest in instructions(text)]
    order = [
        "COPY --chown=policy:policy policy.yml ./policy.yml",
        "COPY --chown=policy:policy locks/requirements.txt ./locks/requirements.txt",
        "RUN xpl install .",
        "COPY --chown=policy:policy . .",
    ]
    assert [line for line in found if line in order] == order


def _shell(run: str) -> str:
    """Return what the shell gets of a RUN instruction."""
    return re.sub(r"^(--\w+=\S+ +)+", "", run)


def test_the_tool_comes_from_a_wheel_and_no_index_is_asked_for_its_name(tmp_path: Path) -> None:
    """The wheel of this version in the folder that the build names; without one the build ends there."""
    hub = {"name": "a", "source": "hf://owner/model", "revision": "0" * 40, "sha256": "0" * 64}
    text = container.recipe(adapter(tmp_path, CASES["uv"], checkpoints=[hub]))[container.DOCKERFILE]
    assert "--build-context xpl=" in text
    (run,) = (rest for word, rest in instructions(text) if word == "RUN" and "from=xpl" in rest)
    mounted = tmp_path / "mounted"
    mounted.mkdir()
    first = _shell(run).partition("&& useradd")[0].replace("/mnt/xpl", str(mounted))
    script = f'pip() {{ printf "%s\\n" "$@"; }}; UV=uv; {first}'
    shell = ["/bin/sh", "-c", script]
    assert subprocess.run(shell, capture_output=True, text=True, check=False).returncode != 0
    wheel = mounted / f"xpl_cli-{__version__}-py3-none-any.whl"
    wheel.touch()
    done = subprocess.run(shell, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["install", f"{wheel}[hub]", "uv"]


def test_what_the_manifest_says_is_in_it(tmp_path: Path) -> None:
    """Requirements of a policy that runs in the tool's own Python."""
    text = container.recipe(adapter(tmp_path, CASES["none"]))[container.DOCKERFILE]
    (run,) = (rest for word, rest in instructions(text) if rest.startswith("pip install 'numpy"))
    assert shlex.split(run)[2:] == ["numpy>=2", "torch"]


@pytest.mark.parametrize("environment", [{"manager": "path", "python": "/x"}, {"manager": "conda", "lock": "c.yml"}])
def test_what_a_container_cannot_have_is_refused(environment: dict[str, Any], tmp_path: Path) -> None:
    """An interpreter of this machine is not there."""
    with pytest.raises(UserError, match="cannot create"):
        container.recipe(adapter(tmp_path, environment))


def test_the_health_check_asks_a_real_server(tmp_path: Path) -> None:
    """With the token; a server that is ready answers, and without the token it does not."""
    token = tmp_path / "token"
    token.write_text("a-word-of-sixteen-letters")
    token.chmod(0o600)
    folder = content_folder("policy") / "demo_policy"
    text = container.recipe(package.load(folder))[container.DOCKERFILE]
    check = json.loads(dict(instructions(text))["HEALTHCHECK"].partition("CMD ")[2])
    assert check[:2] == ["python", "-c"]
    with running_server(folder, options=["--token-file", str(token)]) as server:
        port = server.url.rpartition(":")[2]
        code = check[2].replace("/run/secrets/token", str(token)).replace("127.0.0.1:8000", f"127.0.0.1:{port}")
        assert subprocess.run([sys.executable, "-c", code], check=False, env={**os.environ}).returncode == 0
        token.write_text("another-word-of-sixteen")
        assert subprocess.run([sys.executable, "-c", code], check=False, capture_output=True).returncode != 0


def test_it_is_printed_or_written_and_never_over_an_authors_own(tmp_path: Path) -> None:
    """Printing changes nothing; writing twice is no difference; another file stays."""
    adapter(tmp_path, CASES["uv"])
    printed = xpl("container", "My_Policy", cwd=tmp_path)
    assert printed.stdout.startswith("# syntax=")
    folder = tmp_path / "My_Policy"
    assert not (folder / "Dockerfile").exists()
    answer = json.loads(xpl("container", "My_Policy", "--write", "--json", cwd=tmp_path).stdout)
    assert answer["written"] == ["Dockerfile", ".dockerignore"]
    assert (folder / "Dockerfile").read_text() == printed.stdout
    assert {"checkpoints", ".venv*", "token"} <= set((folder / ".dockerignore").read_text().splitlines())
    (folder / "Dockerfile").write_text("FROM mine\n")
    refused = xpl("container", "My_Policy", "--write", cwd=tmp_path)
    assert (refused.returncode, (folder / "Dockerfile").read_text()) == (2, "FROM mine\n")
