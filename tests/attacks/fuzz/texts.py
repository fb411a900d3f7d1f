"""What reads texts of strangers, as targets of fuzzers: YAML, shell scripts, Python files. Each may refuse in one way.

As a script it runs under atheris, guided by coverage: `python tests/attacks/fuzz/texts.py -max_total_time=20 CORPUS`.
"""

from __future__ import annotations

import contextlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.support.checkout import ROOT, tracked

NESTED = 300


def read_yaml(data: bytes) -> None:
    """Read YAML; what is taken is a bounded number of values."""
    import yaml

    from xpl_cli.basics.yaml import text

    with contextlib.suppress(yaml.MarkedYAMLError):
        text.read(data)


def read_shell(data: bytes) -> None:
    """Read a script; every word is where it is said to be, and says what it expands."""
    from xpl_cli.audit.static import file_reading
    from xpl_cli.audit.static.limits import TooMuchError
    from xpl_cli.audit.static.shell import parse

    text, _ = file_reading.decode_text(data, python=False)
    lines = text.split("\n")
    with contextlib.suppress(TooMuchError):
        script = parse(text)
        for command in script:
            for word in command.words:
                first = word.raw.split("\n")[0]
                assert lines[word.line - 1][word.column - 1 :].startswith(first)
                assert (word.text, word.expansions, word.position, word.variable) is not None
            assert (command.assignments, command.name) is not None
        assert (script.options, script.variables, script.checked) is not None


def read_python(data: bytes) -> None:
    """Read a Python file; what parses can be written down again, which is what rules do."""
    import ast

    from xpl_cli.audit.rules.model import NotApplicable, NotRun
    from xpl_cli.audit.static.model_class import ModelClass
    from xpl_cli.audit.static.source import Source

    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "model.py").write_bytes(data)
        source = Source(Path(folder))
        with contextlib.suppress(NotRun, NotApplicable):
            assert source.encoding_error("model.py") is None or source.text("model.py") is not None
            ast.unparse(source.tree("model.py"))
            assert source.functions("model.py") is not None
            assert source.imports("model.py") is not None
            assert ModelClass.of(source).settings is not None


TARGETS: tuple[Callable[[bytes], None], ...] = (read_yaml, read_shell, read_python)


def seeds() -> Iterator[tuple[int, bytes]]:
    """Yield the number of a target and bytes for it: manifests, scripts and modules of this repository, and tangles."""
    for number, pattern in enumerate(("*.yml", "*.sh", "model.py")):
        for file in tracked(f"policy/*/{pattern}"):
            yield number, file.read_bytes()
    yield 0, b"a: &a [1, 2]\nb: {<<: {c: 1}, d: *a}\ne: !!int 010\nf: 2024-99-99\n? [1]\n: |\n  x\n"
    yield 1, b'cat <<\'E\' | tee "${a:-$(b "c")}" && f() { for i in $@; do (x); done; }\nE\ncase $1 in a) ;; esac\n'
    yield (
        2,
        b"# coding: latin-1\nfrom . import a\nclass Model(Base):\n    def load(self, c): self.x = c['y']\n",
    )
    for number, opened in enumerate((b"[", b"$(", b"not ")):
        yield number, (b"x: " if number == 0 else b"x=") + opened * NESTED


def one_input(data: bytes) -> None:
    """Run the target that the first byte names on the rest."""
    if data:
        TARGETS[data[0] % len(TARGETS)](data[1:])


def main() -> None:
    """Fuzz until the time given on the command line is over."""
    import atheris  # type: ignore[import-untyped]

    sys.path.insert(0, str(ROOT))
    with atheris.instrument_imports(include=["xpl_cli"]):
        from xpl_cli.audit.static import (  # noqa: F401 - instrumented as they are imported
            file_reading,
            shell,
            source,
        )
        from xpl_cli.basics.yaml import text  # noqa: F401
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
