"""Runs an author's script as its interpreter would, and tells the standard's own errors in a line, without a traceback.

It is started by its path in the policy's Python, SCRIPT and its arguments behind it, and imports nothing of `xpl`.
"""

from __future__ import annotations

import functools
import sys
import traceback
from pathlib import Path
from types import ModuleType, TracebackType

STANDARD = "xpl"


def main() -> None:
    """Run the script that the command line names."""
    del sys.argv[0]
    script = Path(sys.argv[0])
    sys.path[0] = str(script.resolve().parent)
    sys.excepthook = functools.partial(_told, script)
    module = ModuleType("__main__")
    module.__file__ = str(script)
    sys.modules["__main__"] = module
    code = compile(script.read_bytes(), script, "exec", dont_inherit=True)
    exec(code, module.__dict__)  # noqa: S102 - what an interpreter is for


def _told(script: Path, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print what ended the script: where and why if the standard says so, else its traceback, from the script on."""
    while trace is not None and trace.tb_frame.f_code.co_filename != str(script):
        trace = trace.tb_next
    if kind.__module__.partition(".")[0] != STANDARD:
        sys.__excepthook__(kind, error.with_traceback(trace), trace)
        return
    passed = [(Path(frame.f_code.co_filename), line) for frame, line in traceback.walk_tb(trace)]
    own = [f"{file}, line {line}: " for file, line in passed if file.parent == script.parent]
    sys.stderr.write(f"{''.join(own[-1:])}{error}\n")


if __name__ == "__main__":
    main()
