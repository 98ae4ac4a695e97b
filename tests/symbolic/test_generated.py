"""The generated files: what the spec says, the same everywhere, and usable from C and C++ without CasADi."""

import copy
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module

import numpy as np
import pytest

from clikgen.runtime.compiler import FLAGS, NATIVE, available_compilers, find_compiler
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import load_manifest
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import difference, generate, generate_file, shipped_folder
from clikgen.symbolic.spec import ControllerSpec, read_spec, shipped_specs

WARNINGS = ["-Wall", "-Wextra", "-pedantic", "-Werror"]
C_COMPILERS = [compiler.command for compiler in available_compilers()]
CXX_COMPILERS = [(name,) for name in ("c++", "g++", "clang++") if shutil.which(name)]


@pytest.fixture
def altered(planar5_spec_file):
    """A spec made from planar5's by a function that changes its table."""

    def alter(change):
        table = copy.deepcopy(tomllib.loads(planar5_spec_file.read_text()))
        change(table)
        return ControllerSpec.parse(table, "an altered planar5")

    return alter


@pytest.fixture
def written(tmp_path):
    """The folder of a controller generated from a spec."""

    def write(spec, target="c"):
        folder = tmp_path / spec.name
        folder.mkdir()
        for name, text in generate(spec, target).items():
            (folder / name).write_text(text)
        return folder

    return write


# ---- A pure function of the spec ----


@pytest.mark.parametrize("path", shipped_specs(), ids=lambda path: path.stem)
def test_files_on_disk_are_what_the_spec_generates(path):
    made = generate_file(path)
    name, files = made.name, made.files
    assert {file.name for file in (shipped_folder() / name).iterdir()} == set(files)
    for file, text in files.items():
        assert (shipped_folder() / name / file).read_text() == text, f"{file} is stale: run 'clikgen generate'"


def test_every_shipped_controller_has_a_spec():
    controllers = {made.name: made.files for made in map(generate_file, shipped_specs())}
    assert not difference(controllers, shipped_folder(), complete=True)


@pytest.mark.parametrize("seed", ["0", "1", "4242"])
def test_text_depends_neither_on_hash_seed_nor_on_folder(seed, planar5_spec_file, planar5_folder, tmp_path):
    program = (
        "import sys; from pathlib import Path\n"
        "from clikgen.symbolic.generate import generate_file\n"
        "for name, text in generate_file(Path(sys.argv[1])).files.items(): Path(name).write_text(text)"
    )
    environment = os.environ | {"PYTHONHASHSEED": seed, "LC_ALL": "C", "TZ": "Asia/Tokyo"}
    command = [sys.executable, "-X", "utf8", "-c", program, str(planar5_spec_file)]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True)
    names = {"planar5.c", "planar5.h", "planar5_lanes.c", "manifest.json"}
    assert {file.name for file in tmp_path.iterdir()} == names
    for file in tmp_path.iterdir():
        assert file.read_bytes() == (planar5_folder / file.name).read_bytes()


def test_text_names_no_path_and_no_machine(planar5_folder, planar5_spec_file):
    for file in planar5_folder.iterdir():
        text = file.read_text()
        assert str(planar5_spec_file.parent) not in text
        assert str(planar5_folder.parent.parent) not in text
        assert not re.search(r"/(home|work|tmp|usr|root)/", text)


def _longer_forearm(table):
    table["robot"]["frames"][0]["xyz"] = [0.45, 0, 0]


def _longer_upper_arm(table):
    table["robot"]["joints"][4]["xyz"] = [0.55, 0, 0]


@pytest.mark.parametrize("change", [_longer_forearm, _longer_upper_arm], ids=lambda change: change.__name__[1:])
def test_another_link_length_makes_another_c(change, planar5_spec, altered):
    before, after = generate(planar5_spec), generate(altered(change))
    assert before["planar5.c"] != after["planar5.c"]
    assert before["planar5.h"] == after["planar5.h"]
    assert before["manifest.json"] != after["manifest.json"]


def test_another_link_length_moves_the_compiled_tool(altered, written):
    controller = CompiledController.load(written(altered(_longer_upper_arm)))
    np.testing.assert_allclose(controller.kinematics()["tool_position"], [0.2 + 0.55 + 0.4, 0], rtol=1e-15, atol=0)


def _other_gain(table):
    table["tasks"][1]["gain"] = 5.0


def _other_period(table):
    table["period"] = 0.02


def _other_influence_radius(table):
    table["robot"]["points_of_interest"][0]["influence_radius"] = 0.3


@pytest.mark.parametrize(
    "change", [_other_gain, _other_period, _other_influence_radius], ids=lambda change: change.__name__[1:]
)
def test_another_default_leaves_every_expression_as_it_is(change, planar5_spec, altered):
    """What one tunes is an input, so that a sweep never regenerates: only the _defaults helpers differ."""
    before, after = (generate(spec)["planar5.c"] for spec in (planar5_spec, altered(change)))
    assert before != after
    mark = "/* ---- The typed helpers"
    assert before.split(mark)[0] == after.split(mark)[0]


def test_a_comment_in_the_spec_changes_nothing(planar5_spec_file, tmp_path):
    commented = tmp_path / "planar5.toml"
    commented.write_text("# one more comment\n" + planar5_spec_file.read_text())
    assert generate_file(commented) == generate_file(planar5_spec_file)


# ---- From C and from C++ ----


@pytest.mark.parametrize(
    "command",
    [(*command, "-std=c99", "-x", "c") for command in C_COMPILERS]
    + [(*command, "-std=c++11", "-x", "c++") for command in CXX_COMPILERS],
    ids=lambda command: " ".join([command[0].rsplit("/", 1)[-1], command[-1]]),
)
def test_header_compiles_alone_without_a_warning(command, planar5_folder, tmp_path):
    unit = tmp_path / "unit"
    # twice: the include guard has to hold
    unit.write_text('#include "planar5.h"\n#include "planar5.h"\nint main(void) { return PLANAR5_JOINTS - 5; }\n')
    _expect_success([*command, *WARNINGS, f"-I{planar5_folder}", "-fsyntax-only", str(unit)])


@pytest.mark.parametrize("command", C_COMPILERS, ids=lambda command: command[0])
@pytest.mark.parametrize("name", [path.stem for path in shipped_specs()])
def test_source_compiles_as_c99_without_a_warning(command, name, tmp_path):
    # CasADi's calling convention has arguments that a function without memory does not use
    flags = ["-std=c99", *WARNINGS, "-Wno-unused-parameter", "-c", "-o", str(tmp_path / f"{name}.o")]
    _expect_success([*command, *flags, str(shipped_folder() / name / f"{name}.c")])


def _expect_success(command):
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr


MAIN = """
#include <stdio.h>
#include "planar5.h"

static void print(const char *name, const double *values, int count) {
  printf("%s", name);
  for (int i = 0; i < count; ++i) printf(" %a", values[i]);
  printf("\\n");
}

int main(void) {
  planar5_step_input input;
  planar5_step_output output;
  planar5_kinematics_input at;
  planar5_kinematics_output where;
  planar5_step_defaults(&input);
ASSIGNMENTS
  if (planar5_step_call(&input, &output)) return 1;
  for (int i = 0; i < PLANAR5_JOINTS; ++i) at.q[i] = input.q[i];
  if (planar5_kinematics_call(&at, &where)) return 1;
PRINTS
  return 0;
}
"""


def _printed(folder, main, extra):
    """What a program with the C of a folder prints."""
    flags = [flag for flag in FLAGS if flag not in ("-shared", "-fPIC")]
    program, source = main.with_suffix(""), folder / f"{load_manifest(folder).controller}.c"
    _expect_success([*find_compiler().command, *flags, *extra, f"-I{folder}", "-o", program, main, source, "-lm"])
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    return {name: [float.fromhex(value) for value in values] for name, *values in map(str.split, printed.splitlines())}


def _expect_the_numbers_of_python(folder, main, expected, rounding=1e-12):
    """Bit for bit where both have FMA or neither, and one program without it as another."""
    lines = _printed(folder, main, NATIVE)
    for name, array in expected.items():
        values = np.array(lines[name]).reshape(array.shape)
        np.testing.assert_array_equal(values.view(np.uint64), array.view(np.uint64), err_msg=name)
    twice = "-DCLIKGEN_FMA=0"  # rounds a product, and then its sum
    plain = _printed(folder, main, [twice])
    assert plain == _printed(folder, main, [*NATIVE, twice])
    for name, array in expected.items():
        np.testing.assert_allclose(np.reshape(plain[name], array.shape), array, rtol=0, atol=rounding, err_msg=name)


def test_a_c_program_with_the_typed_structs_gets_the_numbers_that_python_gets(
    planar5, planar5_folder, tmp_path, states_near_contact, one_state
):
    """Only the two generated files and libm: no CasADi, no Python."""
    state = one_state(states_near_contact(50, 12), 7)
    given = ["q", "tool_reference", "tool_reference_velocity", "obstacle_center", "obstacle_radius"]
    state = {name: state[name] for name in given} | {"obstacle_count": np.array(3.0)}
    state["obstacle_center"][0] = planar5.kinematics(q=state["q"])["tool_position"] + 0.05
    assignments = [
        f"  input.{name}{''.join(f'[{i}]' for i in index)} = {float(array[index]).hex()};"
        for name, array in state.items()
        for index in np.ndindex(array.shape)
    ]
    expected = dict(planar5.step(**state)) | dict(planar5.kinematics(q=state["q"]))
    assert expected["active"] == 1
    prints = [
        f'  print("{name}", (const double *)&{struct}.{name}, sizeof {struct}.{name} / sizeof(double));'
        for struct, function in (("output", planar5.step), ("where", planar5.kinematics))
        for name in function.outputs
    ]
    main = tmp_path / "main.c"
    main.write_text(MAIN.replace("ASSIGNMENTS", "\n".join(assignments)).replace("PRINTS", "\n".join(prints)))
    _expect_the_numbers_of_python(planar5_folder, main, expected)


@pytest.mark.parametrize("target", ["c", "casadi"])
def test_a_c_program_gets_the_numbers_of_a_step_with_a_barrier_too(target, written, tmp_path):
    """ur6 behind its table, so that the barrier acts: a program that may end early, CasADi's with a workspace."""
    folder = written(read_spec(next(path for path in shipped_specs() if path.stem == "ur6")), target)
    controller = CompiledController.load(folder)
    assert (controller.step.info.sz_w > 0) == (target == "casadi")
    q = np.array([0.3, 0.4, 0.5, -1.0, 0.2, 0.0])
    expected = controller.step(q=q)
    assert expected["barrier_steps"] >= 1
    assignments = [f"  input.q[{i}] = {float(value).hex()};" for i, value in enumerate(q)]
    prints = [
        f'  print("{name}", (const double *)&output.{name}, sizeof output.{name} / sizeof(double));'
        for name in controller.step.outputs
    ]
    text = MAIN.replace("ASSIGNMENTS", "\n".join(assignments)).replace("PRINTS", "\n".join(prints))
    main = tmp_path / "main.c"
    main.write_text(text.replace("planar5", "ur6").replace("PLANAR5", "UR6"))
    _expect_the_numbers_of_python(folder, main, expected, 1e-6)  # rows nearly parallel: ten steps to solve them


def test_every_default_of_the_manifest_is_what_defaults_sets(planar5, planar5_folder, tmp_path):
    info = planar5.step.info
    prints = [
        f'  print("{signal.name}", (const double *)&input.{signal.name}, {signal.size});' for signal in info.inputs
    ]
    main = tmp_path / "main.c"
    main.write_text(MAIN.replace("ASSIGNMENTS", "\n".join(prints)).replace("PRINTS", ""))
    sources = [str(main), str(planar5_folder / "planar5.c")]
    program = str(tmp_path / "main")
    _expect_success([*find_compiler().command, "-std=c99", f"-I{planar5_folder}", "-o", program, *sources, "-lm"])
    printed = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    lines = {name: values for name, *values in map(str.split, printed.splitlines())}
    assert set(lines) == set(planar5.step.inputs)
    for signal in info.inputs:
        default = signal.default if signal.role == "parameter" else (0.0,) * signal.size
        assert tuple(map(float.fromhex, lines[signal.name])) == default, signal.name


# ---- Other robots than planar5 ----


def _without_obstacles(table):
    table["tasks"] = table["tasks"][1:]
    table["obstacles"]["maximum"] = 0


def _with_one_point_of_interest(table):
    table["robot"]["points_of_interest"] = table["robot"]["points_of_interest"][:1]


def _with_one_joint(table):
    table["robot"]["joints"] = table["robot"]["joints"][2:3]
    table["robot"]["frames"][0]["link"] = "base"
    _with_one_point_of_interest(table)


def _with_one_obstacle(table):
    table["obstacles"]["maximum"] = 1


def _with_sliding_joints_only(table):
    _without_obstacles(table)
    table["robot"]["joints"] = table["robot"]["joints"][:2]
    table["robot"]["frames"][0]["link"] = "slide_y"
    table["robot"]["points_of_interest"] = []


def _in_space(table):
    table["robot"]["space"] = "spatial"


def _tracking_first(table):
    table["tasks"].reverse()


VARIANTS = [
    _without_obstacles,
    _with_one_point_of_interest,
    _with_one_joint,
    _with_one_obstacle,
    _with_sliding_joints_only,
    _in_space,
    _tracking_first,
]
variants = pytest.mark.parametrize("change", VARIANTS, ids=lambda change: change.__name__[1:])


@variants
def test_a_variant_compiles_loads_and_steps(change, altered, written):
    controller = CompiledController.load(written(altered(change)))
    for function in (controller.kinematics, controller.jacobians, controller.step):
        for array in function().values():
            assert np.all(np.isfinite(array))


@variants
def test_a_variants_source_compiles_as_c99_without_a_warning(change, altered, written, tmp_path):
    folder = written(altered(change))
    flags = ["-std=c99", *WARNINGS, "-Wno-unused-parameter", "-c", "-o", str(tmp_path / "variant.o")]
    _expect_success([*find_compiler().command, *flags, str(folder / "planar5.c")])


@variants
def test_a_variants_state_comes_out_in_the_shape_it_goes_in(change, altered, written):
    manifest = load_manifest(written(altered(change)))
    step, n = manifest.function("step"), len(manifest.joints)
    shapes = {signal.name: signal.shape for signal in (*step.inputs, *step.outputs)}
    assert shapes["q"] == shapes["q_next"] == shapes["dq"] == shapes["dq_law"] == (n,)
    if "distance" in shapes:
        assert shapes["distance"] == shapes["influence_radius"] == (len(manifest.points),)


def test_a_controller_without_obstacles_runs_a_scenario(altered, written):
    controller = CompiledController.load(written(altered(_without_obstacles)))
    scenario = read_scenario(find_scenario("paper"))
    parameters = {name: value for name, value in scenario.parameters.items() if name != "obstacles_gain"}
    scenario = scenario.model_copy(update={"obstacles": (), "parameters": parameters})
    rollout = prepare(controller, scenario, CASES[2]).in_c()
    assert not np.any(rollout.active)
    np.testing.assert_array_equal(rollout.signals["lam"], np.ones(len(rollout.t)))


def test_a_controller_without_a_tracking_task_runs_a_scenario(altered, written):
    def only_avoidance(table):
        table["tasks"] = table["tasks"][:1]

    controller = CompiledController.load(written(altered(only_avoidance)))
    scenario = read_scenario(find_scenario("paper"))
    parameters = {name: value for name, value in scenario.parameters.items() if name != "tool_gain"}
    scenario = scenario.model_copy(update={"references": {}, "parameters": parameters})
    rollout = prepare(controller, scenario, CASES[3]).in_c()
    assert rollout.dq.shape == (len(rollout.t), 5)


@pytest.mark.parametrize("description", ["a */ b", "a /* b", "two\nlines", "ends in a backslash \\", 'a "quote"'])
def test_any_description_gives_c_that_compiles_without_a_warning(description, altered, written, tmp_path):
    folder = written(altered(lambda table: table.update(description=description)))
    flags = ["-std=c99", *WARNINGS, "-Wno-unused-parameter", "-c", "-o", str(tmp_path / "described.o")]
    _expect_success([*find_compiler().command, *flags, str(folder / "planar5.c")])


def _expect_finite_step_or_bad_input(name, make):
    """`make` returns the folder of a controller that works, or says in one line what is wrong with the name."""
    try:
        folder = make()
    except BadInput as error:
        complaint = str(error)
    else:
        complaint = ""
        assert np.all(np.isfinite(CompiledController.load(folder).step()["dq"]))
    assert not complaint or (name in complaint and "\n" not in complaint)


@pytest.mark.parametrize("name", ["point", "obstacle", "filter", "q", "lam", "period", "int", "two__lines", "end_"])
def test_any_task_name_gives_a_controller_or_a_bad_input(name, altered, written):
    """Task names become parts of C names: what collides has to be told."""
    _expect_finite_step_or_bad_input(name, lambda: written(altered(lambda table: table["tasks"][1].update(name=name))))


@pytest.mark.parametrize("name", ["int", "casadi", "rollout", "two__lines", "end_", "step", "x" * 40])
def test_any_controller_name_gives_a_controller_or_a_bad_input(name, altered, written):
    _expect_finite_step_or_bad_input(name, lambda: written(altered(lambda table: table.update(name=name))))


def test_generated_code_is_independent_of_casadi(planar5_folder):
    """Nothing but the C standard library is included."""
    for file in ("planar5.c", "planar5.h"):
        includes = re.findall(r"^\s*#\s*include\s*(\S+)", (planar5_folder / file).read_text(), flags=re.MULTILINE)
        assert set(includes) <= {"<math.h>", "<stdint.h>", '"planar5.h"'}


def test_the_manifest_names_the_casadi_that_generated_it(planar5_manifest):
    assert planar5_manifest.casadi == import_module("casadi").__version__
