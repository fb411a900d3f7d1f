"""Redirects the device "cuda" to the CPU, for an adapter that names it by hand on a machine without a GPU.

`enable()` replaces functions of PyTorch in this process. A `TorchFunctionMode` would hold in one thread only, and sees
neither `torch.load` nor `torch.cuda`. `torch.cuda.is_available()` stays False, and a tensor's device is the CPU.

Two details of a GPU stay: a transfer copies memory that another library owns, such as a numpy array's, and
`torch.cuda.manual_seed` seeds the numbers that are drawn on "cuda". `torch.compile` leaves a function as it is: a
compiled one would name the missing device. Models of `transformers` that ask for flash attention get PyTorch's own.
"""

from __future__ import annotations

import functools
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import os
import re
import sys
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Callable

_CPU = "cpu"
_CUDA = re.compile(r"cuda(:\d+)?")
_MEMORY = 80 << 30
"""Bytes of a GPU's memory, free and in all, as `torch.cuda.mem_get_info` gives them."""
_LIKE = ("empty_like", "full_like", "ones_like", "rand_like", "randint_like", "randn_like", "zeros_like")
_NEW = ("new", "new_empty", "new_empty_strided", "new_full", "new_ones", "new_tensor", "new_zeros")
_NO_OPERATIONS = (
    "empty_cache",
    "init",
    "ipc_collect",
    "reset_accumulated_memory_stats",
    "reset_max_memory_allocated",
    "reset_max_memory_cached",
    "reset_peak_memory_stats",
    "set_device",
    "set_per_process_memory_fraction",
    "set_stream",
    "synchronize",
)
_ANSWERS: dict[str, Any] = {
    "current_device": 0,
    "get_device_capability": (8, 0),
    "get_device_name": "CPU",
    "is_bf16_supported": True,
    "max_memory_allocated": 0,
    "max_memory_reserved": 0,
    "mem_get_info": (_MEMORY, _MEMORY),
    "memory_allocated": 0,
    "memory_reserved": 0,
}
_CONFIGURATIONS = "transformers.configuration_utils"
_enabled = False


def enable() -> None:
    """Redirect "cuda" and "cuda:N" to the CPU from now on, in all threads; a second call changes nothing.

    Call it before the adapter is imported: a function that a module has imported by its name stays as it is.

    Raises:
        ImportError: this Python has no PyTorch.
    """
    global _enabled  # noqa: PLW0603 - a state of the process
    if _enabled:
        return
    os.environ.setdefault("TORCHDYNAMO_DISABLE", "1")  # read as torch._dynamo is imported
    import torch

    _redirect_devices(torch)
    _redirect_transfers(torch)
    _redirect_files(torch)
    _redirect_modes(torch)
    _replace_cuda_module(torch)
    if _CONFIGURATIONS in sys.modules:  # of a worker that is a copy of one with the adapter's libraries
        setattr(sys.modules[_CONFIGURATIONS].PretrainedConfig, _Attention.NAME, _Attention())
    sys.meta_path.insert(0, _AvoidFlashAttention())
    _enabled = True


def _redirect_devices(torch: Any) -> None:
    """Replace the functions that make a tensor on a device."""
    device_module = importlib.import_module("torch.utils._device")
    if hasattr(device_module, "_device_constructors"):
        device_module._device_constructors()  # noqa: SLF001 - it keeps the originals, which modes see
    for module, names in (
        (torch, sorted({*_constructors(torch), *_LIKE})),
        (torch.fft, ("fftfreq", "rfftfreq")),
        (torch.Tensor, _NEW),
        (torch.nn.Module, ("to_empty",)),
    ):
        for name in names:
            if hasattr(module, name):
                original = getattr(module, name)
                shares_memory = name in ("as_tensor", "asarray")
                function = _copying(_redirected(original), torch) if shares_memory else _redirected(original)
                setattr(module, name, function)
                _keep_in_scripts(original, function)

    class Generator(torch.Generator, metaclass=_AnyGenerator):  # type: ignore[misc]
        def __new__(cls, device: Any = _CPU) -> Any:
            return super().__new__(cls, _on_cpu(device))

    _AnyGenerator.original = torch.Generator
    torch.Generator = Generator


class _AnyGenerator(type):
    """Type of a class of which each generator of PyTorch is an instance."""

    original: Any = None

    def __instancecheck__(cls, instance: object) -> bool:
        return isinstance(instance, cls.original)


def _constructors(torch: Any) -> list[str]:
    """Return the names of the functions in `torch` that take a device."""
    names = "arange as_tensor asarray bartlett_window blackman_window empty empty_permuted empty_strided eye from_file"
    more = "full hamming_window hann_window kaiser_window linspace logspace normal ones rand randint randn randperm"
    last = "range scalar_tensor sparse_coo_tensor sparse_csr_tensor tensor tril_indices triu_indices zeros"
    return [name for name in f"{names} {more} {last}".split() if hasattr(torch, name)]


def _keep_in_scripts(original: object, function: object) -> None:
    """Let TorchScript compile a call of the replacement as the original's, which is native code."""
    builtins = importlib.import_module("torch.jit._builtins")
    name = builtins._find_builtin(original)  # noqa: SLF001 - there is no public table
    if name is not None:
        builtins._register_builtin(function, name)  # noqa: SLF001


def _redirect_transfers(torch: Any) -> None:
    """Replace the methods that move a tensor or a module to a device."""
    move = torch.Tensor.to
    torch.Tensor.to = _copying(_redirected(move, first_may_be_index=True), torch)
    torch.nn.Module.to = _redirected(torch.nn.Module.to, first_may_be_index=True)

    def cuda(self: Any, *_: Any, **__: Any) -> Any:
        return self.to("cuda")

    def cpu(self: Any, *_: Any, **__: Any) -> Any:
        """Return a copy, as of a tensor on a GPU."""
        moved = move(self, _CPU)
        return moved.clone() if moved is self else moved

    torch.Tensor.cuda = cuda
    torch.Tensor.cpu = cpu
    torch.Tensor.pin_memory = _returning_self
    torch.UntypedStorage.cuda = _returning_self


def _redirect_files(torch: Any) -> None:
    """Replace the functions that read tensors of a file to a device."""
    torch.load = _redirected(torch.load)
    torch.jit.load = _redirected(torch.jit.load)
    if importlib.util.find_spec("safetensors") is not None:
        importlib.import_module("safetensors.torch")
        original = vars(sys.modules["safetensors"])["safe_open"]
        redirected = _redirected(original, first_may_be_index=True)
        for module in list(sys.modules.values()):  # some have it by its name
            if getattr(module, "__dict__", {}).get("safe_open") is original:
                vars(module)["safe_open"] = redirected


def _redirect_modes(torch: Any) -> None:
    """Replace what names a device for a block of code or a group of processes."""
    modes = importlib.import_module("torch.utils._device")
    if hasattr(modes, "DeviceContext"):
        modes.DeviceContext.__init__ = _redirected(modes.DeviceContext.__init__)
    begin = torch.autocast.__init__

    def begin_autocast(self: Any, device_type: str, dtype: Any = None, *args: Any, **kwargs: Any) -> None:
        if device_type == "cuda" and dtype is None:
            dtype = torch.get_autocast_gpu_dtype()
        is_full = device_type == "cuda" and dtype == torch.float32
        begin(self, _on_cpu(device_type), torch.bfloat16 if is_full else dtype, *args, **kwargs)
        if is_full:  # CUDA casts bfloat16 to it, and only the check of the class above forbids it for the CPU
            self.fast_dtype = dtype

    torch.autocast.__init__ = begin_autocast
    if torch.distributed.is_available():
        start = torch.distributed.init_process_group

        @functools.wraps(start)
        def start_group(backend: Any = None, *args: Any, **kwargs: Any) -> Any:
            kwargs.pop("device_id", None)
            return start("gloo" if backend in (None, "nccl") else backend, *args, **kwargs)

        torch.distributed.init_process_group = start_group


def _replace_cuda_module(torch: Any) -> None:
    """Replace the functions and classes of `torch.cuda` that need a GPU."""
    cuda = torch.cuda
    for name in _NO_OPERATIONS:
        setattr(cuda, name, _returning(None))
    for name, answer in _ANSWERS.items():
        setattr(cuda, name, _returning(answer))
    cuda.manual_seed = cuda.manual_seed_all = _seeding(torch.default_generator)
    cuda.get_rng_state = _without_device(torch.get_rng_state)
    cuda.set_rng_state = _without_device(torch.set_rng_state, arguments=1)
    cuda.Stream = cuda.Event = cuda.device = _Idle
    cuda.current_stream = cuda.default_stream = cuda.stream = _Idle


class _AvoidFlashAttention(importlib.abc.MetaPathFinder):
    """Changes the configurations of `transformers` when that is imported, which takes seconds."""

    def find_spec(self, name: str, path: Any, target: Any = None) -> Any:
        if name != _CONFIGURATIONS:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            run = spec.loader.exec_module

            def run_and_change(module: Any) -> None:
                run(module)
                setattr(module.PretrainedConfig, _Attention.NAME, _Attention())

            spec.loader.exec_module = run_and_change  # type: ignore[method-assign]
        return spec


class _Attention:
    """Attribute of a model's configuration that names the attention: never one whose kernels need a GPU."""

    NAME = "_attn_implementation_internal"

    def __get__(self, config: Any, _: object = None) -> Any:
        if config is None:
            return self
        try:
            return vars(config)[self.NAME]
        except KeyError:
            raise AttributeError(self.NAME) from None

    def __set__(self, config: Any, value: Any) -> None:
        vars(config)[self.NAME] = self._on_cpu(value)

    def _on_cpu(self, value: Any) -> Any:
        """Return a name, or names by part of the model, with PyTorch's attention instead of flash attention."""
        if isinstance(value, Mapping):
            return {part: self._on_cpu(one) for part, one in value.items()}
        return "sdpa" if isinstance(value, str) and value.startswith("flash_attention") else value


class _Idle:
    """A stream, an event or a device of `torch.cuda`: work on a CPU is done when a function returns."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def __enter__(self) -> _Idle:  # noqa: PYI034 - `Self` is newer than this Python
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def record(self, *_: Any) -> None:
        pass

    wait = wait_stream = wait_event = synchronize = record

    def record_event(self, event: _Idle | None = None) -> _Idle:
        return event or _Idle()

    def query(self) -> bool:
        return True

    def elapsed_time(self, _: _Idle) -> float:
        """Return milliseconds: 0."""
        return 0.0


def _on_cpu(value: Any) -> Any:
    """Return the CPU for a device "cuda", as text, device or map of them; anything else unchanged."""
    if isinstance(value, str):
        return _CPU if _CUDA.fullmatch(value) else value
    if isinstance(value, Mapping):
        return {key: _on_cpu(one) for key, one in value.items()}
    if type(value).__name__ == "device" and value.type == "cuda":
        return type(value)(_CPU)
    return value


def _redirected(function: Callable[..., Any], *, first_may_be_index: bool = False) -> Callable[..., Any]:
    """Return a function whose devices are the CPU where they are "cuda".

    Args:
        function: a function, or a method, that takes devices.
        first_may_be_index: an int as `device`, or as the first argument behind `self`, is a GPU's index.
    """

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if first_may_be_index and len(args) > 1 and _is_index(args[1]):
            args = (args[0], _CPU, *args[2:])
        kwargs = {
            name: _CPU if name == "device" and _is_index(value) else _on_cpu(value) if name in _DEVICES else value
            for name, value in kwargs.items()
        }
        return function(*(one if isinstance(one, Mapping) else _on_cpu(one) for one in args), **kwargs)

    return call


_DEVICES = ("device", "map_location")


def _is_index(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _copying(function: Callable[..., Any], torch: Any) -> Callable[..., Any]:
    """Return a function that copies its result if a device is named and the result's memory is not PyTorch's own."""

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        result = function(*args, **kwargs)
        names_device = any(_names_cuda(one) for one in (*args[1:], kwargs.get("device")))
        return result.clone() if names_device and _is_foreign(result, torch) else result

    return call


def _names_cuda(value: Any) -> bool:
    return _is_index(value) or (_on_cpu(value) is not value and not isinstance(value, Mapping))


def _is_foreign(tensor: Any, torch: Any) -> bool:
    """Return whether another library, or a mapped file, owns a tensor's memory."""
    if tensor.device.type != _CPU or tensor.layout != torch.strided:
        return False
    return not tensor.untyped_storage().resizable()


def _returning(value: Any) -> Callable[..., Any]:
    return lambda *_, **__: value


def _returning_self(self: Any, *_: Any, **__: Any) -> Any:
    return self


def _seeding(generator: Any) -> Callable[[int], None]:
    def seed(seed: int) -> None:
        generator.manual_seed(int(seed))

    return seed


def _without_device(function: Callable[..., Any], *, arguments: int = 0) -> Callable[..., Any]:
    """Return a function that passes only its first arguments on, not the device behind them."""
    return lambda *args, **_: function(*args[:arguments])
