"""The measurement as a table, as results.json, as a figure and in the README."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib

from peers.work import HERE

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.patches import Patch

Row = Mapping[str, Any]
TITLES = {
    "planar5": "planar5: 5 joints, 6 points of interest, 3 obstacles, tracking under avoidance",
    "arm7": "arm7: 7 joints, a pose above a posture",
}
IN_BATCHES = "planar5 in batches: a step of one of 4096 robots, the law the same everywhere"
COLOURS = {"ours": "#d95f02", "same": "#4c78a8", "unlike": "#b3bfcc"}
LABELS = {"ours": "clikgen", "same": "the same law", "unlike": "unlike work, see its label"}
BEGIN, END = "<!-- the last saved run -->", "<!-- end of the last saved run -->"


def text(document: Row) -> str:
    """Everything, columns aligned."""
    return "\n".join(lines(document))


def lines(document: Row) -> Iterator[str]:
    yield from (document["machine"], document["compiler"], document["compiler of C++"])
    yield ", ".join(f"{name} {version}" for name, version in document["versions"].items())
    yield f"medians of {document['rounds']} rounds; p99 of single calls; random: another state every time"
    for robot, title in TITLES.items():
        rows = [row for row in document["steps"] if row["robot"] == robot]
        yield from ("", title, "")
        yield from table(STEP_COLUMNS, rows)
    yield from ("", IN_BATCHES, "")
    yield from table(BATCH_COLUMNS, document["batches"])
    yield from ("", "what was aimed at: so many times as fast", "")
    yield from table(AIM_COLUMNS, document["aims"])
    yield from ("", "checked before: the largest deviation of any number, relative", "")
    yield from table(CHECK_COLUMNS, document["checks"])
    yield from ("", "not measured")
    for name, reason in document["missing"].items():
        yield f"  {name}: {reason}"


def number(value: float | None, digits: int = 3) -> str:
    return "" if value is None else f"{value:.{digits}g}" if value < 999.5 else f"{value:.0f}"


STEP_COLUMNS = {
    "": lambda row: row["name"],
    "law": lambda row: row["law"] if row["law"] != "unlike" else "UNLIKE",
    "does": lambda row: row["does"],
    "in": lambda row: row["language"],
    "us": lambda row: number(row["us"]),
    "p99 us": lambda row: number(row["p99_us"]),
    "random us": lambda row: number(row["random_us"]),
    "x ours": lambda row: number(row["times_ours"]),
    "tracking rms": lambda row: f"{row['tracking_rms']:.2g} m",
    "least d - s": lambda row: f"{row['min_clearance']:.3f} m" if "min_clearance" in row else "",
}
BATCH_COLUMNS = {
    "": lambda row: row["name"],
    "ns": lambda row: number(row["ns"]),
    "x our fastest": lambda row: number(row["times_ours"]),
    "million steps/s": lambda row: number(1e3 / row["ns"]),
    "deviation, 1 step": lambda row: f"{row['deviation']:.1e}",
    "still together at the end": lambda row: f"{row['together_at_end']:.1%}",
}
CHECK_COLUMNS = {
    "": lambda row: row["what"],
    "robot": lambda row: row["robot"],
    "states": lambda row: str(row["states"]),
    "in contact": lambda row: f"{row['in contact']:.0%}" if row.get("in contact") is not None else "",
    "deviation": lambda row: f"{row['deviation']:.1e}",
}
AIM_COLUMNS = {
    "robot": lambda row: row["robot"],
    "than": lambda row: row["than"],
    "wanted": lambda row: number(row["wanted"]),
    "x ours": lambda row: number(row["times_ours"]),
    "reached": lambda row: row["reached"],
}
LEFT = ("", "law", "does", "in", "robot", "than", "reached")


def table(columns: Mapping[str, Any], rows: Sequence[Row]) -> Iterator[str]:
    cells = [list(columns), *([value(row) for value in columns.values()] for row in rows)]
    filled = [i for i in range(len(columns)) if any(one[i] for one in cells[1:])]
    cells = [[one[i] for i in filled] for one in cells]
    widths = [max(len(one[i]) for one in cells) for i in range(len(filled))]
    for one in cells:
        parts = [
            cell.ljust(width) if name in LEFT else cell.rjust(width)
            for name, cell, width in zip([list(columns)[i] for i in filled], one, widths, strict=True)
        ]
        yield "  ".join(parts).rstrip()


# ---- What is saved ----


def save(document: Row) -> None:
    """results.json, summary.png, and the table in the README."""
    (HERE / "results.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    figure(document)
    readme = HERE / "README.md"
    before, _, rest = readme.read_text(encoding="utf-8").partition(BEGIN)
    _, _, after = rest.partition(END)
    readme.write_text(f"{before}{BEGIN}\n```\n{text(document)}\n```\n{END}{after}", encoding="utf-8")


def figure(document: Row) -> None:
    """Microseconds per step, a bar each, the fastest first."""
    groups = {title: bars_of(document, robot) for robot, title in TITLES.items()}
    groups[IN_BATCHES] = [
        Bar(row["name"].replace("ours", "clikgen"), row["law"], row["ns"] / 1e3) for row in document["batches"]
    ]
    counts = [len(bars) for bars in groups.values()]
    shape = {"height_ratios": [count + 1 for count in counts]}
    size = (10, 0.27 * sum(counts) + 3)
    drawing, axes = plt.subplots(len(groups), 1, figsize=size, gridspec_kw=shape, sharex=True, layout="constrained")
    for axis, (title, bars) in zip(axes, groups.items(), strict=True):
        draw(axis, sorted(bars, key=lambda bar: bar.us))
        axis.set_title(title, loc="left", fontsize=10, fontweight="bold")
    axes[-1].set_xlabel("microseconds per step (logarithmic)")
    handles = [Patch(label=label, **style(law)) for law, label in LABELS.items()]
    drawing.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    drawing.suptitle(f"What a step costs: {document['machine']}\n", fontsize=12)
    drawing.savefig(HERE / "summary.png", dpi=130)
    plt.close(drawing)


@dataclass(frozen=True, slots=True)
class Bar:
    """One of the figure."""

    label: str
    law: str
    us: float


def bars_of(document: Row, robot: str) -> list[Bar]:
    rows = [row for row in document["steps"] if row["robot"] == robot]
    return [Bar(label(row), row["law"], row["us"]) for row in rows]


def draw(axis: plt.Axes, bars: Sequence[Bar]) -> None:
    for i, bar in enumerate(bars):
        axis.barh(i, bar.us, height=0.74, **style(bar.law))
        axis.annotate(number(bar.us), (bar.us, i), (4, 0), textcoords="offset points", va="center", fontsize=8.5)
    axis.set_yticks(range(len(bars)), [bar.label for bar in bars], fontsize=8.5)
    for text_of, bar in zip(axis.get_yticklabels(), bars, strict=True):
        text_of.set_fontweight("bold" if bar.law == "ours" else "normal")
    axis.set_ylim(len(bars) - 0.4, -0.6)
    axis.set_xscale("log")
    axis.set_xlim(0.01, 1000)
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.tick_params(axis="x", labelbottom=True, labelsize=8.5)
    axis.tick_params(axis="y", length=0)
    axis.grid(axis="x", color="0.9", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)


def label(row: Row) -> str:
    if row["law"] == "ours":
        return row["name"].replace("ours", "clikgen")
    name = row["name"].partition(",")[0]
    return f"{name}: {row['does']}" if row["law"] == "unlike" else f"{name} ({row['language']})"


def style(law: str) -> dict[str, Any]:
    return {"facecolor": COLOURS[law], "hatch": "////" if law == "unlike" else None, "edgecolor": "white"}
