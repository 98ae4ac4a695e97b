"""Where a sweep's results are kept: parts that are whole or not there, and one file made of them at the end.

A folder belongs to one sweep, told by its provenance, and to one process at a time. Whenever that process ends, by
whatever signal, the next one goes on from the parts that are there.
"""

import fcntl
import hashlib
import io
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clikgen.analysis.sweep import Sweep, Table
from clikgen.runtime.documents import (
    TEMPORARY_SUFFIX,
    BadInput,
    json_text,
    make_folder,
    read_text,
    write_atomically,
)

ROW_GROUP = 65_536  # rows of a Parquet file that can be read without the others
_CHECKSUM = 32  # bytes in front of a part


@dataclass(frozen=True, slots=True, eq=False)
class Store:
    """The folder of a sweep, while it is this process's."""

    folder: Path
    sweep: Sweep
    provenance: Mapping[str, Any]

    @property
    def results(self) -> Path:
        """The file of results, which is there once the sweep is done."""
        return self.folder / f"results.{self.sweep.file.format}"

    @property
    def missing(self) -> list[int]:
        """The chunks that have still to be run: none once the sweep is done."""
        if self.results.exists():
            return []
        return [chunk for chunk in range(self.sweep.file.chunks) if self._read(chunk) is None]

    def keep(self, chunk: int, table: Table) -> None:
        """Write the rows of a chunk, under a checksum: all of them or, on an interruption, none."""
        content = io.BytesIO()
        np.save(content, table, allow_pickle=False)
        write_atomically(self._part(chunk), self._checksum(content.getvalue()) + content.getvalue())

    def finish(self) -> None:
        """Make the file of results of the parts, then remove these; raises BadInput where it cannot be written."""
        if not self.results.exists():
            temporary = self.results.with_name(self.results.name + TEMPORARY_SUFFIX)
            try:
                with temporary.open("wb") as file:
                    write = _write_parquet if self.sweep.file.format == "parquet" else _write_csv
                    write(file, self._tables(), self)
                    file.flush()
                    os.fsync(file.fileno())
                temporary.replace(self.results)
                _sync_folder(self.folder)  # the results are there before the parts are gone
            except OSError as error:
                raise BadInput(f"{self.results}: cannot be written: {error.strerror}") from None
        for part in self._parts.glob("*.part"):
            part.unlink()
        if self._parts.is_dir():
            self._parts.rmdir()

    def columns(self, names: Sequence[str]) -> dict[str, NDArray[Any]]:
        """Some columns of the file of results."""
        if self.sweep.file.format == "parquet":
            import pyarrow.parquet

            read = pyarrow.parquet.read_table(self.results, columns=list(names))
            return {name: read[name].to_numpy() for name in names}
        dtype = self.sweep.dtype
        table = np.loadtxt(
            self.results,
            np.dtype([(name, dtype[name]) for name in names]),
            delimiter=",",
            skiprows=1,
            usecols=[(dtype.names or ()).index(name) for name in names],
            ndmin=1,
        )
        return {name: table[name] for name in names}

    @property
    def _parts(self) -> Path:
        return self.folder / "parts"

    def _part(self, chunk: int) -> Path:
        return self._parts / f"{chunk:07d}.part"

    def _read(self, chunk: int) -> Table | None:
        """The rows of a chunk; None where its part is not there, damaged, or of another sweep."""
        try:
            content = self._part(chunk).read_bytes()
        except FileNotFoundError:
            return None
        if content[:_CHECKSUM] != self._checksum(content[_CHECKSUM:]):
            return None
        table: Table = np.load(io.BytesIO(content[_CHECKSUM:]), allow_pickle=False)
        return table

    def _checksum(self, content: bytes) -> bytes:
        """SHA-256 of the provenance and the content."""
        return hashlib.sha256(json_text(self.provenance).encode() + content).digest()

    def _tables(self) -> Iterator[Table]:
        """All rows in order, ROW_GROUP or a few more at a time."""
        waiting: list[Table] = []
        for chunk in range(self.sweep.file.chunks):
            table = self._read(chunk)
            if table is None:
                raise BadInput(f"{self._part(chunk)}: changed while it was in use; run the same command again")
            waiting.append(table)
            if sum(map(len, waiting)) >= ROW_GROUP:
                yield np.concatenate(waiting)
                waiting = []
        if waiting:
            yield np.concatenate(waiting)


@contextmanager
def open_store(folder: Path, sweep: Sweep) -> Iterator[Store]:
    """The folder of a sweep, made where it is not there, for this process alone.

    Raises BadInput where another process has it, it holds something else or another sweep, or cannot be written to.
    """
    store = Store(folder, sweep, _full_provenance(sweep))
    path = folder / "provenance.json"
    there = [found.name for found in (*folder.glob("results.*"), *folder.glob("parts")) if found.exists()]
    if there and not path.exists():
        raise BadInput(f"{folder}: wanted a new folder or that of this sweep, got one with {', '.join(sorted(there))}")
    with _locked(make_folder(folder)):
        if path.exists():
            _check_same(path, store.provenance)
        else:
            write_atomically(path, json_text(store.provenance).encode())
        for pattern in ("results.*", ".provenance.json.*", "parts/.*.part.*"):  # what an interruption left half-written
            for left_over in folder.glob(pattern + TEMPORARY_SUFFIX):
                left_over.unlink()
        yield store


def _full_provenance(sweep: Sweep) -> dict[str, Any]:
    """All that decides the bytes of the file of results: where it is Parquet, pyarrow too; raises BadInput."""
    provenance = dict(sweep.provenance)
    if sweep.file.format == "parquet":
        if find_spec("pyarrow") is None:
            raise BadInput("format: 'parquet' needs pyarrow: pip install 'clikgen[sweep]'; 'csv' works without it")
        provenance["versions"] = {**provenance["versions"], "pyarrow": version("pyarrow")}
    return provenance


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Nobody else's folder meanwhile; the system lets go of it when the process ends, however that happens."""
    try:
        file = (folder / ".lock").open("wb")
    except OSError as error:
        raise BadInput(f"{folder}: cannot be written to: {error.strerror}") from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BadInput(f"{folder}: in use by another sweep; wait for it, or give another --out") from None
        yield


def _check_same(path: Path, provenance: Mapping[str, Any]) -> None:
    """Raises BadInput, saying what differs, unless the file says the same."""
    try:
        there = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise BadInput(f"{path}: not valid JSON: {error}; delete {path.parent} to start anew") from None
    found = next(_differences(there, json.loads(json_text(provenance))), None)
    if found:
        key, old, new = found
        raise BadInput(
            f"{path}: of another sweep: {key} is {_brief(old)} there and {_brief(new)} here; "
            "give another --out, or delete the folder to start anew"
        )


def _differences(there: Any, here: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Where two JSON documents differ: a dotted key, and what stands there in either."""
    if isinstance(there, dict) and isinstance(here, dict):
        for name in {**here, **there}:
            yield from _differences(there.get(name), here.get(name), f"{key}.{name}" if key else name)
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        for i, (old, new) in enumerate(zip(there, here, strict=True)):
            yield from _differences(old, new, f"{key}.{i}")
    elif there != here:
        yield key, there, here


def _brief(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


# ---- The file of results ----


def _write_parquet(file: BinaryIO, tables: Iterator[Table], store: Store) -> None:
    """A row group a table; the provenance is in the file's metadata, under the key `clikgen`."""
    import pyarrow
    import pyarrow.parquet

    fields = {name: pyarrow.from_numpy_dtype(kind[0]) for name, kind in (store.sweep.dtype.fields or {}).items()}
    schema = pyarrow.schema(fields, metadata={"clikgen": json_text(store.provenance)})
    with pyarrow.parquet.ParquetWriter(file, schema, use_dictionary=False) as writer:
        for table in tables:
            columns = [pyarrow.array(np.ascontiguousarray(table[name])) for name in schema.names]
            writer.write_table(pyarrow.table(columns, schema=schema), row_group_size=len(table))


def _write_csv(file: BinaryIO, tables: Iterator[Table], store: Store) -> None:
    """A header line, then a row a line: every number in the fewest digits that give it back exactly."""
    file.write((",".join(store.sweep.dtype.names or ()) + "\n").encode())
    for table in tables:
        file.writelines((",".join(map(repr, row)) + "\n").encode() for row in table.tolist())
