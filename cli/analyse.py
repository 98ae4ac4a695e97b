"""`clikgen analyse`: filter, CLIK loop, chatter, and a report of all three."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clikgen.cli.scenarios import AsJson, ScenarioName, Settings, load_scenario

if TYPE_CHECKING:
    from clikgen.analysis.study import Study

app = typer.Typer(help="Choose T, K and f_c from evidence.", no_args_is_help=True)

Out = Annotated[Path | None, typer.Option(help="Folder for figures (PNG, SVG) and their data (CSV).")]


@app.command("filter")
def filter_command(
    controller: Annotated[str, typer.Argument(help="A generated controller.")] = "planar5",
    cutoff: Annotated[float | None, typer.Option(help="f_c [Hz] of eq. 15; default: the manifest's.")] = None,
    period: Annotated[float | None, typer.Option(help="Sampling time T [s]; default: the manifest's.")] = None,
    design: Annotated[
        float | None, typer.Option(metavar="HZ", help="A wanted true −3 dB frequency: gives β and f_c for it.")
    ] = None,
    out: Out = None,
    as_json: AsJson = False,
) -> int:
    """The filter that the controller ships: response, true cut-off, noise gain, design in hertz."""
    from clikgen.analysis.filter_study import filter_study
    from clikgen.cli.freshness import fresh_controller
    from clikgen.cli.terminal import progress_bar

    compiled = fresh_controller(controller)
    with progress_bar() as progress:
        progress.add_task("measuring the compiled filter", total=None)
        study = filter_study(compiled, cutoff, period, design)
    return _deliver(study, out, as_json)


@app.command("clik")
def clik_command(
    scenario: ScenarioName,
    settings: Settings = None,
    delay: Annotated[int, typer.Option(help="Transport delay [samples].")] = 0,
    servo: Annotated[float, typer.Option(help="Lag of the joints' velocity servos [s].")] = 0.0,
    out: Out = None,
    as_json: AsJson = False,
) -> int:
    """Gain bounds against sampling time: linear, certified, measured; margins, root loci, ramp lag."""
    from clikgen.analysis.clik_study import clik_study
    from clikgen.cli.terminal import progress_bar

    controller, wanted, source = load_scenario(scenario, settings)
    with progress_bar() as progress:
        task = progress.add_task("measuring compiled rollouts", total=None)

        def advance(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        study = clik_study(controller, wanted, source, delay, servo, advance)
    return _deliver(study, out, as_json)


@app.command("chatter")
def chatter_command(
    scenario: ScenarioName,
    settings: Settings = None,
    out: Out = None,
    as_json: AsJson = False,
) -> int:
    """Chatter of cases 1-3, predicted and measured, and sticking; of a barrier, how much margin sampling takes.

    Exit code 1 if a clearance fell below what the barrier guarantees.
    """
    from clikgen.analysis.chatter_study import chatter_study
    from clikgen.cli.terminal import progress_bar

    controller, wanted, source = load_scenario(scenario, settings)
    with progress_bar() as progress:
        progress.add_task("predicting and measuring chatter", total=None)
        study = chatter_study(controller, wanted, source)
    return _deliver(study, out, as_json)


@app.command("report")
def report_command(
    scenario: ScenarioName,
    settings: Settings = None,
    out: Annotated[Path, typer.Option(help="Folder for report.html, figures and data.")] = Path("report"),
    as_json: AsJson = False,
) -> int:
    """One self-contained HTML page: simulation, filter, CLIK loop and chatter of a scenario."""
    from clikgen.analysis.plates import save_plates
    from clikgen.analysis.report import html_report, scenario_studies
    from clikgen.cli.terminal import messages, print_json, progress_bar
    from clikgen.runtime.documents import json_text, make_folder, write_atomically

    controller, wanted, source = load_scenario(scenario, settings)
    make_folder(out)
    with progress_bar() as progress:
        task = progress.add_task("studying", total=None)

        def say(what: str) -> None:
            progress.update(task, description=what)

        studies = scenario_studies(controller, wanted, source, say)
        page = html_report(
            f"{wanted.name} on {wanted.controller}", wanted.description, studies, controller.manifest, say
        )
        write_atomically(out / "report.html", page.encode())
        document = {study.title: dict(study.document) for study in studies}
        write_atomically(out / "report.json", json_text(document).encode())
        for study in studies:
            save_plates(study.plates, out, say)
    if as_json:
        print_json(document)
    messages.print(f"wrote {out / 'report.html'} ({len(page) / 1e6:.1f} MB), report.json, figures and their data")
    return 0 if all(study.holds for study in studies) else 1


def _deliver(study: "Study", out: Path | None, as_json: bool) -> int:
    """Print a study and save its figures."""
    from clikgen.analysis.plates import save_plates
    from clikgen.cli.terminal import messages, print_json, print_table, progress_bar

    if out:
        with progress_bar() as progress:
            task = progress.add_task("saving figures", total=None)
            paths = save_plates(study.plates, out, lambda name: progress.update(task, description=name))
        messages.print(f"wrote {len(paths)} files to {out}")
    if as_json:
        print_json(study.document)
        return 0 if study.holds else 1
    for table in study.tables:
        print_table(table.title, table.columns, table.rows)
    for verdict in study.verdicts:
        print(verdict)
    return 0 if study.holds else 1
