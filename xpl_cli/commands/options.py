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

ISOLATE_HELP = "Run the adapter without network, and with nothing to write to but a temporary folder."
ISOLATE_OR_FAIL_HELP = ISOLATE_HELP + " Exit code 4 where that cannot be had."
ISOLATE = typer.Option(False, "--isolate", help=ISOLATE_OR_FAIL_HELP, rich_help_panel=ADAPTER)
MEMORY_HELP = "Most memory that the adapter's processes may hold: 8GB, 80% (of the machine's) or none."
PATIENCE_HELP = "End an adapter that is silent for so long while it loads or answers: no processor time, input, output."
PRIVILEGED_HELP = "Keep what the simulator tells privileged policies, too: its numbers, for policies that may know."
TIME_HELP = "Most time for one package: 90s, 60m, 2h or none. What is not done then is reported as not run."
