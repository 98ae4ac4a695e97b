"""A library in a process of its own, where it needs another environment: `python -m peers.helper NAME SETUP PATH`.

Each line on standard input is a call of its runner, {"call": , "arguments": }; each is answered by a line.
"""

import json
import sys

import numpy as np

from peers.libraries import LIBRARIES, Setup
from peers.timing import ANSWER, Stateful


def main() -> None:
    name, setup, path = sys.argv[1:]
    data = np.load(path)
    library = LIBRARIES[name](Setup(**json.loads(setup)))
    targets = list(zip(data["places"], data["rotations"], strict=True))
    runner = Stateful(library, data["q"], targets)
    print(f"{ANSWER}0", flush=True)
    for line in sys.stdin:
        asked = json.loads(line)
        answer = getattr(runner, asked["call"])(*asked["arguments"])
        print(ANSWER + json.dumps(np.asarray(answer).tolist()), flush=True)


if __name__ == "__main__":
    main()
