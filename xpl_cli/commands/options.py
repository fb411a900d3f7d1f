"""Arguments and options of several commands, declared once, so that every command names and explains them alike."""

from __future__ import annotations

import typer

ADAPTER = "Adapter"
"""Help panel of the options for the policy's process."""

POLICY = typer.Argument(..., metavar="POLICY", help="Folder of the adapter, or its name below policy/.")
SETTINGS = typer.Option(
    [], "--set", metavar="KEY=VALUE", help="Set a key of deploy.yml (the value is YAML).", rich_help_panel=ADAPTER
)
PYTHON = typer.Option(None, "--python", help="Python interpreter of the adapter.", rich_help_panel=ADAPTER)
POLICY_ENV = typer.Option(
    None,
    "--policy-env",
    metavar="ENV",
    help="conda:NAME, uv:DIR, venv:DIR or none (this Python).",
    rich_help_panel=ADAPTER,
)
POLICY_GPU = typer.Option(
    None, "--policy-gpu", help="GPU of the adapter (CUDA_VISIBLE_DEVICES).", rich_help_panel=ADAPTER
)
EVAL_ENV = typer.Option(
    None,
    "--eval-env",
    help="Like --policy-env, for the environment.",
    rich_help_panel="Environment process",
)
JSON = typer.Option(False, "--json", help="Print a JSON object.")

ISOLATE_HELP = "No network; writes to a temporary folder only."
ISOLATE = typer.Option(False, "--isolate", help=ISOLATE_HELP, rich_help_panel=ADAPTER)
MEMORY_HELP = "Memory limit: 8GB, 80% or none."
PATIENCE_HELP = "End an adapter that hangs for so long."
PRIVILEGED_HELP = "Also record the simulator's ground truth."
TIME_HELP = "Time limit of a package: 90s, 60m, 2h, none."
