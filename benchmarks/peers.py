"""Our step from Python, in C and in batches against its peers from PyPI, side by side.

`python benchmarks/peers.py [--json] [--save] [--rounds N]`

Makes the environments of `peers/requirements*.txt` in `.venv-peers/` where they are not there yet, checks there that
who claims the same law gives the same numbers, then measures: peers/README.md says what and how. `--json` prints one
document; `--save` also writes results.json, summary.png and the table of the README.
"""

import subprocess
import sys
from pathlib import Path

from peers.environments import ENVIRONMENTS, Environment, InstallError


def main() -> int:
    failed = {}
    for environment in ENVIRONMENTS.values():
        try:
            prepare(environment)
        except InstallError as error:
            failed[environment.name] = str(error)
    if "main" in failed:
        print(failed["main"], file=sys.stderr)
        return 1
    command = [str(ENVIRONMENTS["main"].python), "-m", "peers.measure", *sys.argv[1:]]
    command += [f"--missing={name}: {reason}" for name, reason in failed.items()]
    return subprocess.run(command, cwd=Path(__file__).parent, check=False).returncode


def prepare(environment: Environment) -> None:
    if not environment.is_ready():
        print(f"installing {environment.requirements.name} into {environment.folder.name}/ ...", file=sys.stderr)
        environment.install()


if __name__ == "__main__":
    sys.exit(main())
