"""`xpl zoo`: the policies of the field, and how far each runs here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from xpl_cli.basics.exit_codes import exit_codes
from xpl_cli.commands.options import JSON, TIME_HELP
from xpl_cli.commands.plain import PlainGroup

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from xpl_cli.standard.zoo.policies import ManifestValue

_GATES = ("static", "offline")
_READ = ("embodiments", "action_types")
"""Keys of the manifest that a proof writes down."""
_DEFAULT = "list"
_NAME = typer.Argument(..., metavar="NAME", help="Policy; `xpl zoo` lists them.")


class _ListsAtFirst(PlainGroup):
    """A group that lists where no command of it is named: `xpl zoo --level 2`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the name of the command in front of options that are its own."""
        asks_help = args and args[0] in ctx.help_option_names
        if not asks_help and not (args and not args[0].startswith("-")):
            args = [_DEFAULT, *args]
        return super().parse_args(ctx, args)


app = typer.Typer(cls=_ListsAtFirst, help="List published policies, and prove how far each runs.")


@app.command(_DEFAULT)
def list_(
    family: str | None = typer.Option(None, metavar="NAME", help="Policies of this family."),
    robot: str | None = typer.Option(None, metavar="NAME", help="Policies for this robot."),
    level: int = typer.Option(0, min=0, max=4, help="Policies of this level, or a higher one."),
    as_json: bool = JSON,
) -> None:
    """List the policies of the field: what is known of each, and how far it was proven to run. `xpl zoo` does, too."""
    from xpl_cli.basics import console
    from xpl_cli.standard.zoo import policies
    from xpl_cli.zoo import listing

    found = listing.filter_policies(listing.PolicyFilter(family, robot, level))
    if as_json:
        levels = [{"level": one.number, "word": one.word, "meaning": one.meaning} for one in policies.levels()]
        told = {"levels": levels, "policies": [listing.as_json(policy) for policy in found]}
        console.answer("xpl.zoo-list/1", told, [f"xpl zoo show {policy.name}" for policy in found[:1]])
    else:
        console.data(listing.table(found))


@app.command()
def show(name: str = _NAME, as_json: bool = JSON) -> None:
    """Show one policy: every fact with its source, or with why it is not known, and what was proven of it."""
    from xpl_cli.basics import console
    from xpl_cli.standard.zoo import policies
    from xpl_cli.zoo import listing

    policy = policies.find(name)
    if as_json:
        console.answer("xpl.zoo-show/1", {"policy": listing.as_json(policy)}, [f"xpl zoo prove {name} CHECKOUT"])
    else:
        console.data(listing.describe(policy))


@app.command()
@exit_codes(clean="it was proven as far as it runs, whatever rules found", not_run="not even its files could be judged")
def prove(
    name: str = _NAME,
    checkout: Path = typer.Argument(
        ..., metavar="CHECKOUT", help="Folder with its adapter: of XPolicyLab, or its own."
    ),
    gate: list[str] = typer.Option([], "--gate", help="Only this gate; may be repeated. static, offline."),
    python: str | None = typer.Option(
        None, metavar="PATH", help="Interpreter with its own libraries; by default that of its policy.yml."
    ),
    run: Path | None = typer.Option(None, metavar="RUN", help="A recorded run of its weights, for the last level."),
    isolate: bool = typer.Option(False, "--isolate", help="Keep it from the network and from writing."),
    time_limit: str = typer.Option("10m", metavar="TIME", help=TIME_HELP),
    dry_run: bool = typer.Option(False, "--dry-run", help="Only print it, and write no proof."),
    as_json: bool = JSON,
) -> None:
    """Audit the adapter of a policy in a checkout, and write down how far it runs (in a checkout of xpl only)."""
    from xpl_cli.adopt import files
    from xpl_cli.audit.rules.gates import Gate
    from xpl_cli.audit.rules.options import AuditOptions
    from xpl_cli.audit.rules.time_limit import TimeLimit
    from xpl_cli.basics import console
    from xpl_cli.basics.errors import UserError, one_of
    from xpl_cli.basics.progress import progress
    from xpl_cli.isolation import sandbox
    from xpl_cli.standard.zoo import policies
    from xpl_cli.zoo import prove as proving

    for each in gate:
        one_of("--gate", each, _GATES)
    if not dry_run and not policies.folder().resolve().is_relative_to(Path(__file__).resolve().parents[3] / "spec"):
        raise UserError("proofs are kept in a checkout of xpl, and this xpl is an installed one", hint="--dry-run")
    adapter = proving.adapter_in(policies.find(name), checkout)
    sandbox.check([adapter.path], memory_limit="80%", isolate=isolate)
    with progress() as say:
        options = AuditOptions(
            gates=tuple(Gate(each) for each in _GATES if not gate or each in gate),
            keep_going=True,
            python=python,
            memory_limit="80%",
            isolate=isolate,
            time_limit=TimeLimit.parse(time_limit),
            progress=say,
        )
        said = dict(_said(files.read_facts(adapter.path)))
        arguments = [word for each in gate for word in ("--gate", each)]
        arguments += ["--python", "PYTHON"] if python else []
        arguments += ["--run", "RUN"] if run else []
        found = proving.proof(adapter, options, said, arguments, run)
    path = None if dry_run else proving.write(found)
    if as_json:
        following = [] if dry_run else ["xpl spec compile"]
        console.answer("xpl.zoo-prove/1", {"file": None if path is None else str(path), "proof": found}, following)
        return
    word = policies.levels()[found["level"]].word
    console.data(f"{name}: level {found['level']} ({word}); {found['statement']}")
    if found["next"] is not None:
        console.data(f"  no further: {found['next']}")
    if path is not None:
        console.note(f"{path}: written; `xpl spec compile` renews the page")


def _said(sections: Mapping[str, Any]) -> Iterator[tuple[str, ManifestValue]]:
    """Yield what the adapter's files say of some keys of a manifest, with where they say it."""
    from xpl_cli.adopt.facts import ManifestFacts

    for key in _READ:
        for leaf in ManifestFacts.of({key: sections.get(key)}).facts.values():
            yield key, {"value": leaf.value, "source": leaf.comment[:400]}
