"""Plant conversion mistakes into trained policies, and see which proof names them and what they cost.

python tests/audit/offline/mistakes_table OUT --checkpoints DIR --demos DIR --python PYTHON [--jobs N]

DIR of --checkpoints and of --demos hold the folders that `trained.yml` names. Every proof of every mistake writes a
file below OUT/rows; a run that was cut goes on with the same command. `table.py` makes the page of them.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from pathlib import Path
from typing import Any

from tests.audit.offline.mistakes_table import proofs
from tests.audit.offline.mistakes_table.planting import HERE, RIGHT, Subject, Trained, demonstrations, said, trained

PROOFS = ("demonstrations", "parity", "success", "contract")
"""In the order in which they are made; `contract` is the static and the offline gate without the other proofs."""
_SECONDS = {"demonstrations": 620, "parity": 600, "success": 300, "contract": 900}
_RIGHT: dict[str, Any] = {}
"""The right adapters that this process has loaded."""


def main() -> None:
    """Make the proofs that are asked for."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--checkpoints", type=Path, help="holds the folders of weights")
    parser.add_argument("--demos", type=Path, required=True, help="holds the folders of demonstrations")
    parser.add_argument("--python", default=sys.executable, help="interpreter that runs the adapters")
    parser.add_argument("--policy", action="append", help="of trained.yml; all by default")
    parser.add_argument("--only", action="append", help=f"only mistakes of this name; `{RIGHT}` for none")
    parser.add_argument("--sample", choices=("in", "out"), help="only mistakes of this list")
    parser.add_argument("--proof", choices=PROOFS, action="append")
    parser.add_argument("--episodes", type=int, default=20, help="of success")
    parser.add_argument("--demonstrations", type=int, default=24, help="episodes of demonstrations")
    parser.add_argument("--jobs", type=int, default=1, help="processes at once")
    parser.add_argument("--gpus", type=int, default=0, help="among which demonstrations are shared; 0: as it is")
    parser.add_argument("--together", type=int, default=4, help="subjects of demonstrations in one process")
    parser.add_argument("--after", type=Path, help="only what the rows of that earlier OUT do not name right")
    parser.add_argument("--until", type=float, default=86400.0, help="seconds after which no proof is begun")
    parser.add_argument("--here", action="store_true", help="demonstrations one after the other in this process")
    asked = parser.parse_args()
    (asked.out / "rows").mkdir(parents=True, exist_ok=True)
    if asked.here:
        with tempfile.TemporaryDirectory(dir=asked.out) as place:
            for number, (proof, subject) in enumerate(_asked(asked)):
                _one(asked, proof, subject, Path(place) / str(number))
        return
    pool = _Pool(asked)
    threads = [threading.Thread(target=pool.work) for _ in range(asked.jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _asked(asked: argparse.Namespace) -> list[tuple[str, Subject]]:
    """Return the proofs that are to be made and have no row yet, in their order; of equal adapters one is enough."""
    found: list[tuple[str, Subject]] = []
    for proof in asked.proof or PROOFS:
        subjects = [subject for policy in trained(asked.policy) for subject in policy.subjects]
        known = {_alike(proof, subject) for subject in subjects if _row(asked.out, proof, subject).is_file()}
        for subject in subjects:
            wanted = not asked.only or subject.name in asked.only
            if wanted and asked.sample in (None, subject.sample) and _alike(proof, subject) not in known:
                known.add(_alike(proof, subject))
                found.append((proof, subject))
    return found


def _alike(proof: str, subject: Subject) -> str:
    """Return what equal adapters share; what names their mistake in demonstrations depends on the list."""
    return subject.key if proof == "demonstrations" else subject.same


class _Pool:
    """Processes that make proofs, several at once. What weights or demonstrations are not there yet is waited for."""

    def __init__(self, asked: argparse.Namespace) -> None:
        self._asked, self._lock, self._recording = asked, threading.Lock(), threading.Lock()
        self._left, self._begun = _asked(asked), 0
        self._until = time.monotonic() + asked.until

    def work(self) -> None:
        """Make proofs until none is left, or the time is over."""
        while (left := self._until - time.monotonic()) > 0 and self._left:
            jobs = self._next()
            if not jobs:
                time.sleep(2.0)
                continue
            proof, subjects = jobs[0][0], [subject for _, subject in jobs]
            if proof == "parity":
                with self._recording:
                    _record(self._asked, subjects[0].policy)
            command = [sys.executable, str(HERE), *_again(self._asked, proof, subjects)]
            with subprocess.Popen(command, start_new_session=True, env=self._environment()) as process:
                try:
                    process.wait(min(len(subjects) * (_SECONDS[proof] + 120), left + 60))
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    _say(f"{proof:15}{subjects[0].key}: cut")

    def _next(self) -> list[tuple[str, Subject]]:
        """Take the next job whose files are there, of demonstrations several of one policy: what loads is shared."""
        with self._lock:
            self._left = [one for one in self._left if not self._named(*one)]
            ready = [one for one in self._left if self._is_there(*one)]
            if not ready:
                return []
            first = ready[0]
            most = self._asked.together if first[0] == "demonstrations" else 1
            alike = [one for one in ready if one[0] == first[0] and one[1].policy == first[1].policy]
            chosen = [one for one in alike if one[1].sample == first[1].sample][:most]
            self._left = [one for one in self._left if one not in chosen]
            return chosen

    def _environment(self) -> dict[str, str]:
        self._begun += 1
        chosen = {"CUDA_VISIBLE_DEVICES": str(self._begun % self._asked.gpus)} if self._asked.gpus else {}
        return {**os.environ, **chosen}

    def _named(self, proof: str, subject: Subject) -> bool:
        """Tell whether an earlier run has named a mistake right."""
        earlier = self._asked.after
        return earlier is not None and bool(said(_row(earlier, proof, subject)).get("right"))

    def _is_there(self, proof: str, subject: Subject) -> bool:
        policy, earlier = subject.policy, self._asked.after
        if earlier is not None and subject.sample == "out" and not _row(earlier, proof, subject).is_file():
            return False
        weights = policy.told["weights"]
        there = weights is None or (self._asked.checkpoints / weights / "model.safetensors").is_file()
        return there and (self._asked.demos / policy.told["demos"]).is_dir()


def _pairs(asked: argparse.Namespace, policy: Trained) -> Path:
    return asked.out / "pairs" / f"{policy.name.replace(' ', '-')}.json"


def _record(asked: argparse.Namespace, policy: Trained) -> None:
    """Have the authors' code answer scripted episodes with these weights, once."""
    path = _pairs(asked, policy)
    if policy.told["weights"] is None or path.exists():
        return
    path.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=asked.out) as place:
        package = Subject(policy, "in", None).write(Path(place), asked.checkpoints, None)
        told = proofs.record(package, asked.python, _SECONDS["parity"])
        made = package / "golden_pairs.json"
        path.write_bytes(made.read_bytes() if made.is_file() else b"")
        _say(f"pairs          {policy.name}: {told.get('failure') or 'recorded'}")


def _again(asked: argparse.Namespace, proof: str, subjects: list[Subject]) -> list[str]:
    """Return the arguments of a process that makes one proof of some subjects."""
    found = [str(asked.out), "--demos", str(asked.demos), "--python", asked.python, "--here", "--proof", proof]
    found += ["--checkpoints", str(asked.checkpoints)] if asked.checkpoints else []
    found += ["--policy", subjects[0].policy.name, "--sample", subjects[0].sample]
    found += [word for subject in subjects for word in ("--only", subject.name)]
    return [*found, "--episodes", str(asked.episodes), "--demonstrations", str(asked.demonstrations)]


def _one(asked: argparse.Namespace, proof: str, subject: Subject, place: Path) -> None:
    """Make one proof, and write its row."""
    started = time.monotonic()
    try:
        package = subject.write(place / "planted", asked.checkpoints, _pairs(asked, subject.policy))
        found = _made(asked, proof, subject, package, place)
    except Exception as error:  # noqa: BLE001 - one row of many
        found = {"crash": f"{type(error).__name__}: {error}", "told": traceback.format_exc()[-1500:]}
    conventions = () if subject.mistake is None else subject.mistake.conventions
    row = {
        "policy": subject.policy.name,
        "sample": subject.sample,
        "mistake": subject.name,
        "conventions": list(conventions),
        "proof": proof,
        **found,
        "took": round(time.monotonic() - started, 1),
    }
    path = _row(asked.out, proof, subject)
    path.with_suffix(".part").write_text(json.dumps(row))
    path.with_suffix(".part").replace(path)
    _say(f"{proof:15}{subject.key:60}{row['took']:7} {json.dumps(found)[:400]}")


def _made(asked: argparse.Namespace, proof: str, subject: Subject, package: Path, place: Path) -> dict[str, Any]:
    if proof == "success":
        return proofs.success(package, asked.python, subject.policy.told["task"], asked.episodes, _SECONDS[proof])
    if proof in ("parity", "contract"):
        codes = (proofs.PARITY,) if proof == "parity" else ()
        return proofs.audited(package, asked.python, _SECONDS[proof], codes)
    from tests.audit.offline.mistakes_table.local import Judged

    key = subject.policy.name
    if key not in _RIGHT:
        demos = demonstrations(subject.policy, asked.demos, place / "demos", asked.demonstrations)
        _RIGHT[key] = Judged(Subject(subject.policy, "in", None).write(place / RIGHT, asked.checkpoints, None), demos)
    right = _RIGHT[key]
    if subject.mistake is None:
        return proofs.demonstrations(right, right, ())
    return proofs.demonstrations(Judged(package, right.demos), right, subject.mistake.conventions)


def _row(out: Path, proof: str, subject: Subject) -> Path:
    return out / "rows" / f"{subject.key}-{proof}.json"


def rows(out: Path) -> list[dict[str, Any]]:
    """Return all rows that were written."""
    return [found for path in sorted((out / "rows").glob("*.json")) if (found := said(path))]


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
