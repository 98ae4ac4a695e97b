"""The controller spec: one TOML file that says what robot, which tasks in which order, which law."""

import json
import pkgutil
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BeforeValidator, Field, create_model, model_validator

from clikgen.runtime.documents import BadInput, Document, Identifier, choices, read_toml
from clikgen.runtime.manifest import sha256
from clikgen.symbolic import filters, laws, planners, tasks, velocity_limits
from clikgen.symbolic.kinds import one_of
from clikgen.symbolic.models.table import RobotModel, RobotTable
from clikgen.symbolic.obstacles import ObstacleCapacity
from clikgen.symbolic.planner import PlannerSpec
from clikgen.symbolic.planners import event
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.task import TaskSpec

if TYPE_CHECKING:
    from clikgen.symbolic.filters.first_order import Spec as AnyFilter
    from clikgen.symbolic.velocity_limit import VelocityLimitSpec as AnyVelocityLimit

    AnyTask = TaskSpec
    AnyPlanner = PlannerSpec
else:
    AnyTask, AnyFilter, AnyVelocityLimit = one_of(tasks), one_of(filters), one_of(velocity_limits)
    AnyPlanner = Annotated[one_of(planners), BeforeValidator(event.by_default)]


class ControllerSpec(Document):
    """A controller, named: robot, obstacles, tasks from the highest priority down, law, limits, filter, planner.

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
    velocity_limits: AnyVelocityLimit | None = None
    filter: AnyFilter
    planner: AnyPlanner = event.Spec()

    @model_validator(mode="after")
    def _law_exists(self) -> Self:
        names = [module.name for module in pkgutil.iter_modules(laws.__path__)]
        if self.law not in names:
            raise ValueError(f"no law '{self.law}'; {choices(self.law, names)}")
        return self

    @model_validator(mode="after")
    def _task_names_are_unique(self) -> Self:
        names = [task.name for task in self.tasks]
        for i, name in enumerate(names):
            if name in names[:i]:
                first = names.index(name)
                raise ValueError(f"tasks.{first} and tasks.{i} are both called '{name}', wanted every name once")
        return self

    def sha256(self) -> str:
        """What identifies the spec: its content, whatever the file's comments and layout."""
        return sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode())


class _RobotOfSpec(Document):
    robot: RobotTable  # under this name, so that an error says where: robot.joints.0


@dataclass(frozen=True, slots=True)
class SpecFile:
    """A spec file as it was read, and what its writer should know of the robot, a line each."""

    spec: ControllerSpec
    notes: tuple[str, ...]


def read_spec_file(path: Path) -> SpecFile:
    """The spec in a TOML file, its robot built from joints, DH parameters or a URDF; raises BadInput, one line."""
    data, source = read_toml(path), str(path)
    if "robot" not in data:  # let the spec say so
        return SpecFile(ControllerSpec.parse(data, source), ())
    model = _built_robot(data["robot"], path)
    spec = ControllerSpec.parse(data | {"robot": model.robot}, source)
    return SpecFile(spec, model.notes)


def read_robot(path: Path) -> RobotModel:
    """The robot of a URDF file or of a spec, whatever else the spec says; raises BadInput, one line."""
    if path.suffix == ".urdf":
        return _built_robot({"urdf": path.name}, path)
    data = read_toml(path)
    if "robot" not in data:
        raise BadInput(f"{path}: robot: missing; wanted a table [robot]")
    return _built_robot(data["robot"], path)


def _built_robot(table: Any, path: Path) -> RobotModel:
    return _RobotOfSpec.parse({"robot": table}, str(path)).robot.build(path.parent, str(path))


def read_spec(path: Path) -> ControllerSpec:
    """The spec in a TOML file; raises BadInput, one line."""
    return read_spec_file(path).spec


def spec_schema() -> dict[str, Any]:
    """The JSON schema of a spec file."""
    fields: Any = {"robot": (RobotTable, ...)}
    return create_model("ControllerSpec", __base__=ControllerSpec, **fields).model_json_schema()


def shipped_specs() -> list[Path]:
    """The spec files that come with clikgen."""
    folder = Path(str(resources.files("clikgen.symbolic"))) / "specs"
    return sorted(folder.glob("*.toml"))
