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
    """The processor's name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    name = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())
    return f"{name}, {sum(line.startswith('processor') for line in lines) or '?'} cores"


def compiler() -> str:
    """The compiler and the flags it is given."""
    return f"{find_compiler().version} {' '.join((*FLAGS, *NATIVE))}"


def per_call(work: Callable[[], object], calls: int) -> float:
    """Nanoseconds per call."""
    start = time.perf_counter_ns()
    work()
    return (time.perf_counter_ns() - start) / calls
