"""What lies where in a bundle, and the manifest that names all of it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl_cli import __version__
from xpl_cli.basics import files
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.standard import spec
from xpl_cli.standard.validate import validate
from xpl_cli.submission import archive

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

MANIFEST, AUDIT, CHECKPOINTS, ENVIRONMENT = "submission.json", "audit.json", "checkpoints.json", "environment.json"
RECORDS = "records.jsonl"
DOCUMENTS = {
    AUDIT: "audit",
    CHECKPOINTS: "submission#/$defs/checkpoints",
    ENVIRONMENT: "submission#/$defs/environment",
}
"""Documents besides the manifest, and their schemas."""
_MOST_BYTES = 64 << 20
"""What none of them comes near."""


def document(value: Any) -> bytes:
    """Return a document as a bundle holds it: equal values give equal bytes."""
    return (json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()


def adapter_folder(name: str) -> str:
    """Return where the adapter's own files lie."""
    return f"policy/{name}"


def manifest(
    policy: Mapping[str, Any],
    runs: Sequence[Mapping[str, Any]],
    audit: Mapping[str, Any],
    files: Mapping[str, Path | bytes],
) -> dict[str, Any]:
    """Return the manifest of a bundle.

    Args:
        policy: name, spec and digest of the adapter.
        runs: what each run claims (`claims.claim`).
        audit: the verdict on the adapter.
        files: every other file of the bundle.
    """
    return {
        "schema": spec.schema("submission")["title"],
        "tool": {"name": "xpl", "version": __version__},
        "policy": dict(policy),
        "audit": dict(audit),
        "runs": list(runs),
        "files": {name: _described(files[name]) for name in sorted(files)},
    }


def _described(content: Path | bytes) -> dict[str, Any]:
    if isinstance(content, bytes):
        return {"sha256": hashlib.sha256(content).hexdigest(), "size": len(content)}
    with content.open("rb") as stream:
        return {"sha256": hashlib.file_digest(stream, "sha256").hexdigest(), "size": content.stat().st_size}


@dataclass(frozen=True)
class Bundle:
    """A bundle that was unpacked.

    Attributes:
        folder: where.
        digest: SHA-256 of its manifest, which names the whole.
        manifest: what it says of itself.
        digests: SHA-256 of every file that came with it.
    """

    folder: Path
    digest: str
    manifest: Mapping[str, Any]
    digests: Mapping[str, str]

    @property
    def adapter(self) -> Path:
        """The adapter's folder."""
        return self.folder / adapter_folder(self.manifest["policy"]["name"])

    def read(self, name: str) -> Any:
        """Return a document of it.

        Raises:
            UserError: it is not there, or no JSON.
        """
        return _json(self.folder / name, name)

    def problems(self) -> Iterator[str]:
        """Yield where its files are not those that the manifest names, or its documents not what their schemas say."""
        named = {name: entry["sha256"] for name, entry in self.manifest["files"].items()}
        for name in sorted({*named, *self.digests} - {MANIFEST}):
            if name not in self.digests:
                yield f"{name} is missing"
            elif name not in named:
                yield f"{name} is not named by {MANIFEST}"
            elif named[name] != self.digests[name]:
                yield f"{name} has the SHA-256 {self.digests[name][:12]}..., but {MANIFEST} says {named[name][:12]}..."
        for name, schema in DOCUMENTS.items():
            if name not in self.digests:
                yield f"{name} is missing"
                continue
            for problem in validate(self.read(name), schema):
                yield f"{name}: {problem}"


def opened(path: Path, folder: Path, *, limit: int) -> Bundle:
    """Unpack a bundle into an empty folder.

    Args:
        path: the archive.
        folder: where to.
        limit: most bytes in all.

    Raises:
        UserError: it cannot be unpacked, or has no manifest that says what it is.
    """
    digests = archive.unpack(path, folder, limit=limit)
    if MANIFEST not in digests:
        raise UserError(f"{path} is no bundle: it holds no {MANIFEST}")
    told = _json(folder / MANIFEST, MANIFEST)
    found = validate(told, "submission")
    if found:
        raise UserError(f"{path} is no bundle that this version knows: {MANIFEST}: {found[0]}")
    return Bundle(folder, digests[MANIFEST], told, digests)


def _json(path: Path, name: str) -> Any:
    try:
        return json.loads(files.content(path, _MOST_BYTES), parse_constant=_refuse)
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{name} of the bundle cannot be read: {error}", code=ExitCode.FINDINGS) from None


def _refuse(name: str) -> Any:
    raise ValueError(f"it holds {name}, which is no JSON")
