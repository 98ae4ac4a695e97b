"""A generated controller, compiled and callable: shapes checked, buffers made once."""

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn, Self

import cffi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clikgen.runtime.compiler import NATIVE, Compiler, compile_library, find_compiler, library_path
from clikgen.runtime.documents import BadInput, choices
from clikgen.runtime.extension import NoExtension, called_in_c
from clikgen.runtime.manifest import FunctionInfo, Manifest, SignalInfo, load_manifest

Array = NDArray[np.float64]

_ffi = cffi.FFI()
_ffi.cdef("""
typedef struct { void *function; const double **arg; double **res; long long *iw; double *w; } clikgen_evaluation;
typedef struct { double **pointer; long long stride; } clikgen_walk;
""")
_FUNCTION = "int {}(const double **, double **, long long *, double *, int);"  # CasADi's calling convention
_CALLS = """
int clikgen_evaluate(const clikgen_evaluation *);
int clikgen_repeat(const clikgen_evaluation *, long long, const clikgen_walk *, int);
"""


class CompiledFunction:
    """One generated function with its own buffers.

    `inputs` and `outputs` are arrays in the shapes of the manifest that stay the same from call to call: copy what
    has to outlive the next one. Arrays of doubles in those shapes are taken fastest. `code` is the library it is in.
    """

    __slots__ = ("_binding", "_kept", "_own", "code", "info", "inputs", "outputs")

    def __init__(self, info: FunctionInfo, library: Any) -> None:
        self.info = info
        self.code = library
        self.inputs = MappingProxyType({sys.intern(signal.name): _buffer(signal) for signal in info.inputs})
        self.outputs = MappingProxyType({signal.name: _buffer(signal) for signal in info.outputs})
        self._own, self._kept = self._evaluation(self.inputs, self.outputs)
        addresses = (_address(library.clikgen_evaluate), _address(self._own))
        self._binding = (tuple(self.inputs), tuple(self.inputs.values()), self.outputs, *addresses)
        self._bind(self._binding)

    def __call__(self, **values: ArrayLike) -> Mapping[str, Array]:
        """Evaluate once, after copying `values` into the inputs they name; an input not named keeps its value.

        Raises ValueError for an unknown name or a shape other than the manifest's: a scalar would otherwise
        fill a whole vector in silence.
        """
        for name, value in values.items():
            self._write(name, value)
        if failed := self.code.clikgen_evaluate(self._own):
            self._fail(failed)
        return self.outputs

    def _write(self, name: str, value: ArrayLike) -> None:
        """Copy a value into the input of that name; raises ValueError."""
        if name not in self.inputs:
            raise ValueError(f"{self.info.symbol}: no input '{name}'; {choices(name, self.inputs)}")
        buffer, array = self.inputs[name], np.asarray(value)
        if array.shape != buffer.shape:
            raise ValueError(f"{name} must have shape {buffer.shape} for {self.info.symbol}, got {array.shape}")
        buffer[...] = array

    def _fail(self, result: int) -> NoReturn:
        raise RuntimeError(f"{self.info.symbol} returned {result}")

    def _bind(self, binding: tuple[Any, ...]) -> None:
        """Where the call is in C, it takes from this all it needs; here there is no use for it."""

    @property
    def pointer(self) -> Any:
        """The C function itself, in CasADi's calling convention, for other C to call."""
        return _ffi.cast("void *", getattr(self.code, self.info.symbol))

    def with_own_buffers(self) -> "CompiledFunction":
        """The same function with other buffers, at their defaults."""
        return type(self)(self.info, self.code)

    def map(self, count: int, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """`count` independent evaluations inside compiled C.

        Each value is a constant in its input's shape or one per evaluation, (count, *shape); inputs not named
        have their defaults. Returns every output, (count, *shape). Raises BadInput for an unknown name and
        ValueError for another shape.
        """
        inputs = self._arrays(count, values)
        outputs = {signal.name: np.empty((count, *signal.shape)) for signal in self.info.outputs}
        self._repeat(count, inputs, outputs)
        return outputs

    def _arrays(self, count: int, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """An array for every input, checked."""
        for name in values:
            self.info.input(name)
        arrays = {}
        for signal in self.info.inputs:
            array = np.asarray(values.get(signal.name, _buffer(signal)), dtype=np.float64, order="C")
            if array.shape not in (signal.shape, (count, *signal.shape)):
                raise ValueError(
                    f"{signal.name} must have shape {signal.shape} or {(count, *signal.shape)}, got {array.shape}"
                )
            arrays[signal.name] = array
        return arrays

    def _repeat(self, count: int, inputs: Mapping[str, Array], outputs: Mapping[str, Array]) -> None:
        """`count` evaluations in C, each signal's array walked by its own stride."""
        evaluation, kept = self._evaluation(inputs, outputs)
        strides = [_stride(signal, inputs[signal.name]) for signal in self.info.inputs]
        tables = ((evaluation.arg, strides), (evaluation.res, [signal.size for signal in self.info.outputs]))
        walks = [
            (_ffi.cast("double **", table + i), stride)
            for table, strides in tables
            for i, stride in enumerate(strides)
            if stride
        ]
        failed = self.code.clikgen_repeat(evaluation, count, _ffi.new("clikgen_walk[]", walks), len(walks))
        del kept  # held until here: C reads through it
        if failed:
            self._fail(failed)

    def _evaluation(self, inputs: Mapping[str, Array], outputs: Mapping[str, Array]) -> tuple[Any, Any]:
        """The function with these buffers, as C wants it, and the tables and room that have to outlive its use."""
        arg = _ffi.new("const double *[]", _pointers(inputs, self.info.sz_arg))
        res = _ffi.new("double *[]", _pointers(outputs, self.info.sz_res))
        iw, w = _ffi.new("long long[]", max(self.info.sz_iw, 1)), _ffi.new("double[]", max(self.info.sz_w, 1))
        evaluation = {"function": self.pointer, "arg": arg, "res": res, "iw": iw, "w": w}
        return _ffi.new("clikgen_evaluation *", evaluation), (arg, res, iw, w)


def load_library(path: Path, symbols: Iterable[str]) -> Any:
    """The generated functions of these names in a shared library that has calls.c; raises BadInput."""
    ffi = cffi.FFI()
    ffi.include(_ffi)
    ffi.cdef(_CALLS + "".join(map(_FUNCTION.format, symbols)))
    try:
        return ffi.dlopen(str(path))
    except OSError as error:
        raise BadInput(f"{path}: cannot be loaded, delete it to compile anew: {error}") from None


@cache
def function_class() -> type[CompiledFunction]:
    """CompiledFunction, called in C where that can be."""
    try:
        return called_in_c(CompiledFunction)
    except NoExtension:
        return CompiledFunction


def _address(pointer: Any) -> int:
    return int(_ffi.cast("uintptr_t", pointer))


def _buffer(signal: SignalInfo) -> Array:
    return np.array(signal.default or [0.0] * signal.size).reshape(signal.shape)


def _pointers(buffers: Mapping[str, Array], length: int) -> list[Any]:
    # plain addresses: the arrays are kept by whoever made them, and buffers of cffi have crashed in garbage collection
    pointers = [_ffi.cast("double *", buffer.ctypes.data) for buffer in buffers.values()]
    return pointers + [_ffi.NULL] * (length - len(pointers))


@dataclass(frozen=True, slots=True, eq=False)
class CompiledController:
    """The functions of a generated controller: `kinematics`, `jacobians` and `step`.

    `folder` holds the files it was compiled from, `compiler` is the one that was asked for, None for the preferred.
    """

    manifest: Manifest
    kinematics: CompiledFunction
    jacobians: CompiledFunction
    step: CompiledFunction
    folder: Path
    compiler: Compiler | None

    @classmethod
    def load(cls, name_or_folder: str | Path, compiler: Compiler | None = None) -> Self:
        """The controller that ships under a name, or the one in a folder, compiled if the cache lacks it.

        Raises BadInput when it is not there, its files do not belong together, or it cannot be compiled.
        """
        folder = find_controller(name_or_folder)
        manifest = load_manifest(folder)
        if manifest.target == "float":
            raise BadInput(f"{folder}: wanted a controller in double, got one of --target float, for C alone")
        path = compile_library(_sources(folder, manifest), compiler, NATIVE)
        library, function = load_library(path, [info.symbol for info in manifest.functions]), function_class()
        functions = {info.name: function(info, library) for info in manifest.functions}
        kinematics, jacobians, step = (functions[name] for name in ("kinematics", "jacobians", "step"))
        return cls(manifest, kinematics, jacobians, step, folder.resolve(), compiler)

    def rollout(self, steps: int, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """`steps` periods inside compiled C.

        Each value is a constant in its input's shape or an array over time, (steps, *shape); a state is where
        the rollout starts, and inputs not named have their defaults. Returns every output over time, shape
        (steps, *shape), and every state by the name of its input, shape (steps + 1, *shape).
        """
        inputs, outputs = self._rollout_arrays(steps, values)
        self.step._repeat(steps, inputs, outputs)
        return self._named(inputs, outputs)

    def rollout_stepwise(self, steps: int, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """The same as `rollout`, one call from Python per period: equal bit for bit."""
        signals, step = self.stepper(steps, values)
        for k in range(steps):
            step(k)
        return signals

    def stepper(self, steps: int, values: Mapping[str, ArrayLike]) -> tuple[dict[str, Array], Callable[[int], None]]:
        """The arrays `rollout` would return, still empty, and the function that fills in period k.

        Call it for k = 0 .. steps−1 in this order: each period goes on from the state before.
        """
        inputs, outputs = self._rollout_arrays(steps, values)
        evaluate = self.step.with_own_buffers()
        varying = {}
        for signal in self.step.info.inputs:
            array = inputs[signal.name]
            if _stride(signal, array):
                varying[signal.name] = array
            else:
                evaluate.inputs[signal.name][...] = array

        def step(k: int) -> None:
            results = evaluate(**{name: array[k] for name, array in varying.items()})
            for name, array in outputs.items():
                array[k] = results[name]

        return self._named(inputs, outputs), step

    def _rollout_arrays(self, steps: int, values: Mapping[str, ArrayLike]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Arrays for every input and output; a state is one array, its output a view one period further."""
        info = self.step.info
        fed = {signal.feeds: signal.name for signal in info.outputs if signal.feeds}
        inputs = self.step._arrays(steps, values)
        outputs = {signal.name: np.empty((steps, *signal.shape)) for signal in info.outputs if not signal.feeds}
        for state, output in fed.items():
            start = inputs[state]
            if start.shape != info.input(state).shape:
                raise ValueError(f"{state} is a state: it must have shape {info.input(state).shape}, got {start.shape}")
            history = np.empty((steps + 1, *start.shape))
            history[0] = start
            inputs[state], outputs[output] = history, history[1:]
        return inputs, {signal.name: outputs[signal.name] for signal in info.outputs}

    def _named(self, inputs: dict[str, Array], outputs: dict[str, Array]) -> dict[str, Array]:
        states = {signal.name: signal.feeds for signal in self.step.info.outputs if signal.feeds}
        named = {name: array for name, array in outputs.items() if name not in states}
        return {**{state: inputs[state] for state in states.values()}, **named}


def _stride(signal: SignalInfo, array: Array) -> int:
    return 0 if array.shape == signal.shape else signal.size


def _sources(folder: Path, manifest: Manifest) -> list[Path]:
    return [folder / f"{manifest.controller}.c", Path(str(resources.files(__package__))) / "calls.c"]


def is_compiled(folder: Path) -> bool:
    """Whether the cache holds the controller of this folder, for the compiler in use; raises BadInput."""
    return library_path(_sources(folder, load_manifest(folder)), find_compiler(), NATIVE).exists()


def find_controller(name_or_folder: str | Path) -> Path:
    """The folder of a generated controller: a folder as given, else ./generated/NAME, else the shipped NAME.

    Raises BadInput with the names that are there.
    """
    given = Path(name_or_folder)
    candidates = (
        [given] if given.is_absolute() or len(given.parts) > 1 else [folder / given for folder in controller_folders()]
    )
    for folder in candidates:
        if (folder / "manifest.json").is_file():
            return folder
    names = {path.parent.name for folder in controller_folders() for path in folder.glob("*/manifest.json")}
    raise BadInput(f"no generated controller '{name_or_folder}'; {choices(str(name_or_folder), names)}")


def controller_folders() -> list[Path]:
    """Where generated controllers are looked for, in order."""
    return [Path("generated"), Path(str(resources.files("clikgen.generated")))]
