"""`clikgen compare`: a scenario under the paper's three cases and the laws without chatter, side by side."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clikgen.cli.scenarios import AsJson, ScenarioName, Settings, load_scenario

if TYPE_CHECKING:
    from clikgen.analysis.comparison import Law
    from clikgen.runtime.controller import CompiledController

WIDEST = 240  # characters: a table that is folded to the terminal's width cannot be read


def command(
    scenario: ScenarioName,
    laws: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...", help="Of case1,case2,case3,smooth,hysteresis,ramp,damped,barrier; default: all."
        ),
    ] = None,
    settings: Settings = None,
    out: Annotated[Path | None, typer.Option(help="Folder for figure, data, animation and comparison.json.")] = None,
    animation: Annotated[bool, typer.Option("--animation/--no-animation", help="With --out: the film too.")] = True,
    as_json: AsJson = False,
) -> int:
    """Compare the paper's three cases and the laws that do not chatter on one scenario."""
    from clikgen.analysis.comparison import (
        chosen_laws,
        compare,
        comparison_document,
        comparison_table,
        intrusion_table,
    )
    from clikgen.analysis.comparison_figures import save_comparison
    from clikgen.cli.terminal import messages, print_json, print_table, progress_bar
    from clikgen.runtime.documents import json_text, make_folder, write_atomically
    from clikgen.runtime.scenario import read_scenario

    chosen = chosen_laws(laws)
    own, wanted, source = load_scenario(scenario, settings)
    given = read_scenario(Path(source), ["parameters={}", *(settings or ())]).parameters  # without the file's own
    if out:
        make_folder(out)
    compared = compare(compiled_laws(chosen, wanted.controller), own.manifest, wanted, tuple(given), source)
    document = comparison_document(compared, own.manifest)
    if out:
        with progress_bar() as progress:
            task = progress.add_task("drawing", total=None)
            paths = save_comparison(compared, out, animation, lambda name: progress.update(task, description=name))
        write_atomically(out / "comparison.json", json_text(document).encode())
        messages.print(f"wrote {out}: {', '.join(path.name for path in paths)}, comparison.json")
    if as_json:
        print_json(document)
    else:
        print_table(*comparison_table(compared), width=WIDEST)
        print_table(*intrusion_table(compared), width=WIDEST)
    return 0


def compiled_laws(laws: "Sequence[Law]", controller: str) -> "dict[Law, CompiledController]":
    """The controller under every law, generated from its spec and compiled if need be; raises BadInput."""
    from tempfile import TemporaryDirectory

    from clikgen.cli.freshness import spec_of
    from clikgen.cli.terminal import progress_bar
    from clikgen.runtime.controller import CompiledController
    from clikgen.runtime.documents import BadInput, write_atomically
    from clikgen.symbolic.generate import generate
    from clikgen.symbolic.spec import read_spec
    from clikgen.symbolic.variants import with_activation, with_planner

    path = spec_of(controller)
    if path is None:
        raise BadInput(f"{controller}: wanted its spec to compare laws, {controller}.toml beside ./generated, got none")
    spec = read_spec(path)
    compiled = {}
    with progress_bar() as progress, TemporaryDirectory() as folder:
        for law in progress.track(laws, description="compiling"):
            variant = with_activation(spec, law.activation)
            variant = with_planner(variant, law.planner) if law.planner else variant
            for name, text in generate(variant).items():
                write_atomically(Path(folder) / law.name / name, text.encode())
            compiled[law] = CompiledController.load(Path(folder) / law.name)
    return compiled
