"""The module `torch` and its parts, as far as they are more than things."""

from __future__ import annotations

from typing import Any

from xpl.worker.standins.torch.functions import FUNCTIONS, KINDS, Generator, Guard, manual_seed
from xpl.worker.standins.torch.kinds import Size, device, dtype
from xpl.worker.standins.torch.tensor import Tensor


def _nothing(*_: Any, **__: Any) -> None:
    return None


def _no(*_: Any, **__: Any) -> bool:
    return False


def _yes(*_: Any, **__: Any) -> bool:
    return True


def _zero(*_: Any, **__: Any) -> int:
    return 0


def _is_tensor(value: Any) -> bool:
    return isinstance(value, Tensor)


def _same(function: Any = None, *_: Any, **__: Any) -> Any:
    return function if function is not None else _same


def seed(*_: Any, **__: Any) -> int:
    """Return the number that torch would have drawn."""
    return 0


def parts() -> dict[str, dict[str, Any]]:
    """Return what each module offers, by its name."""
    activation = {name: FUNCTIONS[name] for name in ("interpolate", "pad", "normalize", "softmax", "sigmoid", "tanh")}
    seeds = {"manual_seed": manual_seed, "manual_seed_all": _nothing, seed.__name__: seed}
    return {
        "torch": {
            **FUNCTIONS, **KINDS, **seeds,
            "Tensor": Tensor, "FloatTensor": Tensor, "device": device, "dtype": dtype, "Size": Size,
            "Generator": Generator, "no_grad": Guard, "inference_mode": Guard, "enable_grad": Guard,
            "set_grad_enabled": Guard, "autocast": Guard, "compile": _same, "is_tensor": _is_tensor,
            "is_grad_enabled": _no, "get_default_dtype": lambda: KINDS["float32"], "set_default_dtype": _nothing,
            "set_default_device": _nothing, "set_float32_matmul_precision": _nothing, "set_num_threads": _nothing,
            "use_deterministic_algorithms": _nothing, "__version__": "2.7.0", "pi": 3.141592653589793,
            "inf": float("inf"), "nan": float("nan"),
        },
        "torch.cuda": {
            **seeds, "is_available": _yes, "device_count": lambda *_: 1, "current_device": _zero,
            "empty_cache": _nothing,
            "synchronize": _nothing, "set_device": _nothing, "is_bf16_supported": _yes, "memory_allocated": _zero,
            "max_memory_allocated": _zero, "reset_peak_memory_stats": _nothing, "get_device_name": lambda *_: "none",
            "ipc_collect": _nothing,
        },
        "torch.amp": {"autocast": Guard},
        "torch.cuda.amp": {"autocast": Guard},
        "torch.distributed": {
            "is_available": _no, "is_initialized": _no, "get_rank": _zero, "get_world_size": lambda *_: 1,
            "init_process_group": _nothing, "destroy_process_group": _nothing, "barrier": _nothing,
        },
        "torch.backends.mps": {"is_available": _no, "is_built": _no},
        "torch.nn.functional": activation,
        "torch.random": seeds,
    }  # fmt: skip
