"""``planopt path`` and ``report``: files for other programs, and the page of a saved result."""

from pathlib import Path
from typing import Annotated

from planopt.commands.options import JsonOption, ResultArgument, option
from planopt.commands.output import progress, show
from planopt.errors import InputError


def export_path(
    result: ResultArgument,
    out: Annotated[
        Path, option("--out", "FILE", "Ends in .json, .geojson, .plan, .csv, .mcap or .rrd.")
    ],
    robot: Annotated[
        str | None, option("--robot", "NAME", "Robot; default: the first one.")
    ] = None,
    origin: Annotated[
        str | None,
        option("--origin", "LAT,LON", "Position of (0, 0) in degrees; default: that of the log."),
    ] = None,
    altitude: Annotated[
        float, option("--altitude", "M", "Altitude above the start, for drones.")
    ] = 0.0,
    json: JsonOption = False,
) -> int:
    """Write the path of a saved plan or run for other programs.

    .json is for ROS, .plan for QGroundControl. .mcap (Foxglove) and .rrd (Rerun) are recordings of
    all robots with their plans, powers and the map.
    """
    from planopt.planning.files.path_files import path_of_result, save_path
    from planopt.planning.files.recordings import RECORDERS
    from planopt.planning.loop.results import Run, Solution
    from planopt.tasks.calls import load_result
    from planopt.world.geodesy import parse_origin

    place = None if origin is None else parse_origin(origin)
    with progress("reading"):
        found = load_result(result)
    if not isinstance(found, Solution | Run):
        raise InputError("is no plan or run of robots", file=result, remedy="name one of a motion")
    if out.suffix.lower() in RECORDERS:
        with progress("writing"):
            found.save_recording(out)
        robots = len(found.problem.robots)
        words = f"{out}: recording of {robots} robot{'' if robots == 1 else 's'}"
        show(json, {"file": str(out), "robots": robots}, words)
        return 0
    path = path_of_result(found, 0 if robot is None else robot)
    save_path(path, out, place, altitude)
    data = {"file": str(out), "robot": path.robot, "positions": len(path.t_s)}
    show(json, data, f"{out}: {len(path.t_s)} positions of {path.robot}")
    return 0


def report(result: ResultArgument, json: JsonOption = False) -> int:
    """Write report.html, a page with map and charts, next to a result."""
    from planopt.files.writing import write_text
    from planopt.report.page import PAGE_FILE, page_html
    from planopt.report.page_content import comparison_page
    from planopt.studies.comparison import Comparison
    from planopt.tasks.calls import load_result

    with progress("reading"):
        found = load_result(result)
    with progress("drawing"):
        if isinstance(found, Comparison):
            page = comparison_page(found)
        else:
            page = found.task.page(found)
        file = (result if result.is_dir() else result.parent) / PAGE_FILE
        write_text(file, page_html(page))
    steps = 0 if page.map is None else len(page.map.times_s) - 1
    data = {"file": str(file), "title": page.title, "steps": steps}
    show(json, data, f"{file}: {page.title}")
    return 0
