"""`xpl serve --renew` builds the model anew for every client, in the same process."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.adapters.rules import made_adapter
from xpl import Client
from xpl.client import ClientError
from xpl_cli.packages import environments, package
from xpl_cli.serving.launch import serving

if TYPE_CHECKING:
    from pathlib import Path

COUNTS = """
    def load(self, config):
        {shelf}

        shelf.built = getattr(shelf, "built", 0) + 1
        self.answered = 0
        if shelf.built > 1:
            raise RuntimeError("there is only one robot")

    def predict(self, inputs, envs):
        {shelf}

        self.answered += 1
        pose = np.stack(inputs)
        pose[:, 0] = 0.01 * shelf.built + 0.001 * self.answered
        return np.repeat(pose[:, None], self.chunk, axis=1)
"""


def _counting(folder: Path, shelf: str) -> Path:
    adapter = made_adapter(folder, block=False)
    (adapter / "shelf.py").touch()
    model = adapter / "model.py"
    head, _, _ = model.read_text().partition("    def load(")
    _, _, tail = model.read_text().partition("    def encode(")
    encode, _, _ = tail.partition("    def predict(")
    model.write_text(
        head + "    def encode(" + encode + textwrap.dedent(COUNTS.format(shelf=shelf)).replace("\n", "\n    ")
    )
    return adapter


def _first_joint(url: str, adapter: Path) -> float:
    """Ask once as a client of its own and return the first value of the answer."""
    loaded = package.load(adapter)
    observation: dict[str, Any] = environments.module("offline", "scenario").observation(_robot(loaded))
    with Client(url, config=loaded.config()) as client:
        client.reset()
        client.update_obs(observation)
        step = client.get_action()[0]
    return round(float(next(iter(step.values()))[0]), 4)


def _robot(loaded: package.Package) -> Any:
    from xpl.embodiment import get_embodiment

    return get_embodiment(loaded.config()["env_cfg_type"])


@pytest.mark.parametrize(("options", "answers"), [((), [0.011, 0.012]), (("--renew",), [0.011, 0.011])])
def test_every_client_gets_a_model_that_was_just_built(
    options: tuple[str, ...], answers: list[float], tmp_path: Path
) -> None:
    """Neither the model nor its modules know of the client before; without the option the model goes on."""
    adapter = _counting(tmp_path / "Foo", "from . import shelf")
    with serving(adapter, options=options) as server:
        assert [_first_joint(server.url, adapter) for _ in range(2)] == answers


def test_a_model_that_cannot_be_built_twice_ends_the_server(tmp_path: Path) -> None:
    """The client is told why; nobody is served by half a model."""
    adapter = _counting(tmp_path / "Foo", "import sys as shelf")
    with serving(adapter, options=["--renew"]) as server:
        _first_joint(server.url, adapter)
        with pytest.raises(ClientError, match="only one robot"):
            _first_joint(server.url, adapter)
