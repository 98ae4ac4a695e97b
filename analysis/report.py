"""Studies as one self-contained HTML page that reads on a phone and prints for a design review."""

import base64
from collections.abc import Callable, Sequence
from html import escape
from string import Template

import numpy as np

from clikgen.analysis import drawing
from clikgen.analysis.chatter_study import chatter_study
from clikgen.analysis.clik_study import clik_study
from clikgen.analysis.figures import rendered
from clikgen.analysis.filter_study import filter_study
from clikgen.analysis.plates import Plate
from clikgen.analysis.simulation_study import simulation_study
from clikgen.analysis.study import Study, Table
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import Manifest
from clikgen.runtime.scenario import CASES, Scenario
from clikgen.runtime.simulation import prepare

_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root { --ink: #1b2126; --quiet: #5d6b78; --line: #dde3e9; --accent: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.2rem; max-width: 60rem; color: var(--ink); background: #fff;
       font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .6rem; padding-top: .6rem; border-top: 2px solid var(--accent); }
h3 { font-size: 1rem; margin: 1.6rem 0 .4rem; }
.lead, figcaption, .assumptions { color: var(--quiet); }
.lead, figcaption, .assumptions, footer { font-size: .9rem; }
nav a { display: inline-block; margin: 0 1rem .3rem 0; }
a { color: var(--accent); }
ul.verdicts { padding: 0; list-style: none; }
ul.verdicts li { margin: .4rem 0; padding: .5rem .8rem; border-left: 4px solid var(--accent);
                 background: #f4f8fb; }
figure { margin: 1.4rem 0; }
img { display: block; max-width: 100%; height: auto; }
.scroll { overflow-x: auto; }
@media (max-width: 700px) { figure .scroll img { max-width: none; width: 680px; } }
table { border-collapse: collapse; font-size: .88rem; }
th, td { padding: .3rem .7rem .3rem 0; border-bottom: 1px solid var(--line); text-align: left;
         vertical-align: top; }
td { font-variant-numeric: tabular-nums; }
code { word-break: break-all; font-size: .85em; }
footer { margin-top: 3rem; color: var(--quiet); border-top: 1px solid var(--line); padding-top: .8rem; }
@media print { h2 { break-before: page; } figure, table { break-inside: avoid; } nav { display: none; } }
</style>
</head>
<body>
<h1>$title</h1>
<p class="lead">$lead</p>
<nav>$contents</nav>
$body
<footer>$footer</footer>
</body>
</html>
""")


def scenario_studies(
    controller: CompiledController,
    scenario: Scenario,
    source: str = "scenario",
    progress: Callable[[str], None] = drawing.ignore,
) -> list[Study]:
    """Every study of a scenario: simulation, filter, and where they speak of it CLIK loop and chatter.

    The loop is studied for a task of kind frame_position, chatter where there is contact; a study that cannot be
    made says why. Raises BadInput where the scenario does not fit its controller.
    """
    progress("simulating")
    rollouts = {number: prepare(controller, scenario, case, source).in_c() for number, case in CASES.items()}
    studies = [simulation_study(controller, rollouts)]
    parameters = rollouts[1].parameters
    progress("measuring the compiled filter")
    cutoff, period = float(np.min(parameters["filter_cutoff"])), rollouts[1].period
    studies.append(_or_why_not("Filter", lambda: filter_study(controller, cutoff, period)))
    progress("measuring the compiled loop over gain and sampling time")
    studies.append(_or_why_not("CLIK loop", lambda: clik_study(controller, scenario, source)))
    if any(rollout.active.any() for rollout in rollouts.values()):
        progress("predicting and measuring chatter")
        studies.append(_or_why_not("Chatter", lambda: chatter_study(controller, scenario, source)))
    return studies


def _or_why_not(title: str, study: Callable[[], Study]) -> Study:
    """The study, or in its place the one line that says why the theory does not speak of this controller."""
    try:
        return study()
    except BadInput as error:
        return Study(title, [f"Not studied: {error}."], [], [], [], {"not_studied": str(error)})


def html_report(
    title: str,
    lead: str,
    studies: Sequence[Study],
    manifest: Manifest,
    progress: Callable[[str], None] = drawing.ignore,
) -> str:
    """One page: per study its verdicts, tables, figures and assumptions; at the end what was judged."""
    sections = []
    for i, study in enumerate(studies):
        progress(study.title)
        sections.append(_section(f"s{i}", study))
    contents = "".join(f'<a href="#s{i}">{escape(study.title)}</a>' for i, study in enumerate(studies))
    files = "".join(f"<br>{escape(name)} <code>{digest}</code>" for name, digest in manifest.source_sha256.items())
    footer = (
        f"Controller {escape(manifest.controller)}: {escape(manifest.description)}. Law {escape(manifest.law)}, "
        f"filter {escape(manifest.filter)}, CasADi {escape(manifest.casadi)}.<br>"
        f"Spec <code>{manifest.spec_sha256}</code>{files}"
    )
    return _PAGE.substitute(
        title=escape(title), lead=escape(lead), contents=contents, body="\n".join(sections), footer=footer
    )


def _section(anchor: str, study: Study) -> str:
    verdicts = "".join(f"<li>{escape(verdict)}</li>" for verdict in study.verdicts)
    assumptions = "".join(f"<li>{escape(assumption)}</li>" for assumption in study.assumptions)
    return (
        f'<section id="{anchor}"><h2>{escape(study.title)}</h2><ul class="verdicts">{verdicts}</ul>'
        + "".join(map(_figure, study.plates))
        + "".join(map(_table, study.tables))
        + f'<div class="assumptions"><h3>Assumptions</h3><ul>{assumptions}</ul></div></section>'
    )


def _figure(plate: Plate) -> str:
    picture = base64.b64encode(rendered(plate.figure, "png")).decode()
    return (
        f'<figure><div class="scroll"><img alt="{escape(plate.caption, quote=True)}" '
        f'src="data:image/png;base64,{picture}"></div>'
        f"<figcaption>{escape(plate.caption)}</figcaption></figure>"
    )


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(column)}</th>" for column in table.columns)
    rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows)
    return (
        f'<h3>{escape(table.title)}</h3><div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )
