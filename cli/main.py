"""`clikgen`: the commands, and one clear line with exit code 2 for bad input."""

import sys

import typer

from clikgen.cli import analyse, demo, doctor, generate, listing, simulate
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
app.command("simulate")(simulate.command)
app.add_typer(analyse.app, name="analyse")
app.command("list")(listing.command)
app.command("doctor")(doctor.command)


def main() -> None:
    """Run the command line; exit codes: 0 done, 1 the check does not hold, 2 bad input."""
    try:
        sys.exit(app(standalone_mode=False))
    except (BadInput, typer.TyperException) as error:
        message = str(error) if isinstance(error, BadInput) else error.format_message()
        if message:  # none where `clikgen` alone has printed its help
            print("clikgen: error: " + " ".join(message.split()), file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("clikgen: interrupted", file=sys.stderr)
        sys.exit(130)
