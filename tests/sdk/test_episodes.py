"""Environment numbers and episodes of clients that share a model."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from xpl.episodes import CLIENT_ENVS, EpisodeCounter, own_index, shared_index

CLIENTS = st.integers(0, 1 << 20)
ENVS = st.integers(0, CLIENT_ENVS - 1)


@given(CLIENTS, ENVS, CLIENTS, ENVS)
def test_no_two_clients_share_a_number(client: int, env: int, other: int, another: int) -> None:
    number = shared_index(client, env)
    assert own_index(number) == env
    assert (number == shared_index(other, another)) == ((client, env) == (other, another))


@given(CLIENTS, ENVS)
def test_seeds_are_those_of_a_client_alone(client: int, env: int) -> None:
    alone, shared = EpisodeCounter(), EpisodeCounter()
    number, other = shared_index(client, env), shared_index(client + 1, env)
    for _ in range(2):
        alone.observe([env])
        shared.observe([number, other])
        assert shared.seeds(7, number) == alone.seeds(7, env)
        alone.reset([env])
        for _ in range(2):
            shared.reset([number])
        assert shared.seeds(7, number) == alone.seeds(7, env)
    assert alone.seeds(7, env) == [7, 2, env]
    assert shared.seeds(7, other)[1] == 0
