"""Spec -> the files of a generated controller, as a pure function; and keeping a folder equal to it."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path

from clikgen.runtime.documents import TEMPORARY_SUFFIX, BadInput, commit_all, json_text
from clikgen.runtime.manifest import (
    BodyInfo,
    FrameInfo,
    FunctionInfo,
    InputInfo,
    JointInfo,
    LinkInfo,
    Manifest,
    PointInfo,
    ReferenceInfo,
    TaskInfo,
    sha256,
)
from clikgen.symbolic import c_code
from clikgen.symbolic.c_code import Target
from clikgen.symbolic.controller import Controller, ControllerFunction, build
from clikgen.symbolic.emitter import LANES
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.spec import ControllerSpec, read_spec_file
from clikgen.symbolic.task import TaskSpec


def generate(spec: ControllerSpec, target: Target = "c") -> dict[str, str]:
    """File name -> text for a controller: `<name>.c`, `<name>.h`, `manifest.json`, the manifest last.

    Where the target is "c" and the step a straight line, also `<name>_lanes.c`, the step of many robots at once. The
    same spec gives the same text on every machine. Raises BadInput when the spec asks for what its robot does not
    have.
    """
    return _files(build(spec), target)


def _files(controller: Controller, target: Target) -> dict[str, str]:
    spec = controller.spec
    functions = [_function_info(function, target) for function in controller.functions]
    sources = {
        f"{spec.name}.c": c_code.source(controller, functions, target),
        f"{spec.name}.h": c_code.header(controller, functions, target),
    }
    lanes = c_code.lanes_source(controller) if target == "c" else None
    if lanes is not None:
        sources[f"{spec.name}_lanes.c"] = lanes
    manifest = _manifest(controller, functions, sources, target)
    return {**sources, "manifest.json": json_text(manifest.model_dump(mode="json", exclude_none=True))}


@dataclass(frozen=True, slots=True)
class Generated:
    """A controller's name, its files (name -> text), and notes on its robot and its tasks, a line each."""

    name: str
    files: dict[str, str]
    notes: tuple[str, ...]


def generate_file(path: Path, target: Target = "c") -> Generated:
    """The controller of the spec in `path`; raises BadInput that names the file."""
    read = read_spec_file(path)
    try:
        controller = build(read.spec)
        return Generated(read.spec.name, _files(controller, target), (*read.notes, *controller.notes))
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from None


def _function_info(function: ControllerFunction, target: Target) -> FunctionInfo:
    sizes = {"sz_arg": len(function.inputs), "sz_res": len(function.outputs), "sz_iw": 0, "sz_w": 0}
    if target == "casadi":
        compiled = function.casadi
        looped = compiled.is_a("MXFunction")  # the others keep their temporaries in local variables
        sizes = {name: getattr(compiled, name)() * (looped or name in ("sz_arg", "sz_res")) for name in sizes}
    return FunctionInfo(
        name=function.name,
        symbol=function.procedure.name,
        description=function.description,
        inputs=tuple(signal.info for signal in function.inputs),
        outputs=tuple(signal.info for signal in function.outputs),
        operations=c_code.scalar(function.procedure).operations,
        **sizes,
    )


def _manifest(
    controller: Controller, functions: Iterable[FunctionInfo], sources: Mapping[str, str], target: Target
) -> Manifest:
    spec, robot = controller.spec, controller.spec.robot
    return Manifest(
        generator="clikgen",
        controller=spec.name,
        description=spec.description,
        casadi=metadata.version("casadi"),
        target=target,
        lanes=LANES if f"{spec.name}_lanes.c" in sources else None,
        spec_sha256=spec.sha256(),
        source_sha256={name: sha256(text.encode()) for name, text in sources.items()},
        dimension=robot.dimension,
        joints=tuple(
            JointInfo(
                name=joint.name,
                type=joint.type,
                unit=joint.unit,
                link=joint.link,
                lower=joint.lower,
                upper=joint.upper,
                velocity=joint.velocity,
            )
            for joint in robot.coordinates
            if joint.type != "fixed"
        ),
        inputs=tuple(InputInfo(name=one.name, unit=one.unit, velocity=one.velocity) for one in robot.inputs),
        links=tuple(
            LinkInfo(name=joint.link, parent=robot.parent(joint), outline=joint.outline) for joint in robot.joints
        ),
        points=tuple(
            PointInfo(name=point.name, link=point.link, offset=point.offset) for point in robot.points_of_interest
        ),
        bodies=tuple(
            BodyInfo(name=body.name, link=body.link, start=body.start, end=body.end or body.start, radius=body.radius)
            for body in robot.bodies
        ),
        obstacles=spec.obstacles.maximum,
        capsules=spec.obstacles.capsules,
        half_spaces=spec.obstacles.half_spaces,
        tasks=tuple(
            TaskInfo(
                name=task.name,
                kind=task.kind,
                equality=task.equality,
                activation=task.activation.kind if isinstance(task, OneSidedSpec) else None,
                dimension=task.dimension(robot),
                tracks=bool(task.tracked_axes(robot)),
                axes=task.tracked_axes(robot),
                frame=_frame_info(robot, task),
            )
            for task in spec.tasks
        ),
        references=tuple(
            ReferenceInfo(
                name=one.name,
                task=task.name,
                space=one.space,
                dimension=one.velocity.info.size,
                required=one.required,
            )
            for task in controller.tasks
            for one in task.references
        ),
        law=spec.law,
        velocity_limits=spec.velocity_limits.kind if spec.velocity_limits else None,
        filter=spec.filter.kind,
        planner=spec.planner.kind,
        functions=tuple(functions),
    )


def _frame_info(robot: Robot, task: TaskSpec) -> FrameInfo | None:
    """The frame of a task whose table names one."""
    name = dict(task).get("frame")
    if name is None:
        return None
    frame = robot.frame(name)
    return FrameInfo(name=frame.name, link=frame.link, xyz=frame.xyz)


@dataclass(frozen=True, slots=True)
class Difference:
    """What would change in a folder: files to write (path -> text) and orphans to remove."""

    write: Mapping[Path, str]
    remove: tuple[Path, ...]

    def __bool__(self) -> bool:
        return bool(self.write or self.remove)

    def unified(self) -> str:
        """The change as a unified diff."""
        changes = [(path, _text_or_nothing(path), text) for path, text in self.write.items()]
        changes += [(path, _text_or_nothing(path), "") for path in self.remove]
        return "".join(
            line
            for path, old, new in changes
            for line in difflib.unified_diff(
                old.splitlines(keepends=True),
                new.splitlines(keepends=True),
                f"{path} (on disk)",
                f"{path} (from the spec)",
            )
        )

    def apply(self) -> None:
        """Write what changed, each file whole or not at all, then remove the orphans; raises BadInput."""
        commit_all({path: text.encode() for path, text in self.write.items()})
        for path in self.remove:
            path.unlink(missing_ok=True)
        for folder in {path.parent for path in self.remove}:
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()


def difference(controllers: Mapping[str, Mapping[str, str]], out: Path, *, complete: bool) -> Difference:
    """How `out` differs from what `controllers` (name -> file name -> text) should make of it.

    Orphans are files of our making that no spec stands for: in the folders of `controllers` and, when they are
    `complete`, in every other folder of `out`. A file that clikgen did not write is never touched.
    """
    wanted = {out / name / file: text for name, files in controllers.items() for file, text in files.items()}
    folders = [path for path in out.iterdir() if path.is_dir()] if complete and out.is_dir() else []
    folders += [out / name for name in controllers]
    orphans = sorted(
        {
            path
            for folder in folders
            for path in folder.glob("*")
            if path not in wanted and path.is_file() and _is_ours(path)
        }
    )
    write = {path: text for path, text in wanted.items() if _text_or_nothing(path) != text or not path.is_file()}
    return Difference(write, tuple(orphans))


def shipped_folder() -> Path:
    """The folder of the controllers that ship, which `clikgen generate` keeps equal to the shipped specs."""
    return Path(str(resources.files("clikgen.generated")))


def _is_ours(path: Path) -> bool:
    if path.name.endswith(TEMPORARY_SUFFIX):
        return True
    start = _text_or_nothing(path)[:200]
    return (
        c_code.MARK in start
        if path.suffix in (".c", ".h")
        else path.name == "manifest.json" and '"generator": "clikgen"' in start
    )


def _text_or_nothing(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return ""
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        return ""
