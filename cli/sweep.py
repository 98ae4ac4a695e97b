"""`clikgen sweep`: a scenario over a design of up to millions of rollouts, on threads or on a Dask cluster."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clikgen.cli.scenarios import AsJson

if TYPE_CHECKING:
    from rich.progress import Progress, Task

WIDEST = 120  # characters: a table that is folded to a narrow terminal cannot be read


def command(
    sweep: Annotated[Path, typer.Argument(help="A .toml file: scenario, design, axes and metrics.")],
    out: Annotated[Path | None, typer.Option(help="Folder of the results; default: ./NAME-sweep.")] = None,
    threads: Annotated[int | None, typer.Option(help="Threads of this process; default: one for each core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Of a Dask cluster to run on, as tcp://host:8786.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Run a scenario over a design and keep a table of metrics; an interrupted sweep goes on where it was."""
    from clikgen.analysis.sweep import bind, read_sweep
    from clikgen.analysis.sweep_cluster import check_dask, cluster_tables
    from clikgen.analysis.sweep_store import open_store
    from clikgen.analysis.sweep_summary import summary_document, summary_table
    from clikgen.cli.freshness import fresh_controller
    from clikgen.cli.terminal import messages, print_json, print_table
    from clikgen.runtime.documents import BadInput

    if threads is not None and (threads < 1 or scheduler):
        raise BadInput(f"--threads: wanted 1 or more, and no --scheduler, got {threads}")
    if scheduler:
        check_dask()
    source = read_sweep(sweep)
    bound = bind(source, fresh_controller(source.scenario.controller))
    rollouts = bound.file.count
    with open_store(out or Path(f"{sweep.stem}-sweep"), bound) as store:
        missing = store.missing
        wanted = sum(len(bound.file.span(chunk)) for chunk in missing)
        start = time.monotonic()
        with _bar() as progress:
            task = progress.add_task("simulating", total=rollouts, completed=rollouts - wanted)

            def done(count: int) -> None:
                progress.advance(task, count)

            if scheduler:
                tables = cluster_tables(scheduler, source, bound, missing, done)
            else:
                tables = bound.tables(missing, threads, done)
            for chunk, table in tables:
                store.keep(chunk, table)
            progress.update(task, description="writing")
            store.finish()
        took = time.monotonic() - start
        document = summary_document(bound, store.columns(bound.file.metrics))
    document |= {"results": str(store.results), "resumed": rollouts - wanted, "computed": wanted}
    if wanted:
        before = f", {rollouts - wanted:,} of them before" if wanted < rollouts else ""
        rate = f"{wanted:,} in {took:.3g} s, {wanted / took:,.0f} a second"
        messages.print(f"wrote {store.results}: {rollouts:,} rollouts{before}; {rate}")
    else:
        messages.print(f"{store.results} holds all {rollouts:,} rollouts: nothing to do")
    if as_json:
        print_json(document)
    else:
        print_table(*summary_table(document), width=WIDEST)
    return 0


def _bar() -> "Progress":
    """How many rollouts of how many are done, and how fast; what was done before counts, but not for the speed."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.text import Text

    from clikgen.cli.terminal import messages

    class Rate(TextColumn):
        def render(self, task: "Task") -> Text:
            return Text(f"{task.speed:,.0f}/s" if task.speed else "")

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(""),
        TimeRemainingColumn(),
        console=messages,
        transient=True,
        disable=not messages.is_terminal,
    )
