"""Whether a generated controller still is what its spec says."""

from pathlib import Path

from clikgen.cli.terminal import progress_bar
from clikgen.runtime.controller import CompiledController, find_controller
from clikgen.runtime.documents import BadInput, read_toml
from clikgen.runtime.manifest import load_manifest
from clikgen.symbolic.generate import shipped_folder
from clikgen.symbolic.spec import read_spec, shipped_specs


def spec_of(controller: str) -> Path | None:
    """The spec of a controller: the one that ships, or NAME.toml beside the folder `generated` of one's own.

    None where there is no such file, or it holds a spec of another name.
    """
    folder = find_controller(controller).resolve()
    if folder.parent == shipped_folder().resolve():
        return next((path for path in shipped_specs() if path.stem == folder.name), None)
    beside = folder.parent.parent / f"{folder.name}.toml"
    return beside if beside.is_file() and read_toml(beside).get("name") == folder.name else None


def is_stale(controller: str) -> bool:
    """Whether the spec has changed since its controller was generated; raises BadInput."""
    spec = spec_of(controller)
    folder = find_controller(controller)
    return spec is not None and read_spec(spec).sha256() != load_manifest(folder).spec_sha256


def fresh_controller(controller: str) -> CompiledController:
    """The controller, compiled if need be, with a progress bar meanwhile.

    Raises BadInput when the generated code is not what its spec says, or cannot be compiled.
    """
    if is_stale(controller):
        folder, spec = find_controller(controller), spec_of(controller)
        command = "clikgen generate" if spec in shipped_specs() else f"clikgen generate {spec}"
        raise BadInput(f"{folder}: stale, {spec} or its URDF changed; run '{command}'")
    with progress_bar() as progress:
        progress.add_task(f"compiling {controller}", total=None)
        return CompiledController.load(controller)
