"""`clikgen generate`: spec files -> C, header and manifest."""

from pathlib import Path
from typing import Annotated, get_args

import typer


def command(
    specs: Annotated[
        list[Path] | None, typer.Argument(metavar="[SPEC]...", help="Spec files; default: those that ship.")
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Write nothing; print a diff and exit 1 when stale.")] = False,
    schema: Annotated[bool, typer.Option("--schema", help="Print the JSON schema of a spec file.")] = False,
    target: Annotated[
        str, typer.Option(help="c: our C in double; float: in single precision; casadi: CasADi's, the reference.")
    ] = "c",
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the controllers; default: ./generated, or where the shipped ones are."),
    ] = None,
) -> int:
    """Make the generated code equal to the specs: write what changed, remove what no spec stands for."""
    from clikgen.cli.terminal import messages, print_json, progress_bar
    from clikgen.runtime.documents import BadInput, choices
    from clikgen.symbolic.c_code import Target
    from clikgen.symbolic.generate import difference, generate_file, shipped_folder
    from clikgen.symbolic.spec import shipped_specs, spec_schema

    targets: dict[str, Target] = {name: name for name in get_args(Target)}
    if target not in targets:
        raise BadInput(f"--target: {choices(target, targets)}")
    chosen = targets[target]
    if schema:
        print_json(spec_schema())
        return 0
    folder = out or (Path("generated") if specs else shipped_folder())
    controllers: dict[str, dict[str, str]] = {}
    with progress_bar() as progress:
        for path in progress.track(specs or shipped_specs(), description="generating"):
            made = generate_file(path, chosen)
            if made.name in controllers:
                raise BadInput(f"{path}: name: another spec is called '{made.name}' too")
            controllers[made.name] = made.files
            for note in made.notes:
                messages.print(f"{path}: note: {note}")
    change = difference(controllers, folder, complete=not specs)
    if check:
        print(change.unified(), end="")
        state = "stale: run 'clikgen generate'" if change else "up to date"
        messages.print(f"{folder}: {', '.join(controllers)}: {state}")
        return 1 if change else 0
    change.apply()
    for written in change.write:
        messages.print(f"wrote {written}")
    for removed in change.remove:
        messages.print(f"removed {removed}")
    guests = controllers.keys() - {path.stem for path in shipped_specs()}
    if guests and folder.resolve() == shipped_folder().resolve():
        messages.print(
            f"note: {folder} is kept equal to the shipped specs, so that 'clikgen generate' alone will remove "
            f"{', '.join(sorted(guests))} again; work in a folder of your own, or give --out"
        )
    if not change:
        messages.print(f"{folder}: {', '.join(controllers)}: up to date, nothing written")
    return 0
