"""A call from Python: in C where Python's headers are, in Python elsewhere, and the same either way."""

import gc
import sys
import sysconfig

import cffi
import numpy as np
import pytest

from clikgen.runtime import controller as module
from clikgen.runtime.controller import CompiledController, CompiledFunction, function_class
from clikgen.runtime.extension import NoExtension, called_in_c


@pytest.fixture
def in_c():
    """The class that is called in C, which wants Python's headers."""
    try:
        return called_in_c(CompiledFunction)
    except NoExtension as error:
        pytest.skip(str(error))


@pytest.fixture(params=["in Python", "in C"])
def step(request, planar5):
    """planar5's step, called either way."""
    kind = CompiledFunction if request.param == "in Python" else request.getfixturevalue("in_c")
    return kind(planar5.step.info, planar5.step.code)


def _somewhere(step, seed=0):
    random = np.random.default_rng(seed)
    return {name: buffer + 0.1 * random.standard_normal(buffer.shape) for name, buffer in step.inputs.items()}


def test_a_controller_is_called_in_c(in_c, planar5):
    for function in (planar5.kinematics, planar5.jacobians, planar5.step):
        assert type(function) is function_class()
        assert isinstance(function, CompiledFunction)
    assert in_c.__call__ is not CompiledFunction.__call__
    assert function_class().__call__ is not CompiledFunction.__call__


@pytest.mark.parametrize("seed", range(5))
def test_a_call_gives_what_the_loop_in_c_gives(step, seed):
    values = _somewhere(step, seed)
    expected = step.map(1, values)
    found = step(**values)
    assert found is step.outputs
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value[0])


def test_an_input_not_named_keeps_its_value(step):
    values = _somewhere(step)
    step(**values)
    q = values["q"] + 0.2
    found = {name: value.copy() for name, value in step(q=q).items()}
    for name, value in step.map(1, {**values, "q": q}).items():
        np.testing.assert_array_equal(found[name], value[0])
    for name, value in step().items():
        np.testing.assert_array_equal(found[name], value)


@pytest.mark.parametrize(
    "given",
    [
        pytest.param([0.1, 0.2, 0.3, 0.4, 0.5], id="a list"),
        pytest.param((0.1, 0.2, 0.3, 0.4, 0.5), id="a tuple"),
        pytest.param(np.repeat([0.1, 0.2, 0.3, 0.4, 0.5], 2)[::2], id="every second"),
        pytest.param(np.array([0.5, 0.4, 0.3, 0.2, 0.1])[::-1], id="backwards"),
        pytest.param(np.array([0.1, 0.2, 0.3, 0.4, 0.5], dtype=">f8"), id="the other byte order"),
        pytest.param(np.array([0.1, 0.2, 0.3, 0.4, 0.5]).view(np.recarray), id="a subclass"),
        pytest.param(np.frombuffer(b"\0" + np.array([0.1, 0.2, 0.3, 0.4, 0.5]).tobytes(), "f8", offset=1), id="odd"),
    ],
)
def test_whatever_numpy_makes_an_array_of_is_taken(step, given):
    step(q=given)
    np.testing.assert_array_equal(step.inputs["q"], [0.1, 0.2, 0.3, 0.4, 0.5])


@pytest.mark.parametrize("kind", [np.float32, np.int64, np.int8, bool])
def test_other_numbers_are_converted_not_read_as_doubles(step, kind):
    given = np.array([0, 1, 0, 1, 1], dtype=kind)
    step(q=given)
    np.testing.assert_array_equal(step.inputs["q"], given.astype(float))


@pytest.mark.parametrize("period", [0.004, 1, np.float64(0.004), np.array(0.004), np.float32(0.5)])
def test_a_scalar_is_taken_as_a_number_of_any_kind(step, period):
    step(period=period)
    assert step.inputs["period"] == period


def test_a_matrix_is_taken_row_by_row(step):
    centers = np.arange(6.0).reshape(3, 2)
    step(obstacle_center=np.asfortranarray(centers))
    np.testing.assert_array_equal(step.inputs["obstacle_center"], centers)
    step(obstacle_center=centers + 1)
    np.testing.assert_array_equal(step.inputs["obstacle_center"], centers + 1)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"q": np.zeros(4)}, r"q must have shape \(5,\) for planar5_step, got \(4,\)"),
        ({"q": np.zeros((5, 1))}, r"q must have shape \(5,\) for planar5_step, got \(5, 1\)"),
        ({"q": 0.0}, r"q must have shape \(5,\) for planar5_step, got \(\)"),
        ({"q": None}, r"q must have shape \(5,\)"),
        ({"period": np.zeros(1)}, r"period must have shape \(\) for planar5_step, got \(1,\)"),
        ({"obstacle_center": np.zeros(6)}, r"obstacle_center must have shape \(3, 2\) for planar5_step, got \(6,\)"),
        ({"obstacle_center": np.zeros((2, 3))}, r"obstacle_center must have shape \(3, 2\).*got \(2, 3\)"),
        ({"q": ["a"] * 5}, "could not convert string to float"),
        ({"perod": 0.002}, "planar5_step: no input 'perod'; did you mean 'period'"),
        ({"dq": np.zeros(5)}, "planar5_step: no input 'dq'; did you mean 'q'"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_of_it_written(step, given, said):
    step(**_somewhere(step))
    before = {name: value.copy() for name, value in step.inputs.items()}
    with pytest.raises(ValueError, match=said):
        step(**given)
    for name, value in step.inputs.items():
        np.testing.assert_array_equal(value, before[name])


def test_a_position_says_nothing(step):
    with pytest.raises(TypeError):
        step(np.zeros(5))


def test_names_made_at_run_time_are_found(step):
    name = "".join(["tool", "_", "reference"])
    assert name is not sys.intern(name)
    step(**{name: np.array([0.7, 0.9])})
    np.testing.assert_array_equal(step.inputs["tool_reference"], [0.7, 0.9])


def test_an_output_and_an_input_may_be_what_the_next_call_takes(step):
    q = step()["q_next"]
    expected = q.copy()
    step(q=q)
    np.testing.assert_array_equal(step.inputs["q"], expected)
    step(q=step.inputs["q"])
    np.testing.assert_array_equal(step.inputs["q"], expected)


def test_a_result_other_than_zero_is_an_error(step):
    class Failing:
        def __init__(self):
            ffi = cffi.FFI()
            self.clikgen_evaluate = ffi.callback("int(void *)", lambda _: 7)
            self.planar5_step = ffi.NULL

    failing = type(step)(step.info, Failing())
    with pytest.raises(RuntimeError, match="planar5_step returned 7"):
        failing(q=np.zeros(5))


def test_calls_and_functions_leave_nothing_behind(step):
    q = np.zeros(5)
    step(q=q)
    held = sys.getrefcount(q), sys.getrefcount(step.outputs)
    for _ in range(1000):
        step(q=q)
        with pytest.raises(ValueError, match="shape"):
            step(q=q[1:])
    assert (sys.getrefcount(q), sys.getrefcount(step.outputs)) == held
    step.with_own_buffers()
    gc.collect()
    count = len(gc.get_objects())
    for _ in range(100):
        step.with_own_buffers()(q=q)
    gc.collect()
    assert len(gc.get_objects()) < count + 50


def test_functions_have_buffers_of_their_own(step):
    other = step.with_own_buffers()
    assert type(other) is type(step)
    other(q=np.ones(5))
    assert not np.array_equal(step.inputs["q"], np.ones(5))
    q_next = other.outputs["q_next"]
    expected = q_next.copy()
    del other
    gc.collect()
    np.testing.assert_array_equal(q_next, expected)  # an array outlives its function


def test_without_headers_calls_are_in_python(planar5_folder, tmp_path, monkeypatch):
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path / name))
    with pytest.raises(NoExtension, match=r"include has no Python\.h"):
        called_in_c(CompiledFunction)
    module.function_class.cache_clear()
    try:
        step = CompiledController.load(planar5_folder).step
    finally:
        module.function_class.cache_clear()
    assert type(step) is CompiledFunction
    assert step(q=np.ones(5))["q_next"].shape == (5,)


def test_headers_that_do_not_compile_are_no_headers(tmp_path, monkeypatch):
    (tmp_path / "Python.h").write_text("#error of another world\n")
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    with pytest.raises(NoExtension, match="of another world"):
        called_in_c(CompiledFunction)


def test_a_library_that_cannot_be_loaded_is_no_extension(tmp_path, monkeypatch):
    (tmp_path / "extension.so").write_bytes(b"nothing")
    monkeypatch.setattr("clikgen.runtime.extension.compile_library", lambda *_, **__: tmp_path / "extension.so")
    with pytest.raises(NoExtension):
        called_in_c(CompiledFunction)
