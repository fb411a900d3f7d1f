"""Runs code that names "cuda" by hand, redirected to the CPU, and prints what each function returned or raised."""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

sys.path.insert(0, sys.argv[1])
if sys.argv[2] == "late":
    with contextlib.suppress(ImportError):
        import safetensors.torch  # noqa: F401
        import transformers.modeling_utils  # noqa: F401
from xpl.worker import cuda_on_cpu

cuda_on_cpu.enable()
cuda_on_cpu.enable()
import torch  # noqa: E402 - after the redirection, as an adapter does


def moves_tensors() -> bool:
    x = torch.zeros(2)
    moved = [x.to("cuda:1"), x.to(torch.device("cuda")), x.to(0), x.to(device=0), x.cuda(), x.cuda(0), x.pin_memory()]
    return all(one is x for one in moved) and x.to("cuda", torch.float64).dtype == torch.float64


def moves_modules() -> bool:
    module = torch.nn.Linear(2, 2, device="cuda").cuda().to("cuda:0").to(0).to(device="cuda", dtype=torch.bfloat16)
    return str(module.weight.device) == "cpu" and module.weight.dtype == torch.bfloat16


def makes_tensors() -> bool:
    x = torch.ones(2, device="cuda")
    made = [torch.zeros_like(x, device="cuda:0"), x.new_zeros(3, device="cuda"), torch.tensor([1.0], device="cuda")]
    made += [torch.randperm(3, device=torch.device("cuda")), torch.arange(3, device=0)]
    return all(str(one.device) == "cpu" for one in made)


def copies_foreign_memory() -> bool:
    array = np.zeros(3)
    for tensor in (torch.from_numpy(array).cuda(), torch.as_tensor(array, device="cuda")):
        tensor.add_(1)
    shared = torch.from_numpy(array)
    shared -= 1
    return array.tolist() == [-1.0] * 3


def copies_results() -> bool:
    x = torch.zeros(2, device="cuda")
    array = x.cpu().numpy()
    x += 1
    return array.tolist() == [0.0, 0.0]


def enters_modes() -> bool:
    with torch.device("cuda"):
        inside = torch.zeros(2)
    with torch.device("meta"):
        meta = torch.nn.Linear(2, 2)
    torch.set_default_device("cuda")
    after = torch.ones(2)
    torch.set_default_device("cpu")
    return (
        str(inside.device) == str(after.device) == "cpu"
        and meta.weight.is_meta
        and not meta.to_empty(device="cuda").weight.is_meta
    )


def casts() -> bool:
    layer = torch.nn.Linear(2, 2)
    with torch.autocast("cuda", dtype=torch.bfloat16):
        brain = layer(torch.ones(1, 2)).dtype
    with torch.autocast(device_type="cuda"):
        half = layer(torch.ones(1, 2)).dtype
    with torch.autocast("cuda", dtype=torch.float32):
        full = layer(torch.ones(1, 2, dtype=torch.bfloat16)).dtype
    return (brain, half, full) == (torch.bfloat16, torch.float16, torch.float32)


def draws() -> bool:
    generator = torch.Generator(device="cuda").manual_seed(3)
    torch.cuda.manual_seed_all(3)
    same = torch.equal(torch.rand(2, device="cuda", generator=generator), torch.rand(2, device="cuda"))
    return same and isinstance(generator, torch.Generator) and isinstance(torch.default_generator, torch.Generator)


def loads() -> bool:
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "weights.pt")
        torch.save({"a": torch.ones(2)}, path)
        where = ["cuda", torch.device("cuda"), {"cpu": "cuda:0"}, lambda storage, _: storage.cuda(0)]
        loaded = [torch.load(path, map_location=one)["a"] for one in where] + [torch.load(path, "cuda:0")["a"]]
    return all(str(one.device) == "cpu" for one in loaded)


def loads_safetensors() -> bool | str:
    try:
        from safetensors.torch import load_file, save_file
    except ImportError:
        return "no safetensors"
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "weights.safetensors")
        save_file({"a": torch.ones(2)}, path)
        return str(load_file(path, device="cuda:0")["a"].device) == "cpu"


def avoids_flash_attention() -> bool | str:
    try:
        from transformers import LlamaConfig, LlamaForCausalLM
    except ImportError:
        return "no transformers"
    small = {"hidden_size": 8, "intermediate_size": 8, "num_hidden_layers": 1, "num_attention_heads": 1}
    with tempfile.TemporaryDirectory() as folder:
        LlamaForCausalLM(LlamaConfig(**small, vocab_size=8)).save_pretrained(folder)
        model = LlamaForCausalLM.from_pretrained(folder, attn_implementation="flash_attention_2")
    return model.config._attn_implementation == "sdpa" and "_attn_implementation" not in model.config.to_dict()


def scripts() -> bool:
    @torch.jit.script
    def add(x: torch.Tensor) -> torch.Tensor:
        return torch.zeros(2, device=x.device) + torch.tensor([1.0]) + x.to(torch.float64)

    @torch.compile
    def double(x: torch.Tensor) -> torch.Tensor:
        return 2 * x.cuda()

    return add(torch.ones(2)).tolist() == double(torch.ones(2)).tolist() == [2.0, 2.0]


def asks_the_gpu() -> bool:
    start = torch.cuda.Event(enable_timing=True)
    start.record()
    with torch.cuda.stream(torch.cuda.Stream()), torch.cuda.device(0):
        torch.cuda.synchronize()
    torch.cuda.current_stream().synchronize()
    torch.cuda.empty_cache()
    return not torch.cuda.is_available() and torch.cuda.current_device() == 0 and start.elapsed_time(start) == 0


def works_in_threads() -> bool:
    moved = []
    thread = threading.Thread(target=lambda: moved.append(torch.zeros(1).cuda()))
    thread.start()
    thread.join()
    return len(moved) == 1


def keeps_other_devices() -> bool:
    x = torch.zeros(2)
    return x.to("meta").is_meta and x.to(torch.float64).dtype == torch.float64 and x.to(x) is x


results = {}
for name, function in [(name, one) for name, one in globals().items() if getattr(one, "__module__", "") == "__main__"]:
    try:
        results[name] = function()
    except Exception as error:  # noqa: BLE001 - a test shows it
        results[name] = f"{type(error).__name__}: {error}"
sys.stdout.write(json.dumps(results))
