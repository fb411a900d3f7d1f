"""A convention of an installed package is found by all that know conventions, without a change elsewhere."""

from __future__ import annotations

import copy
import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support import commands
from tests.support.adapters.model_io import CASES
from tests.support.adapters.planted import RecordedEpisodes
from tests.support.checkout import ROOT
from tests.support.distributions import installing
from xpl.catalogue import AdapterCase
from xpl.catalogue.convention import applying, convention_of_key, io_mistakes
from xpl.convert import compile_interface
from xpl_cli.audit.offline.demonstrations import scripted
from xpl_cli.data.probe.probe import probe
from xpl_cli.data.reading import open_set
from xpl_cli.model_io import reference_file
from xpl_cli.model_io.difference import differences, spreads
from xpl_cli.model_io.explain import TriedChange, explain
from xpl_cli.model_io.mistakes import in_block
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NAME = "image_gamma"
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
CASE = CASES["two arms, joint deltas"]


@pytest.fixture
def gamma(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install the convention of docs/extending.md, and return where."""
    (text,) = re.findall(r'^```python title="xpl_tiny/gamma.py"\n(.*?)^```', PAGE, re.DOTALL | re.MULTILINE)
    probe = "\n\ndef _probe(sample):\n    from xpl_cli.data.probe.answer import unknown\n"
    probe += '    yield unknown("gamma", "set", "no light was measured", "a grey card")\n'
    files = {
        "outside_gamma.py": text.replace("CONVENTION =", f"{probe}\n\nCONVENTION =").replace(
            "NAME,\n", "NAME,\n    probe=_probe,\n"
        )
    }
    with installing(tmp_path, monkeypatch) as install:
        yield install("gamma", "[xpl.conventions]\ngamma = outside_gamma\n", files)


def _block(gamma: float | None) -> dict[str, Any]:
    block: dict[str, Any] = copy.deepcopy(CASE.model_io)
    for image in block["images"]:
        if gamma is not None:
            image["gamma"] = gamma
    return block


def test_without_the_package_its_key_is_not_known() -> None:
    assert validate(_block(2.2), "model_io")


@pytest.mark.usefixtures("gamma")
def test_the_schema_and_the_conversions_know_it() -> None:
    assert validate(_block(2.2), "model_io") == []
    assert NAME in applying(_block(2.2))
    assert NAME not in applying(_block(None))
    assert convention_of_key(("images", 0, "gamma")) == NAME
    reference_file.vocabulary.cache_clear()
    assert reference_file.vocabulary()[NAME] == "gamma of pixels"
    reference_file.vocabulary.cache_clear()
    plain, other = (compile_interface(_block(one), CASE.embodiment, CASE.action_type).images[0] for one in (None, 2.2))
    image = np.random.default_rng(0).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    assert not np.allclose(plain.view(image), other.view(image))
    (back,) = other.visible_images(other.view(image))[:1]
    (there,) = plain.visible_images(plain.view(image))[:1]
    far = np.abs(back.astype(int) - there)[there > 64]  # what is dark is rounded to fewer bytes
    assert far.max() <= 2


@pytest.mark.usefixtures("gamma")
def test_the_search_names_it() -> None:
    """Left out of a block, it is the single change that explains the difference."""
    rig = RecordedEpisodes(CASE)
    right, wrong = _block(2.2), _block(None)
    golden, given = rig.answers(right), rig.answers(wrong)
    spread = spreads(golden)
    tried = [
        TriedChange(one.description, one.convention, differences(golden, rig.answers(block), spread))
        for one, block in in_block(AdapterCase(CASE.embodiment, CASE.action_type, wrong))
        if one.convention in {NAME, "image_range", "image_channels"}
    ]
    found = explain(differences(golden, given, spread), tried, 1e-4)
    assert found.cause is not None
    assert (found.cause.convention, found.cause.words) == (NAME, "gamma: 2.2")
    shown = [
        one
        for one in io_mistakes(AdapterCase(CASE.embodiment, CASE.action_type, cameras=["cam_head"]))
        if one.convention == NAME
    ]
    assert [one.description for one in shown] == ["gamma: 2.2"]


@pytest.mark.usefixtures("gamma")
def test_the_command_line_explains_it_and_the_probe_asks_it(tmp_path: Path) -> None:
    done = commands.xpl("explain", NAME, "--json", folder=tmp_path)
    told = json.loads(done.stdout)
    assert done.code == 0
    assert told["about"] == "gamma of pixels"
    assert told["keys"] == {"images": ["gamma"]}
    assert "gamma: 2.2" in told["mistakes"]
    package = tmp_path / "policy"
    package.mkdir()
    found = probe(open_set(scripted.write(package, "franka_single", 2)), images=False)
    assert [one.needs for one in found.answers if one.topic == "gamma"] == ["a grey card"]


def test_ours_are_explained(tmp_path: Path) -> None:
    told = json.loads(commands.xpl("explain", "rotation", "--json", folder=tmp_path).stdout)
    assert {one["name"] for one in told["values"]["form"]} >= {"quaternion_wxyz", "rot6d_rows", "euler"}
    assert any("scipy" in one["source"] for one in told["values"]["form"])
    assert commands.xpl("explain", "rotations", folder=tmp_path).code == 2
