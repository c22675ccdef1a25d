"""The animation of a run: its frames, and the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor
from teams import team_run

from planopt.cli import main
from planopt.errors import InputError
from planopt.report.animation import FRAME_MS, LAST_MS, MOST_FRAMES, shown_steps
from planopt.report.motion_animation import animation_frames, save_animation
from planopt.report.style import robot_colour


def coloured(frame: Image.Image, colour: str) -> int:
    """How many pixels have a colour exactly."""
    pixels = np.asarray(frame.convert("RGB"))
    return int((pixels == np.array(ImageColor.getrgb(colour))).all(axis=-1).sum())


@pytest.mark.parametrize("count", [1, 2, 7, MOST_FRAMES, MOST_FRAMES + 1, 1000])
def test_shown_steps(count):
    """The first and the last step are shown, evenly many between, and never too many."""
    steps = shown_steps(count)
    assert steps[0] == 0 and steps[-1] == count - 1 and len(steps) <= MOST_FRAMES + 1
    assert len(set(np.diff(steps[:-1]))) <= 1


def test_frames_show_more_of_the_path_each_step(simulation):
    """A frame a step, of one size; the driven line in the robot's colour only grows."""
    frames = list(animation_frames(simulation))
    assert len(frames) == len(simulation.run.log.t_s)
    assert len({frame.size for frame in frames}) == 1
    driven = [coloured(frame, robot_colour(0)) for frame in frames]
    assert driven[0] > 0 and driven[-1] > driven[0]


def test_frames_leave_nothing_behind(simulation):
    """The first frame of a second drawing equals that of the first: a frame has its own step."""
    once, again = (list(animation_frames(simulation)) for _ in range(2))
    for one, other in zip(once, again, strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))
    assert (np.asarray(once[0]) != np.asarray(once[-1])).any()


@pytest.mark.parametrize("task", ["track", "map"])
def test_several_robots_have_their_colours(simulation, task):
    """Every robot of a team is in every frame, also where there is no target."""
    frames = list(animation_frames(team_run(simulation, task)))
    for frame in (frames[0], frames[-1]):
        assert all(coloured(frame, robot_colour(number)) for number in range(3))


def test_the_file_shows_the_frames(simulation, tmp_path: Path):
    """Played, the file shows each frame with colours at most a little off, for the stated times."""
    path = tmp_path / "deep" / "run.gif"
    save_animation(simulation, path)
    frames = list(animation_frames(simulation))
    with Image.open(path) as played:
        assert played.n_frames == len(frames)
        for number, frame in enumerate(frames):
            played.seek(number)
            shown = np.asarray(played.convert("RGB"), dtype=int)
            off = np.abs(shown - np.asarray(frame, dtype=int)).max(axis=-1)
            assert np.quantile(off, 0.95) <= 24
            assert played.info["duration"] == (LAST_MS if number == len(frames) - 1 else FRAME_MS)


def test_another_ending_is_refused(simulation, tmp_path: Path):
    """Only GIF is written, and nothing where it is not."""
    with pytest.raises(InputError, match=r"end the name in \.gif"):
        save_animation(simulation, tmp_path / "run.mp4")
    assert list(tmp_path.iterdir()) == []


def test_command(tmp_path: Path, capsys):
    """``simulate --animation`` saves it beside the pictures, and asks for a folder."""
    assert main(["simulate", "open_field", "--animation"]) == 2
    assert "--out" in capsys.readouterr().err
    assert main(["simulate", "open_field", "--animation", "--out", str(tmp_path / "run")]) == 0
    assert {"run.gif", "run.png"} <= {file.name for file in (tmp_path / "run").iterdir()}
    assert main(["check", str(tmp_path / "run")]) == 0
