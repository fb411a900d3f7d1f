"""Runs an author's script like its interpreter, but prints the standard's own errors in one line, without a traceback.

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
    sys.excepthook = functools.partial(_print_exception, script)
    module = ModuleType("__main__")
    module.__file__ = str(script)
    sys.modules["__main__"] = module
    code = compile(script.read_bytes(), script, "exec", dont_inherit=True)
    exec(code, module.__dict__)  # noqa: S102 - what an interpreter is for


def _print_exception(
    script: Path, kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Print an uncaught exception: one line with its location for an error of `xpl`, else a traceback."""
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
