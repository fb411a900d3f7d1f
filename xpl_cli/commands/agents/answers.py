"""`xpl answers`: schemas of the commands' JSON answers."""

from __future__ import annotations

import typer

from xpl_cli.commands.options import JSON


def answers(
    name: str | None = typer.Argument(None, metavar="[NAME]", help="An answer, such as xpl.audit/1, or a command."),
    as_json: bool = JSON,
) -> None:
    """List the JSON answers of all commands. With NAME print the JSON Schema of one."""
    import json

    from xpl_cli.basics import console
    from xpl_cli.standard import answers as known

    if name is None:
        entries = [vars(one) | {"commands": list(one.commands)} for one in known.answers().values()]
        if as_json:
            console.answer("xpl.answers/1", {"answers": entries, "document": None}, ["xpl answers xpl.audit/1"])
        else:
            width = max(map(len, known.answers()))
            console.data("\n".join(f"{one['name']:<{width}}  {', '.join(one['commands'])}" for one in entries))
        return
    chosen = known.find(name)
    document = known.schema(chosen.name)
    if as_json:
        entry = vars(chosen) | {"commands": list(chosen.commands)}
        console.answer("xpl.answers/1", {"answers": [entry], "document": document})
    else:
        console.data(json.dumps(document, indent=2))
