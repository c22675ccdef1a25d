"""The design chart of a pursuit's network: power by slot width, what is worth what, the front."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from planopt.pursuit.design import DesignTask
from planopt.report.panel import Panel, add_panel, new_figure
from planopt.report.style import BLACK, BLUE, SERIES, VERMILLION, dress, head, legend_inside, spaced

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMES = {
    "evader_speed_m_s": "evader's speed",
    "pursuer_speed_m_s": "pursuer's speed",
    "bit_rate_bit_s": "bit rate",
    "header_bits": "header",
    "record_bits": "record",
    "mote_spacing_m": "mote spacing",
}
"""Of sensitivities."""

CURVES = 5
"""Numbers of bits whose power is drawn: those that cost least."""


def draw_design(task: DesignTask, data: Mapping[str, Any]) -> Figure:
    """Draw the answer to a design problem."""
    from matplotlib.gridspec import GridSpec

    figure = new_figure(13.0, 4.6)
    grid = GridSpec(1, 3, figure=figure)
    _power(add_panel(figure, grid[0, 0]), task, data)
    _worth(add_panel(figure, grid[0, 1]), data)
    _front(add_panel(figure, grid[0, 2]), data)
    head(
        figure,
        f"{spaced(data['problem'])}: {data['cost_w']:.4g} W, binding: "
        f"{spaced(' and '.join(data['binding'])) or 'nothing'}",
    )
    return figure


def _power(panel: Panel, task: DesignTask, data: Mapping[str, Any]) -> None:
    """Power over the slot width, from the payload's slot to the widest, by bits."""
    rows = [row for row in data["cost_curve"] if row["objective"] is not None]
    rows = sorted(
        sorted(rows, key=lambda row: row["objective"])[:CURVES],
        key=lambda row: row["bits_per_axis"],
    )
    divisor = data["rate_divisor"]
    for number, row in enumerate(rows):
        bits, widest_s = row["bits_per_axis"], row["slot_width_s"]
        least_s = task.network.least_slot_s(bits)
        first_s = max(0.4 * widest_s, min(least_s, widest_s))
        slots_s = np.linspace(first_s, widest_s, 60, dtype=np.float64).tolist()
        power_w = [task.network.power_w(slot, bits, divisor) for slot in slots_s]
        colour = SERIES[number % len(SERIES)]
        slots_ms = [1e3 * slot for slot in slots_s]
        panel.plot(slots_ms, power_w, color=colour, linewidth=1.6, label=f"{bits} bits")
        panel.plot([1e3 * widest_s], power_w[-1:], color=colour, marker="o", markersize=5.0)
    panel.plot(
        [1e3 * data["slot_width_s"]],
        [data["cost_w"]],
        color=BLACK,
        marker="*",
        markersize=14.0,
        linestyle="none",
        label="chosen",
    )
    dress(panel, "power by slot width and compression", "slot width [ms]", "power [W]")
    legend_inside(panel)


def _worth(panel: Panel, data: Mapping[str, Any]) -> None:
    found = sorted(data["sensitivities"].items(), key=lambda item: abs(item[1]))
    for place, (_, value) in enumerate(found):
        colour = VERMILLION if value > 0.0 else BLUE
        panel.plot([0.0, value], [place, place], color=colour, linewidth=9.0, solid_capstyle="butt")
    panel.plot([0.0, 0.0], [-0.5, len(found) - 0.5], color=BLACK, linewidth=0.8)
    panel.set_yticks(list(range(len(found))), [NAMES[name] for name, _ in found])
    what = "energy" if data["objective_name"] == "energy_per_capture_j" else "power"
    dress(panel, "one per cent more of a quantity", f"change of the least {what} [%]", "")


def _front(panel: Panel, data: Mapping[str, Any]) -> None:
    front = data["pareto"]
    if not front:
        panel.set_axis_off()
        panel.text(0.1, 0.5, "no first distance is given:\nno time to capture")
        return
    times_s = [row["capture_time_s"] for row in front]
    energies_j = [row["energy_per_capture_j"] for row in front]
    panel.plot(times_s, energies_j, color=BLUE, marker="o", markersize=4.0, linewidth=1.4)
    dress(
        panel,
        "energy against time, by the Lemma",
        "longest time to capture [s]",
        "energy a capture [J]",
    )
