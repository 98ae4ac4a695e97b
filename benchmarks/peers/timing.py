"""How a candidate is timed: along a part of the path as a whole, or call by call, or in states at random.

What the loop around it takes in Python is not its own: a function that does nothing is timed in its place and taken
off.
"""

import json
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter_ns
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Items = Sequence[tuple[Array, ...]]
VISITED = 256  # states at random in Python, per round
ANSWER = "answer: "  # what a helper's line begins with
IDLE: dict[int, Callable[..., Array]] = {
    2: lambda q, a: q,
    3: lambda q, a, b: q,
    4: lambda q, a, b, c: q,
    5: lambda q, a, b, c, d: q,
}
"""Functions of so many arguments that do nothing: what the loop around a step in Python takes is measured with them."""


class Runner(Protocol):
    """Something that can be taken along the path."""

    def along(self, first: int, last: int, laps: int) -> int:
        """Nanoseconds that `laps` times the steps first .. last−1 take, from our path's q at `first` on."""

    def each(self, first: int, last: int) -> list[int]:
        """Nanoseconds of each of these steps, the clock's own and the loop's taken off."""

    def way(self) -> Array:
        """Where it is after each step of the whole path, (count, n)."""


class Function:
    """A step as a function of q and of what else is given; it returns the next q."""

    def __init__(self, step: Callable[..., Array], q: Array, items: Items) -> None:
        self.step, self.q, self.items = step, q, items
        self.idle = IDLE[1 + len(items[0])]

    def along(self, first: int, last: int, laps: int) -> int:
        return self._along(self.step, first, last, laps) - self._along(self.idle, first, last, laps)

    def each(self, first: int, last: int) -> list[int]:
        return without_loop(self._each(self.step, first, last), self._each(self.idle, first, last))

    def visit(self) -> float:
        """Nanoseconds per step where every step has a q of its own; of the first VISITED."""
        visits = list(zip(self.q, self.items, strict=True))[:VISITED]
        return (_visited(self.step, visits) - _visited(self.idle, visits)) / len(visits)

    def way(self) -> Array:
        q, found = self.q[0], []
        for item in self.items:
            q = self.step(q, *item)
            found.append(np.array(q))
        return np.array(found)

    def _along(self, step: Callable[..., Array], first: int, last: int, laps: int) -> int:
        items, total = self.items[first:last], 0
        for _ in range(laps):
            q = self.q[first]
            start = perf_counter_ns()
            for item in items:
                q = step(q, *item)
            total += perf_counter_ns() - start
        return total

    def _each(self, step: Callable[..., Array], first: int, last: int) -> list[int]:
        q, ns = self.q[first], []
        for item in self.items[first:last]:
            start = perf_counter_ns()
            q = step(q, *item)
            ns.append(perf_counter_ns() - start)
        return ns


def _visited(step: Callable[..., Array], visits: Sequence[tuple[Array, tuple[Array, ...]]]) -> int:
    start = perf_counter_ns()
    for q, item in visits:
        step(q, *item)
    return perf_counter_ns() - start


class Stateful:
    """A library that knows where it is: `start(q)`, then `advance(*item)` once a period."""

    def __init__(self, solver: Any, q: Array, items: Items) -> None:
        self.solver, self.q, self.items = solver, q, items
        self.idle = IDLE[len(items[0])]

    def along(self, first: int, last: int, laps: int) -> int:
        return self._along(self.solver.advance, first, last, laps) - self._along(self.idle, first, last, laps)

    def each(self, first: int, last: int) -> list[int]:
        return without_loop(self._each(self.solver.advance, first, last), self._each(self.idle, first, last))

    def way(self) -> Array:
        self.solver.start(self.q[0])
        found = []
        for item in self.items:
            self.solver.advance(*item)
            found.append(np.array(self.solver.q))
        return np.array(found)

    def _along(self, advance: Callable[..., object], first: int, last: int, laps: int) -> int:
        items, total = self.items[first:last], 0
        for _ in range(laps):
            self.solver.start(self.q[first])
            start = perf_counter_ns()
            for item in items:
                advance(*item)
            total += perf_counter_ns() - start
        return total

    def _each(self, advance: Callable[..., object], first: int, last: int) -> list[int]:
        ns = []
        self.solver.start(self.q[first])
        for item in self.items[first:last]:
            start = perf_counter_ns()
            advance(*item)
            ns.append(perf_counter_ns() - start)
        return ns


class Remote:
    """A `Stateful` in a process of another environment, asked over a pipe; it keeps its own time."""

    def __init__(self, python: Path, name: str, setup: str, path: Path) -> None:
        command = [str(python), "-m", "peers.helper", name, setup, str(path)]
        where = Path(__file__).parents[1]
        self.process = subprocess.Popen(
            command, cwd=where, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._answer()

    def along(self, first: int, last: int, laps: int) -> int:
        return self._ask("along", first, last, laps)

    def each(self, first: int, last: int) -> list[int]:
        return self._ask("each", first, last)

    def way(self) -> Array:
        return np.array(self._ask("way"))

    def close(self) -> None:
        self.process.communicate()

    def _ask(self, call: str, *arguments: int) -> Any:
        assert self.process.stdin is not None
        print(json.dumps({"call": call, "arguments": arguments}), file=self.process.stdin, flush=True)
        return self._answer()

    def _answer(self) -> Any:
        """Of the next line that is one: a library may print on its own account. Raises RuntimeError with the last."""
        assert self.process.stdout is not None
        line = ""
        for line in self.process.stdout:
            if line.startswith(ANSWER):
                return json.loads(line.removeprefix(ANSWER))
        raise RuntimeError(line.strip())


def without_loop(ns: Sequence[int], idle: Sequence[int]) -> list[int]:
    """Without what the clock and a call that does nothing take."""
    common = int(np.median(idle))
    return [max(one - common, 0) for one in ns]
