"""What every command says on the terminal: tables to read, progress on stderr, JSON alone on stdout."""

import sys
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from clikgen.runtime.documents import json_text

messages = Console(stderr=True, highlight=False, soft_wrap=True)


def print_json(document: Any) -> None:
    """One JSON document on stdout."""
    sys.stdout.write(json_text(document))


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], width: int | None = None) -> None:
    """A table on stdout, as wide as the terminal or `width` characters; the first column is the name of the row."""
    table = Table(title=Text(title), title_justify="left", title_style="bold", show_lines=False)
    for i, column in enumerate(columns):
        table.add_column(Text(column), style="bold" if i == 0 else None, no_wrap=i == 0)
    for row in rows:
        table.add_row(*map(Text, row))  # as it is: "[s]" is a unit, not markup
    Console(highlight=False, width=width).print(table)


def progress_bar() -> Progress:
    """A progress bar on stderr that leaves nothing behind."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=messages,
        transient=True,
        disable=not messages.is_terminal,
    )
