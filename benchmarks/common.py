"""What the benchmarks share: the name of the machine and of its compiler, and time per call."""

import platform
import time
from collections.abc import Callable
from pathlib import Path

from clikgen.runtime.compiler import FLAGS, NATIVE, find_compiler


def machine() -> str:
    """Processor, cores, system and Python."""
    return f"{processor()}, {platform.system()}, Python {platform.python_version()}"


def processor() -> str:
    """The processor's name, family and model, where the system tells them: a virtual machine's name says little."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    first = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in reversed(lines))}
    known = {"cpu family", "model"} <= first.keys()
    kind = f" (family {first['cpu family']}, model {first['model']})" if known else ""
    cores = sum(line.startswith("processor") for line in lines) or "?"
    return f"{first.get('model name', platform.machine())}{kind}, {cores} cores"


def compiler() -> str:
    """The compiler and the flags it is given."""
    return f"{find_compiler().version} {' '.join((*FLAGS, *NATIVE))}"


def per_call(work: Callable[[], object], calls: int) -> float:
    """Nanoseconds per call."""
    start = time.perf_counter_ns()
    work()
    return (time.perf_counter_ns() - start) / calls
