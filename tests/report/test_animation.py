"""The animation of a run: its frames, as the file has them."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor
from refusals import refused
from teams import team_run

from planopt.cli import main
from planopt.report import save_animation
from planopt.report.animation import FRAME_MS, LAST_MS, MOST_FRAMES, shown_steps
from planopt.report.panel import colour_of


def frames_of(path: Path) -> list[np.ndarray]:
    """The frames of a GIF as it is played, (height, width, 3) each; durations as stated."""
    frames: list[np.ndarray] = []
    with Image.open(path) as played:
        for number in range(played.n_frames):
            played.seek(number)
            frames.append(np.asarray(played.convert("RGB"), dtype=int))
            last = number == played.n_frames - 1
            assert played.info["duration"] == (LAST_MS if last else FRAME_MS)
    return frames


def coloured(frame: np.ndarray, colour: str) -> int:
    return int((frame == np.array(ImageColor.getrgb(colour))).all(axis=-1).sum())


@pytest.mark.parametrize("count", [1, 2, 7, MOST_FRAMES, MOST_FRAMES + 1, 1000])
def test_shown_steps(count):
    """The first and the last step are shown, evenly many between, and never too many."""
    steps = shown_steps(count)
    assert steps[0] == 0 and steps[-1] == count - 1 and len(steps) <= MOST_FRAMES + 1
    assert len(set(np.diff(steps[:-1]))) <= 1


def test_frames_show_more_of_the_path_each_step(simulation, tmp_path: Path):
    """A frame a step, the same in a second drawing; the line in the robot's colour only grows."""
    once, again = tmp_path / "deep" / "run.gif", tmp_path / "again.gif"
    save_animation(simulation, once)
    save_animation(simulation, again)
    frames = frames_of(once)
    np.testing.assert_array_equal(frames, frames_of(again))
    assert len(frames) == len(simulation.run.log.t_s)
    driven = [coloured(frame, colour_of(0)) for frame in frames]
    assert driven[0] > 0 and driven[-1] > driven[0]


@pytest.mark.parametrize("task", ["track", "map"])
def test_several_robots_have_their_colours(simulation, task, tmp_path: Path):
    """Every robot of a team is in every frame, also where there is no target."""
    save_animation(team_run(simulation, task), tmp_path / "run.gif")
    frames = frames_of(tmp_path / "run.gif")
    for frame in (frames[0], frames[-1]):
        assert all(coloured(frame, colour_of(number)) for number in range(3))


def test_another_ending_is_refused(simulation, tmp_path: Path):
    """Only GIF is written, and nothing where it is not."""
    with refused():
        save_animation(simulation, tmp_path / "run.mp4")
    assert list(tmp_path.iterdir()) == []


def test_command(tmp_path: Path, capsys):
    """``simulate --animation`` saves it with the pictures, and requires a folder."""
    assert main(["simulate", "open_field", "--animation"]) == 2
    assert "--out" in capsys.readouterr().err
    assert main(["simulate", "open_field", "--animation", "--out", str(tmp_path / "run")]) == 0
    assert {"run.gif", "run.png"} <= {file.name for file in (tmp_path / "run").iterdir()}
    assert main(["check", str(tmp_path / "run")]) == 0
