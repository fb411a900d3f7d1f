"""A client of whatever policy server deploy.yml names: what adapters that forward (`--kind remote`) are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from xpl import _spec as spec
from xpl.client import makes
from xpl.policy import ConfigError

_SERVER, _TOKEN_FILE, _WIRE = "server", "server_token_file", "wire"


class Remote(Protocol):
    """The operations of a policy that is elsewhere."""

    def update_obs(self, obs: Mapping[str, Any]) -> None:
        """Show the newest observation of one environment."""

    def update_obs_batch(self, obs_list: Sequence[Mapping[str, Any]]) -> None:
        """Show the newest observations of several environments."""

    def get_action(self) -> Any:
        """Return the chunk of the environment that was observed last."""

    def get_action_batch(self, env_idx_list: Sequence[int] | None = None) -> Any:
        """Return the chunks of these environments, in this order."""

    def reset(self) -> None:
        """Start a new episode."""


def connect(config: Mapping[str, Any]) -> Remote:
    """Return a client that is connected.

    Args:
        config: values of deploy.yml. Read: `server`, its address; `server_token_file`, a file with its token; `wire`,
            what it speaks, xpl or openpi; for openpi also `openpi`, what its names mean (`xpl.openpi.names`).

    Raises:
        ConfigError: if one of them is wrong.
        ServerConnectionError: if no connection came about, or another make of server answers.
        EnvironmentMismatchError: if the server says that it serves another robot or another kind of control.
    """
    wire = config.get(_WIRE) or makes.XPL
    if wire not in makes.WIRES:
        raise ConfigError(
            f"{_WIRE} in deploy.yml must be one of {', '.join(makes.WIRES)}, got {wire!r}: {makes.SPOKEN}"
        )
    address, file = config.get(_SERVER), config.get(_TOKEN_FILE)
    if not isinstance(address, str):
        raise ConfigError(f"{_SERVER} in deploy.yml must be an address such as ws://host:8000, got {address!r}")
    token = None if file is None else Path(file).expanduser().read_text(encoding="utf-8").strip()
    if wire == makes.OPENPI:
        from xpl.openpi.client import OpenpiClient

        return OpenpiClient(address, config=config, token=token)
    from xpl.client.client import Client

    environment = {
        "embodiment": config[spec.Deploy.ENV_CFG_TYPE],
        spec.Deploy.ACTION_TYPE: config[spec.Deploy.ACTION_TYPE],
    }
    return Client(address, config=config, token=token, environment=environment)
