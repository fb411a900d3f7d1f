"""Mistakes as changes of encoded inputs: their list, and what they are about."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl.catalogue import AdapterCase
from xpl.catalogue import convention as catalogue
from xpl.catalogue.convention import input_mistakes
from xpl.catalogue.walk import NoEffectError
from xpl.embodiment import get_embodiment
from xpl_cli.audit.offline.search.loaded_adapter import _convention_of
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Mapping

    from xpl.catalogue import Mistake

VOCABULARY = {option["const"] for option in spec.schema("model_io")["$defs"]["convention"]["oneOf"]}


def _all(robot: str = "franka", **more: Any) -> list[Mistake]:
    told = {"cameras": ("cam_head",), "instructions": ("Do it.",), "history": 2, **more}
    return list(input_mistakes(AdapterCase(get_embodiment(robot), "joint", **told)))


def _how(one: Mistake) -> Mapping[str, Any]:
    assert one.input_change is not None
    return one.input_change


def test_orders_are_of_all_numbers() -> None:
    for robot, width in (("franka", 16), ("franka_single", 8)):
        made = [_how(one) for one in _all(robot)]
        orders = [how["order"] for how in made if how["kind"] == "ordered" and how["way"] == "in"]
        assert all(sorted(order) == list(range(width)) for order in orders)
        assert list(range(width)) not in orders
    by_words = {one.description: _how(one)["order"] for one in _all("franka") if _how(one)["kind"] == "ordered"}
    assert by_words["joint order: reversed"][:8] == [6, 5, 4, 3, 2, 1, 0, 7]
    there, back = by_words["parts: the arms, then the grippers"], by_words["parts: arm by arm"]
    assert [there[place] for place in back] == list(range(16))
    assert by_words["parts: joints of the arms in turn"][:4] == [0, 8, 1, 9]


def test_each_is_there_once_and_can_be_sent() -> None:
    found = _all()
    assert {one.convention for one in found} <= VOCABULARY
    texts = [json.dumps(_how(one), sort_keys=True) for one in found]
    assert len(set(texts)) == len(texts)
    assert [one.rank for one in found] == sorted(one.rank for one in found)


def test_what_is_not_read_is_not_changed() -> None:
    kinds = {_how(one)["kind"] for one in _all(cameras=(), instructions=(), history=1)}
    assert kinds == {"drawn", "linear", "normalized", "once", "ordered", "rotation", "segmented"}


def test_the_geometry_tells_a_filter_from_a_size() -> None:
    letterbox = next(one for one in _all() if one.geometry == "letterbox")
    assert _convention_of(letterbox, {"letterbox", "resize"}) == "image_filter"
    assert _convention_of(letterbox, {"resize"}) == "image_size"
    colours = next(one for one in _all() if _how(one)["kind"] == "colours")
    assert _convention_of(colours, ()) == "image_channels"


def test_a_history_is_reversed_where_there_is_one() -> None:
    reversed_ = catalogue.lookup("input_changes", "reversed")
    inputs = {"state": np.arange(8.0).reshape(2, 4), "rgb": np.zeros((2, 3, 16, 16)), "text": "Do it."}
    inputs["rgb"][1] = 1.0
    made = reversed_(inputs, {"length": 2, "of": "all"})
    assert made["state"].tolist() == [[4.0, 5.0, 6.0, 7.0], [0.0, 1.0, 2.0, 3.0]]
    assert (made["rgb"][0] == 1.0).all()
    assert reversed_(inputs, {"length": 2, "of": "vectors"})["rgb"][1].all()
    frames = [[(np.zeros(3), "a"), (np.ones(3), "b")], [(np.ones(3), "c")]]
    turned = reversed_(frames, {"length": 2, "of": "all", "way": "batch"})
    assert [[text for _, text in one] for one in turned] == [["b", "a"], ["c"]]
    with pytest.raises(NoEffectError):
        reversed_(inputs, {"length": 3, "of": "all"})
