"""A sweep on a Dask cluster: a task is a chunk, and all that a worker needs travels with it.

Workers share no disk with this process, which alone writes the results; each compiles the controller once, into its
own cache. A worker that is lost loses nothing: the scheduler gives its chunks to others.
"""

import itertools
import logging
import pickle
import threading
from collections.abc import Iterable, Iterator
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

from clikgen.analysis.sweep import Progress, Sweep, SweepSource, Table, bind
from clikgen.runtime.compiler import cache_folder
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput, commit_all, json_text, read_text
from clikgen.runtime.manifest import sha256

AHEAD = 1024  # chunks that the scheduler knows of at a time
PATIENCE = 10  # [s] for the scheduler to answer
DEATHS = 3  # times that all of the workers the scheduler tried a chunk on may be lost; each time it tries several
RETRIES = 2  # of a chunk that a worker failed at


def check_dask() -> None:
    """Raises BadInput, with what to do, where dask.distributed is not installed."""
    if find_spec("distributed") is None:
        raise BadInput("--scheduler needs dask.distributed: pip install 'clikgen[sweep]'; threads work without it")


def cluster_tables(
    address: str, source: SweepSource, sweep: Sweep, chunks: Iterable[int], progress: Progress | None = None
) -> Iterator[tuple[int, Table]]:
    """The chunks of those numbers and their rows, in the order in which the workers of a scheduler finish them.

    Raises BadInput where the scheduler is not there, is lost, or a worker cannot do it.
    """
    from distributed import Client, as_completed
    from distributed.client import ClosedClientError

    for name in ("distributed", "distributed.client"):  # what they log is raised, in one line
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise BadInput(f"--scheduler: wanted a Dask scheduler at {address}: {error or type(error).__name__}") from None
    waiting, numbers, deaths = iter(chunks), {}, dict.fromkeys(chunks, 0)
    with client:
        parcel = client.submit(bytes, _packed(source, sweep), pure=False)  # a task, so that it can be made anew

        def submit(chunk: int) -> Any:
            try:
                future = client.submit(_table, parcel, chunk, pure=False, retries=RETRIES)
            except ClosedClientError:
                raise _lost(address) from None
            numbers[future] = chunk
            return future

        done = as_completed([submit(chunk) for chunk in itertools.islice(waiting, AHEAD)], loop=client.loop)
        for future in done:
            chunk = numbers.pop(future)
            try:
                table = future.result()
            except Exception as error:  # the worker's, or that of a connection that broke meanwhile
                if future.status != "error":
                    raise _lost(address) from None
                deaths[chunk] += 1
                _check_worth_trying(error, address, chunk, deaths[chunk])
                following: int | None = chunk
            else:
                if progress:
                    progress(len(table))
                yield chunk, table
                following = next(waiting, None)
            if following is not None:
                done.add(submit(following))


def _check_worth_trying(error: Exception, address: str, chunk: int, deaths: int) -> None:
    """Raises BadInput, in one line, unless a chunk was given up only because its workers were lost."""
    from distributed import KilledWorker

    if not isinstance(error, KilledWorker) or deaths > DEATHS:
        said = BadInput(f"--scheduler: a worker of {address} failed at chunk {chunk}: {error or type(error).__name__}")
        raise said from None


def _lost(address: str) -> BadInput:
    return BadInput(f"--scheduler: {address} is lost; run the same command again to go on")


# ---- What travels ----


def _packed(source: SweepSource, sweep: Sweep) -> bytes:
    """The sweep, the generated controller, and what both have to be when they arrive."""
    files = {
        name: read_text(sweep.controller.folder / name)
        for name in ("manifest.json", *sweep.controller.manifest.source_sha256)
    }
    return pickle.dumps((source, files, sweep.provenance))


_unpacking = threading.Lock()


@lru_cache(maxsize=1)
def _unpacked(parcel: bytes) -> Sweep:
    """The sweep on this worker; raises BadInput where it would not be the same one here."""
    source, files, provenance = pickle.loads(parcel)
    folder = cache_folder() / "controllers" / sha256(json_text(files).encode())[:24]
    commit_all({folder / name: text.encode() for name, text in files.items()})
    sweep = bind(source, CompiledController.load(folder))
    there, here = ({**one["versions"], "fma": one["fma"]} for one in (provenance, sweep.provenance))
    for name, wanted in there.items():
        if here[name] != wanted:
            raise BadInput(f"{name}: wanted {wanted}, as where the results are written, got {here[name]}")
    sweep.make_ready()
    return sweep


def _table(parcel: bytes, chunk: int) -> Table:
    """What a worker is asked for; its other threads have chunks of their own."""
    with _unpacking:
        sweep = _unpacked(parcel)
    return sweep.table(chunk, threads=1)
