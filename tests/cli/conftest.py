"""The command line, called in this process: the same `main`, without the start of a new interpreter."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from clikgen.cli.main import main
from clikgen.symbolic.generate import shipped_folder


@dataclass(frozen=True, slots=True)
class Outcome:
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def run_clikgen(monkeypatch, capsys) -> Callable[..., Outcome]:
    """Run `clikgen ARGUMENTS` in a folder, with environment variables put over the present ones."""

    def run(*arguments: object, cwd: str | Path | None = None, **environment: str) -> Outcome:
        capsys.readouterr()
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["clikgen", *map(str, arguments)])
            for name, value in environment.items():
                patch.setenv(name, value)
            if cwd is not None:
                patch.chdir(cwd)
            with pytest.raises(SystemExit) as stop:
                main()
        said = capsys.readouterr()
        return Outcome(int(stop.value.code or 0), said.out, said.err)

    return run


@pytest.fixture
def generated_copy(tmp_path) -> Path:
    """A copy of the generated controllers that a test may damage, found from tmp_path as ./generated."""
    return Path(shutil.copytree(shipped_folder(), tmp_path / "generated"))
