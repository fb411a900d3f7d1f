"""The reader of bundles as a target of fuzzers: it takes any bytes, and may refuse them in one way only.

As a script it runs under atheris, guided by coverage: `python tests/attacks/fuzz/bundles.py -max_total_time=20 CORPUS`.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
from pathlib import Path

from tests.support.checkout import ROOT


def one_input(data: bytes) -> None:
    """Unpack a bundle, and look it through where it can be."""
    from xpl_cli.basics.errors import UserError
    from xpl_cli.basics.progress import Progress
    from xpl_cli.submission import bundle, inspection

    with tempfile.TemporaryDirectory(prefix="xpl-fuzz-") as name, contextlib.suppress(UserError):
        path, folder = Path(name) / "bundle.zip", Path(name) / "unpacked"
        path.write_bytes(data)
        folder.mkdir()
        inspection.inspect(bundle.open_bundle(path, folder, limit=10**7), Progress())


def main() -> None:
    """Fuzz until the time given on the command line is over."""
    import atheris

    sys.path.insert(0, str(ROOT))
    with atheris.instrument_imports(include=["xpl_cli.submission", "zipfile"]):
        from xpl_cli.submission import bundle  # noqa: F401 - instrumented as it is imported
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
