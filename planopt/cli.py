"""The command line: ``planopt COMMAND``.

Exit codes: 0 verified, 2 usage error or bad input, 3 solved but not verified, 4 no plan, 130
interrupted, 143 terminated.
An error is one line on standard error and, with ``--json``, one JSON object on standard output.
"""

import contextlib
import re
import signal
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from planopt.commands.compare import bench, compare
from planopt.commands.fit import fit
from planopt.commands.import_problem import import_problem
from planopt.commands.map import map_log
from planopt.commands.options import option, print_out, standard_output, stopping
from planopt.commands.planning import check, export_path, report, simulate, solve
from planopt.commands.problem_files import init, list_problems, schema, show_problem, validate
from planopt.errors import InputError, OutputError, PlanoptError, require_text
from planopt.files.writing import strict_text

BAD_INPUT = 2
INTERRUPTED, TERMINATED = 130, 143
USAGE_ERRORS = {
    r"'[^']*' is not a valid float|Input should be a valid number.*": "give a number",
    r"'[^']*' is not a valid integer|Input should be a valid integer.*": "give an integer",
    r"\S+ is not in the range x>=|Input should be greater than or equal to ": "give at least ",
    r"Got unexpected extra arguments? ?(\(s\) )?\((.*)\)": r"there are too many arguments: \2",
}
"""Wordings of Typer's versions and one wording for all of them."""

app = typer.Typer(
    name="planopt",
    help="Plan motion that stays in radio contact, and prove what can be proven about each plan.",
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command("list")(list_problems)
app.command()(solve)
app.command()(simulate)
app.command()(compare)
app.command()(fit)
app.command("map")(map_log)
app.command("import")(import_problem)
app.command()(check)
app.command("path")(export_path)
app.command()(report)
app.add_typer(bench, name="bench")
app.command()(schema)
app.command()(init)
app.command("show")(show_problem)
app.command()(validate)


def _print_version(wanted: bool) -> None:
    if wanted:
        import planopt

        typer.echo(planopt.__version__)
        raise typer.Exit


FIRST_STEPS = """planopt plans motion for robots that must stay in radio contact. First steps:

  planopt list                            list the problem library
  planopt solve open_field --out first    plan, verify the plan and draw it
  planopt simulate open_field --out run   drive the robot in a simulated channel

planopt --help lists all commands."""


@app.callback()
def _planopt(
    context: typer.Context,
    version: Annotated[
        bool,
        option("--version", None, "Print the version.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print_out(f"{FIRST_STEPS}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    try:
        for argument in words:
            require_text(argument, "the argument")
        with standard_output(), stopping() as received:
            try:
                code = int(app(arguments, prog_name="planopt", standalone_mode=False) or 0)
            except KeyboardInterrupt:
                code = INTERRUPTED
        # Typer returns this code for any interrupt; one raised in a callback may have been lost.
        if received:
            return TERMINATED if signal.SIGTERM in received else INTERRUPTED
        return code
    except PlanoptError as error:
        message, found = str(error), error
    except Exception as error:
        # Typer's usage errors share no public base class across the supported versions.
        format_message = getattr(error, "format_message", None)
        if format_message is None:
            raise
        message, found, context = str(format_message()), error, getattr(error, "ctx", None)
        # The same words for all versions of Typer, with the help page
        message = message.rstrip(".")
        for pattern, replacement in USAGE_ERRORS.items():
            message = re.sub(pattern, replacement, message)
        message += f" (see {context.command_path if context else 'planopt'} --help)"
    message = " ".join(message.split())
    if "--json" in words:
        with contextlib.suppress(OutputError):
            print_out(strict_text(error_json(message, found)))
    print(f"planopt: {message}", file=sys.stderr)
    return BAD_INPUT


def error_json(message: str, error: Exception) -> dict[str, str | int | None]:
    """Return the JSON object of a failed command: the message and the location, if known."""
    place = ("file", "key", "row", "remedy")
    known = vars(error) if isinstance(error, InputError) else {}
    return {"error": message, **{name: known.get(name) for name in place}}
