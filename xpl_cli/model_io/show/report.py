"""The inputs and actions of a model for a scene, computed from the model_io block or recorded from `predict`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from xpl import _spec as sdk
from xpl.convert import ConversionError
from xpl.observation import ObservationError
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.model_io import names, pairs
from xpl_cli.model_io.kinematics import sample_verdicts
from xpl_cli.model_io.show import numbers, predict_run, robot_figure, views
from xpl_cli.model_io.show.scene import ReportScene

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from xpl.contract import Entry, State
    from xpl.convert import Interface
    from xpl_cli.model_io.cited_conventions import CitedConvention
    from xpl_cli.model_io.show.compiled_adapter import CompiledAdapter
    from xpl_cli.model_io.show.drawing import VectorFigure
    from xpl_cli.model_io.show.numbers import Number
    from xpl_cli.model_io.show.views import ImageView

Steps = list[dict[str, np.ndarray]]
_SMALL: Final = 1e-5
"""Share of its span by which an input may differ from what the block makes."""
_MOVE: Final = (0.02, 0.1)
"""How far a made-up command goes in all: m, rad."""
_STEPS: Final = 8


@dataclass(frozen=True)
class StateVector:
    """A vector that the model reads.

    Attributes:
        input: the model's name for it.
        words: what the block says of normalisation and padding.
        numbers: of it.
    """

    input: str
    words: str
    numbers: Sequence[Number]


@dataclass(frozen=True)
class ShowReport:
    """Everything on the page.

    Attributes:
        policy, robot, action_type: what is looked at.
        scene: the observations.
        how: whether the model ran, in words.
        views: its pictures.
        vectors: its states.
        texts: by input, the text that the model gets; and the instruction.
        instruction: the standard's.
        action: numbers of the action.
        action_from: where the action is from, in words.
        action_words: what the block says of the whole action.
        figures: the robot.
        notes: what people should know: what is open, what code does, what differs.
        witness: what the robot's kinematics says of `model_io.samples`, a sentence for each part.
        conventions: what the block says of each, and the lines that reference.py cites for it.
    """

    policy: str
    robot: str
    action_type: str
    scene: ReportScene
    how: str
    views: Sequence[ImageView] = ()
    vectors: Sequence[StateVector] = ()
    texts: Mapping[str, str] = field(default_factory=dict)
    instruction: str | None = None
    action: Sequence[Number] = ()
    action_from: str = ""
    action_words: str = ""
    figures: Sequence[VectorFigure] = ()
    notes: Sequence[str] = ()
    witness: Sequence[str] = ()
    conventions: Sequence[CitedConvention] = ()

    def document(self) -> dict[str, Any]:
        """Return all numbers as JSON."""
        return {
            "policy": self.policy,
            "embodiment": self.robot,
            sdk.Deploy.ACTION_TYPE: self.action_type,
            "scene": self.scene.origin,
            "how": self.how,
            "notes": list(self.notes),
            "images": [one.document() for one in self.views],
            "state": [
                {"input": one.input, "words": one.words, "numbers": [number.document() for number in one.numbers]}
                for one in self.vectors
            ],
            sdk.Obs.INSTRUCTION: {"standard": self.instruction, "model": dict(self.texts)},
            "action": {
                "from": self.action_from,
                "words": self.action_words,
                "numbers": [number.document() for number in self.action],
            },
            "kinematics": list(self.witness),
        }


def report_from_block(
    adapter: CompiledAdapter, scene: ReportScene, steps: tuple[Steps, str] | None = None
) -> ShowReport:
    """Return what the model gets of a scene, and how it would say a command, by the block alone.

    Args:
        adapter: the adapter.
        scene: the observations.
        steps: a command, and where it is from; by default one is made up.

    Raises:
        UserError: if the scene lacks what the model reads, or the adapter has no block.
    """
    _, interface = _require_block(adapter)
    inputs = _inputs(interface, scene)
    now = scene.observations[-1]
    steps_shown, source = steps or (
        _made_up_steps(adapter, now[sdk.Obs.STATE]),
        "a command that was made up: it holds still at the first step, and moves until the last",
    )
    notes = [*adapter.notes, *_code_notes(adapter)]
    answer: np.ndarray | None = None
    try:
        answer = interface.action.encode(steps_shown, now[sdk.Obs.STATE], {})
    except (ConversionError, ValueError, KeyError) as error:
        notes.append(f"the action cannot be shown: {error}")
    report = ShowReport(
        adapter.package.name,
        adapter.robot.name,
        adapter.action_type,
        scene,
        "By the model_io block; the model did not run",
    )
    return _fill_report(replace(report, notes=notes), adapter, inputs, _ReportAction(answer, steps_shown, source))


def report_from_run(adapter: CompiledAdapter, scene: ReportScene, options: predict_run.RunOptions) -> ShowReport:
    """Return the inputs and the output of `predict` for a scene.

    Raises:
        UserError: if the adapter cannot be run.
    """
    call = predict_run.run_predict(adapter.package, adapter.config, scene.observations, options)
    how = "Recorded: inputs and output of predict"
    report = ShowReport(adapter.package.name, adapter.robot.name, adapter.action_type, scene, how)
    if adapter.interface is None or adapter.model_io is None:
        notes = ["no model_io block: the meaning of these numbers is unknown, and they are shown unchanged"]
        return replace(
            report,
            views=predict_run.find_images(call.inputs, scene.observations[-1]),
            notes=[*notes, *predict_run.describe_inputs(call.inputs)],
            instruction=scene.observations[-1].get(sdk.Obs.INSTRUCTION),
        )
    notes = list(adapter.notes)
    expected_inputs = _inputs(adapter.interface, scene)
    inputs: dict[str, Any] = {}
    inputs_given = predict_run.unbatched(call.inputs)
    for name, expected in expected_inputs.items():
        if name not in inputs_given:
            notes.append(f"predict got no {name}, which the block names; it got {', '.join(inputs_given)}")
            continue
        inputs[name] = inputs_given[name]
        difference = _describe_difference(inputs_given[name], expected)
        if difference:
            notes.append(f"{name}: {difference} than the block makes")
    answer = call.raw if isinstance(call.raw, np.ndarray) else np.zeros(0)
    width = adapter.interface.action.vector.padded
    usable = answer.shape[1:] == (width,) and bool(call.steps)
    if call.failure:
        notes.append(f"what it answered makes no action: {call.failure}")
    elif not usable:
        notes.append(f"predict answered the shape {answer.shape}; the block says (H, {width})")
    action = _ReportAction(answer if usable else None, call.steps, "what the model answered")
    return _fill_report(replace(report, notes=notes), adapter, inputs, action)


def first_pair(adapter: CompiledAdapter) -> tuple[ReportScene, Steps, str] | None:
    """Return the first question of golden_pairs.json: its scene, the golden answer, and what it is called.

    Raises:
        PairsError: if there is such a file, and it cannot be read.
    """
    if not (adapter.package.path / names.PAIRS).is_file():
        return None
    for session in pairs.read(adapter.package.path).sessions:
        if (session.embodiment, session.action_type) == (adapter.robot.name, adapter.action_type) and session.questions:
            question = session.questions[0]
            observations = session.scene.observations(question.recipes)
            origin = f"{names.PAIRS}, {question.where}"
            return ReportScene(observations, origin), session.chunk(question), f"what {names.CODE} answered ({origin})"
    return None


def _require_block(adapter: CompiledAdapter) -> tuple[Entry, Interface]:
    if adapter.model_io is None or adapter.interface is None:
        raise UserError(
            f"{adapter.package.path} has no model_io block, which would say what the model reads",
            hint="--run shows what predict gets, as it is",
            code=ExitCode.NOT_RUN,
        )
    return adapter.model_io, adapter.interface


@dataclass(frozen=True)
class _ReportAction:
    """An action: the model's answer (H, D), None where it cannot be shown; the standard's steps; where it is from."""

    answer: np.ndarray | None
    steps: Steps
    source: str


def _fill_report(
    report: ShowReport, adapter: CompiledAdapter, inputs: Mapping[str, Any], action: _ReportAction
) -> ShowReport:
    """Fill the report with the block's inputs and an action."""
    model_io, interface = _require_block(adapter)
    now = report.scene.observations[-1]
    state = now[sdk.Obs.STATE]
    vectors, read_vectors = [], []
    for entry in model_io.get("state", ()):
        name = entry["input"]
        if name in inputs:
            vector, values = interface.states[name], _newest(interface, name, inputs[name])
            numbers_shown = numbers.of_state(entry, vector, values, state, adapter.robot)
            vectors.append(StateVector(name, _vector_words(entry), numbers_shown))
            read_vectors.append(
                robot_figure.ReadVector(name, entry, vector, vector.denormalize(values.astype(np.float64)))
            )
    return replace(
        report,
        views=views.views(model_io, inputs, report.scene.observations),
        vectors=vectors,
        texts={name: str(value) for name, value in inputs.items() if isinstance(value, str)},
        instruction=now.get(sdk.Obs.INSTRUCTION),
        action=[]
        if action.answer is None
        else numbers.of_action(model_io["action"], interface, action.answer, action.steps, adapter.robot),
        action_from=action.source,
        action_words=_action_words(model_io, len(action.steps)),
        figures=robot_figure.figures(adapter.robot, state, read_vectors, action.steps),
        witness=_witness(adapter),
    )


def _witness(adapter: CompiledAdapter) -> list[str]:
    """Return what kinematics says of the samples; nothing where there are none."""
    if adapter.package.manifest.model_io is None or not adapter.package.manifest.model_io.samples:
        return []
    manifest, folder = adapter.package.manifest, adapter.package.path
    try:
        return [verdict.sentence for verdict in sample_verdicts.judge_samples(manifest, [folder])]
    except (sample_verdicts.NotJudgeableError, ConversionError) as error:
        return [str(error)]


def _inputs(interface: Interface, scene: ReportScene) -> dict[str, Any]:
    """Return the inputs that the block makes of a scene, without the axis of the batch."""
    memory: dict[str, np.ndarray] = {}
    try:
        encodings = [interface.encode(one, memory) for one in scene.observations[-interface.span :]]
        return predict_run.unbatched(interface.batch([encodings]))
    except (ConversionError, ObservationError) as error:
        raise UserError(f"{scene.origin}: {error}", code=ExitCode.NOT_RUN) from None


def _newest(interface: Interface, name: str, value: Any) -> np.ndarray:
    array, history = np.asarray(value), interface.history_of(name)
    return array if history is None else array[history.newest]


def _made_up_steps(adapter: CompiledAdapter, state: State) -> Steps:
    """Return a command: the first step holds still, the last is a little further, with grippers half way to closed."""
    count = adapter.interface.action.steps if adapter.interface and adapter.interface.action.steps else _STEPS
    steps = []
    for step_number in range(count):
        share = step_number / max(1, count - 1)
        step = {}
        for key, width in adapter.robot.dims(adapter.action_type).items():
            now = np.asarray(state[key], np.float64).copy()
            if key.endswith(sdk.State.EE_POSE):
                now[: sdk.POSITION_DIM] += share * _MOVE[0] * np.arange(1, sdk.POSITION_DIM + 1)
            elif key.endswith(sdk.State.EE_JOINT_STATE):
                now *= 1 - 0.5 * share
            else:
                now += share * _MOVE[1] * np.arange(1, width + 1) / width
            step[key] = now.astype(np.float32)
        steps.append(step)
    return steps


def _code_notes(adapter: CompiledAdapter) -> list[str]:
    """Return notes on conversions in code, which the page does not show."""
    listed = (adapter.model_io or {}).get("code") or ()
    return [f"done in code, and not shown here: {sentence}; --run shows it" for sentence in listed]


def _describe_difference(value: Any, expected: Any) -> str:
    """Return in what an input differs from what the block makes, "" if in nothing."""
    if isinstance(expected, str) or isinstance(value, str):
        return "" if value == expected else f"predict got {value!r}, other"
    one, other = np.asarray(value), np.asarray(expected)
    if one.shape != other.shape:
        return f"predict got the shape {one.shape}, not {other.shape}: other"
    if one.dtype != other.dtype:
        return f"predict got {one.dtype}, not {other.dtype}: another type"
    apart = float(np.abs(one.astype(np.float64) - other.astype(np.float64)).max(initial=0.0))
    span = float(np.ptp(other.astype(np.float64))) if other.size else 0.0
    return f"numbers differ by up to {apart:.3g}: others" if apart > _SMALL * max(span, 1.0) else ""


def _vector_words(entry: Entry) -> str:
    rule = entry.get("normalize") or {}
    texts = [f"normalised by {rule['rule']}" if "rule" in rule else "not normalised"]
    texts += [f"numbers of {rule['file']}"] if "file" in rule else []
    texts += [f"clipped to {rule['clip'][0]} to {rule['clip'][1]}"] if "clip" in rule else []
    texts += [f"padded to {entry['pad']}"] if "pad" in entry else []
    return ", ".join(texts)


def _action_words(model_io: Entry, steps: int) -> str:
    entry = model_io["action"]
    return (
        f"{entry['reference']}, {_vector_words(entry)}; {steps} steps, from step {entry.get('first', 0)} of the model's"
    )
