"""Who imports whom: the layers of pyproject.toml hold, there is no circle, and a rule knows its own gate only."""

from __future__ import annotations

import ast
import graphlib
from pathlib import Path
from typing import TYPE_CHECKING

import grimp

from tests.support.checkout import ROOT, tracked

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ALWAYS = (
    *("xpl", "xpl_cli.audit", "xpl_cli.audit.rules"),
    *("xpl_cli.standard", "xpl_cli.basics", "xpl_cli.model_io", "xpl_cli.packages"),
)
"""What a rule of any gate may import; of `xpl_cli.audit` what stands in the package itself."""

OWN = {
    "static": ("static",),
    "offline": ("offline", "served"),
    "mujoco": ("physics", "served"),
    "environments": ("environments", "static"),  # what env.yml and client.py say is read in the static gate
    "audit": ("engine", "static"),  # a rule about the audit itself asks for results of others
    "advice": ("static",),
    "demonstrations": ("offline", "served"),  # what a recording shows goes through the adapter as in the offline gate
}
"""The rooms of `xpl_cli.audit` that the rules of a folder of `conformance/` may import."""


def imports(*packages: str) -> dict[str, set[str]]:
    """Return the modules of packages with what each imports, inside functions and for types too."""
    graph = grimp.build_graph(*packages, exclude_type_checking_imports=False, cache_dir=None)
    return {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}


def circle(graph: Mapping[str, set[str]]) -> list[str]:
    """Return the modules of one circle of imports; none if there is none."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        found: list[str] = error.args[1]
        return found
    return []


def foreign(rule: Path) -> list[str]:
    """Return what a rule imports and should not; its folder is its gate's."""
    rooms = tuple(f"xpl_cli.audit.{room}" for room in OWN[rule.parent.parent.name])
    return [name for name in _imported(rule) if not _is_allowed(name, rooms)]


def _imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module or ''}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (name for name in names if name.partition(".")[0] in {"xpl", "xpl_cli"})


def _is_allowed(name: str, rooms: tuple[str, ...]) -> bool:
    """Tell whether a rule may import a name; of the audit itself only what its package offers."""
    import xpl_cli.audit

    if name.startswith("xpl_cli.audit."):
        own = tuple(f"{room}." for room in (*rooms, "xpl_cli.audit.rules"))
        return f"{name}.".startswith(own) or name.rpartition(".")[2] in xpl_cli.audit.__all__
    return f"{name}.".startswith(tuple(f"{place}." for place in ALWAYS))


def test_no_import_is_part_of_a_circle() -> None:
    assert circle(imports("xpl", "xpl_cli")) == []


def test_a_rule_imports_nothing_of_another_gate() -> None:
    rules = tracked("conformance/*/*/rule.py")
    assert {rule.parent.parent.name for rule in rules} == set(OWN)
    assert {str(rule.relative_to(ROOT)): found for rule in rules if (found := foreign(rule))} == {}
