"""Things, which stand in for whatever a missing module may hold."""

from __future__ import annotations

import abc
import copy
import dataclasses
import enum
import inspect
from collections.abc import Iterator
from typing import Any, Optional

import numpy as np
import pytest

from xpl.worker.standins.facts import Facts
from xpl.worker.standins.finder import StandInModule
from xpl.worker.standins.origins import WORLD, StubError
from xpl.worker.standins.values import Values

lib = StandInModule("lib")


@pytest.fixture(autouse=True)
def _world() -> Iterator[None]:
    """Things of one test are not those of another, and other tests have stubs."""
    yield
    WORLD.facts, WORLD.value, WORLD.serving, WORLD.documents = None, None, False, ()
    WORLD.makes = lambda _: None
    WORLD.failed.clear()


@pytest.fixture
def serving() -> Facts:
    """An adapter that is shown things, with chunks of 4 steps and 14 columns."""
    facts = Facts(4, 14, np.zeros(14), np.ones(14))
    WORLD.facts, WORLD.value, WORLD.serving = facts, Values(facts).of, True
    return facts


# -- stubs, which have no worth ----------------------------------------------------------------------------------------


def test_a_thing_is_derived_from_whatever_else_the_class_derives_from() -> None:
    """Metaclasses do not clash, keywords of a class are taken, and two things are bases of one class."""

    class Meta(type):
        pass

    class Own(metaclass=Meta):
        pass

    class Mixed(lib.Base, Own, flag=True):
        pass

    class Abstract(lib.Base, abc.ABC):
        @abc.abstractmethod
        def act(self) -> int: ...

    class Twice(lib.Base, lib.Mixin):
        def __init__(self) -> None:
            super().__init__(1, two=2)

    assert type(Mixed) is Meta
    with pytest.raises(TypeError, match="abstract"):
        Abstract()
    twice = Twice()
    assert isinstance(twice, lib.Base)
    assert isinstance(twice, lib.Mixin)
    assert issubclass(Twice, lib.Base)
    assert not isinstance(twice, lib.Other)
    assert not isinstance("text", lib.Base)


def test_a_thing_is_a_field_an_annotation_and_a_registry() -> None:
    """Of data classes, of pydantic, of typing; a class that derives from one has what it has."""
    pydantic = pytest.importorskip("pydantic")

    @dataclasses.dataclass
    class Config(lib.Base):
        kind: lib.Kind
        size: int = 3

    class Settings(pydantic.BaseModel):
        kind: Optional[lib.Kind] = None  # noqa: UP045 - what adapters write
        tensor: lib.Tensor = None

    class Registry(lib.ChoiceRegistry, abc.ABC):
        pass

    @Registry.register_subclass("name")
    class Choice(Registry):
        pass

    assert Config(kind=1).size == 3
    assert Settings(kind="any").kind == "any"
    assert inspect.isclass(Choice)
    assert (lib.Kind | None) is Any


@pytest.mark.parametrize("decorator", [lib.compile, lib.compile(mode="fast"), lib.register("a"), lib.no_grad()])
def test_what_a_thing_decorates_stays_what_it_is(decorator: Any) -> None:
    """With arguments and without."""

    def act() -> int:
        return 1

    class Model:
        pass

    assert decorator(act) is act
    assert decorator(Model) is Model


def test_a_thing_is_raised_and_caught_copied_entered_and_compared() -> None:
    """As classes of errors, and as contexts."""
    with pytest.raises(lib.LoadError):
        raise lib.LoadError("no")
    with lib.autocast("cuda") as entered:
        assert entered is not None
    assert copy.deepcopy(lib.value) is lib.value
    assert lib.value != lib.other
    assert not lib.value

    class Kind(enum.Enum):
        A = lib.A

    assert Kind.A.value is lib.A


@pytest.mark.parametrize(
    "asked",
    [
        int,
        float,
        len,
        list,
        np.asarray,
        bytes,
        tuple,
        lambda thing: [*thing],
    ],
)
def test_a_stub_is_not_worth_a_number(asked: Any) -> None:
    """It is refused, and remembered."""
    with pytest.raises(StubError, match=r"lib\.size\(\) has no"):
        asked(lib.size())
    assert WORLD.failed


# -- what was put into a thing -----------------------------------------------------------------------------------------


def _shown(seed: float, text: str = "pick it up") -> dict[str, Any]:
    return {"image": np.full((48, 64, 3), seed * 40, np.uint8), "state": np.full(14, seed, np.float32), "prompt": text}


def _chunk(answer: Any) -> np.ndarray:
    return np.asarray(answer["actions"])


def test_an_answer_depends_on_all_that_went_in(serving: Facts) -> None:
    """On each array and on the text, through whatever came between; and on nothing else."""
    policy, processor = lib.Policy("weights"), lib.Processor()

    def answer(shown: dict[str, Any]) -> np.ndarray:
        return _chunk(policy.infer(processor.encode_all(shown)))

    first = answer(_shown(1))
    assert first.shape == (serving.steps, serving.width)
    assert np.array_equal(first, answer(_shown(1)))
    for other in (_shown(2), _shown(1, "put it down"), {**_shown(1), "state": _shown(2)["state"]}):
        assert not np.array_equal(first, answer(other))
    assert ((first >= 0) & (first <= 1)).all()


def test_the_environments_of_a_batch_do_not_matter_to_each_other(serving: Facts) -> None:
    """A batch answers each as it is answered alone."""
    policy = lib.Policy()
    batch = {key: [item, other] for (key, item), other in zip(_shown(1).items(), _shown(2).values(), strict=True)}
    both = {key: np.stack(items) if key != "prompt" else items for key, items in batch.items()}
    alone = {key: np.stack(items[1:]) if key != "prompt" else items[1:] for key, items in batch.items()}
    answers = np.asarray(policy.predict_action(both))
    assert answers.shape == (2, serving.steps, serving.width)
    assert np.array_equal(answers[1], np.asarray(policy.predict_action(alone))[0])


def test_what_an_object_was_given_counts_until_it_is_reset(serving: Facts) -> None:
    """Also by the numbers of environments that came with it."""
    runner = lib.Runner()
    runner.update_obs([_shown(1), _shown(2)], [4, 7])
    forward, backward = np.asarray(runner.get_action([4, 7])), np.asarray(runner.get_action([7, 4]))
    assert np.array_equal(forward, backward[::-1])
    assert not np.array_equal(forward[0], forward[1])
    runner.reset()
    with pytest.raises(StubError):
        np.asarray(runner.get_action([4, 7]))


def test_a_prompt_of_an_earlier_call_counts_where_a_later_one_has_none(serving: Facts) -> None:
    """As where a video is begun with the instruction, and gone on with pictures."""

    def second(text: str) -> np.ndarray:
        model = lib.Model()
        model.infer_action(_shown(1, text), phase="video")
        return np.asarray(model.infer_action(chunk=_shown(2)["image"], phase="action"))

    assert np.array_equal(second("pick it up"), second("pick it up"))
    assert not np.array_equal(second("pick it up"), second("put it down"))


def test_a_limb_is_as_wide_as_it_was_shown(serving: Facts) -> None:
    """And the first of several answers is the actions."""
    shown = {
        "state.left_arm": np.zeros((1, 1, 6)),
        "state.left_hand": np.zeros((1, 1, 1)),
        "language": [["pick it up"]],
    }
    action, _ = lib.Policy().get_action(shown)
    assert np.asarray(action["action.left_arm"]).shape == (1, serving.steps, 6)
    assert np.asarray(action["action.left_hand"])[0].shape == (serving.steps, 1)


def test_a_transformation_gives_back_what_it_was_given(serving: Facts) -> None:
    """Under its key; statistics and sizes are worth what their names say, and nothing else is."""
    sample = lib.Normalizer().normalize({"state": np.arange(14.0), "task": "pick it up"})
    assert np.array_equal(sample["state"], np.arange(14.0))
    assert set(sample.keys()) == {"state", "task"}
    WORLD.serving = False
    config = lib.Config.from_pretrained("weights")
    assert int(config.action_dim) == 14
    assert range(config.chunk_size) == range(serving.steps)
    assert np.asarray(lib.stats()["action"]["std"]).shape == (14,)
    with pytest.raises(StubError):
        int(config.anything)
