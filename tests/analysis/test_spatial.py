"""The film of cases in space: its frames, what they show, and the files that cannot be written."""

import os
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from clikgen.analysis import animation, spatial
from clikgen.analysis.animation import check_film, write_film
from clikgen.analysis.drawing import CONTACT, TRACED
from clikgen.analysis.scene import even_steps, scene
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, Scenario, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare

SCENARIO = {
    "name": "small",
    "description": "past a ball",
    "controller": "small_arm",
    "duration": 3.0,
    "q0": [-0.6, -0.3, 1.0],
    "references": {
        "tip": {"kind": "point_to_point", "start": [0.5, -0.35, 0.35], "end": [0.5, 0.4, 0.35], "duration": 2.5},
        "wrist": {"kind": "turn", "start": [0, 0.7, -0.6], "end": [0, 0.7, 0.6], "duration": 2.5},
    },
    "obstacles": [{"radius": 0.06, "center": [0.36, 0.1, 0.3]}],
    "capsules": [{"start": [-0.4, -0.4, 0.0], "end": [-0.4, -0.4, 0.6], "radius": 0.05}],
    "half_spaces": [{"normal": [0, 0, 1], "offset": 0.0}],
}


@pytest.fixture(scope="module")
def controller(small_arm):
    return small_arm()


@pytest.fixture(scope="module")
def rollouts(controller):
    scenario = Scenario.parse(SCENARIO, "small")
    return {number: prepare(controller, scenario, CASES[number]).in_c() for number in (1, 3)}


@pytest.fixture(scope="module")
def frames(controller, rollouts):
    """Twelve frames of both cases, as pixels."""
    steps = even_steps(rollouts[1], 12)
    with animation.mpl.rc_context(animation.STYLE):
        paint = spatial.painter([scene(controller, rollout, steps) for rollout in rollouts.values()])
        return [paint(k) for k in range(12)]


def near(pixels, colour, distance=12):
    """How many pixels are about of a colour."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return int(np.sum(np.abs(pixels.astype(int) - wanted).max(axis=-1) <= distance))


# ---- What it shows ----


def test_no_frame_is_blank_and_each_differs_from_the_next(frames):
    assert all(frame.shape == frames[0].shape for frame in frames)
    assert all(np.mean(frame < 250) > 0.03 for frame in frames)
    assert all((one != other).any(axis=-1).sum() > 500 for one, other in pairwise(frames))


def test_nothing_touches_the_margin_of_the_page(frames):
    for frame in frames:
        for margin in (frame[:3], frame[-3:], frame[:, :3], frame[:, -3:]):
            assert (margin == 255).all()


def test_the_traced_path_grows(frames):
    half = [frame[: frame.shape[0] // 2] for frame in frames]
    assert near(half[-1], TRACED) > near(half[3], TRACED) > near(half[0], TRACED)


def test_contact_colours_the_region(frames, rollouts):
    steps = even_steps(rollouts[1], 12)
    touched = [rollouts[1].active[steps[k - 1] + 1 : steps[k] + 1].any() for k in range(1, 12)]
    assert 0 < sum(touched) < 11
    shown = [near(frame[: frame.shape[0] // 2, : frame.shape[1] // 2], CONTACT) > 20 for frame in frames[1:]]
    assert shown == touched


def test_a_place_is_drawn_where_the_axes_have_it(controller, rollouts):
    """The camera is the axes' own: what it takes for a metre is one along each of them."""
    each = scene(controller, rollouts[1], [0, 299])
    with animation.mpl.rc_context(animation.STYLE):
        figure, panels, _ = spatial._stage([each])
        spatial.FigureCanvasAgg(figure).draw()
        axes = panels[0].axes
        camera = spatial._Camera.of(axes)
        mark = axes.plot([0.3], [0.2], [0.1], "o")[0]
        figure.canvas.draw()
    np.testing.assert_allclose(
        camera.pixels(np.array([0.3, 0.2, 0.1])), mark.get_transform().transform(mark.get_xydata()[0])
    )
    gram = camera.matrix @ camera.matrix.T
    np.testing.assert_allclose(gram, camera.scale**2 * np.eye(2), atol=1e-6 * camera.scale**2)
    np.testing.assert_allclose(camera.matrix @ camera.view, 0.0, atol=1e-6 * camera.scale)


# ---- Files ----


def test_film_has_the_frames_and_the_size_wanted(controller, rollouts, tmp_path, frames):
    path = tmp_path / "new" / "film.gif"
    said = []
    spatial.animate(rollouts, controller, path, frames=12, progress=said.append)
    assert said == [str(path)]
    assert [file.name for file in path.parent.iterdir()] == ["film.gif"]
    with Image.open(path) as film:
        assert film.n_frames == 12
        assert film.size == frames[0].shape[1::-1]
        film.seek(6)
        shown = np.asarray(film.convert("RGB")).astype(int)
    # one palette for all: a few shades are off, nothing else
    assert np.mean(np.abs(shown - frames[6])) < 2.0


def test_a_robot_in_the_plane_is_drawn_in_the_plane(tmp_path):
    planar5 = CompiledController.load("planar5")
    wanted = read_scenario(find_scenario("paper"), ["duration=1.0"])
    rollouts = {1: prepare(planar5, wanted, CASES[1]).in_c()}
    for animate, name in ((spatial.animate, "one.gif"), (animation.animate, "two.gif")):
        animate(rollouts, planar5, tmp_path / name, frames=3)
    assert (tmp_path / "one.gif").read_bytes() == (tmp_path / "two.gif").read_bytes()


@pytest.mark.parametrize("name", ["film.avi", "film", "film.png"])
def test_another_ending_is_refused_with_the_choices(name, controller, rollouts, tmp_path):
    with pytest.raises(BadInput, match=r"valid choices: \.gif, \.mp4"):
        spatial.animate(rollouts, controller, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_to_is_a_bad_input(controller, rollouts, tmp_path):
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(BadInput, match="taken"):
        spatial.animate(rollouts, controller, tmp_path / "taken" / "film.gif", frames=2)


def test_without_ffmpeg_mp4_says_what_to_do(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BadInput, match=r"film\.mp4: .*'ffmpeg': install it, or write a \.gif"):
        check_film(tmp_path / "film.mp4")
    check_film(tmp_path / "film.gif")


@pytest.fixture
def ffmpeg(monkeypatch, tmp_path):
    """A stand-in for ffmpeg: it writes what it is fed to the file it is told last, or fails."""

    def make(script):
        program = tmp_path / "bin" / "ffmpeg"
        program.parent.mkdir()
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")

    return make


def test_mp4_is_every_frame_and_the_last_one_held(ffmpeg, tmp_path):
    ffmpeg('for last; do :; done\ncat > "$last"')
    images = [np.full((40, 60, 3), shade, dtype=np.uint8) for shade in (0, 100, 200)]
    write_film(tmp_path / "film.mp4", lambda k: images[k], 3)
    fed = np.frombuffer((tmp_path / "film.mp4").read_bytes(), dtype=np.uint8).reshape(-1, 40, 60, 4)[..., :3]
    assert len(fed) == 3 + 1500 // 80
    for image, shown in zip([*images, images[2]], fed[:4], strict=True):
        np.testing.assert_array_equal(shown, image)


def test_ffmpeg_that_fails_is_a_bad_input_and_leaves_no_file(ffmpeg, tmp_path):
    ffmpeg("cat > /dev/null; exit 3")
    with pytest.raises(BadInput, match="ffmpeg failed"):
        write_film(tmp_path / "film.mp4", lambda _: np.zeros((40, 60, 3), dtype=np.uint8), 2)
    assert not (tmp_path / "film.mp4").exists()
