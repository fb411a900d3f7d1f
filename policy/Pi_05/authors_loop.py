"""The evaluation in LIBERO of openpi's authors: examples/libero/main.py as the client of openpi's policy server.

`benchmarks/authors_loops.py` runs this beside `xpl eval`, and compares what reaches model and simulator. It uses
nothing of model.py or policy.yml.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

_LIBERO: dict[str, Any] = {
    "variant": None,
    "environment": "libero",
    "setting": "delta",
    "task": "libero_spatial_0",
    "model": {
        "model": "openpi.policies.policy:Policy.infer",
        "network": "openpi.models.model:Observation.from_dict",
    },
    "left_out": ["obs/observation/state", "data/state", "policy_timing"],  # no input of pi05_libero, as README.md says
    "tolerance": 0.01,  # poses are float32: 1e-6 of a delta, by which some pixels differ after the first chunk
}
LOOPS = {"libero": _LIBERO, "libero_seed_7": {**_LIBERO, "differs": "observation of the simulator"}}
"""What `xpl eval` runs, and functions through which both loops ask the model.

`libero_seed_7` has the seed of openpi's example, by which LIBERO places fixtures, so that it shows another scene;
`libero` has 0, as the environment package.
"""


def evaluation(config: dict[str, Any]) -> Callable[[Any], None]:
    """Return a function that runs their evaluation, whose first episode is the initial state of a trial's seed."""
    name, here = config["ckpt_name"], Path(__file__).parent
    checkpoint = here / name if "/" in name else here / "checkpoints" / name

    def evaluate(trial: Any) -> None:
        sys.modules["imageio"] = mock.MagicMock()  # videos
        main = example("libero/main.py")
        states = main.benchmark.Benchmark.get_task_init_states
        port = serve(policy(config, checkpoint), trial.rng)
        with mock.patch.object(
            main.benchmark.Benchmark, "get_task_init_states", lambda *task: states(*task)[trial.seed :]
        ):
            main.eval_libero(main.Args(host="127.0.0.1", port=port, seed=7 if trial.loop == "libero_seed_7" else 0))

    return evaluate


def example(name: str) -> ModuleType:
    """Import a file of openpi's examples, which lie beside its packages."""
    spec = importlib.util.spec_from_file_location("example", Path(sys.prefix) / "src" / "openpi" / "examples" / name)
    if spec is None or spec.loader is None:
        raise ImportError(f"openpi has no example {name}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def policy(config: dict[str, Any], checkpoint: Path) -> Any:
    """Return openpi's policy, with the sizes in the checkpoint's config.json, as its converter writes it."""
    from openpi.policies import policy_config
    from openpi.training import config as training

    train = training.get_config(config["train_config"])
    sizes = json.loads((checkpoint / "config.json").read_text())
    names = {field.name for field in dataclasses.fields(train.model)}
    model = dataclasses.replace(train.model, **{key: value for key, value in sizes.items() if key in names})
    return SimpleNamespace(
        policy=policy_config.create_trained_policy(dataclasses.replace(train, model=model), checkpoint),
        noise=(model.action_horizon, model.action_dim),
    )


def serve(trained: Any, rng: Any) -> int:
    """Serve a policy by openpi's server in a thread; each inference draws its noise from `rng`. Return the port."""
    import socket

    from openpi.serving.websocket_policy_server import WebsocketPolicyServer

    def infer(obs: dict[str, Any]) -> dict[str, Any]:
        answer: dict[str, Any] = trained.policy.infer(obs, noise=rng.standard_normal(trained.noise).astype(np.float32))
        return answer

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    server = WebsocketPolicyServer(SimpleNamespace(infer=infer), "127.0.0.1", port, trained.policy.metadata)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return port
