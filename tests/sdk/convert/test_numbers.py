"""Normalisation: the formulas of the authors, written out, and where the numbers come from."""

from __future__ import annotations

import json
import struct
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xpl.conventions.normalization import Normalization
from xpl.errors import ConversionError

if TYPE_CHECKING:
    from pathlib import Path

X = np.array([0.3, -1.2, 2.5])
LOW, HIGH = np.array([-1.0, -2.0, 0.5]), np.array([1.0, 3.0, 4.5])
STATS = {"mean": LOW, "std": HIGH, "min": LOW, "max": HIGH, "low": LOW, "high": HIGH}


def _rule(rule: str, **more: Any) -> Normalization:
    values = {name: list(map(float, numbers)) for name, numbers in STATS.items()}
    return Normalization({"rule": rule, "values": values, **more}, 3)


AUTHORS = {
    "openpi Normalize": ("mean_std", 1e-6, (X - LOW) / (HIGH + 1e-6)),
    "openpi Normalize(use_quantiles=True)": ("quantiles", 1e-6, (X - LOW) / (HIGH - LOW + 1e-6) * 2.0 - 1.0),
    "LeRobot MEAN_STD": ("mean_std", 1e-8, (X - LOW) / (HIGH + 1e-8)),
    "LeRobot MIN_MAX": ("min_max", 0.0, 2 * (X - LOW) / (HIGH - LOW) - 1),
    "OpenVLA-OFT BOUNDS_Q99": ("quantiles", 1e-8, 2 * (X - LOW) / (HIGH - LOW + 1e-8) - 1),
    "GR00T q99": ("quantiles", 0.0, 2 * ((X - LOW) / (HIGH - LOW)) - 1),
}


@pytest.mark.parametrize(("rule", "epsilon", "wanted"), AUTHORS.values(), ids=AUTHORS)
def test_the_authors_formulas(rule: str, epsilon: float, wanted: np.ndarray) -> None:
    numbers = _rule(rule, epsilon=epsilon)
    assert np.allclose(numbers.encode(X), wanted, rtol=1e-13, atol=1e-13)
    assert np.allclose(numbers.decode(wanted), X, rtol=1e-12)


@settings(max_examples=25, derandomize=True, deadline=None)
@given(
    st.sampled_from(["mean_std", "min_max", "quantiles"]),
    st.floats(0, 0.1),
    st.lists(st.floats(-9, 9), min_size=3, max_size=3),
)
def test_the_inverse_leads_back(rule: str, epsilon: float, values: list[float]) -> None:
    numbers = _rule(rule, epsilon=epsilon)
    assert np.allclose(numbers.decode(numbers.encode(np.array(values))), values, atol=1e-9)


def test_statistics_of_the_padded_vector_are_cut() -> None:
    """Those that openpi ships have 32 numbers, whatever the robot has; neither more nor fewer will do."""
    values = {"low": [0.0] * 32, "high": [2.0] * 3 + [0.0] * 29}
    how = {"rule": "quantiles", "values": values}
    assert Normalization(how, 3, padded=32).encode(np.ones(3)).tolist() == [0, 0, 0]
    with pytest.raises(ConversionError, match="32 numbers as low, expected 3"):
        Normalization(how, 3, padded=16)


def test_a_mask_leaves_numbers_as_they_are() -> None:
    """OpenVLA keeps its gripper out; what is clipped is clipped everywhere."""
    numbers = _rule("quantiles", only=[True, False, True])
    assert numbers.encode(X)[1] == X[1]
    assert numbers.decode(X)[1] == X[1]
    assert _rule("quantiles", only=[True, False, True], clip=[-1, 1]).encode(X)[1] == -1


def test_clipping_goes_both_ways() -> None:
    numbers = _rule("quantiles", clip=[-1, 1])
    assert numbers.encode(np.array([-5.0, 0.5, 9.0])).tolist() == [-1, 0, 1]
    assert numbers.decode(np.array([-5.0, 0.0, 9.0])).tolist() == [-1, 0.5, 4.5]


@pytest.mark.parametrize(
    ("constant", "epsilon", "there", "back"),
    [
        ("epsilon", 1e-2, [9.0, 0.0], [2.005, 0.5]),  # LeRobot: 2 * 0.05 / 0.01 - 1, and the other has no epsilon
        ("refuse", 1e-2, [9.0, 2 * 0.5 / 1.01 - 1], [2.005, 0.505]),  # openpi: epsilon everywhere
        ("keep", 0.0, [2.05, 0.0], [2.0, 0.5]),  # GR00T q99
        ("zero", 0.0, [0.0, 0.0], [2.0, 0.5]),  # GR00T min_max
        ("shift", 0.0, [0.05, 0.0], [2.0, 0.5]),  # Diffusion Policy
    ],
)
def test_numbers_that_never_moved(constant: str, epsilon: float, there: list[float], back: list[float]) -> None:
    """The first was always 2; it is 2.05 now, and the model answers with the middle."""
    how = {
        "rule": "min_max",
        "values": {"min": [2.0, 0.0], "max": [2.0, 1.0]},
        "constant": constant,
        "epsilon": epsilon,
    }
    numbers = Normalization(how, 2)
    assert numbers.encode(np.array([2.05, 0.5])) == pytest.approx(there)
    assert numbers.decode(np.zeros(2)) == pytest.approx(back)


def test_a_mean_stands_for_a_number_that_never_moved() -> None:
    """Where there is no low, GR00T answers with the mean."""
    numbers = Normalization({"rule": "mean_std", "values": {"mean": [3.0], "std": [0.0]}, "constant": "keep"}, 1)
    assert [float(numbers.encode(np.array([3.5]))[0]), float(numbers.decode(np.array([1.0]))[0])] == [3.5, 3.0]


def _files(folder: Path) -> None:
    document = {"norm_stats": {"state": {"q01": [1.0, 2.0], "q99": [3.0, 4.0]}}}
    (folder / "stats.json").write_text(json.dumps(document))
    arrays: dict[str, Any] = {"norm_stats.state.q01": [1.0, 2.0], "norm_stats.state.q99": [3.0, 4.0]}
    np.savez(folder / "stats.npz", **arrays)
    header, body = {}, b""
    for name, numbers in arrays.items():
        data = np.array(numbers, np.float32).tobytes()
        header[name] = {"dtype": "F32", "shape": [2], "data_offsets": [len(body), len(body) + len(data)]}
        body += data
    text = json.dumps(header).encode()
    (folder / "stats.safetensors").write_bytes(struct.pack("<Q", len(text)) + text + body)


@pytest.mark.parametrize("file", ["stats.json", "stats.npz", "stats.safetensors"])
def test_numbers_are_read_from_files(file: str, tmp_path: Path) -> None:
    _files(tmp_path)
    how = {"rule": "quantiles", "file": file, "key": "norm_stats/state", "names": {"low": "q01", "high": "q99"}}
    numbers = Normalization(how, 2, [tmp_path / "nowhere", tmp_path])
    assert numbers.encode(np.array([1.0, 4.0])).tolist() == [-1, 1]


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"file": "other.json"}, "is in none of"),
        ({"file": "stats.json", "key": "norm_stats/action"}, "at 'action' there is state"),
        ({"file": "stats.json", "key": "norm_stats/state"}, "at 'low' there is q01, q99"),
        ({"file": "stats.npz", "key": "state"}, "has no state/low; it has norm_stats.state.q01"),
        ({"file": "broken.json"}, "is not JSON"),
        ({"file": "deep.json"}, "nested"),
        ({"file": "broken.npz"}, "is not a file of numpy arrays"),
        ({"file": "large.npz"}, "low unpacks to"),
        ({"file": "broken.safetensors"}, "is not a safetensors file"),
        ({"values": {"low": [1.0, 2.0]}}, "has no high, which the rule quantiles needs"),
        ({"values": {"low": [1.0], "high": [2.0]}}, "1 numbers as low, expected 2"),
        ({"values": {"low": [1.0, float("inf")], "high": [2.0, 3.0]}}, "not finite"),
        ({"values": {"low": [1.0, 2.0], "high": [1.0, 2.5]}}, r"divides by zero in dimensions \[0\]"),
        ({"values": {"low": [1.0, 2.0], "high": [2.0, 2.5]}, "only": [True]}, "only has 1 entries, expected 2"),
        ({"file": "text.json", "names": {"low": "a", "high": "b"}}, "expected a list of numbers as low, got many"),
    ],
)
def test_numbers_that_cannot_be_had(how: dict[str, Any], told: str, tmp_path: Path) -> None:
    _files(tmp_path)
    (tmp_path / "deep.json").write_text("[" * 100_000)
    if how.get("file") == "large.npz":
        with zipfile.ZipFile(tmp_path / "large.npz", "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("low.npy", bytes(2**26 + 1))
    for name in ("broken.json", "broken.npz", "broken.safetensors"):
        (tmp_path / name).write_text("{")
    (tmp_path / "text.json").write_text('{"a": "many", "b": 3}')
    with pytest.raises(ConversionError, match=told):
        Normalization({"rule": "quantiles", **how}, 2, [tmp_path])
