"""Audits without the model: what the shadow proves, and when it is chosen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from xpl.client import Client
from xpl.policy import Policy
from xpl.worker.missing_requirements import ShadowError, missing_requirement
from xpl.worker.shadow import NoShadowError, shadow_of
from xpl.worker.third_party import is_third_party
from xpl_cli.audit.engine import engine
from xpl_cli.audit.formats import as_json, render
from xpl_cli.audit.rules.gates import Gate
from xpl_cli.audit.rules.model import GateReport, Outcome, exit_code
from xpl_cli.audit.rules.options import AuditOptions
from xpl_cli.audit.rules.profiles import Profile
from xpl_cli.audit.rules.verdict import VerdictStatus, verdict_of
from xpl_cli.basics.errors import ExitCode
from xpl_cli.scaffold import adapter
from xpl_cli.scaffold.answers import AdapterAnswers
from xpl_cli.serving.launch import MissingRequirement, ServerStartError, running_server
from xpl_cli.standard import spec
from xpl_cli.standard.validate import validate

if TYPE_CHECKING:
    from pathlib import Path

    from xpl_cli.audit.rules.model import TargetReport

NAME = "Subject"
CONFIG = {"env_cfg_type": "arx_x5", "action_type": "joint"}
MISSING = "a_library_that_nobody_has"
RULES = ("serves", "action-structure", "batch-order", "inputs-matter", "action-after-reset")
SPLIT = f"""
import numpy as np
from xpl import Policy
from xpl.checkpoint import resolve
from xpl.observation import pack_state


class Model(Policy):
    def load(self, config):
        import {MISSING}

        self.net = {MISSING}.load(resolve(config, self.policy_dir))

    def encode(self, obs, env):
        return pack_state(obs, self.embodiment, self.action_type)

    def predict(self, inputs, envs):
        return self.net(np.stack(inputs))
"""
BARE = f"""
import {MISSING} as lib


class Model:
    def __init__(self, config):
        self.net = lib.open(resolve(config))

    def update_obs(self, obs):
        pass

    def get_action(self):
        return [{{}}]


def resolve(config):
    from pathlib import Path

    return Path(__file__).parent / (config["ckpt_name"] or "checkpoints/run.pt")
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return a scaffold in which nothing is left to fill in."""
    folder, mark = tmp_path / NAME, spec.data("package")["placeholder"].encode()
    files = adapter.render(AdapterAnswers(**{**adapter.defaults(), "name": NAME}))
    adapter.write({name: content.replace(mark, b"done") for name, content in files.items()}, folder)
    return folder


def _offline(package: Path, model: str | None = None, **options: Any) -> TargetReport:
    if model is not None:
        (package / "model.py").write_text(model, encoding="utf-8")
    return engine.audit(package, "policy", AuditOptions(gates=(Gate.OFFLINE,), names=RULES, **options))


def _gate(report: TargetReport) -> GateReport:
    (gate,) = report.gates
    return gate


def _outcomes(gate: GateReport) -> dict[str, str]:
    return {result.slug: result.outcome.value for result in gate.results}


def _reasons(gate: GateReport) -> str:
    return "\n".join(result.reason or "" for result in gate.results)


# -- which profile -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_what_can_be_loaded_is_audited_in_full_and_a_shadow_has_a_digest_of_its_own(package: Path) -> None:
    """Nothing stands in, and the finish line does not speak of a profile; that of a shadow repeats."""
    gate = _gate(_offline(package))
    assert (gate.profile, gate.stood_in, gate.outcome) == (Profile.FULL, None, Outcome.PASS)
    assert "profile" not in str(gate.finish)
    shadows = [_gate(_offline(package, profile=Profile.SHADOW)) for _ in range(2)]
    assert shadows[0].finish == shadows[1].finish
    assert shadows[0].fingerprint != gate.fingerprint


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("model", "lacks"),
    [
        pytest.param(SPLIT, MISSING, id="module"),
        pytest.param(SPLIT.replace(f"import {MISSING}", "pass").replace(MISSING, "np"), "checkpoint", id="checkpoint"),
        pytest.param(
            SPLIT.replace(f"import {MISSING}\n", "return\n").replace(
                "return self.net", f"import {MISSING}\n        return"
            ),
            MISSING,
            id="module of predict",
        ),
    ],
)
def test_a_missing_part_makes_a_shadow_that_is_told_and_can_be_clean(package: Path, model: str, lacks: str) -> None:
    """Chosen by itself, also where the model is built at the first question; the reason is in every report."""
    report = _offline(package, model)
    gate = _gate(report)
    assert set(_outcomes(gate).values()) == {"pass"}, gate.results
    assert (verdict_of(report).status, exit_code([report])) == (VerdictStatus.SHADOW, ExitCode.CLEAN)
    assert gate.profile is Profile.SHADOW
    assert lacks in str(gate.stood_in)
    assert str(gate.finish).endswith("profile=shadow")
    assert all("shadow mode" in render(name, [report]) for name in ("text", "github", "sarif", "junit"))
    document = as_json([report])
    assert validate(document, "audit") == []
    assert (document["targets"][0]["gates"][0]["profile"], document["exit_code"]) == ("shadow", 0)


# -- what a shadow still catches ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_shadow_shows_what_is_wrong_around_the_model(package: Path) -> None:
    """An adapter that reads a batch by position, and one that reads no input it requires."""
    by_position = """
    def get_action_batch(self, env_idx_list=None):
        answers = super().get_action_batch(None if env_idx_list else env_idx_list)
        return answers[: len(env_idx_list)] if env_idx_list else answers
"""
    assert _outcomes(_gate(_offline(package, SPLIT + by_position)))["batch-order"] == "fail"
    blind = SPLIT.replace("return pack_state", "return 0 * pack_state")
    assert _outcomes(_gate(_offline(package, blind)))["inputs-matter"] == "warn"


@pytest.mark.slow
def test_a_raw_output_of_another_shape_is_declared(package: Path) -> None:
    """`shadow` in policy.yml: decode gets that shape and that range."""
    decode = """
    def decode(self, raw, obs, env):
        assert raw.shape == (50, 32) and np.abs(raw).max() <= 0.01
        return super().decode(raw[: self.chunk, :14] + pack_state(obs, self.embodiment, self.action_type), obs, env)
"""
    assert _outcomes(_gate(_offline(package, SPLIT + decode)))["serves"] == "pass"
    assert _outcomes(_gate(_offline(package)))["action-structure"] == "fail"
    with (package / "policy.yml").open("a", encoding="utf-8") as stream:
        stream.write("\nshadow: {shape: [50, 32], range: [-0.01, 0.01]}\n")
    assert _outcomes(_gate(_offline(package)))["action-structure"] == "pass"


@pytest.mark.slow
def test_one_action_in_place_of_a_chunk_is_no_failure_of_a_mock_of_undeclared_shape(package: Path) -> None:
    """A decode may expect another axis; once the shape is declared, the answer counts."""
    first = """
    def decode(self, raw, obs, env):
        return super().decode(raw, obs, env)[0]
"""
    results = {result.slug: result for result in _gate(_offline(package, SPLIT + first)).results}
    assert results["action-structure"].outcome is Outcome.WARN, results["action-structure"].findings
    assert "which may come from the mock" in results["action-structure"].findings[0].message
    manifest = package / "policy.yml"
    manifest.write_text(manifest.read_text(encoding="utf-8") + "\nshadow: {shape: [8, 14]}\n", encoding="utf-8")
    assert _outcomes(_gate(_offline(package)))["action-structure"] == Outcome.FAIL.value


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("return pack_state", "self.tokenizer(obs)\n        return pack_state", "no 'tokenizer'"),
        ("return pack_state(obs, self.embodiment, self.action_type)", "return dict(obs)", "returns the observation"),
        ("import numpy as np", f"import numpy as np\nimport {MISSING}", "import it in load"),
        ("class Model(Policy):", "class Model:\n    def __init__(self, config):\n        self.load(config)", "derives"),
    ],
)
def test_what_a_shadow_cannot_stand_in_for_is_not_run(package: Path, old: str, new: str, told: str) -> None:
    """It is no fault of the adapter's, and nothing is green."""
    report = _offline(package, SPLIT.replace(old, new, 1))
    assert set(_outcomes(_gate(report)).values()) == {"not_run"}, _gate(report).results
    assert told in _reasons(_gate(report))


@pytest.mark.slow
def test_an_adapter_without_the_sdk_is_not_run_without_its_library_and_weights(package: Path) -> None:
    """Both are named at once; with the library alone the weights are; with both it is served, whatever they are."""
    reasons = _reasons(_gate(_offline(package, BARE)))
    assert f"module {MISSING} is not installed" in reasons
    assert "the checkpoint is not here" in reasons
    report = _offline(package, BARE, profile=Profile.SHADOW)
    assert set(_outcomes(_gate(report)).values()) == {"not_run"}
    assert exit_code([report]) is ExitCode.NOT_RUN
    equipped = BARE.replace(MISSING, "builtins")
    reasons = _reasons(_gate(_offline(package, equipped)))
    assert MISSING not in reasons
    assert "the checkpoint is not here" in reasons
    (package / "checkpoints").mkdir(exist_ok=True)
    (package / "checkpoints" / "tiny.pt").write_bytes(b"random")
    gate = _gate(_offline(package, equipped, overrides={"ckpt_name": "checkpoints/tiny.pt"}))
    assert (gate.profile, _outcomes(gate)["serves"]) == (Profile.FULL, "pass")


def test_a_misspelt_module_of_the_adapter_is_a_fault(package: Path) -> None:
    """It is like a file of the adapter; a module that the requirements name is not."""
    (package / "helpers.py").write_text("x = 1\n", encoding="utf-8")
    gate = _gate(_offline(package, SPLIT.replace(MISSING, "helpes")))
    assert _outcomes(gate)["serves"] == "fail"
    (package / "transformer.py").write_text("x = 1\n", encoding="utf-8")
    assert not is_third_party("transformers_x", package)
    (package / "requirements.txt").write_text("transformers-x==4.1\n", encoding="utf-8")
    assert is_third_party("transformers_x", package)
    assert not is_third_party("numpy.no_such_part", package)


def test_only_files_of_the_checkpoint_are_a_missing_checkpoint(package: Path) -> None:
    """A statistics file of the adapter itself that is missing is a fault."""
    config = {"ckpt_name": "weights/run7"}
    missing = [
        FileNotFoundError(2, "", str(package / name)) for name in ("weights/run7/a.pt", "checkpoints/b", "stats")
    ]
    found = [(missing_requirement(error, package, config) or {}).get("kind") for error in missing]
    assert found == ["checkpoint", "checkpoint", None]


# -- the function ------------------------------------------------------------------------------------------------------


KEYS = {"arm_joint_state": 6, "ee_joint_state": 1}


class _Adapter(Policy):
    def encode(self, obs: Any, env: int) -> Any:
        return obs["inputs"]

    def predict(self, inputs: Any, envs: Any) -> Any:
        raise AssertionError


def _shadow(action_type: str = "joint") -> Policy:
    return shadow_of(_Adapter)({**CONFIG, "action_type": action_type})


@pytest.mark.parametrize("action_type", ["joint", "ee"])
def test_the_shadow_answers_valid_actions_that_follow_every_bit(action_type: str) -> None:
    """Whatever holds the inputs; the default decode accepts them; neighbours in the batch do not matter."""
    shadow = _shadow(action_type)
    image = np.random.default_rng(1).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    inputs = {"image": image, "state": [0.5, 1.5], "text": "pick", "more": [{"mask": True}, None, 3]}
    (plain,) = shadow.predict([inputs], [0])
    shadow.decode(plain, {}, 0)
    other = image.copy()
    other[5, 6, 1] ^= 1
    changes: list[dict[str, Any]] = [
        {"image": other},
        {"state": [0.5, 1.5000001]},
        {"text": "pick "},
        {"more": [{"mask": False}, None, 3]},
    ]
    for change in changes:
        assert not np.array_equal(shadow.predict([{**inputs, **change}], [0])[0], plain), change
    assert np.array_equal(shadow.predict([{**inputs, "state": np.float32([0.5, 1.5])}], [0])[0], plain)
    assert np.array_equal(shadow.predict([{**inputs, "text": "x"}, inputs], [0, 1])[1], plain)
    assert np.isnan(shadow.predict([{**inputs, "state": [np.nan, 0]}], [0])[0]).all()


def test_the_shadow_is_smooth() -> None:
    """Noise as compression leaves it moves the actions much less than an exchange of red and blue."""
    shadow = _shadow()
    rng = np.random.default_rng(1)
    image = np.dstack([rng.integers(low, low + 60, (48, 64)) for low in (10, 90, 180)]).astype(np.uint8)
    plain, noisy, swapped = (
        shadow.predict([item], [0])[0]
        for item in (image, image + rng.integers(0, 4, image.shape, np.uint8), image[..., ::-1])
    )
    assert np.abs(noisy - plain).max() < 0.1 * np.abs(swapped - plain).max()


def test_the_shadow_reads_tensors_and_refuses_what_it_cannot_read() -> None:
    """Whatever offers `detach` or `__array__` is an array; an object of another kind is named."""

    class Tensor:
        dtype = "float32"

        def detach(self) -> Any:
            return self

        cpu = detach

        def numpy(self) -> np.ndarray:
            return np.ones(3, np.float32)

    shadow = _shadow()
    assert np.array_equal(shadow.predict([Tensor()], [0]), shadow.predict([np.ones(3)], [0]))
    with pytest.raises(ShadowError, match=r"builtins\.object"):
        shadow.predict([object()], [0])
    with pytest.raises(NoShadowError):
        shadow_of(object)


class _OfModel(Policy):
    def predict(self, inputs: Any, envs: Any) -> Any:
        raise AssertionError


def test_the_shadow_of_an_adapter_with_a_model_io_block_answers_in_the_models_words(tmp_path: Path) -> None:
    """Also where the block is open, and where its statistics are not there: commands that the robot can follow."""
    parts = [
        {"joints": {"arm": "left", "unit": "deg"}},
        {"gripper": {"arm": "left", "closed": {"unknown": "-"}, "open": 0.08}},
        {"joints": {"arm": "right"}},
        {"gripper": {"arm": "right", "closed": 0.0, "open": 0.08}},
    ]
    normalize = {"rule": "mean_std", "file": "stats.json"}
    model_io = {
        "state": [{"input": "s", "parts": parts[2:], "normalize": normalize}],
        "action": {"reference": "delta_state", "parts": parts, "normalize": normalize, "pad": 32},
    }
    config = {"env_cfg_type": "arx_x5", "action_type": "joint"}
    with pytest.raises(NoShadowError):
        shadow_of(_OfModel)(config)
    policy = shadow_of(_OfModel)({**config, "manifest": {"temporal": {"chunk": 6}, "model_io": model_io}})
    rng = np.random.default_rng(0)
    state = {f"{side}_{key}": rng.uniform(0, 1, width) for side in ("left", "right") for key, width in KEYS.items()}
    policy.update_obs_batch([{"state": state, "env_idx": env} for env in range(2)])
    one, two = policy.get_action_batch()
    assert len(one) == len(two) == 6
    for step in one:
        assert 0 <= step["left_ee_joint_state"][0] <= 1
        assert np.abs(step["left_arm_joint_state"]).max() < 3
    assert all(np.array_equal(a[key], b[key]) for a, b in zip(one, two, strict=True) for key in a)


# -- the server --------------------------------------------------------------------------------------------------------


def test_a_shadow_is_served_and_says_so(package: Path) -> None:
    """In its announcement; a server that cannot load says what is missing."""
    (package / "model.py").write_text(SPLIT, encoding="utf-8")
    with pytest.raises(ServerStartError) as caught, running_server(package):
        pass
    assert caught.value.lacks == MissingRequirement("module", MISSING)
    with running_server(package, options=("--shadow",)) as server, Client(server.url) as client:
        assert client.policy["shadow"] is True
