"""How much contacts chatter over gain and filter: rollouts of the compiled step beside the edges of the normal map."""

from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from clikgen.analysis.chatter import avoidance_task
from clikgen.analysis.discrete_filter import beta_of, cutoff_of
from clikgen.analysis.drawing import STYLE
from clikgen.analysis.plates import Plate
from clikgen.runtime.batch import simulate_batch_of
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import Case, Scenario
from clikgen.runtime.simulation import prepare

Array = NDArray[np.float64]

GAINS = np.linspace(0.1, 6.0, 60)  # K_oT
BETAS = np.linspace(0.02, 0.999, 50)  # the last one is hardly a filter
EDGES = (2.0, 4.0)  # βK_oT = 2(1 − a) beyond which the normal map has a < 0 and a < −1


@dataclass(frozen=True, slots=True, eq=False)
class ChatterMap:
    """A case of a scenario with every avoidance gain and every filter.

    `gains` (G,) are K_oT, `betas` (B,) the filter's; `switching` (B, G) is how often per sample of an encounter a point
    goes in or out, NaN where the run diverged, and `own` is where the scenario itself stands: K_oT and β.
    """

    case: int
    gains: Array
    betas: Array
    switching: Array
    own: tuple[float, float]

    @property
    def filtered_gain(self) -> Array:
        """βK_oT (B, G)."""
        return self.betas[:, None] * self.gains

    def median(self, low: float, high: float) -> float:
        """Of the switching where βK_oT is in between; NaN where nothing is."""
        between = self.switching[(self.filtered_gain >= low) & (self.filtered_gain < high)]
        known = between[np.isfinite(between)]
        return float(np.median(known)) if known.size else float("nan")


def chatter_map(
    controller: CompiledController,
    scenario: Scenario,
    number: int,
    case: Case,
    gains: Array = GAINS,
    betas: Array = BETAS,
    source: str = "scenario",
) -> ChatterMap:
    """A rollout for every cell, K_o the same for the contacts of all points and f_c for all joints.

    Raises BadInput where the scenario does not fit or the controller avoids nothing by the paper's switched task.
    """
    run = prepare(controller, scenario, case, source)
    gain_name, T = f"{avoidance_task(controller.manifest)}_gain", run.period
    joints = np.size(run.values["filter_cutoff"])
    every_beta, every_gain = (grid.ravel() for grid in np.meshgrid(betas, gains, indexing="ij"))
    cutoffs = np.array([cutoff_of(float(beta), T) for beta in every_beta])
    each = {gain_name: every_gain / T, "filter_cutoff": np.repeat(cutoffs[:, None], joints, axis=1)}
    found = simulate_batch_of(run, each, ["switch_rate", "diverged_at"])
    switching = np.where(np.isfinite(found["diverged_at"]), np.nan, found["switch_rate"] * T)
    own = float(run.values[gain_name]) * T, beta_of(float(np.max(run.values["filter_cutoff"])), T)
    return ChatterMap(number, gains, betas, switching.reshape(len(betas), len(gains)), own)


def chatter_map_plate(maps: Sequence[ChatterMap]) -> Plate:
    """A panel per case: switching in colour, the edges of the normal map as curves, the scenario's own place."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.2 * len(maps), 4.6), layout="constrained")
        panels = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
        for axes, one in zip(panels, maps, strict=True):
            mesh = axes.pcolormesh(one.gains, one.betas, one.switching, cmap="viridis", vmin=0.0, vmax=1.0)
            mesh.set_rasterized(True)
            for edge, style in zip(EDGES, ("-", "--"), strict=True):
                shown = np.linspace(edge / one.betas[-1], one.gains[-1])  # from the frame on
                axes.plot(shown, edge / shown, color="black", linestyle=style, label=rf"$\beta K_oT = {edge:g}$")
            mark = {"color": "#D55E00", "marker": "o", "markeredgecolor": "white", "linestyle": "none"}
            axes.plot(*one.own, label="as the scenario has it", clip_on=False, zorder=3, **mark)
            axes.set(title=f"Case {one.case}", xlabel="$K_oT$", xlim=(one.gains[0], one.gains[-1]))
            axes.set_ylim(one.betas[0], one.betas[-1])
            axes.grid(visible=False)
        panels[0].set_ylabel(r"$\beta$ of the filter (no filter: 1)")
        figure.colorbar(mesh, ax=list(panels), label="switches per sample of an encounter")
        handles, _ = panels[0].get_legend_handles_labels()
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
        figure.suptitle("Where contacts chatter: measured, and the edges of the normal map")
    cells = sum(one.switching.size for one in maps)
    caption = (
        f"{cells} compiled rollouts: how often a point of interest enters or leaves its region. Below βK_oT = 2 the "
        "normal map has sawtooths or nothing; between the curves a point may go in and out with every sample; beyond "
        "βK_oT = 4 it does so without a period."
    )
    data = {"K_oT": np.tile(maps[0].gains, len(maps[0].betas)), "beta": np.repeat(maps[0].betas, len(maps[0].gains))}
    columns = {f"switches per sample, case {one.case}": one.switching.ravel() for one in maps}
    return Plate("chatter_map", caption, figure, data | columns)
