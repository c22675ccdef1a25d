"""Find what a figure shows."""

from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg


def panel_of(figure: Any, title: str) -> Any:
    (found,) = [axes for axes in figure.axes if title in axes.get_title(loc="left")]
    return found


def line_of(axes: Any, label: str) -> Any:
    (found,) = [line for line in axes.lines if line.get_label() == label]
    return found


def collection_of(axes: Any, label: str) -> Any:
    (found,) = [part for part in axes.collections if part.get_label() == label]
    return found


def labels_of(figure: Any) -> set[str]:
    texts = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel())]
    return {text for text in texts if text}


def legend_of(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def drawn(figure: Any) -> Any:
    """The figure, rendered: warnings of the layout and of the ticks come only then."""
    FigureCanvasAgg(figure).draw()
    return figure
