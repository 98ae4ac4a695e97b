"""What clikgen needs of a machine, tried out."""

import platform
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata

from clikgen.runtime.compiler import available_compilers, cache_folder, has_fma
from clikgen.runtime.controller import CompiledController, CompiledFunction
from clikgen.runtime.documents import BadInput, write_atomically
from clikgen.runtime.extension import NoExtension, called_in_c


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was tried: what was found, whether it works, and what to do if not."""

    what: str
    found: str
    works: bool
    advice: str = ""


def checkup() -> list[Finding]:
    """Python and package versions, the compilers, the cache, and a controller compiled and stepped."""
    return [*_versions(), *_compilers(), _cache(), _step(), _call()]


def _versions() -> Iterator[Finding]:
    yield Finding("python", platform.python_version(), True)
    for package in ("clikgen", "casadi", "numpy", "scipy", "cffi", "matplotlib"):
        yield Finding(package, metadata.version(package), True)


def _compilers() -> Iterator[Finding]:
    try:
        compilers = available_compilers()
    except BadInput as error:
        yield Finding("compiler", str(error), False, "set CC to a C compiler, or unset it")
        return
    if not compilers:
        yield Finding("compiler", "none", False, "install gcc or clang, or: pip install 'clikgen[zig]'")
    for i, compiler in enumerate(compilers):
        yield Finding(
            "compiler, used" if i == 0 else "compiler", f"{' '.join(compiler.command)}: {compiler.version}", True
        )


def _cache() -> Finding:
    folder = cache_folder()
    try:
        write_atomically(folder / "checkup", b"")
        (folder / "checkup").unlink()
    except BadInput as error:
        return Finding("cache", str(error), False, "set CLIKGEN_CACHE to a folder you can write to")
    libraries = list(folder.glob("*.so"))
    return Finding("cache", f"{folder}: {len(libraries)} compiled", True)


def _step() -> Finding:
    try:
        controller = CompiledController.load("planar5")
    except BadInput as error:
        return Finding("planar5", str(error), False, "see the lines above")
    lam = controller.step()["lam"]
    fma = "with" if has_fma(controller.folder / "planar5.c", controller.compiler) else "without"
    return Finding("planar5", f"compiled {fma} FMA, loaded and stepped (λ = {float(lam):g})", True)


def _call() -> Finding:
    """A call in Python works as well, at ten times the cost."""
    try:
        called_in_c(CompiledFunction)
    except NoExtension as error:
        return Finding("calls", f"in Python, which is slower: {error}", True)
    return Finding("calls", "in C, built with this Python's headers", True)
