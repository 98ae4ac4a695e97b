"""What the commands that run a scenario have in common: their options, and what those stand for."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from clikgen.runtime.controller import CompiledController
    from clikgen.runtime.scenario import Scenario

ScenarioName = Annotated[str, typer.Argument(help="A scenario that ships, or a .toml file.")]
CaseNumber = Annotated[int | None, typer.Option(help="1 NSB, 2 with filter, 3 with filter and planner; default: all.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A parameter or a key of the scenario.")
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]


def chosen_cases(number: int | None) -> Sequence[int]:
    """The case of that number alone, or all of them; raises BadInput."""
    from clikgen.runtime.documents import BadInput
    from clikgen.runtime.scenario import CASES

    if number is None:
        return list(CASES)
    if number not in CASES:
        raise BadInput(f"--case: wanted one of {', '.join(map(str, CASES))}, got {number}")
    return [number]


def load_scenario(name: str, settings: Sequence[str] | None) -> "tuple[CompiledController, Scenario, str]":
    """A scenario's compiled controller, the scenario with its settings, and the file it is from; raises BadInput."""
    from clikgen.cli.freshness import fresh_controller
    from clikgen.runtime.scenario import find_scenario, read_scenario

    path = find_scenario(name)
    wanted = read_scenario(path, settings or ())
    return fresh_controller(wanted.controller), wanted, str(path)
