# pyright: basic
"""Animated GIFs, with a background drawn once and the artists of each frame on top.

All uses of Matplotlib's Agg canvas and Pillow, which are untyped, are in this module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planopt.errors import InputError
from planopt.files.writing import write_whole
from planopt.report.panel import (
    BLACK,
    FRAME,
    OBSTACLE,
    POWER_MAP,
    SERIES,
    WHITE,
    YELLOW,
    legend_below,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure
    from PIL.Image import Image

WIDTH_PX = 900  # Width of every frame
SAMPLED_STEPS = 9  # Number of evenly spaced steps whose artists appear in the legend
MOST_FRAMES = 90
"""Maximum number of frames; longer runs skip steps, so that files stay below about 2 MB."""
COLOURS = 64  # Number of palette entries for the background
MARKS = (*SERIES, YELLOW, FRAME, OBSTACLE, BLACK, WHITE)
"""Colours of marks with fixed palette entries; marks are too small to affect a frame's palette."""
SCALE_COLOURS = 48  # Number of palette entries for the colour bar
UNCHANGED = 255  # Palette entry for pixels that are unchanged from the previous frame
FRAME_MS, LAST_MS = 120, 2500  # Durations of each frame and of the last one in ms

LEGEND_COLUMNS = 4

DrawFrame = Callable[[int], Sequence["Artist"]]
"""Function that draws one step and returns its artists, which are removed after the frame."""


def animate(
    figure: Figure, path: Path, count: int, draw_frame: DrawFrame, entries: Sequence[Artist] = ()
) -> None:
    """Write `count` steps of a run as an animated GIF; `draw_frame` returns a step's artists."""
    if path.suffix.lower() != ".gif":
        raise InputError(
            f"cannot write an animation to {path.name}: the ending {path.suffix!r} is not "
            "supported",
            remedy="use a name that ends in .gif",
        )
    images = _with_palette(list(frames(figure, count, draw_frame, entries)))
    durations = [FRAME_MS] * (len(images) - 1) + [LAST_MS]
    write_whole(
        path,
        lambda temporary: images[0].save(
            temporary,
            save_all=True,
            append_images=images[1:],
            duration=durations,
            loop=0,
            optimize=False,
            disposal=1,
            transparency=UNCHANGED,
        ),
    )


def frames(
    figure: Figure, count: int, draw_frame: DrawFrame, entries: Sequence[Artist] = ()
) -> Iterator[Image]:
    """Yield the frames of a run from its start to its end."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure.set_dpi(WIDTH_PX / float(figure.get_size_inches()[0]))
    canvas = FigureCanvasAgg(figure)
    # The layout is computed once, including the legend, and kept.
    steps = np.linspace(0, count - 1, SAMPLED_STEPS).round().astype(int).tolist()
    sample = [artist for step in sorted(set(steps)) for artist in draw_frame(step)]
    named = {str(artist.get_label()): artist for artist in sample}
    shown = [artist for label, artist in named.items() if label and not label.startswith("_")]
    legend_below(figure, [*entries, *shown], LEGEND_COLUMNS)
    canvas.draw()
    figure.set_layout_engine("none")
    for artist in sample:
        artist.remove()
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    for step in shown_steps(count):
        canvas.restore_region(background)
        drawn: list[Any] = sorted(draw_frame(step), key=lambda artist: artist.get_zorder())
        for artist in drawn:
            artist.draw(canvas.renderer)
        yield Image.fromarray(np.array(canvas.buffer_rgba())[..., :3])
        for artist in drawn:
            artist.remove()


def shown_steps(count: int) -> list[int]:
    """Return evenly spaced steps, including the first and the last."""
    every = -(-count // MOST_FRAMES)
    return sorted({*range(0, count, every), count - 1})


def _with_palette(images: Sequence[Image]) -> list[Image]:
    """Return all frames in the palette of the last frame, with unchanged pixels transparent."""
    from matplotlib import colormaps
    from PIL import Image, ImageColor

    ground = (images[-1].quantize(COLOURS).getpalette() or [])[: 3 * COLOURS]
    scale = colormaps[POWER_MAP](np.linspace(0.0, 1.0, SCALE_COLOURS), bytes=True)[:, :3]
    marks = [part for colour in MARKS for part in ImageColor.getrgb(colour)]
    marks += np.asarray(scale).ravel().tolist()
    palette = Image.new("P", (1, 1))
    palette.putpalette(ground + marks)
    indices = [
        np.array(image.quantize(palette=palette, dither=Image.Dither.NONE)) for image in images
    ]
    found: list[Any] = []
    for number, index in enumerate(indices):
        shown = index
        if number:
            shown = np.where(index == indices[number - 1], np.uint8(UNCHANGED), index)
        image = Image.fromarray(shown.astype(np.uint8), mode="P")
        image.putpalette(ground + marks)
        found.append(image)
    return found
