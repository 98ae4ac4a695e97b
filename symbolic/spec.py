"""The controller spec: one TOML file that says what robot, which tasks in which order, which law."""

import pkgutil
from functools import reduce
from importlib import import_module, resources
from operator import or_
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from clikgen.runtime.documents import Document, Identifier, choices, read_toml
from clikgen.runtime.manifest import sha256
from clikgen.symbolic import filters, laws
from clikgen.symbolic.planner import Planner
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.task import TaskSpec, task_kinds

if TYPE_CHECKING:
    from clikgen.symbolic.filters.first_order import Spec as AnyFilter

    AnyTask = TaskSpec
else:  # the kinds are the files of a folder, so pydantic learns them when it starts

    def _one_of(kinds):
        kinds = tuple(kinds)
        return kinds[0] if len(kinds) == 1 else Annotated[reduce(or_, kinds), Field(discriminator="kind")]

    AnyTask = _one_of(task_kinds().values())
    AnyFilter = _one_of(
        import_module(f"{filters.__name__}.{module.name}").Spec for module in pkgutil.iter_modules(filters.__path__)
    )


class ObstacleCapacity(Document):
    """How many obstacles the controller can hold at once."""

    maximum: Annotated[int, Field(strict=True, ge=0, le=100)] = 0


class ControllerSpec(Document):
    """A controller, named: robot, obstacles, tasks from the highest priority down, law, filter, planner.

    `period` is the default sampling time T [s]. Structure is compiled in; every number one tunes (gains,
    damping, influence radii, T, f_c, λ) is a run-time parameter whose default is written here.
    """

    name: Identifier
    description: str
    period: Annotated[float, Field(strict=True, ge=1e-6, le=10)]
    law: str = "nsb"
    robot: Robot
    obstacles: ObstacleCapacity = ObstacleCapacity()
    tasks: Annotated[tuple[AnyTask, ...], Field(min_length=1)]
    filter: AnyFilter
    planner: Planner = Planner()

    @model_validator(mode="after")
    def _law_exists(self) -> Self:
        names = [module.name for module in pkgutil.iter_modules(laws.__path__)]
        if self.law not in names:
            raise ValueError(f"no law '{self.law}'; {choices(self.law, names)}")
        return self

    @model_validator(mode="after")
    def _task_names_are_unique(self) -> Self:
        names = [task.name for task in self.tasks]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"task '{name}' is there twice")
        return self

    def sha256(self) -> str:
        """What identifies the spec: its content, whatever the file's comments and layout."""
        return sha256(self.model_dump_json().encode())


def read_spec(path: Path) -> ControllerSpec:
    """The spec in a TOML file; raises BadInput, one line."""
    return ControllerSpec.parse(read_toml(path), str(path))


def shipped_specs() -> list[Path]:
    """The spec files that come with clikgen."""
    folder = Path(str(resources.files("clikgen.symbolic"))) / "specs"
    return sorted(folder.glob("*.toml"))
