"""The `xpl` command: mounts the commands and turns exceptions into one sentence and an exit code."""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Annotated, Any, NoReturn

import typer

from xpl_cli import __version__
from xpl_cli.basics import console, failures
from xpl_cli.basics.endings import endings
from xpl_cli.basics.errors import ExitCode, UserError
from xpl_cli.commands.agents import answers, mcp, skills, status
from xpl_cli.commands.command import equip
from xpl_cli.commands.headings import HeadedGroup
from xpl_cli.commands.maintain import sdk, spec
from xpl_cli.commands.prove import audit, hook, metrics, replay, review
from xpl_cli.commands.report import compare, leaderboard, report, submit
from xpl_cli.commands.run import checkpoint, container, demo, doctor, env, evaluate, lifecycle, serve
from xpl_cli.commands.scaffold import adopt, new_env, new_policy, update

_UsageError: Any = typer.BadParameter.__base__
"""What the parser raises for a command line that it does not understand."""

app = typer.Typer(
    name="xpl",
    cls=HeadedGroup,
    help="Scaffold, serve, audit and evaluate robot policies against one standard.",
    no_args_is_help=True,
    add_completion=False,
    epilog=endings(),
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("new-policy")(new_policy.new_policy)
app.command("new-env")(new_env.new_env)
app.command("update")(update.update)
app.command("adopt")(adopt.adopt)
app.command("audit")(audit.audit)
app.command("review")(review.review)
app.command("explain")(audit.explain)
app.command("rules")(audit.rules)
app.command("replay")(replay.replay)
app.command("status")(status.status)
app.command("metrics")(metrics.metrics)
app.command("hook", hidden=True)(hook.hook)
app.command("serve")(serve.serve)
app.command("eval")(evaluate.evaluate)
app.command("compare")(compare.compare)
app.command("report")(report.report)
app.command("leaderboard")(leaderboard.leaderboard)
app.command("submit")(submit.submit)
app.command("verify")(submit.verify)
app.command("install")(lifecycle.install)
app.command("prepare")(lifecycle.prepare)
app.command("train")(lifecycle.train)
app.command("container")(container.container)
app.command("doctor")(doctor.doctor)
app.command("demo")(demo.demo)
app.command("answers")(answers.answers)
app.command("mcp")(mcp.mcp)
app.add_typer(env.app, name="env")
app.add_typer(checkpoint.app, name="checkpoint")
app.add_typer(spec.app, name="spec")
app.add_typer(sdk.app, name="sdk")
app.add_typer(skills.app, name="skills")
equip(app)


@app.callback(invoke_without_command=True)
def _root(
    *,
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    if version:
        typer.echo(f"xpl {__version__}")
        raise typer.Exit


def run() -> NoReturn:
    """Run the command line of this process."""
    console.open_streams()
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as a shell has it for what it starts in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # A supervisor's SIGTERM ends a command the way Ctrl-C does, so that every `finally` still runs.
    signal.signal(signal.SIGTERM, _interrupt)
    sys.exit(main(sys.argv[1:]))


def main(arguments: list[str]) -> int:
    """Run a command and return its exit code; never shows a traceback for a mistake of the user.

    Args:
        arguments: the command line after `xpl`.
    """
    try:
        ended = app(args=arguments, prog_name="xpl", standalone_mode=False)
    except UserError as error:
        return _told(error, arguments)
    except _UsageError as error:
        return _told(failures.of_usage(error), arguments)
    except (KeyboardInterrupt, typer.Abort):
        _ignore_interrupts()
        return _told(UserError("interrupted", code=ExitCode.INTERRUPTED), arguments)
    except BrokenPipeError:
        # The reader of our output went away, as `head` does: not a failure worth a message.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.CLEAN
    except Exception as error:
        if os.environ.get("XPL_DEBUG"):
            raise
        return _told(failures.of_system(error) if isinstance(error, OSError) else failures.of_fault(error), arguments)
    return ended if isinstance(ended, int) else ExitCode.CLEAN


def _interrupt(_signal: int, _frame: object) -> NoReturn:
    raise KeyboardInterrupt


def _ignore_interrupts() -> None:
    """Let whoever presses Ctrl-C again still see the sentence, and the exit code that goes with it."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _told(error: UserError, arguments: list[str]) -> int:
    """Tell an error, on stderr and to who asked for JSON and has no answer yet also on stdout; return its exit code."""
    if failures.wants_json(arguments) and not console.has_answered():
        console.data_json(failures.document(error))
    console.note(failures.lines(error).removesuffix("\n"))
    return error.code
