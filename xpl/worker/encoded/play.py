"""Answers the same questions with one change of the encoded inputs after another (`xpl.worker.perturbed_answers`).

What an audit looks for the mistake with where an adapter converts in code: pictures that `encode` made are scaled
otherwise, texts and vectors written otherwise, while `decode` sees what was shown. Of each change the answer has
"answers", the chunk of every question; "apart", how far pictures are from those before; "draws", how many times
something was drawn; "words", if the process knows better what the change is; or there is an "error".
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Callable

from xpl import _spec as spec
from xpl.catalogue import convention as catalogue
from xpl.catalogue.walk import EncodeOne, NoEffectError, leaves, map_leaves
from xpl.contract import Entry, Observation
from xpl.conventions import instruction
from xpl.wire.arrays import as_array
from xpl.worker.block_answers import replay_from_start
from xpl.worker.encoded import pictures, turns, vectors
from xpl.worker.encoded.draws import EnvGenerators
from xpl.worker.encoded.rebuilt import RebuiltImages
from xpl.worker.encoded.repeats import StepOncePerObservation
from xpl.worker.encoded.segments import RenormalizedSegments
from xpl.worker.subprocess_task import FAILURES, pack_error, pack_result

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from xpl.policy import Policy

_MOST_KEPT = 64
"""Observations whose inputs are kept."""
_SAMPLES = 6
"""Observations by which it is seen what numbers are."""

Encode = Callable[[Observation, int], Any]


def changes(
    model: Policy, input_changes: Sequence[Mapping[str, Any]], calls: Sequence[Mapping[str, Any]], seconds: float
) -> Iterator[bytes]:
    """Yield the answers under each change, packed.

    Args:
        model: the adapter's model; its `encode` is wrapped.
        input_changes: maps with a `kind` and its parameters; `way`: in, out or both for changes that may apply to the
            model's output, too; batch for changes of the inputs of a batch. `several` applies the changes listed
            under `of` in order.
        calls: observations and inferences of the episodes.
        seconds: time limit.
    """
    until = time.monotonic() + seconds
    samples = [obs for call in calls for _, obs in call.get("show", ())][:_SAMPLES]
    newest = list({obs.get(spec.Obs.ENV_IDX) or 0: obs for obs in samples}.values())
    own, predicts = model.encode, model.predict
    known: dict[str, Any] = {"kept": _cached_encode(own)}
    for how in input_changes:
        if time.monotonic() > until:
            return
        try:
            model.reset()
            model.update_obs_batch(newest)  # so that there are environments that encode
            if how["kind"] in _WHOLE:
                yield _WHOLE[how["kind"]](model, how, calls)
                continue
            report: dict[str, Any] = {}
            encode: Any = own
            predict, held = predicts, known
            for one in how["of"] if how["kind"] == "several" else [how]:
                if one.get("way") == "batch":
                    predict = _batched(predict, one)
                elif one.get("way") != "out":
                    encode, more = _wrapped(model, encode, one, samples, held)
                    report, held = _merge_reports(report, more), {"kept": _cached_encode(encode)}
                if one.get("way") in ("out", "both"):
                    predict = _answering(predict, one)
            model.encode, model.predict = encode, predict  # type: ignore[method-assign]
            yield pack_result({"answers": list(replay_from_start(model, calls)), **report})
        except FAILURES as error:
            yield pack_error(error)
        finally:
            model.encode, model.predict = own, predicts  # type: ignore[method-assign]


def _merge_reports(before: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is to be told of several changes: words of each that knows better."""
    words = [report["words"] for report in (before, more) if "words" in report]
    return {**before, **more, **({"words": " and ".join(words)} if len(words) > 1 else {})}


def _cached_encode(encode: Encode) -> Encode:
    """Return an `encode` that makes the inputs of an observation once; what it returns may be written to."""
    cache: dict[tuple[int, int], tuple[Any, Any]] = {}

    def remembered(obs: Observation, env: int) -> Any:
        key = (id(obs), env)
        if key not in cache or cache[key][0] is not obs:
            made = encode(obs, env)
            if len(cache) >= _MOST_KEPT:
                return made
            cache[key] = obs, made
        return map_leaves(cache[key][1], lambda leaf: None if isinstance(leaf, str) else leaf.copy())

    return remembered


def _drawn(model: Policy, how: Entry, calls: Sequence[Mapping[str, Any]]) -> bytes:
    """Return the answers with other draws, packed."""
    drawn = EnvGenerators(model, how)
    model.predict = drawn.predict  # type: ignore[method-assign]
    answers = list(replay_from_start(model, calls))
    return pack_result({"answers": answers, **drawn.report})


def _once(model: Policy, _how: Entry, calls: Sequence[Mapping[str, Any]]) -> bytes:
    """Return the answers where no state is advanced twice by one observation, packed.

    Raises:
        NoEffectError: if none is.
    """
    once = StepOncePerObservation()
    with once.around(model):
        answers = list(replay_from_start(model, calls))
    if not once.left_out:
        raise NoEffectError("nothing is called twice")
    return pack_result({"answers": answers})


_WHOLE = {"drawn": _drawn, "once": _once}
"""Changes of all that a model does, by kind."""


def _batched(predicts: Callable[..., Any], how: Entry) -> Callable[..., Any]:
    """Return the model with the inputs of a batch changed."""
    change = catalogue.lookup("input_changes", how["kind"])
    return lambda inputs, envs: predicts(change(inputs, how), envs)


def _answering(predicts: Callable[..., Any], how: Entry) -> Callable[..., Any]:
    """Return the model with its answers changed."""
    change = catalogue.lookup("input_changes", how["kind"])

    def predict(inputs: object, envs: list[int]) -> Any:
        return [change(as_array(row), how) for row in predicts(inputs, envs)]

    return predict


def _wrapped(
    model: Policy, own: Encode, how: Entry, samples: Sequence[Observation], known: dict[str, Any]
) -> tuple[Encode, dict[str, Any]]:
    """Return an `encode` with a change, and what is to be told of it.

    Raises:
        NoEffectError: if the change has no meaning here.
    """
    sample = samples[0]

    def encode(obs: Observation) -> Any:
        made = known["kept"] if any(obs is one for one in samples) else own
        return made(obs, obs.get(spec.Obs.ENV_IDX) or 0)

    kind, cached_encode = how["kind"], known["kept"]
    if kind == "resized":
        return _resized(own, encode, how, sample, known)
    if kind == "text":
        instruction.rewrite_texts(encode(sample), how, sample)
        return (lambda obs, env: instruction.rewrite_texts(cached_encode(obs, env), how, obs)), {}
    if kind in ("normalized", "segmented"):
        if kind not in known:
            several = kind == "segmented"
            known[kind] = (
                RenormalizedSegments(model, encode, samples)
                if several
                else vectors.RenormalizedInputs(model, encode, sample)
            )
        numbers = known[kind]
        words = numbers.change(encode(sample), how)[1]
        return (lambda obs, env: numbers.change(cached_encode(obs, env), how)[0]), {"words": words}
    if kind == "rotation":
        turn = turns.RotatedInputs([encode(one) for one in samples], how)
        return (lambda obs, env: turn(cached_encode(obs, env))), {}
    change = catalogue.lookup("input_changes", kind)
    if change is None:
        raise NoEffectError(f"nobody here knows the change {kind}")
    before = encode(sample)
    if _equal(change(before, how), before):
        raise NoEffectError("it changes nothing")
    return (lambda obs, env: change(cached_encode(obs, env), how)), {}


def _resized(
    own: Encode, encode: EncodeOne, how: Entry, sample: Observation, known: dict[str, Any]
) -> tuple[Encode, dict[str, Any]]:
    """Return an `encode` whose pictures got their size otherwise: shown in that size, or made again.

    Raises:
        NoEffectError: if that cannot be done.
    """
    steps, exchanged = how["steps"], bool(how.get("exchanged"))
    if "pictures" not in known:
        known["pictures"] = (
            _tried(pictures.ResizedInputs, encode, sample),
            _tried(RebuiltImages, encode, sample),
            encode(sample),
        )
    seen, rebuilt, before = known["pictures"]
    if not exchanged and not isinstance(seen, NoEffectError):
        far = pictures.apart(encode(seen(sample, steps)), before)
        return (lambda obs, env: own(seen(obs, steps), env)), {"apart": far}
    if isinstance(rebuilt, NoEffectError):
        raise rebuilt
    far = pictures.apart(rebuilt(before, sample, steps, exchanged=exchanged), before)
    return (lambda obs, env: rebuilt(known["kept"](obs, env), obs, steps, exchanged=exchanged)), {"apart": far}


def _tried(make: Callable[..., Any], *arguments: Any) -> Any:
    """Return what is made, or why it is not."""
    try:
        return make(*arguments)
    except NoEffectError as error:
        return error


def _equal(one: object, other: object) -> bool:
    pairs = list(zip(leaves(one), leaves(other)))
    return all(_same(a, b) for a, b in pairs)


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return bool(one == other)
    return one.shape == other.shape and bool((one == other).all())
