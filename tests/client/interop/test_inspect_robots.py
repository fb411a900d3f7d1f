"""inspect-robots, with its plugin inspect-robots-xpolicylab as the client, plays whole episodes on our server."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tests.client.interop.build import ROOT
from tests.client.interop.driver import Driver, PeerError, environment
from tests.client.interop.journal import CHUNK, Journal
from tests.client.interop.relay import Relay
from tests.support.peer import wait_until
from xpl import _spec as spec
from xpl import get_embodiment
from xpl_cli.serving.launch import RunningServer

ONE_ARM = {"prefixes": [""], "dof": 7, "action_type": "joint"}
Serve = Callable[..., RunningServer]
Connect = Callable[..., Driver]


@pytest.mark.sampled(1)
def test_whole_episodes_of_inspect_robots_carry_every_bit(serve: Serve, plugin: Connect, journal: Journal) -> None:
    """Each reset arrives once; observations and actions are equal, bit for bit, on both sides of the wire."""
    peer = plugin(serve(journal.folder, overrides=journal.overrides).url)
    log = peer.ask("evaluate", scenes=["pick", "place"], steps=8, epochs=2, **ONE_ARM)
    peer.ask("close")
    assert (log["status"], log["steps"]) == ("success", 32)
    assert len(log["trials"]) == 4
    expected: list[dict[str, Any]] = []
    for trial in log["trials"]:
        expected.append({"event": "reset"})
        expected += [
            {
                "event": "infer",
                "asked": first // CHUNK,
                "observed": trial["observations"][first]["digest"],
                "instruction": trial["instruction"],
                "actions": trial["actions"][first : first + CHUNK],
            }
            for first in range(0, 8, CHUNK)
        ]
        expected.append({"event": "trial_end"})
    notes = journal.read()
    trials = [entry.pop("trial") for entry in notes if entry["event"] == "trial_end"]
    assert len(set(trials)) == 4
    for entry, wanted in zip(notes, expected, strict=True):
        if entry["event"] == "infer":  # an episode may end within a chunk
            entry["actions"] = entry["actions"][: len(wanted["actions"])]
        assert entry == wanted


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("robot", "prefixes", "action_type"),
    [("franka_single", [""], "joint"), ("arx_x5", ["left_", "right_"], "ee")],
)
def test_inspect_robots_plays_the_demo_policy(
    serve: Serve, plugin: Connect, robot: str, prefixes: list[str], action_type: str
) -> None:
    dof = get_embodiment(robot).arms[0].dof
    server = serve(ROOT / "policy/demo_policy", overrides={"env_cfg_type": robot, "action_type": action_type})
    theirs = {"arm_joint_state": "joint_pos", "ee_joint_state": "gripper", "ee_pose": "eef_pose"}
    names = [(prefix + ours, prefix + key) for prefix in prefixes for ours, key in theirs.items()]
    peer = plugin(
        server.url,
        action_type=action_type,
        arms=len(prefixes),
        arm_dim=dof,
        state_map=",".join(f"{ours}:{key}" for ours, key in names),  # as on its command line
        required_state_keys=",".join(key for _, key in names),
    )
    log = peer.ask("evaluate", scenes=["hold"], steps=20, prefixes=prefixes, dof=dof, action_type=action_type)
    assert (log["status"], log["steps"]) == ("success", 20)
    (trial,) = log["trials"]
    for step, action in enumerate(trial["actions"]):
        seen = trial["observations"][step // 16 * 16]["state"]
        arm = theirs["arm_joint_state" if action_type == "joint" else "ee_pose"]
        held = [value for prefix in prefixes for key in (arm, "gripper") for value in seen[prefix + key]]
        assert action == pytest.approx(held, abs=1e-6)  # quaternions are normalised on the way


@pytest.mark.sampled(1)
def test_an_error_of_the_policy_is_an_error_of_that_trial_only(serve: Serve, plugin: Connect, journal: Journal) -> None:
    peer = plugin(serve(journal.folder, overrides=journal.overrides).url)
    log = peer.ask("evaluate", scenes=["pick", "break", "place"], steps=4, **ONE_ARM)
    assert [scene["status"] for scene in log["scenes"]] == ["success", "error", "success"]
    assert spec.ErrorCode.INFER_FAILED in log["scenes"][1]["error"]
    assert "the gripper is jammed" in log["scenes"][1]["error"]
    assert "Traceback" not in log["scenes"][1]["error"]
    played = [spec.Message.RESET, "infer", "infer", "trial_end"]
    peer.ask("close")
    assert journal.events() == [*played, "reset", "trial_end", *played]


@pytest.mark.slow
def test_a_second_peer_is_refused_and_may_ask_again(serve: Serve, plugin: Connect, journal: Journal) -> None:
    """The plugin does not retry a hello that is answered by busy: it raises, and its next reset succeeds once free."""
    url = serve(journal.folder, overrides=journal.overrides).url
    first, second = plugin(url), plugin(url)
    first.ask("reset")
    for _ in range(2):  # it keeps the connection whose hello was refused
        with pytest.raises(PeerError, match="in use by another client") as refused:
            second.ask("reset")
        assert refused.value.kind == "WsError"
        assert refused.value.details == {"reason": spec.ErrorReason.BUSY}
    first.ask("act", **ONE_ARM)
    assert journal.events() == ["reset", "infer"]
    first.ask("close")
    wait_until(lambda: not _refused(second), "the server is free")
    second.ask("act", **ONE_ARM)
    assert journal.events() == ["reset", "infer", "trial_end", "reset", "infer"]


def _refused(peer: Driver) -> bool:
    try:
        peer.ask("reset")
    except PeerError as error:
        assert error.details == {"reason": spec.ErrorReason.BUSY}  # noqa: PT017 - any other error fails the test
        return True
    return False


@pytest.mark.slow
def test_a_restart_amid_an_episode_is_refused(serve: Serve, plugin: Connect, journal: Journal) -> None:
    """The plugin does not compare server instances, so the new server has to tell that the episode is not its own."""
    with Relay(serve(journal.folder, overrides=journal.overrides).url) as relay:
        peer = plugin(relay.url)
        peer.ask("reset")
        peer.ask("act", **ONE_ARM)
        relay.target = serve(journal.folder, overrides=journal.overrides).url
        relay.cut()
        with pytest.raises(PeerError, match="ConnectionError"):
            peer.ask("act", **ONE_ARM)
        with pytest.raises(PeerError, match="seen no reset") as refused:
            peer.ask("act", **ONE_ARM)
        assert refused.value.details["reason"] == spec.ErrorReason.NO_EPISODE
        peer.ask("reset")
        peer.ask("act", **ONE_ARM)
    assert [event for event in journal.events() if event != "trial_end"] == ["reset", "infer"] * 2


@pytest.mark.sampled(1)
def test_our_client_waits_while_a_third_party_has_the_server(
    serve: Serve, client: Connect, plugin: Connect, journal: Journal
) -> None:
    url = serve(journal.folder, overrides=journal.overrides).url
    theirs = plugin(url)
    theirs.ask("reset")
    with pytest.raises(PeerError, match="in use by another client") as refused:
        client(url, max_connect_attempts=2, connect_retry_delay_s=0)
    assert refused.value.kind == "ServerConnectionError"
    theirs.ask("close")
    client(url, connect_retry_delay_s=0.05)


@pytest.mark.slow
# Not with the oldest: a connection of websockets 12 left open keeps its interpreter from ending, the plugin's hook
# included, until the server closes it.
@pytest.mark.parametrize("peers", [environment("newest")], indirect=True)
def test_a_peer_that_ends_without_goodbye_leaves_the_server_free(
    serve: Serve, plugin: Connect, journal: Journal
) -> None:
    """At the end of its interpreter the plugin ends trial and connection in order: nobody has to wait for the grace."""
    url = serve(journal.folder, overrides=journal.overrides).url
    first = plugin(url)
    first.ask("reset")
    first.ask("act", **ONE_ARM)
    assert first.end() == 0
    second = plugin(url)
    second.ask("reset")
    assert journal.events() == ["reset", "infer", "trial_end", "reset"]


@pytest.mark.sampled(1)
def test_a_cut_costs_inspect_robots_one_trial(serve: Serve, plugin: Connect, journal: Journal) -> None:
    with Relay(serve(journal.folder, overrides=journal.overrides).url) as relay:
        peer = plugin(relay.url)
        peer.start("evaluate", scenes=["pick", "place", "stack"], steps=6, pause=[1, CHUNK - 1], **ONE_ARM)
        assert peer.receive() == {"paused": [1, CHUNK - 1]}  # before the last action of the first chunk
        relay.cut()
        peer.send({})
        log = peer.result()
        peer.ask("close")
    assert [scene["status"] for scene in log["scenes"]] == ["success", "error", "success"]
    assert "connection" in log["scenes"][1]["error"]
    played = ["reset", "infer", "infer", "trial_end"]
    assert journal.events() == [*played, "reset", "infer", "trial_end", *played]
    assert [entry["asked"] for entry in journal.read() if entry["event"] == "infer"] == [0, 1, 0, 0, 1]
