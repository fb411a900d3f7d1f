"""Bundles that hold together although nobody played their run, and what a stranger may make of them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from tests.support.checkout import ROOT
from tests.support.recordings.runs import Faults, renamed, synthetic_run
from xpl_cli.environments import check
from xpl_cli.evaluation.records import fingerprints, records
from xpl_cli.packages import environments, package
from xpl_cli.submission import archive, bundle, claims, prepare

ADAPTER = ROOT / "policy" / "scripted_expert"
_INTERPRETER: dict[str, Any] = {"python": "3.11.7", "installed": {}, "lock": None}


def write_bundle(folder: Path) -> dict[str, bytes]:
    """Return the files of a bundle but for its manifest, which `archived` makes of them.

    Args:
        folder: an empty one to work in.
    """
    run = recorded(folder / "run")
    files: dict[str, bytes] = {
        bundle.AUDIT: _audit(),
        bundle.CHECKPOINTS: bundle.document({"loaded": None, "name": None, "declared": []}),
        bundle.ENVIRONMENT: bundle.document({"policy": _INTERPRETER, "environments": {"mujoco": _INTERPRETER}}),
        f"{claims.folder(run)}/{records.FILE}": (run.folder / records.FILE).read_bytes(),
    }
    base = bundle.adapter_folder(ADAPTER.name)
    return files | {f"{base}/{path}": (ADAPTER / path).read_bytes() for path in fingerprints.files_of(ADAPTER)}


def manifest(files: Mapping[str, bytes], folder: Path) -> dict[str, Any]:
    """Return the manifest of such files; what it claims is of the run that `made` recorded."""
    run = records.read(folder / "run")
    (target,) = json.loads(files[bundle.AUDIT])["targets"]
    audit = {key: target[key] for key in ("verdict", "statement", "proven", "unproven")}
    entries = {name: bundle.BundledFile.of(content) for name, content in files.items()}
    return bundle.BundleManifest(prepare.describe_adapter(run), [claims.claim_of(run)], entries, audit).as_json()


def archived(path: Path, files: Mapping[str, bytes], told: Mapping[str, Any]) -> Path:
    """Write a bundle; its manifest names the files as they are."""
    entries = {
        name: {"sha256": hashlib.sha256(content).hexdigest(), "size": len(content)} for name, content in files.items()
    }
    archive.write(path, {**files, bundle.MANIFEST: bundle.document({**told, "files": entries})})
    return path


def recorded(folder: Path) -> records.Run:
    """Record a run of the adapter, of two episodes that succeeded, which nobody played."""
    faults = Faults(policy=0.0, retried=0.0)
    first = check.seeds(environments.find("mujoco"), "lift_cube", "clean")[0]
    told: dict[str, Any] = {"episodes": 2, "rate": 1.0, "policy": ADAPTER.name, "faults": faults, "first_seed": first}
    synthetic_run(folder, ("lift_cube",), ("clean",), **told)
    file = folder / records.FILE
    plan, *others = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    adapter = package.load(ADAPTER)
    plan["policy"] |= {"digest": fingerprints.package_digest(ADAPTER), "checkpoint": None}
    plan["policy"]["spec"] = adapter.manifest.spec
    plan["cells"][0]["frozen"] = True
    plan["environment"]["digest"] = fingerprints.package_digest(environments.find("mujoco"))
    lines = [renamed(plan), *others]
    file.write_text("".join(f"{json.dumps(line)}\n" for line in lines), encoding="utf-8")
    return records.read(folder)


@cache
def _audit() -> bytes:
    """Return what the cheapest gate says of the adapter."""
    from xpl_cli.audit.engine.engine import audit
    from xpl_cli.audit.formats import ReportContext, as_json
    from xpl_cli.audit.rules.gates import Gate
    from xpl_cli.audit.rules.options import AuditOptions

    report = audit(
        ADAPTER, package.POLICY, AuditOptions(gates=(Gate.STATIC,)), display_path=bundle.adapter_folder(ADAPTER.name)
    )
    return bundle.document(as_json([report], ReportContext(here=ROOT)))
