"""A scenario: what a controller is asked to do, from a TOML file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Self, get_args

from pydantic import Field, model_validator

from clikgen.runtime.documents import (
    BadInput,
    Document,
    Identifier,
    NonNegative,
    Number,
    Positive,
    UnitVector,
    choices,
    parse_toml_value,
    read_toml,
)
from clikgen.runtime.manifest import Manifest, Space
from clikgen.runtime.references import AnyTrajectory, Fixed, Trajectory


@dataclass(frozen=True, slots=True)
class Case:
    """One of the paper's cases: λ while no influence region meets an obstacle, and while one does."""

    number: int
    title: str  # with a place for the law's name
    lam_free: float
    lam_event: float


CASES = {
    case.number: case
    for case in (
        Case(1, "{law} alone", 0.0, 0.0),
        Case(2, "{law} + filter", 1.0, 1.0),
        Case(3, "{law} + filter + planner", 0.0, 1.0),
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


class Capsule(Document):
    """All points within `radius` [m] of the segment from `start` to `end` [m]; it stays where it is."""

    start: tuple[Number, ...]
    end: tuple[Number, ...]
    radius: NonNegative = 0.0


class HalfSpace(Document):
    """All points p with normalᵀp <= offset [m]: a wall, a floor or a ceiling."""

    normal: UnitVector[tuple[Number, ...]]
    offset: Number


class MetricSettings(Document):
    """What the metrics are measured with: the lowest frequency that counts as chatter, and a dead-band."""

    f_h: Positive = Field(default=5.0, description="hf_rms counts what lies above this frequency [Hz]")
    dead_band: NonNegative = Field(default=0.01, description="smaller velocity reversals are not counted")


class Sensing(Document):
    """How the step is told where the balls are, once per period: perfectly, unless this says otherwise.

    A ball on the path o(t) is sensed at o(max(t − delay, 0)) + noise · w, where w ~ N(0, 1) is drawn anew for every
    coordinate of every ball in every period, the same for every case. Capsules and half-spaces are sensed perfectly.
    """

    noise: NonNegative = Field(default=0.0, le=1e3, description="standard deviation of each coordinate [m]")
    delay: NonNegative = Field(default=0.0, description="how old the sensed positions and velocities are [s]")
    seed: Annotated[int, Field(strict=True, ge=0, description="another one gives other noise")] = 0

    @property
    def perfect(self) -> bool:
        """Whether the step is told the truth."""
        return self.noise == 0 and self.delay == 0


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
    capsules: tuple[Capsule, ...] = ()
    half_spaces: tuple[HalfSpace, ...] = ()
    sensing: Sensing = Sensing()
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
    n = len(manifest.joints)
    if len(scenario.q0) != n:
        raise BadInput(f"{source}: q0: wanted {n} numbers for {manifest.controller}, got {len(scenario.q0)}")
    _check_references(scenario, manifest, source)
    _check_obstacles(scenario, manifest, source)
    step = manifest.function("step")
    parameters = {signal.name: signal for signal in step.inputs if signal.role == "parameter"}
    for name, value in scenario.parameters.items():
        if name not in parameters:
            raise BadInput(f"{source}: parameters: no parameter '{name}'; {choices(name, parameters)}")
        parameters[name].value(value, f"{source}: parameters.{name}")


def _check_references(scenario: Scenario, manifest: Manifest, source: str) -> None:
    references = {reference.name: reference for reference in manifest.references}
    for name, motion in scenario.references.items():
        if name not in references:
            raise BadInput(f"{source}: references: no reference '{name}'; {choices(name, references)}")
        wanted = references[name]
        if motion.space != wanted.space:
            raise BadInput(
                f"{source}: references.{name}: wanted a {wanted.space}, got the {motion.space} '{motion.kind}'; "
                f"{choices('', _kinds_of(wanted.space))}"
            )
        if motion.dimension != wanted.dimension:
            raise BadInput(
                f"{source}: references.{name}: wanted {wanted.dimension} coordinates, got {motion.dimension}"
            )
    for reference in manifest.references:
        if reference.required and reference.name not in scenario.references:
            coordinates = f" of {reference.dimension} coordinates" if reference.space == "vector" else ""
            raise BadInput(
                f"{source}: references.{reference.name}: missing; task '{reference.task}' wants a reference, "
                f"a {reference.space}{coordinates}"
            )


def _kinds_of(space: Space) -> list[str]:
    """The kinds of trajectory whose values are vectors, or rotations."""
    trajectories = get_args(get_args(AnyTrajectory)[0])
    return [
        get_args(one.model_fields["kind"].annotation)[0] for one in trajectories if one.model_construct().space == space
    ]


def _check_obstacles(scenario: Scenario, manifest: Manifest, source: str) -> None:
    for key, got, most in (
        ("obstacles", len(scenario.obstacles), manifest.obstacles),
        ("capsules", len(scenario.capsules), manifest.capsules),
        ("half_spaces", len(scenario.half_spaces), manifest.half_spaces),
    ):
        if got > most:
            raise BadInput(f"{source}: {key}: wanted at most {most} for {manifest.controller}, got {got}")
    places = {f"obstacles.{i}": one.motion.dimension for i, one in enumerate(scenario.obstacles)}
    for i, obstacle in enumerate(scenario.obstacles):
        if obstacle.motion.space != "vector":
            raise BadInput(f"{source}: obstacles.{i}.path: wanted positions, got the rotation '{obstacle.motion.kind}'")
    for i, capsule in enumerate(scenario.capsules):
        places |= {f"capsules.{i}.start": len(capsule.start), f"capsules.{i}.end": len(capsule.end)}
    places |= {f"half_spaces.{i}.normal": len(wall.normal) for i, wall in enumerate(scenario.half_spaces)}
    for key, dimension in places.items():
        if dimension != manifest.dimension:
            raise BadInput(f"{source}: {key}: wanted {manifest.dimension} coordinates, got {dimension}")
