"""CasADi's C and CasADi's own evaluation agree in every bit; ours is compared with both in test_emitter."""

import casadi as ca
import numpy as np
import pytest

from clikgen.runtime.controller import CompiledController
from clikgen.symbolic.generate import generate

STATES = 10_000


@pytest.fixture(scope="module")
def by_casadi(planar5_spec, tmp_path_factory):
    """planar5 as CasADi's own generator writes it, compiled."""
    folder = tmp_path_factory.mktemp("casadi")
    for name, text in generate(planar5_spec, "casadi").items():
        (folder / name).write_text(text)
    return CompiledController.load(folder)


@pytest.mark.parametrize("name", ["kinematics", "jacobians", "step"])
@pytest.mark.parametrize("sampler", ["states_near_contact", "states_within_limits"])
def test_casadi_s_c_equals_casadi_bit_for_bit(name, sampler, request, planar5_casadi, by_casadi):
    """Zeros of either sign differ here, too: the outputs are compared as integers."""
    values = request.getfixturevalue(sampler)(STATES, 7)
    compiled = getattr(by_casadi, name)
    outputs = compiled.map(STATES, {key: value for key, value in values.items() if key in compiled.inputs})
    function = planar5_casadi.function(name)
    columns = [values[function.name_in(i)].reshape(STATES, -1).T for i in range(function.n_in())]
    evaluated = function.map(STATES).call([ca.DM(column) for column in columns])
    assert list(outputs) == function.name_out()
    for array, result in zip(outputs.values(), evaluated, strict=True):
        expected = np.ascontiguousarray(np.array(result).T).reshape(array.shape)
        np.testing.assert_array_equal(array.view(np.uint64), expected.view(np.uint64))


def test_the_states_near_contact_meet_every_branch(evaluate_many, states_near_contact):
    """Otherwise the comparison would prove little."""
    values = states_near_contact(STATES, 7)
    outputs = evaluate_many("step", values)
    count, center = values["obstacle_count"], values["obstacle_center"]
    points = evaluate_many("kinematics", values)["point_position"]
    on_top = np.any(np.all(points[:, :, None] == center[:, None], axis=-1), axis=1)
    present = np.arange(3) < count[:, None]
    assert np.sum(np.any(on_top & present, axis=1)) > 1000
    assert np.sum(count == 3) > 1000
    assert np.sum(count == 0) > 1000
    assert 1000 < np.sum(outputs["active"]) < STATES - 1000
    assert np.sum(outputs["distance"] < 0) > 1000  # inside a disc
    assert np.sum(np.abs(np.sin(values["q"][:, 4])) < 1e-8) > 1000  # the arm stretched or folded
