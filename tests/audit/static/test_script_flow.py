"""What rules learn about shell scripts: what ends a command, which names are set, what may be empty."""

from __future__ import annotations

import pytest

from xpl_cli.audit.static.scripts.flow import executed_words, may_be_empty, program
from xpl_cli.audit.static.shell import parse


@pytest.mark.parametrize(
    ("script", "ends"),
    [
        ("a; b\nc", ["", "", ""]),
        ("a && b || c | d & e", ["&&", "||", "|", "&", ""]),
        ("( cd x\n  a ) &\nb", ["", "&", ""]),
        ("{ a; } | tee log\n", ["|", ""]),
        ("a &> log\nb 2>&1 &", ["", "&"]),
        ("a <<X || b\ntext\nX\nc", ["||", "", ""]),
        ("case $1 in x) a & ;; *) b | c ;; esac", ["&", "|", ""]),
    ],
)
def test_a_command_knows_what_ends_it(script: str, ends: list[str]) -> None:
    assert [command.end for command in parse(script)] == ends


def test_a_command_knows_the_keywords_before_it() -> None:
    found = [(command.keywords, command.name) for command in parse("if ! a; then b; else c; fi")]
    assert found == [(("if", "!"), "a"), (("then",), "b"), (("else",), "c")]


@pytest.mark.parametrize(
    ("word", "expansions"),
    [
        ('"${a}/$b"', [("a", ""), ("b", "")]),
        ("$a\"$b\"'$c'", [("a", ""), ("b", "")]),
        ('"$(awk \'{print $1}\' "$file")"', [("file", "")]),
        ("${a:-${b}}", [("a", ":-"), ("b", "")]),
        (r"\$a${#list[@]}$@", [("list", ""), ("@", "")]),
    ],
)
def test_a_word_knows_its_expansions_and_their_guards(word: str, expansions: list[tuple[str, str]]) -> None:
    """Single quotes hide, except inside of double ones; a substitution begins anew."""
    (command,) = parse(f"x {word}")
    assert [tuple(item) for item in command.words[1].expansions] == expansions


def test_a_script_knows_its_options_and_variables() -> None:
    script = parse(
        "set -eu\nset -o pipefail\na=1 export b=2\nexport c d=4\nfor e in 1; do read -r f g; done\n"
        'printf -v h %s x\n: "${i:=1}"\nfor ((j = 0; j < 3; j++)); do :; done\n'
    )
    assert script.options == {"errexit", "nounset", "pipefail"}
    assert set("acdefghij") <= script.variables


@pytest.mark.parametrize(
    ("command", "really"),
    [
        ("exec env A=1 B=2 python x.py", "python"),
        ("nohup setsid bash run.sh", "bash"),
        ("A=1 /opt/bin/python3 x.py", "python3"),
        ('exec "${PYTHON}" x.py', ""),
        ("A=1", ""),
    ],
)
def test_what_a_command_really_runs(command: str, really: str) -> None:
    """Without assignments, `exec` and `env`; nothing where a variable holds the program."""
    (parsed,) = parse(command)
    assert program(parsed) == really
    assert len(executed_words(parsed)) == (0 if command == "A=1" else 2)


@pytest.mark.parametrize(
    ("script", "is_open"),
    [
        ("a=$1\nrm $a", True),
        ("set -u\na=$1\nrm $a", False),
        ("set -u\na=${1:-}\nrm $a", True),
        ('a=${1:-}\n[[ -z "$a" ]] && exit\nrm $a', False),
        ('a=$1\nrm "${a:?}"; rm $a', False),
        ("a=x\nrm $a", False),
        ("a=$(cd x && pwd)\nrm $a", True),
        ("rm $a", True),
    ],
)
def test_what_may_be_empty(script: str, is_open: bool) -> None:
    assert may_be_empty("a", parse(script)) == is_open
