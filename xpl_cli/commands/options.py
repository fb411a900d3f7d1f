"""Arguments and options that several commands take: declared once, so that they mean and say the same everywhere."""

from __future__ import annotations

import typer

ADAPTER = "Adapter"
"""Panel of the help that shows what concerns the policy's own process."""

POLICY = typer.Argument(..., metavar="POLICY", help="Folder of the adapter, or its name below policy/.")
SETTINGS = typer.Option(
    [], "--set", metavar="KEY=VALUE", help="Override a key of deploy.yml; the value is YAML.", rich_help_panel=ADAPTER
)
PYTHON = typer.Option(None, "--python", help="Interpreter that runs the adapter.", rich_help_panel=ADAPTER)
POLICY_ENV = typer.Option(
    None,
    "--policy-env",
    metavar="ENV",
    help="conda:NAME, uv:DIR, venv:DIR or none (this interpreter).",
    rich_help_panel=ADAPTER,
)
POLICY_GPU = typer.Option(None, "--policy-gpu", help="Device made visible to the adapter.", rich_help_panel=ADAPTER)
EVAL_ENV = typer.Option(
    None,
    "--eval-env",
    help="Python of the environment, as for --policy-env; env.yml's if unsaid.",
    rich_help_panel="Environment's process",
)
JSON = typer.Option(False, "--json", help="Print a JSON object.")

ISOLATE_HELP = "Run the adapter without network, able to write to a temporary folder alone."
ISOLATE = typer.Option(False, "--isolate", help=ISOLATE_HELP, rich_help_panel=ADAPTER)
MEMORY_HELP = "Memory limit of the adapter's processes: 8GB, 80% (of the machine's) or none."
PATIENCE_HELP = "End an adapter that does nothing for so long while it loads or answers."
PRIVILEGED_HELP = "Record the simulator's ground truth, too, for privileged policies."
TIME_HELP = "Time limit for one package: 90s, 60m, 2h or none; the rest is reported as not run."
