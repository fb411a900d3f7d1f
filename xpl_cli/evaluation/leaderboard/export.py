"""Write result files in the formats and folders of two other benchmarks, for their own tools.

RoboDojo, read by its `summarize`: one `_result.json` for each task, robot and seed; the tasks of its randomized setting
have names of their own. Source: RoboDojo-Benchmark/RoboDojo, src/eval_client/eval_env.py and
scripts/internal/summarize_result.py at 36bfcb7.

RoboTwin: one `_result.txt` for each task and setting. Source: RoboTwin-Platform/RoboTwin, script/eval_policy.py at
0c3f24c, which writes two lines before the rate (the time, the kind of instructions) on which readers of a plain number
would fail; the rate is the last line there and the only one here.
"""

from __future__ import annotations

import datetime as dt
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl_cli.basics import atomic
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.evaluation.records import mock_settings
from xpl_cli.evaluation.records.cells import cells

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from xpl_cli.evaluation.records.cells import Cell
    from xpl_cli.evaluation.records.records import Run

_PLAIN, _RANDOMIZED = "clean", "randomized"
_UNFIT = re.compile(r"[^\w.+-]+")
_DIGITS = 12


def robodojo(run: Run) -> Iterator[tuple[Path, str]]:
    """Yield path and text of each file of a run, below RoboDojo's folder of results."""
    plan, config = run.plan, run.plan.policy.config
    began = _start_time(run).strftime("%Y-%m-%d_%H-%M-%S")
    settings = f"{config.get(sdk.Deploy.SEED, 0)}_ckpt_name={_checkpoint(run)},action_type={plan.action_type}"
    for cell in _rated_cells(run):
        task = {_PLAIN: cell.task, _RANDOMIZED: f"{cell.task}_random"}.get(cell.setting, f"{cell.task}_{cell.setting}")
        path = _result_path(task, plan.policy.name, plan.embodiment) / settings / began / "_result.json"
        yield path, json.dumps(_details(cell), indent=2, ensure_ascii=False) + "\n"


def robotwin(run: Run) -> Iterator[tuple[Path, str]]:
    """Yield path and text of each file of a run, below RoboTwin's folder of results."""
    began = _start_time(run).strftime("%Y-%m-%d %H:%M:%S")
    for cell in _rated_cells(run):
        path = _result_path(cell.task, run.plan.policy.name, cell.setting, _checkpoint(run)) / began / "_result.txt"
        yield path, f"{sum(cell.certain) / len(cell.certain)}\n"


FORMATS: dict[str, Callable[[Run], Iterable[tuple[Path, str]]]] = {"robodojo": robodojo, "robotwin": robotwin}
"""Formats by name."""


def write(name: str, runs: Iterable[Run], folder: Path) -> int:
    """Write the files of some runs; return their number.

    Raises:
        UserError: there is no such format, a run used a mock of a part of the benchmark, two runs would write the same
            file, or it cannot be written.
    """
    if name not in FORMATS:
        raise UserError(f"there is no format {name!r}; there are {', '.join(FORMATS)}")
    texts: dict[Path, str] = {}
    for run in runs:
        mock_settings.refuse(run, "written as a result of a benchmark")
        for path, text in FORMATS[name](run):
            if path in texts:
                raise UserError(
                    f"{run.folder} and another run would both write {path}: their results are of equal name"
                )
            texts[path] = text
    try:
        for path, text in texts.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            atomic.write_file(folder / path, text.encode())
    except OSError as error:
        raise UserError(f"{folder} cannot be written: {error.strerror}", code=ExitCode.NOT_RUN) from None
    return len(texts)


def _details(cell: Cell) -> dict[str, Any]:
    """Return RoboDojo's result of one task; an episode with an infrastructure error counts as failed."""
    judged = [line for line in cell.counted if cell.counts_as_success(line) is not None]
    details = {
        str(number): {
            "layout_id": line.seed,
            "success": bool(cell.counts_as_success(line)),
            "score": 1.0 if cell.counts_as_success(line) else (cell.score(line) or 0.0),
        }
        for number, line in enumerate(judged)
    }
    count = len(judged)
    return {
        "success_rate": sum(entry["success"] for entry in details.values()) / count,
        "eval_time": count,
        "score": 100 * sum(entry["score"] for entry in details.values()) / count,
        "details": details,
    }


def _rated_cells(run: Run) -> Iterator[Cell]:
    """Yield the cells that have a success rate."""
    return (cell for cell in cells(run) if cell.outcomes)


def _start_time(run: Run) -> dt.datetime:
    return dt.datetime.fromisoformat(run.plan.created)


def _checkpoint(run: Run) -> str:
    """Return what the checkpoint is called in a path: its name in deploy.yml, or the beginning of its digest."""
    policy = run.plan.policy
    digest = policy.checkpoint.digest[:_DIGITS] if policy.checkpoint else "none"
    return _UNFIT.sub("_", str(policy.config.get(sdk.Deploy.CKPT_NAME) or digest))


def _result_path(*names: str) -> Path:
    return Path(*(_UNFIT.sub("_", name).strip(".") or "_" for name in names))
