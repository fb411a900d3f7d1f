"""An external policy server: the announcement of its policy, whose package may not be here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from xpl import Client
from xpl import _spec as sdk
from xpl.client import ClientError
from xpl.client.agreement import AnnouncementError, validate_announcement
from xpl.manifest import Manifest
from xpl_cli.basics.errors import ExitCode, NotFoundError, UserError
from xpl_cli.packages import package
from xpl_cli.serving.secrets import client_tls_context

if TYPE_CHECKING:
    from xpl.contract import Announcement, Config
    from xpl_cli.packages.package import Package

WHOLE_CHUNK: Final = 1 << 16
"""A horizon that no chunk reaches: where the adapter's own loop is not here, ours executes whole chunks."""
_POLICY = "policy"


@dataclass(frozen=True)
class RemoteServer:
    """How to reach a running policy server.

    Attributes:
        url: its address.
        token: bearer token, if it requires one.
        ca_file: certificate authority for `wss://`, in addition to the system's.
    """

    url: str
    token: str | None = None
    ca_file: Path | None = None


def fetch_announcement(remote: RemoteServer, config: Config) -> Announcement:
    """Connect to a server, and return its announcement of itself and of its policy.

    A server of another implementation that announces nothing still reveals its generation.

    Args:
        remote: the server.
        config: timing keys of deploy.yml.

    Raises:
        UserError: there is no answer, or the announcement is invalid.
    """
    context = None if remote.ca_file is None else client_tls_context(remote.ca_file)
    try:
        with Client(remote.url, config=config, token=remote.token, ssl_context=context) as client:
            announcement = {_POLICY: validate_announcement(client.policy)}
            return {**announcement, "generation": 1 if client.server_instance_id is None else 2}
    except AnnouncementError as error:
        raise UserError(f"{remote.url}: what it announces of its policy cannot be understood: {error}") from None
    except (ClientError, ValueError, OSError) as error:
        raise UserError(f"{remote.url}: {error}", code=ExitCode.NOT_RUN) from None


def resolve_package(name: str, announcement: Announcement | None, overrides: Config) -> Package:
    """Return an adapter, or a substitute made of a server's announcement if its package is not here.

    Args:
        name: the adapter, or a name for it.
        announcement: of the server; None without a server.
        overrides: keys of deploy.yml.

    Raises:
        NotFoundError: the package is not here, and there is no server.
        UserError: the package is not here, and the server does not announce its robot.
    """
    try:
        return package.load(name, overrides)
    except NotFoundError:
        if announcement is None:
            raise
    policy = announcement[_POLICY]
    deploy = {
        sdk.Deploy.ENV_CFG_TYPE: policy.get("embodiment"),
        sdk.Deploy.ACTION_TYPE: policy.get(sdk.Deploy.ACTION_TYPE),
    }
    deploy = {key: overrides.get(key) or value for key, value in deploy.items()}
    if deploy[sdk.Deploy.ENV_CFG_TYPE] is None:
        raise UserError(
            f"{name} is not here, and its server does not announce its robot",
            hint=f"--set {sdk.Deploy.ENV_CFG_TYPE}=NAME, and --set {sdk.Deploy.ACTION_TYPE}=joint or ee",
        )
    manifest = {key: policy[key] for key in ("embodiments", "action_types", "cameras") if policy.get(key) is not None}
    if policy.get("inputs") is not None:
        # Optional inputs are not announced: the policy gets all cameras.
        manifest["inputs"] = {"required": policy["inputs"], "optional": [sdk.Obs.VISION]}
    return package.Package(
        Path.cwd() / Path(name).name, {k: v for k, v in deploy.items() if v is not None}, Manifest.parse(manifest)
    )
