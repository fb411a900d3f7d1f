"""Changes of encoded inputs: their list, and what they are about."""

from __future__ import annotations

import json

from xpl_cli.model_io.alternatives.encodings import Encoding, convention_of, encodings

from xpl.embodiment import get_embodiment
from xpl_cli.standard import spec

VOCABULARY = {option["const"] for option in spec.schema("model_io")["$defs"]["convention"]["oneOf"]}


def _all(robot: str = "franka", **more: bool) -> list[Encoding]:
    return list(encodings(get_embodiment(robot), "joint", **more))


def test_orders_are_of_all_numbers() -> None:
    for robot, width in (("franka", 16), ("franka_single", 8)):
        orders = [one.how["order"] for one in _all(robot) if one.how["kind"] == "ordered" and one.how["way"] == "in"]
        assert all(sorted(order) == list(range(width)) for order in orders)
        assert list(range(width)) not in orders
    by_words = {one.words: one.how["order"] for one in _all("franka") if one.how["kind"] == "ordered"}
    assert by_words["joint order: reversed"][:8] == [6, 5, 4, 3, 2, 1, 0, 7]
    there, back = by_words["parts: the arms, then the grippers"], by_words["parts: arm by arm"]
    assert [there[place] for place in back] == list(range(16))


def test_each_is_there_once_and_can_be_sent() -> None:
    found = _all()
    assert {one.convention for one in found} <= VOCABULARY
    texts = [json.dumps(one.how, sort_keys=True) for one in found]
    assert len(set(texts)) == len(texts)
    assert [one.rank for one in found] == sorted(one.rank for one in found)


def test_what_is_not_read_is_not_changed() -> None:
    kinds = {one.how["kind"] for one in _all(pictures=False, text=False)}
    assert kinds == {"drawn", "linear", "normalized", "ordered", "rotation", "segmented"}


def test_the_geometry_tells_a_filter_from_a_size() -> None:
    letterbox = next(one for one in _all() if one.geometry == "letterbox")
    assert convention_of(letterbox, {"letterbox", "resize"}) == "image_filter"
    assert convention_of(letterbox, {"resize"}) == "image_size"
    colours = next(one for one in _all() if one.how["kind"] == "colours")
    assert convention_of(colours, ()) == "image_channels"
