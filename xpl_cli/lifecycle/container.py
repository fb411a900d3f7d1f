"""Dockerfile of a policy server for one adapter, from its manifest."""

from __future__ import annotations

import json
import shlex
from typing import TYPE_CHECKING

from xpl import _spec as sdk
from xpl_cli import __version__
from xpl_cli.basics import atomic
from xpl_cli.basics.content import content_folder
from xpl_cli.basics.errors import UserError
from xpl_cli.lifecycle.checkpoints.specification import HUB, declared_checkpoints
from xpl_cli.lifecycle.python_env.plan import CONDA, plan_of

if TYPE_CHECKING:
    from xpl_cli.packages.package import Package

DOCKERFILE, IGNORED = "Dockerfile", ".dockerignore"

_PYTHON = "3.12"
_UV = "0.13.*"
_USER_ID = 10001
_PORT = 8000
_HEALTH = (
    "import urllib.request as u; t = open('/run/secrets/token').read().strip(); "
    "u.urlopen(u.Request('http://127.0.0.1:{port}/healthz', headers={{'Authorization': 'Bearer ' + t}}), timeout=5)"
)


def recipe(package: Package) -> dict[str, str]:
    """Return the files of the recipe by name, for the adapter's folder.

    Raises:
        UserError: if the adapter's environment cannot be created in a container.
    """
    import jinja2

    plan = plan_of(package.path, package.manifest.environment)
    environment = package.manifest.environment
    manager = environment.manager
    if manager in ("path", CONDA):
        raise UserError(
            f"{package.name} uses an environment of the kind {manager}, which the Dockerfile cannot create",
            hint="declare one with a lockfile: manager: uv, lock: requirements.lock.txt",
        )
    locks = [] if plan is None else [path.relative_to(package.path).as_posix() for path in plan.locks()]
    needed = [] if plan is not None else list(environment.requirements)
    hub = any(one.kind == HUB for one in declared_checkpoints(package).values())
    source = (content_folder("templates") / "container" / "Dockerfile.jinja").read_text(encoding="utf-8")
    jinja = jinja2.Environment(  # noqa: S701 - a Dockerfile is no HTML
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    template = jinja.from_string(source)
    text = template.render(
        name=package.name,
        image=package.name.lower().replace("_", "-"),
        port=package.config().get(sdk.Deploy.PORT) or _PORT,
        python=_PYTHON,
        uv=_UV,
        version=__version__,
        extras="[hub]" if hub else "",
        user_id=_USER_ID,
        sources=[sdk.File.POLICY_YML, *locks],
        requirements=" ".join(shlex.quote(one) for one in needed),
        health=json.dumps(_HEALTH.format(port=package.config().get(sdk.Deploy.PORT) or _PORT))[1:-1],
    )
    return {
        DOCKERFILE: text,
        IGNORED: (content_folder("templates") / "container" / "dockerignore").read_text(encoding="utf-8"),
    }


def write(package: Package, files: dict[str, str]) -> list[str]:
    """Write the files into the adapter's folder, and return the names of new ones.

    Raises:
        UserError: if one of them exists with other content.
    """
    for name, text in files.items():
        path = package.path / name
        if path.exists() and path.read_text(encoding="utf-8") != text:
            raise UserError(f"{path} exists with other content and is kept", hint="move it away")
    new = [name for name in files if not (package.path / name).exists()]
    for name in new:
        atomic.write_file(package.path / name, files[name].encode())
    return new
