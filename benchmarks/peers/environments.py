"""The Python environments of the peers: one for all but those that need another Pinocchio."""

import hashlib
import platform
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PLACE = ROOT / ".venv-peers"
BUILD = PLACE / "build"  # what is compiled


class InstallError(RuntimeError):
    """An environment could not be made; the message is one line."""


@dataclass(frozen=True, slots=True)
class Environment:
    """A virtual environment made from a file of pinned versions; `with_clikgen` also holds this checkout."""

    name: str
    requirements: Path
    with_clikgen: bool

    @property
    def folder(self) -> Path:
        return PLACE / self.name

    @property
    def python(self) -> Path:
        return self.folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")

    def is_ready(self) -> bool:
        mark = self.folder / "ready"
        return mark.exists() and mark.read_text() == self._wanted()

    def install(self) -> None:
        """Make it, or go on where an earlier attempt was left; raises InstallError."""
        PLACE.mkdir(exist_ok=True)
        (PLACE / ".gitignore").write_text("*\n")  # git and the linters leave it alone
        if not self._has_this_python():
            _run(sys.executable, "-m", "venv", "--clear", str(self.folder))
        self._pip("--requirement", str(self.requirements))
        if self.with_clikgen:
            self._pip("--no-build-isolation", "--no-deps", "--editable", str(ROOT))
        (self.folder / "ready").write_text(self._wanted())

    def _has_this_python(self) -> bool:
        config = self.folder / "pyvenv.cfg"
        return self.python.exists() and config.exists() and platform.python_version() in config.read_text()

    def _pip(self, *arguments: str) -> None:
        _run(str(self.python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *arguments)

    def _wanted(self) -> str:
        return hashlib.sha256(self.requirements.read_bytes() + sys.version.encode()).hexdigest()


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")]
        raise InstallError(" ".join(lines) or f"{' '.join(command)} failed: {done.stderr[-200:]}")


ENVIRONMENTS = {
    "main": Environment("main", HERE / "requirements.txt", with_clikgen=True),
    "placo": Environment("placo", HERE / "requirements-placo.txt", with_clikgen=False),  # needs an older Pinocchio
}
