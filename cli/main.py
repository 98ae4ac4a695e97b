"""`clikgen`: the commands, and one clear line with exit code 2 for bad input."""

import shlex
import sys
from typing import NoReturn

import typer

from clikgen.cli import analyse, compare, demo, doctor, generate, inspect, listing, new, simulate, sweep, view
from clikgen.runtime.documents import BadInput

app = typer.Typer(
    name="clikgen",
    help="A robot and its prioritized tasks in one spec file -> CasADi -> C -> a fixed-rate loop.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.command)
app.command("generate")(generate.command)
app.command("inspect")(inspect.command)
app.command("new")(new.command)
app.command("simulate")(simulate.command)
app.command("compare")(compare.command)
app.command("sweep")(sweep.command)
app.command("view")(view.command)
app.add_typer(analyse.app, name="analyse")
app.command("list")(listing.command)
app.command("doctor")(doctor.command)


def main() -> None:
    """Run the command line; exit codes: 0 done, 1 the check does not hold, 2 bad input."""
    try:
        sys.exit(app(standalone_mode=False))
    except BadInput as error:
        _refuse(str(error))
    except typer.TyperException as error:
        if error.format_message():  # none where `clikgen` alone has printed its help
            _refuse(f"{error.format_message()} (got: {shlex.join(['clikgen', *sys.argv[1:]])})")
        sys.exit(2)
    except KeyboardInterrupt:
        print("clikgen: interrupted", file=sys.stderr)
        sys.exit(130)


def _refuse(message: str) -> NoReturn:
    """One line on stderr, exit code 2."""
    print("clikgen: error: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(2)
