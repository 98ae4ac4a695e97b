"""A film of some laws beside each other: the robots, what they trace, and their joint velocities."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from clikgen.analysis import spatial
from clikgen.analysis.animation import Pixels, Shown, film, write_film
from clikgen.analysis.comparison import Compared
from clikgen.analysis.drawing import STYLE
from clikgen.analysis.scene import even_steps, scene

FRAMES = 90
PLANAR, SPATIAL = 4, 3  # laws that a film shows at most


def animate(compared: Sequence[Compared], path: Path, frames: int = FRAMES) -> None:
    """Write a film (.gif or .mp4) of `frames` even moments, the whole file or none.

    Of many laws it shows PLANAR or, of a robot in space, SPATIAL, evenly from the first to the last. Raises BadInput
    where `write_film` does.
    """
    in_space = compared[0].controller.manifest.dimension == 3
    shown = filmed(compared, SPATIAL if in_space else PLANAR)
    with mpl.rc_context(STYLE):
        if in_space:
            steps = even_steps(shown[0].rollout, frames)
            write_film(path, _painter_in_space(shown, steps), len(steps))
        else:
            film([Shown("\n".join(_title(one)), one.controller, one.rollout) for one in shown], path, frames, lam=False)


def filmed(compared: Sequence[Compared], most: int) -> list[Compared]:
    """`most` of the laws, evenly from the first to the last; all of them where there are no more."""
    places = np.linspace(0, len(compared) - 1, min(most, len(compared))).round().astype(int)
    return [compared[i] for i in places]


def _painter_in_space(shown: Sequence[Compared], steps: NDArray[np.intp]) -> Callable[[int], Pixels]:
    scenes = [scene(each.controller, each.rollout, steps) for each in shown]
    named = zip(scenes, shown, strict=True)
    return spatial.painter([replace(one, title=", ".join(_title(each))) for one, each in named])


def _title(each: Compared) -> list[str]:
    """The law and, where the controller says so, how often its contact switched."""
    return [each.law.title, *([each.switches] if each.switches else [])]
