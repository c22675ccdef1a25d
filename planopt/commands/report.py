"""``planopt report``: the HTML page of a saved result."""

from planopt.commands.options import JsonOption, ResultArgument
from planopt.commands.output import progress, show


def report(result: ResultArgument, json: JsonOption = False) -> int:
    """Write report.html next to a saved result: map, time slider, charts and tables."""
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
