"""XPL179: Importing a module of the adapter only defines functions and classes."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, rule
from xpl_cli.audit.static.source import Source
from xpl_cli.audit.static.syntax import SCOPES, called, constant, dotted, last, names

_WEIGHTS: Final = frozenset(("torch.load", "from_pretrained", "snapshot_download", "hf_hub_download", "load_file"))
_NETWORK: Final = frozenset(("requests.get", "requests.post", "urlopen", "urlretrieve", "urllib.request.urlopen"))
_PROCESSES: Final = frozenset(("os.system", "subprocess.run", "subprocess.Popen", "subprocess.check_call"))
_PLACES: Final = frozenset(("os.chdir", "mp.set_start_method", "multiprocessing.set_start_method", "os.makedirs"))
_FILES: Final = frozenset(("open", "np.load", "json.load", "yaml.safe_load", "pickle.load", "h5py.File"))
_CONSEQUENCES: Final = (
    (_WEIGHTS, "weights are loaded"),
    (_NETWORK, "another host is asked"),
    (_PROCESSES, "a process is started"),
    (_PLACES, "the process or the disk is changed"),
    (_FILES, "a file is read"),
)


@rule(code="XPL179", requirement="XPL-CON-8")
def work_at_import(source: Source) -> Iterator[Finding]:
    """Importing the adapter loads, downloads or changes something.

    ## What it does
    Looks at the code that runs at an import of model.py, deploy.py, `__init__.py` and the modules they import: at top
    level, in class bodies and in `if` and `try`, but not under `if __name__ == "__main__"`. It reports weights,
    downloads, processes, a change of the working directory, files, and tensors that are put on a GPU.

    ## Why it matters
    A simulator imports deploy.py, and a catalogue or a test imports the package: they load gigabytes, use GPU memory,
    or fail because a file exists only on the policy's machine. An error at import is hard to report.

    ## Example
    `STATS = json.load(open("stats.json"))` at the top of model.py.

    ## Use instead
    Do it in `load`, with paths from the configuration.

    ## Fix safety
    No automatic fix.
    """
    entries = (sdk.File.MODEL_PY, sdk.File.DEPLOY_PY, sdk.File.INIT_PY)
    for file in dict.fromkeys(name for entry in entries for name in source.reached(entry)):
        for statement in source.tree(file).body if source.parses(file) else ():
            call = next(_calls(statement), None)
            if call is not None:
                what = _done(call)
                yield Finding(
                    f"{what} when {file} is imported: the import takes long, or fails if that is impossible",
                    **source.at(file, call),
                    expected="definitions only",
                    got=ast.unparse(call)[:80],
                    fix=Fix("advice", "move it into load"),
                )
                break


def _calls(node: ast.AST) -> Iterator[ast.Call]:
    """Yield the calls that work, of what runs at import below a node."""
    if isinstance(node, SCOPES) and not isinstance(node, ast.ClassDef):
        return
    if isinstance(node, ast.If) and names(node.test) & {"__name__", "TYPE_CHECKING"}:
        return
    if isinstance(node, ast.Call) and _done(node):
        yield node
    for child in ast.iter_child_nodes(node):
        yield from _calls(child)


def _done(call: ast.Call) -> str:
    """Return what a call does, "" if it is harmless at import."""
    name = called(call)
    for group, what in _CONSEQUENCES:
        if name in group or (last(name) in group and "." not in last(name) and last(name) != "open"):
            return "" if name == "open" and _is_own_stream(call) else what
    if last(name) == "cuda" and isinstance(call.func, ast.Attribute) and dotted(call.func) != "torch.cuda":
        return "GPU memory is allocated"
    if last(name) == "to" and any(str(constant(entry)).startswith("cuda") for entry in call.args):
        return "GPU memory is allocated"
    return ""


def _is_own_stream(call: ast.Call) -> bool:
    """Tell whether `open` wraps a stream that the process has anyway."""
    return bool(call.args) and last(called(call.args[0])) == "fileno"
