"""Which compiler is taken, what it makes, and where that is kept."""

import ctypes
import os
import subprocess
import sys
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from clikgen.runtime import compiler as compiler_module
from clikgen.runtime.compiler import (
    NATIVE,
    Compiler,
    available_compilers,
    cache_folder,
    compile_library,
    find_compiler,
    has_fma,
    library_path,
)
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput


@pytest.fixture
def source(tmp_path):
    """A C file with its header, in a folder of its own."""
    folder = tmp_path / "sources"
    folder.mkdir()
    (folder / "answer.h").write_text("int answer(void);\n")
    path = folder / "answer.c"
    path.write_text('#include "answer.h"\nint answer(void) { return 42; }\n')
    return path


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("CLIKGEN_CACHE", str(folder))
    return folder


@pytest.fixture
def programs(tmp_path, monkeypatch):
    """Makes the PATH hold just the programs of these names, and no ziglang or $CC be there."""

    def only(*names):
        folder = tmp_path / "bin"
        folder.mkdir()
        for name in names:
            (folder / name).write_text("#!/bin/sh\n")
            (folder / name).chmod(0o755)
        monkeypatch.setenv("PATH", str(folder))
        monkeypatch.delenv("CC", raising=False)
        monkeypatch.setattr(compiler_module, "find_spec", lambda name: None)
        return folder

    return only


# ---- The search ----


def test_cc_gcc_clang_are_taken_in_this_order(programs):
    programs("clang", "gcc", "cc", "tcc")
    assert [compiler.command for compiler in available_compilers()] == [("cc",), ("gcc",), ("clang",)]
    assert find_compiler().command == ("cc",)


def test_the_variable_cc_comes_first_with_its_arguments(programs, monkeypatch):
    programs("cc", "tcc")
    monkeypatch.setenv("CC", "tcc -m64 '-DNAME=a b'")
    assert [compiler.command for compiler in available_compilers()] == [("tcc", "-m64", "-DNAME=a b"), ("cc",)]


def test_ziglang_comes_last(programs, monkeypatch):
    programs("clang")
    monkeypatch.setattr(compiler_module, "find_spec", lambda name: f"the spec of {name}")
    zig = (sys.executable, "-m", "ziglang", "cc")
    assert [compiler.command for compiler in available_compilers()] == [("clang",), zig]


@pytest.mark.parametrize("nonsense", ["no-such-compiler", "no-such-compiler -O2", "/no/such/cc", "'unbalanced"])
def test_a_cc_that_is_not_there_is_a_bad_input(nonsense, programs, monkeypatch):
    programs("cc")
    monkeypatch.setenv("CC", nonsense)
    with pytest.raises(BadInput, match=r"^\$CC: wanted a C compiler, got .*" + nonsense.strip("'")):
        available_compilers()


@pytest.mark.parametrize("blank", ["", "  "])
def test_a_blank_cc_is_as_none(blank, programs, monkeypatch):
    programs("cc")
    monkeypatch.setenv("CC", blank)
    assert find_compiler().command == ("cc",)


def test_no_compiler_at_all_is_a_bad_input_that_says_what_to_install(programs):
    programs()
    assert available_compilers() == []
    with pytest.raises(BadInput, match=r"no C compiler: wanted \$CC, cc, gcc or clang .*clikgen\[zig\]"):
        find_compiler()


def test_another_program_under_the_same_name_is_another_compiler(programs):
    folder = programs("cc")
    before = find_compiler()
    assert find_compiler() == before
    (folder / "cc").write_text("#!/bin/sh\n# a newer one\n")
    assert find_compiler().identity != before.identity


def test_the_version_is_the_first_line(tmp_path):
    fake = tmp_path / "fakecc"
    fake.write_text("#!/bin/sh\necho fakecc 1.2.3\necho more\n")
    fake.chmod(0o755)
    assert Compiler((str(fake),), "").version == "fakecc 1.2.3"


# ---- The results ----


def _paper_bits(controller):
    """Every output of 300 steps through contact, as integers."""
    t = np.arange(300) * 0.01
    rollout = controller.rollout(
        300,
        {
            "q": np.array([0.0, 0.0, 0.0, 0.6, -1.2]),
            "tool_reference": np.column_stack([0.98 + 0.5 * t, 0.06 + 0.1 * np.sin(t)]),
            "tool_reference_velocity": np.column_stack([np.full(300, 0.5), 0.1 * np.cos(t)]),
            "obstacle_center": np.array([[1.8, 0.05], [0, 5], [0, 5]]),
            "obstacle_count": 1.0,
        },
    )
    assert 10 < np.sum(rollout["active"]) < 290
    return {name: array.view(np.uint64) for name, array in rollout.items()}


def _expect_equal(first, second):
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name], err_msg=name)


@pytest.mark.parametrize("compiler", available_compilers(), ids=lambda compiler: " ".join(compiler.command))
def test_every_compiler_of_this_machine_gives_the_same_bits(compiler, planar5, planar5_folder):
    _expect_equal(_paper_bits(CompiledController.load(planar5_folder, compiler)), _paper_bits(planar5))


@pytest.mark.parametrize("level", ["-O0", "-O1", "-O3"])
def test_every_optimisation_level_gives_the_same_bits(level, planar5, planar5_folder, monkeypatch):
    flags = tuple(level if flag == "-O2" else flag for flag in compiler_module.FLAGS)
    assert flags != compiler_module.FLAGS
    monkeypatch.setattr(compiler_module, "FLAGS", flags)
    _expect_equal(_paper_bits(CompiledController.load(planar5_folder)), _paper_bits(planar5))


# ---- The cache ----


@pytest.mark.parametrize("compiler", available_compilers(), ids=lambda one: one.command[-1])
def test_fma_is_there_where_a_compiled_sum_shows_it(compiler, planar5_folder, tmp_path, monkeypatch):
    generated = planar5_folder / "planar5.c"
    asked = tmp_path / "asked.c"
    asked.write_text(
        generated.read_text() + "\ndouble sum(double a, double b, double c);\n"
        "double sum(double a, double b, double c) { return clikgen_fma(a, b, c); }\n"
    )
    (tmp_path / "planar5.h").write_text((planar5_folder / "planar5.h").read_text())
    for flags in (NATIVE, (*NATIVE, "-DCLIKGEN_FMA=0")):
        monkeypatch.setattr(compiler_module, "NATIVE", flags)
        library = ctypes.CDLL(str(compile_library([asked], compiler, flags)))
        library.sum.restype, library.sum.argtypes = ctypes.c_double, [ctypes.c_double] * 3
        assert has_fma(generated, compiler) == (library.sum(1 / 3, 3.0, -1.0) != 0)
    assert not has_fma(generated, compiler)


def test_a_library_is_compiled_once_and_found_again(source, cache):
    library = compile_library([source])
    assert library.parent == cache
    assert ctypes.CDLL(str(library)).answer() == 42
    stamp = library.stat().st_mtime_ns
    nonsense = Compiler(("false",), find_compiler().identity)  # would fail if it were started
    assert compile_library([source], nonsense) == library
    assert library.stat().st_mtime_ns == stamp


def test_the_key_changes_with_source_header_flags_and_compiler(source, monkeypatch):
    compiler = Compiler(("cc",), "cc 1")
    keys = [library_path([source], compiler)]
    assert library_path([source], compiler) == keys[0]
    source.write_text(source.read_text().replace("42", "43"))
    keys.append(library_path([source], compiler))
    header = source.with_suffix(".h")
    header.write_text(header.read_text() + "\n")
    keys.append(library_path([source], compiler))
    keys.append(library_path([source], Compiler(("cc",), "cc 2")))
    monkeypatch.setattr(compiler_module, "FLAGS", (*compiler_module.FLAGS, "-g"))
    keys.append(library_path([source], compiler))
    other = source.with_name("other.c")
    other.write_text("int other(void) { return 1; }\n")
    keys.append(library_path([source, other], compiler))
    assert len(set(keys)) == len(keys)


def test_the_key_depends_on_content_and_not_on_place(source, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for file in (source, source.with_suffix(".h")):
        (elsewhere / file.name).write_text(file.read_text())
    compiler = Compiler(("cc",), "cc 1")
    assert library_path([source], compiler) == library_path([elsewhere / source.name], compiler)


def test_the_cache_is_where_the_variables_say(monkeypatch):
    monkeypatch.setenv("CLIKGEN_CACHE", "/own/place")
    assert cache_folder() == Path("/own/place")
    monkeypatch.delenv("CLIKGEN_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/xdg")
    assert cache_folder() == Path("/xdg/clikgen")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "clikgen"


@pytest.mark.parametrize("folder", [".", "cache", "deep/cache"])
def test_the_cache_may_be_a_relative_folder(folder, planar5_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CLIKGEN_CACHE", folder)
    assert CompiledController.load(planar5_folder).step()["lam"] == 0
    assert len(list((tmp_path / folder).glob("*.so"))) == 1


def test_a_source_that_does_not_compile_is_one_line_and_leaves_nothing(source, cache):
    source.write_text("int answer(void) { return 42 }\n")
    with pytest.raises(BadInput) as caught:
        compile_library([source])
    message = str(caught.value)
    assert "\n" not in message
    assert str(source) in message
    assert "error" in message
    assert list(cache.iterdir()) == []


def test_a_compiler_that_writes_nothing_is_a_bad_input_and_leaves_nothing(source, cache):
    with pytest.raises(BadInput):
        compile_library([source], Compiler(("true",), "true"))
    assert list(cache.iterdir()) == []


def test_a_cache_that_is_a_file_is_a_bad_input(source, cache):
    cache.write_text("not a folder")
    with pytest.raises(BadInput, match="cache"):
        compile_library([source])


def test_two_processes_compile_into_an_empty_cache_at_once(source, cache, tmp_path):
    """The compiler of each waits until the other has started too, so that they do overlap."""
    meeting = tmp_path / "meeting"
    meeting.mkdir()
    slow = tmp_path / "slow-cc"
    real = " ".join(find_compiler().command)
    slow.write_text(
        "#!/bin/sh\n"
        f'touch "{meeting}/$$"\n'
        f'for i in $(seq 600); do [ $(ls "{meeting}" | wc -l) -ge 2 ] && exec {real} "$@"; sleep 0.05; done\n'
        "exit 1\n"
    )
    slow.chmod(0o755)
    program = (
        "import sys; from pathlib import Path\n"
        "from clikgen.runtime.compiler import compile_library\n"
        "print(compile_library([Path(sys.argv[1])]))"
    )
    environment = os.environ | {"CC": str(slow), "CLIKGEN_CACHE": str(cache)}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", program, str(source)], env=environment, text=True, stdout=subprocess.PIPE
        )
        for _ in range(2)
    ]
    printed = [process.communicate(timeout=60)[0].strip() for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    assert len(list(meeting.iterdir())) == 2
    assert printed[0] == printed[1]
    assert list(cache.iterdir()) == [Path(printed[0])]
    assert ctypes.CDLL(printed[0]).answer() == 42


def test_a_library_that_cannot_be_loaded_is_a_bad_input_that_names_it(planar5_folder, cache):
    # compiled but not loaded: the linker would answer from memory otherwise
    calls = Path(str(resources.files("clikgen.runtime"))) / "calls.c"
    library = compile_library([planar5_folder / "planar5.c", calls], extra=NATIVE)
    library.write_bytes(b"not a library")
    with pytest.raises(BadInput, match=f"{library.name}: cannot be loaded, delete it"):
        CompiledController.load(planar5_folder)


def test_a_library_may_be_read_by_everyone(source, cache):
    assert compile_library([source]).stat().st_mode & 0o777 == 0o755
