"""Whether a generated controller still is what its spec says."""

from pathlib import Path

from clikgen.cli.terminal import progress_bar
from clikgen.runtime.controller import CompiledController, find_controller
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import load_manifest
from clikgen.symbolic.generate import shipped_folder
from clikgen.symbolic.spec import read_spec, shipped_specs


def spec_of(controller: str) -> Path | None:
    """The spec of a controller that ships; None for one of the user's, whose spec we do not know."""
    folder = find_controller(controller).resolve()
    if folder.parent != shipped_folder().resolve():
        return None
    return next((path for path in shipped_specs() if path.stem == folder.name), None)


def is_stale(controller: str) -> bool:
    """Whether the shipped spec has changed since its controller was generated; raises BadInput."""
    spec = spec_of(controller)
    folder = find_controller(controller)
    return spec is not None and read_spec(spec).sha256() != load_manifest(folder).spec_sha256


def fresh_controller(controller: str) -> CompiledController:
    """The controller, compiled if need be, with a progress bar meanwhile.

    Raises BadInput when the generated code is not what its spec says, or cannot be compiled.
    """
    if is_stale(controller):
        raise BadInput(f"{find_controller(controller)}: stale, {spec_of(controller)} changed; run 'clikgen generate'")
    with progress_bar() as progress:
        progress.add_task(f"compiling {controller}", total=None)
        return CompiledController.load(controller)
