from __future__ import annotations

from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from tests.support.examples import examples
from xpl.wire import codec
from xpl_cli.serving.requests import RequestError
from xpl_cli.serving.slots import SlotPool, WorkerSlot

GRACE = 30.0


class Clock:
    """A clock that goes when it is told to."""

    now = 100.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def taken(places: SlotPool, connection: str, evaluation: str = "e", session: str | None = None) -> WorkerSlot:
    """Return the place that a connection gets, and take over from nobody."""
    place, lost = places.take(connection, evaluation, session)
    assert lost is None
    return place


def assert_busy(places: SlotPool, connection: str, evaluation: str, session: str | None = None) -> None:
    """Check that there is no place for a connection."""
    with pytest.raises(RequestError, match="in use by another client") as busy:
        places.take(connection, evaluation, session)
    assert busy.value.reason == "busy"
    assert places.of(connection) is None


def test_a_lease_survives_a_cut_for_its_own_client_only(clock: Clock) -> None:
    """For the length of the grace period; a clean end frees it at once."""
    places = SlotPool(1, 1, GRACE, clock)
    place = taken(places, "a", "evaluation 1")
    assert places.of("a") is place
    assert_busy(places, "b", "evaluation 1")  # the first connection still stands
    assert places.leave("b", clean=True) is None  # not the holder: changes nothing
    assert places.leave("a", clean=False) is place
    assert places.of("a") is None
    assert_busy(places, "c", "evaluation 2")
    assert taken(places, "d", "evaluation 1") is place
    assert place.tenancy == 1
    places.leave("d", clean=True)
    assert taken(places, "c", "evaluation 2") is place
    assert place.tenancy == 2
    places.leave("c", clean=False)
    clock.now += GRACE - 0.1
    assert_busy(places, "e", "evaluation 3")
    clock.now += 0.1
    assert taken(places, "e", "evaluation 3").tenancy == 3


def test_after_the_grace_period_a_client_finds_its_place_unless_it_was_given_away(clock: Clock) -> None:
    """The state of its episode is there still."""
    places = SlotPool(1, 1, GRACE, clock)
    place = taken(places, "a", "evaluation 1")
    place.begun = True
    places.leave("a", clean=False)
    clock.now += 10 * GRACE
    assert places.taken() == 0
    assert taken(places, "b", "evaluation 1").begun
    places.leave("b", clean=False)
    clock.now += GRACE
    taken(places, "c", "evaluation 2")
    assert_busy(places, "d", "evaluation 1")


def test_a_secret_takes_its_place_back_while_the_lost_connection_seems_alive(clock: Clock) -> None:
    """A half-open connection may look alive for minutes; nobody else can take a place from it."""
    places = SlotPool(2, 1, GRACE, clock)
    place = taken(places, "a", "e", "secret")
    place.begun, place.sequence = True, 5
    for connection, evaluation, session in [("b", "e", "guess"), ("c", "other", "secret"), ("d", "e", None)]:
        other, lost = places.take(connection, evaluation, session)
        assert (other is place, lost) == (False, None)
        places.leave(connection, clean=True)
    assert places.take("new", "e", "secret") == (place, "a")
    assert (places.of("a"), places.of("new")) == (None, place)
    assert (place.begun, place.sequence, place.tenancy) == (True, 5, 1)
    assert places.leave("a", clean=False) is None  # what was lost ends at last
    assert places.of("new") is place
    assert places.taken() == 1


def test_without_a_secret_a_place_with_one_is_not_given_back(clock: Clock) -> None:
    """An evaluation_id is no secret."""
    places = SlotPool(1, 1, GRACE, clock)
    taken(places, "a", "e", "secret")
    places.leave("a", clean=False)
    assert_busy(places, "b", "e")
    assert_busy(places, "b", "e", "guess")
    assert taken(places, "b", "e", "secret").tenancy == 1


def test_another_client_begins_anew(clock: Clock) -> None:
    """Nothing of the one before is seen; what the model may still remember is marked."""
    places = SlotPool(1, 1, 0.0, clock)
    place = taken(places, "a", "e")
    assert not place.stale
    place.begun, place.sequence = True, 7
    frame = codec.Frame("infer", "e")
    place.replay.finish(frame.message_id, place.replay.begin(frame), b"answer")
    places.leave("a", clean=False)
    assert len(place.replay) == 1
    taken(places, "b", "f")
    assert (place.begun, place.stale, place.sequence, len(place.replay)) == (False, True, 0, 0)


def test_a_goodbye_ends_the_episode(clock: Clock) -> None:
    """Also for the client itself, should it come back; a place that saw none is not stale."""
    places = SlotPool(1, 1, GRACE, clock)
    place = taken(places, "a", "e")
    places.leave("a", clean=True)
    assert not place.stale
    taken(places, "b", "e")
    place.begun, place.sequence = True, 3
    frame = codec.Frame("infer", "e", message_id="1")
    place.replay.begin(frame)
    places.leave("b", clean=True)
    assert taken(places, "c", "e") is place
    assert (place.begun, place.stale, place.sequence) == (False, True, 0)
    assert place.replay.find(frame) is None


def test_clients_spread_over_the_workers(clock: Clock) -> None:
    """Also after some have left: nobody shares a worker while another one has less to do."""
    places = SlotPool(3, 2, GRACE, clock)
    assert len(places) == 6
    assert [taken(places, name, name).worker for name in "abcde"] == [0, 1, 2, 0, 1]
    for name in "be":
        places.leave(name, clean=True)
    assert [taken(places, name, name).worker for name in "fgh"] == [1, 2, 1]
    assert_busy(places, "i", "i")
    assert places.taken() == 6


def test_a_place_is_given_to_the_next_as_late_as_possible(clock: Clock) -> None:
    """So that a client that comes back late may find its own."""
    places = SlotPool(1, 3, 0.0, clock)
    first = taken(places, "a", "a")
    places.leave("a", clean=False)
    for name in "bc":
        assert taken(places, name, name) is not first
    assert taken(places, "d", "a") is first


def test_with_a_worker_its_places_are_gone(clock: Clock) -> None:
    """Those who had them are told; the others go on."""
    places = SlotPool(2, 2, GRACE, clock)
    for name in "abc":
        taken(places, name, name)
    places.leave("c", clean=False)
    assert places.close(0) == ["a"]
    assert places.of("a") is None
    assert places.leave("a", clean=True) is None
    assert len(places) == 2
    taken(places, "d", "c")
    assert_busy(places, "e", "e")
    assert sorted(places.close(1)) == ["b", "d"]
    assert_busy(places, "a", "a")


class Coming(RuleBasedStateMachine):
    """Connections come, are cut and leave in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = Clock()
        self.places = SlotPool(2, 2, GRACE, self.clock)
        self.held: dict[int, WorkerSlot] = {}
        self.count = 0

    @rule(evaluation=st.sampled_from("abcdef"), session=st.sampled_from([None, "s"]))
    def come(self, evaluation: str, session: str | None) -> None:
        """Take a place, or hear that all are in use."""
        self.count += 1
        try:
            place, lost = self.places.take(self.count, evaluation, session)
        except RequestError:
            assert self.places.taken() == len(self.places)
            return
        if lost is not None:
            assert isinstance(lost, int)
            assert self.held.pop(lost) is place
        assert place not in self.held.values()
        self.held[self.count] = place

    @rule(data=st.data(), clean=st.booleans())
    def go(self, data: st.DataObject, clean: bool) -> None:
        """Leave; a connection without a place changes nothing."""
        connection = data.draw(st.integers(0, self.count))
        assert self.places.leave(connection, clean=clean) is self.held.pop(connection, None)

    @rule(seconds=st.sampled_from([1.0, GRACE]))
    def wait(self, seconds: float) -> None:
        self.clock.now += seconds

    @invariant()
    def everyone_has_one_place_of_their_own(self) -> None:
        assert all(self.places.of(connection) is place for connection, place in self.held.items())
        assert len({id(place) for place in self.held.values()}) == len(self.held) <= self.places.taken()


TestComing: Any = Coming.TestCase
TestComing.settings = settings(max_examples=examples(50), stateful_step_count=30)
