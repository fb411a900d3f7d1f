"""Folders that nobody trained: each is one clear error, and nothing outside of it is read."""

from __future__ import annotations

import os
import struct
import zipfile
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.adapters import trained
from tests.support.examples import examples
from xpl_cli.adopt.checkpoints import registry
from xpl_cli.adopt.checkpoints.reading import CheckpointFolder, ConfigDocument
from xpl_cli.basics.errors import NotFoundError, UserError

_KEYS = (
    *("type", "input_features", "output_features", "action", "observation.state", "shape", "n_action_steps"),
    *("model_type", "norm_stats", "pred_horizon", "state_token_dim", "config", "rdt", "algo_name", "observation"),
    *("modalities", "obs", "rgb", "train", "algo"),
)


def refused(folder: Path, message: str) -> None:
    """Hold that a folder is refused with these words, and its own path."""
    with pytest.raises(UserError) as failed:
        registry.read([folder])
    assert message in str(failed.value)
    assert str(folder) in str(failed.value)


def test_a_folder_of_nobody_s_is_told_whose_there_are(tmp_path: Path) -> None:
    refused(tmp_path, "expected LeRobot, openpi")
    refused(trained.put(tmp_path, "weights.pt", "x"), "is a file: expected the folder that training wrote")
    with pytest.raises(NotFoundError, match="there is no"):
        registry.read([tmp_path / "nothing"])


@pytest.mark.parametrize(
    ("text", "told"),
    [("{", "not JSON"), ("[" * 100_000, "nested"), ('{"type": "act"', "not JSON"), ("\0\1", "not JSON")],
)
def test_what_is_no_json_is_one_error(tmp_path: Path, text: str, told: str) -> None:
    trained.put(tmp_path, "config.json", text)
    refused(tmp_path, told)


def test_what_is_too_large_is_not_read(tmp_path: Path) -> None:
    """A document of 40 MB, which takes no room on disk, is refused before it is read."""
    with (trained.put(tmp_path, "config.json", "{}")).open("r+b") as stream:
        stream.truncate(40 << 20)
    refused(tmp_path, "more than the limit")


def test_no_link_leads_out(tmp_path: Path) -> None:
    """A checkpoint is read where it lies: not /etc, and not a folder beside it."""
    folder = tmp_path / "p"
    folder.mkdir()
    trained.put(tmp_path, "secret.json", {"type": "act", "input_features": {}})
    (folder / "config.json").symlink_to(tmp_path / "secret.json")
    refused(folder, "leads out of its folder")


def test_a_statistics_file_that_is_named_outside_is_not_read(tmp_path: Path) -> None:
    """The processor's own words are not trusted either."""
    folder = trained.lerobot(tmp_path / "p", n_action_steps=8)
    trained.safetensors(tmp_path / "outside.safetensors", {"action.mean": [1.0]})
    path = folder / "policy_preprocessor.json"
    held = path.read_text(encoding="utf-8")
    path.write_text(held.replace("policy_preprocessor_step_2_normalizer_processor", "../outside"), encoding="utf-8")
    refused(folder, "leads out of its folder")


def test_links_of_the_hub_s_cache_are_followed(tmp_path: Path) -> None:
    """A snapshot there is links to blobs two folders above; only these are followed."""
    hub = tmp_path / "models--somebody--shirts"
    checkpoint = trained.lerobot(tmp_path / "made", n_action_steps=8)
    snapshot = hub / "snapshots" / ("0" * 40)
    snapshot.mkdir(parents=True)
    (hub / "blobs").mkdir()
    for number, path in enumerate(sorted(checkpoint.iterdir())):
        path.rename(hub / "blobs" / str(number))
        (snapshot / path.name).symlink_to(Path("..") / ".." / "blobs" / str(number))
    assert registry.read([snapshot])[0].framework == "lerobot"


def test_nothing_waits_for_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "config.json")
    refused(tmp_path, "expected a file, got a pipe")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff" * 64,
        struct.pack("<Q", 2**60) + b"{}",
        struct.pack("<Q", 2) + b"[]",
        struct.pack("<Q", 30) + b'{"action.mean": {"shape": [2]}}'[:30],
        struct.pack("<Q", 76)
        + b'{"action.mean": {"dtype": "F32", "shape": [9], "data_offsets": [0, 36]}}    '
        + b"\0" * 8,
    ],
)
def test_a_file_of_statistics_that_is_none_is_one_error(tmp_path: Path, content: bytes) -> None:
    """Empty, random, with a header of any size, or shorter than it says."""
    folder = trained.lerobot(tmp_path / "p", n_action_steps=8)
    name = "policy_postprocessor_step_0_unnormalizer_processor.safetensors"
    (folder / name).write_bytes(content)
    refused(folder, name)


def test_a_zip_is_listed_and_not_unpacked(tmp_path: Path) -> None:
    """A member of four gigabytes of zeros is a name."""
    with zipfile.ZipFile(tmp_path / "bomb.ckpt", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", b"\0" * (8 << 20))
    assert (tmp_path / "bomb.ckpt").stat().st_size < 100_000
    assert CheckpointFolder(tmp_path).members("bomb.ckpt") == ["archive/data.pkl"]
    trained.put(tmp_path, "no.ckpt", "no zip")
    assert CheckpointFolder(tmp_path).members("no.ckpt") == []


def test_numbers_are_finite_and_few(tmp_path: Path) -> None:
    for value in ([float("nan")], ["1"], [0.0] * 20_000, [True]):
        with pytest.raises(UserError, match="expected a list of finite numbers"):
            ConfigDocument("stats.json", {"mean": value}).numbers("mean")


def test_yaml_that_names_classes_is_refused(tmp_path: Path) -> None:
    """A tag makes nothing; a tangle of aliases is no configuration."""
    trained.put(tmp_path, ".hydra/config.yaml", "shape_meta: !!python/object/apply:os.system [touch /tmp/x]")
    refused(tmp_path, "is not YAML")
    bomb = "a: &a [x, x]\n"
    for before, name in pairwise("abcdefghi"):
        bomb += f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    trained.put(tmp_path, ".hydra/config.yaml", bomb)
    refused(tmp_path, "is not YAML")


@pytest.mark.slow
@settings(max_examples=examples(40), deadline=None)
@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(_KEYS), inner, max_size=4),
        max_leaves=20,
    )
)
def test_whatever_a_config_holds_it_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, value: object) -> None:
    """No document ends in anything but facts or one sentence."""
    folder = tmp_path_factory.mktemp("any")
    trained.put(folder, "config.json", value)
    with suppress(UserError):
        registry.read([folder])
