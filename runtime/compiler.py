"""C sources -> shared library, compiled once per user and found again by its content."""

import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from clikgen.runtime.documents import BadInput, make_folder
from clikgen.runtime.manifest import sha256

# -std=c99 and -ffp-contract=off keep results the same whatever the compiler, and CasADi's C equal to its own evaluation
# bit for bit; the -fno-* flags keep calls and branches cheap and change no result. With the last two, loops whose
# iterations do not depend on each other run side by side.
FLAGS = (
    "-std=c99",
    "-O2",
    "-fPIC",
    "-shared",
    "-ffp-contract=off",
    "-fno-semantic-interposition",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fopenmp-simd",
    "-DCLIKGEN_OPENMP",
)

# For what runs here: vectors as wide as this processor has, which change no result, and its FMA, if it has that, for
# the products and sums that the generated text names: machines with FMA give one result, those without another.
NATIVE = ("-O3", "-march=native")


@dataclass(frozen=True, slots=True)
class Compiler:
    """A C compiler: the command that starts it and what identifies it in the cache."""

    command: tuple[str, ...]
    identity: str

    @property
    def version(self) -> str:
        """The first line of `--version`, or what went wrong."""
        outcome = subprocess.run([*self.command, "--version"], capture_output=True, text=True, check=False)
        return (outcome.stdout or outcome.stderr or f"exit code {outcome.returncode}").splitlines()[0]


def available_compilers() -> list[Compiler]:
    """The compilers of this machine, the preferred one first: $CC, cc, gcc, clang, then ziglang from PyPI.

    Raises BadInput when $CC names a program that is not there.
    """
    found = []
    wanted = os.environ.get("CC", "").strip()
    if wanted:
        try:
            command = shlex.split(wanted)
        except ValueError as error:
            raise BadInput(f"$CC: wanted a C compiler, got {wanted!r}: {error}") from None
        if shutil.which(command[0]) is None:
            raise BadInput(f"$CC: wanted a C compiler, got {wanted!r}, which is not on the PATH")
        found.append(command)
    found += [[name] for name in ("cc", "gcc", "clang") if shutil.which(name)]
    compilers = [Compiler(tuple(command), _identity(command)) for command in found]
    if find_spec("ziglang"):
        zig = (sys.executable, "-m", "ziglang", "cc")
        compilers.append(Compiler(zig, f"{zig} {find_spec('ziglang')}"))
    return compilers


def find_compiler() -> Compiler:
    """The preferred compiler; raises BadInput that says what to install when there is none."""
    compilers = available_compilers()
    if not compilers:
        raise BadInput(
            "no C compiler: wanted $CC, cc, gcc or clang on the PATH, or the PyPI package 'clikgen[zig]', found none"
        )
    return compilers[0]


def _identity(command: Sequence[str]) -> str:
    """The command with the file behind it: another compiler under the same name compiles anew."""
    program = Path(shutil.which(command[0]) or command[0]).resolve()
    status = program.stat()
    return f"{shlex.join(command)} {program} {status.st_size} {status.st_mtime_ns}"


def cache_folder() -> Path:
    """Where compiled libraries are kept: $CLIKGEN_CACHE, else the user's cache folder."""
    if own := os.environ.get("CLIKGEN_CACHE"):
        return Path(own).resolve()
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base).resolve() / "clikgen"


def _processor() -> str:
    """What -march=native stands for here: a cache may be shared by machines of other processors."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return f"{platform.machine()} {platform.processor()}"
    first_core, _, _ = info.read_text().partition("\n\n")
    pairs = (line.partition(":") for line in first_core.splitlines())
    return " ".join(f"{key.strip()}:{value}" for key, _, value in pairs if key.strip() in _OF_THE_PROCESSOR)


_OF_THE_PROCESSOR = (  # not: clock frequencies, bugs and whatever else changes from boot to boot
    *("vendor_id", "cpu family", "model", "flags"),
    *("CPU implementer", "CPU architecture", "CPU variant", "CPU part", "Features", "isa"),
)


def library_path(sources: Sequence[Path], compiler: Compiler, extra: Sequence[str] = ()) -> Path:
    """The cached library's place, by the content, the flags, the compiler and, for -march=native, the processor."""
    files = [path for source in sources for path in (source, source.with_suffix(".h")) if path.exists()]
    key = [*(path.read_bytes() for path in files), " ".join((*FLAGS, *extra)).encode(), compiler.identity.encode()]
    if "-march=native" in extra:
        key.append(_processor().encode())
    return cache_folder() / f"{sources[0].stem}-{sha256(b''.join(sha256(part).encode() for part in key))[:24]}.so"


def has_fma(source: Path, compiler: Compiler | None = None) -> bool:
    """Whether a product and a sum in this generated C are rounded once here: that decides the last bits of results.

    Raises BadInput when there is no compiler.
    """
    command = [*(compiler or find_compiler()).command, *FLAGS, *NATIVE, "-E", str(source)]
    return "return fma(" in subprocess.run(command, capture_output=True, text=True, check=False).stdout


def compile_library(sources: Sequence[Path], compiler: Compiler | None = None, extra: Sequence[str] = ()) -> Path:
    """The shared library of the C files, compiled if the cache lacks it; with `extra` flags after FLAGS.

    Two processes may do this at once: each compiles into a file of its own and renames it into place. Raises
    BadInput when there is no compiler, the compiler fails, or the cache cannot be written.
    """
    compiler = compiler or find_compiler()
    library = library_path(sources, compiler, extra)
    if library.exists():
        return library
    make_folder(library.parent)
    try:
        handle, name = tempfile.mkstemp(dir=library.parent, suffix=".so.tmp")
    except OSError as error:
        raise BadInput(f"{library.parent}: cannot write the compiled library: {error.strerror}") from None
    os.close(handle)
    temporary = Path(name)
    try:
        command = [*compiler.command, *FLAGS, *extra, "-o", str(temporary), *map(str, sources), "-lm"]
        outcome = subprocess.run(command, capture_output=True, text=True, check=False)
        if outcome.returncode != 0:
            complaint = next((line for line in outcome.stderr.splitlines() if "error" in line), outcome.stderr)
            raise BadInput(f"{shlex.join(compiler.command)} failed on {sources[0]}: {complaint.strip()}")
        if temporary.stat().st_size == 0:
            raise BadInput(f"{shlex.join(compiler.command)} wrote nothing for {sources[0]}: is it a C compiler?")
        with temporary.open("rb") as written:
            os.fsync(written.fileno())  # a library cut short by a power failure would kill every later run
        temporary.chmod(0o755)
        temporary.replace(library)
    finally:
        temporary.unlink(missing_ok=True)
    return library
