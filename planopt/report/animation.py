# pyright: basic
"""Animated GIFs: a background that is drawn once, and the artists of each frame on top of it.

This file is the boundary to Matplotlib's Agg canvas and to Pillow, which leave what is used here
untyped.
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

DPI = 76

SAMPLED_STEPS = 9
"""Number of steps, evenly spaced, whose artists the legend lists."""

MOST_FRAMES = 90
"""Longer runs show every second or third step, so that files stay below some 2 MB."""

COLOURS = 64
"""Palette entries for the background."""

MARKS = (*SERIES, YELLOW, FRAME, OBSTACLE, BLACK, WHITE)
"""Palette entries for the marks, which cover too little of a frame to be chosen."""

SCALE_COLOURS = 48
"""Palette entries for the colour bar."""

UNCHANGED = 255
"""Palette entry of pixels that are as in the frame before."""

FRAME_MS, LAST_MS = 120, 2500
"""Duration of each frame and of the last one."""

LEGEND_COLUMNS = 4

DrawFrame = Callable[[int], Sequence["Artist"]]
"""Draws the artists of one step and returns them; they are removed after the frame."""


def animate(
    figure: Figure, path: Path, count: int, draw_frame: DrawFrame, entries: Sequence[Artist] = ()
) -> None:
    """Write the steps of a run as an animated GIF, whole or not at all.

    Parameters
    ----------
    figure
        With the background drawn.
    path
        Ends in ``.gif``; its folder is made if it is missing.
    count
        Number of steps; at most about `MOST_FRAMES` of them are shown.
    draw_frame
        Draws one step and returns its artists. Those with a label appear in the legend.
    entries
        Further legend entries.

    Raises
    ------
    InputError
        The path has another suffix.
    OutputError
        The file cannot be written.
    """
    if path.suffix.lower() != ".gif":
        raise InputError(
            f"{path.name}: an animation cannot be written as "
            f"{path.suffix or 'a file without ending'!r}",
            remedy="end the name in .gif",
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
    """Draw the frames of a run, the first at its start, the last at its end."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    # The layout is found once, with the legend, and kept.
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
    """Return the evenly spaced steps that are shown, the first and the last among them."""
    every = -(-count // MOST_FRAMES)
    return sorted({*range(0, count, every), count - 1})


def _with_palette(images: Sequence[Image]) -> list[Image]:
    """Give all frames the palette of the last one, and leave out pixels that did not change."""
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
