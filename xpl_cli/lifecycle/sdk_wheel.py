"""The SDK alone as a wheel, `xpl-sdk`, for the Python of a policy or a simulator.

`xpl-cli` installs the import package `xpl` too, so the two distributions do not go into one environment: `xpl-sdk` is
for interpreters that are too old for the tool (3.9 and 3.10) or that should not carry its dependencies.

The backend that builds `xpl-cli` builds this wheel as well, in this process: no network, no checkout needed (the
sources are the installed ones), and the same sources give the same bytes. `SOURCE_DATE_EPOCH` sets the time stamps.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

import xpl
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import UserError

_README = """\
# xpl-sdk

What robot policies and environment clients import: `import xpl`. Python 3.9 or newer; only numpy at import time.

Extras: `client` (the connection to a policy server: msgpack, websockets), `images` (the image codec: pillow), `data`
(recorded episodes: h5py, pillow).

Do not install it beside `xpl-cli`, which contains the same import package.
"""


@dataclass(frozen=True)
class SdkWheel:
    """A wheel that `build` left in the output folder.

    Attributes:
        path: the wheel file, absolute.
        sha256: digest of its bytes, hexadecimal.
        state: "written" where nothing was, "unchanged" where these bytes were, "replaced" where others were.
    """

    path: Path
    sha256: str
    state: Literal["written", "unchanged", "replaced"]


def build(out: Path, *, overwrite: bool = False) -> SdkWheel:
    """Build `xpl_sdk-<version>-py3-none-any.whl` in the folder `out`, made if missing.

    The file appears whole or not at all.

    Args:
        out: the folder to put the wheel in.
        overwrite: replace a file of the same name that has other contents.

    Raises:
        UserError: such a file is there and `overwrite` is false, or `out` cannot be written to.
    """
    with tempfile.TemporaryDirectory(prefix="xpl-sdk-") as folder:
        built = _build_in(Path(folder))
        content = built.read_bytes()
    path = out.absolute() / built.name
    try:
        state = _compare(path, content)
        if state == "replaced" and not overwrite:
            raise UserError(
                f"{path} exists with other contents",
                hint="pass --overwrite to replace it, or choose another folder with --out",
            )
        if state != "unchanged":
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic.write_file(path, content)
    except OSError as error:
        raise UserError(
            f"the wheel cannot be written to {path}: {error.strerror}", hint="choose another folder with --out"
        ) from error
    return SdkWheel(path, hashlib.sha256(content).hexdigest(), state)


def _build_in(root: Path) -> Path:
    """Lay out the project in the empty folder `root`, build it there and return the wheel."""
    from hatchling.builders.wheel import WheelBuilder

    shutil.copytree(Path(xpl.__file__).parent, root / "xpl", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(_licence(), root / "LICENSE")
    builder = WheelBuilder(str(root), config=_project())
    try:
        return Path(next(builder.build(directory=str(root / "dist"))))
    except (ValueError, OverflowError) as error:  # hatchling reads the variable as it is
        raise UserError(
            f"no wheel can be made with SOURCE_DATE_EPOCH={os.environ.get('SOURCE_DATE_EPOCH', '')[:40]}: {error}"
        ) from None


def _project() -> dict[str, object]:
    """Return what would stand in the SDK's own `pyproject.toml`."""
    return {
        "project": {
            "name": "xpl-sdk",
            "version": xpl.__version__,
            "description": "SDK for robot policies and environment clients: contract, wire codec, client, worker",
            "readme": {"text": _README, "content-type": "text/markdown"},
            "license": "Apache-2.0",
            "license-files": ["LICENSE"],
            "requires-python": ">=3.9",
            # No lower bound: simulators pin their numpy, and the SDK keeps to its oldest functions.
            "dependencies": ["numpy"],
            "optional-dependencies": {
                "client": ["msgpack", "websockets>=12"],
                "images": ["pillow"],
                "data": ["h5py", "pillow"],
            },
        },
        "tool": {
            "hatch": {
                "build": {
                    "ignore-vcs": True,  # the folder is temporary; a `.gitignore` above it has no say
                    "targets": {"wheel": {"packages": ["xpl"], "core-metadata-version": "2.4"}},
                }
            }
        },
    }


def _licence() -> Path:
    """Find the licence text that the wheel has to carry: in the installed metadata, or in the checkout's root."""
    try:
        installed = metadata.files("xpl-cli") or []
    except metadata.PackageNotFoundError:
        installed = []
    shipped = (Path(str(file.locate())) for file in installed if file.match("*.dist-info/licenses/LICENSE"))
    return next(shipped, Path(xpl.__file__).parents[1] / "LICENSE")


def _compare(path: Path, content: bytes) -> Literal["written", "unchanged", "replaced"]:
    """Tell what putting `content` at `path` means."""
    if not path.exists():
        return "written"
    return "unchanged" if path.read_bytes() == content else "replaced"
