"""A scenario: what a controller is asked to do, from a TOML file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from clikgen.runtime.documents import (
    BadInput,
    Document,
    Identifier,
    NonNegative,
    Number,
    Positive,
    choices,
    parse_toml_value,
    read_toml,
)
from clikgen.runtime.manifest import Manifest
from clikgen.runtime.references import AnyTrajectory, Fixed, Trajectory


@dataclass(frozen=True, slots=True)
class Case:
    """One of the paper's cases: λ while no influence region meets an obstacle, and while one does."""

    number: int
    title: str
    lam_free: float
    lam_event: float


CASES = {
    case.number: case
    for case in (
        Case(1, "NSB alone", 0.0, 0.0),
        Case(2, "NSB + filter", 1.0, 1.0),
        Case(3, "NSB + filter + planner", 0.0, 1.0),
    )
}


class Obstacle(Document):
    """A disc of `radius` [m] (0: a point) that stays at `center` [m] or moves along `path`."""

    radius: NonNegative = 0.0
    center: tuple[Number, ...] | None = None
    path: AnyTrajectory | None = None

    @model_validator(mode="after")
    def _is_somewhere(self) -> Self:
        if (self.center is None) == (self.path is None):
            raise ValueError("wanted either 'center' or 'path'")
        return self

    @property
    def motion(self) -> Trajectory:
        """Where the centre is over time."""
        return self.path or Fixed(kind="fixed", position=self.center or ())


class MetricSettings(Document):
    """What the metrics are measured with: the lowest frequency that counts as chatter, and a dead-band."""

    f_h: Positive = Field(default=5.0, description="hf_rms counts what lies above this frequency [Hz]")
    dead_band: NonNegative = Field(default=0.01, description="smaller velocity reversals are not counted")


class Scenario(Document):
    """A run of a controller: how long, from where, after which references, past which obstacles."""

    name: Identifier
    description: str
    controller: str
    duration: Positive
    q0: Annotated[tuple[Number, ...], Field(min_length=1)]
    parameters: Mapping[str, Any] = {}
    references: Mapping[str, AnyTrajectory] = {}
    obstacles: tuple[Obstacle, ...] = ()
    metrics: MetricSettings = MetricSettings()


def shipped_scenarios() -> list[Path]:
    """The scenario files that come with clikgen."""
    return sorted((Path(str(resources.files(__package__))) / "scenarios").glob("*.toml"))


def find_scenario(name_or_path: str) -> Path:
    """The file of a scenario: a path that ends in .toml as given, else the shipped one of that name.

    Raises BadInput with the names that ship.
    """
    if name_or_path.endswith(".toml"):
        return Path(name_or_path)
    shipped = {path.stem: path for path in shipped_scenarios()}
    if name_or_path not in shipped:
        raise BadInput(f"no scenario '{name_or_path}' (nor a .toml file); {choices(name_or_path, shipped)}")
    return shipped[name_or_path]


def read_scenario(path: Path, settings: Sequence[str] = ()) -> Scenario:
    """The scenario in a TOML file, with `KEY=VALUE` settings put over it.

    KEY is a parameter of the controller's step or a dotted key of the scenario (`duration`, `metrics.f_h`);
    VALUE is written as in TOML. Files named in the scenario are found from its folder. Raises BadInput.
    """
    data = read_toml(path)
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or not key:
            raise BadInput(f"--set {setting}: wanted KEY=VALUE")
        _put(data, key.strip(), parse_toml_value(text, f"--set {key}"))
    for reference in data.get("references", {}).values() if isinstance(data.get("references"), dict) else ():
        if isinstance(reference, dict) and isinstance(reference.get("file"), str):
            reference["file"] = str(path.parent / reference["file"])
    return Scenario.parse(data, str(path))


def _put(data: dict[str, Any], key: str, value: Any) -> None:
    """Set a dotted key; one without dots that the scenario does not know is a controller parameter."""
    first, *rest = key.split(".")
    if not rest and first not in Scenario.model_fields:
        first, rest = "parameters", [first]
    table = data
    for part in [first, *rest][:-1]:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise BadInput(f"--set {key}: '{part}' is not a table")
    table[[first, *rest][-1]] = value


def check_against(scenario: Scenario, manifest: Manifest, source: str) -> None:
    """Raises BadInput where the scenario does not fit its controller."""
    n, dimension = len(manifest.joints), manifest.dimension
    if len(scenario.q0) != n:
        raise BadInput(f"{source}: q0: wanted {n} numbers for {manifest.controller}, got {len(scenario.q0)}")
    if len(scenario.obstacles) > manifest.obstacles:
        raise BadInput(
            f"{source}: obstacles: wanted at most {manifest.obstacles} for {manifest.controller}, "
            f"got {len(scenario.obstacles)}"
        )
    tracking = [task.name for task in manifest.tracking_tasks]
    for name in scenario.references:
        if name not in tracking:
            raise BadInput(f"{source}: references: no tracking task '{name}'; {choices(name, tracking)}")
    for name in tracking:
        if name not in scenario.references:
            raise BadInput(f"{source}: references.{name}: missing; task '{name}' wants a reference")
    motions: dict[str, Trajectory] = {f"references.{name}": motion for name, motion in scenario.references.items()}
    motions |= {f"obstacles.{i}": obstacle.motion for i, obstacle in enumerate(scenario.obstacles)}
    for key, motion in motions.items():
        if motion.dimension != dimension:
            raise BadInput(f"{source}: {key}: wanted {dimension} coordinates, got {motion.dimension}")
    step = manifest.function("step")
    parameters = {signal.name: signal for signal in step.inputs if signal.role == "parameter"}
    for name, value in scenario.parameters.items():
        if name not in parameters:
            raise BadInput(f"{source}: parameters: no parameter '{name}'; {choices(name, parameters)}")
        parameters[name].value(value, f"{source}: parameters.{name}")
