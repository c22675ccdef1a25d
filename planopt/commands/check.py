"""``planopt check``: judge a saved plan or run again, from the files alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planopt.commands.options import JsonOption
from planopt.commands.output import progress, show

REJECTED = 3


def check(
    path: Annotated[
        Path, typer.Argument(metavar="PATH", help="The folder given as --out, or its JSON file.")
    ],
    json: JsonOption = False,
) -> int:
    """Audit saved results from their files alone. Exit code 0 agrees, 3 rejects."""
    from planopt.planning.certificate import excused_in_words, excused_steps
    from planopt.planning.files.record import plain
    from planopt.planning.files.result_json import certificate_json, no_certificate_json
    from planopt.planning.plan import Verdict
    from planopt.tasks.calls import check as checked
    from planopt.tasks.motion_words import apart_in_words, planned_in_words

    with progress("checking"):
        result = checked(path)
    certificate = (
        no_certificate_json(result.reasons)
        if result.certificate is None
        else certificate_json(result.certificate)
    )
    planned = planned_in_words(certificate["min_clearance_m"], certificate["min_connectivity"])
    rule = None if result.certificate is None else result.certificate.rule
    excused = excused_steps(result.certificates)
    data = {
        "verdict": result.verdict.value,
        "certificate": certificate,
        "excused": plain(excused),
        "reasons": list(result.reasons),
        "remarks": list(result.remarks),
    }
    lines = [
        f"{path}: {result.verdict.value}",
        *([] if result.certificate is None else [f"  {planned}"]),
        *apart_in_words(certificate["min_separation_m"], certificate["min_moving_clearance_m"]),
        *([] if rule is None else [f"  {rule.words}"]),
        *(f"  {line}" for line in excused_in_words(excused)),
        *(f"  {reason}" for reason in result.reasons),
        *(f"  remark: {remark}" for remark in result.remarks),
    ]
    show(json, data, "\n".join(lines))
    return 0 if result.verdict is Verdict.VERIFIED else REJECTED
