"""The comparison as text."""

from dataclasses import replace

from planopt.report.tables import comparison_text


def test_exact_lines(comparison):
    """Every number, its unit, its order and its alignment."""
    lines = comparison_text(comparison).splitlines()
    assert lines[0].startswith("small: 8 runs in 3.2 s; means over runs")
    assert lines[1] == ""
    assert [" ".join(line.split()) for line in lines[3:]] == [
        "geodesic auto 10 2 0 60.5 (54.1 to 66.9) 90.0 2.0 - 87.5 1.23 12.5 40.0",
        "geodesic auto 1 2 2 - 90.0 2.0 - 87.5 1.23 12.5 40.0",
        "connected lattice 10 2 0 60.5 (54.1 to 66.9) 90.0 2.0 - 87.5 1.23 12.5 40.0",
        "connected lattice 1 2 0 51.5 (45.1 to 57.9) 90.0 2.0 - 87.5 1.23 12.5 40.0",
    ]
    assert len({len(line) for line in lines[2:]}) == 1


def test_columns_line_up_under_the_header(comparison):
    """Each number ends where its heading ends."""
    header, *lines = comparison_text(comparison).splitlines()[2:]
    for heading, value in (("step p95 [ms]", "40.0"), ("verified [%]", "87.5")):
        end = header.index(heading) + len(heading)
        assert all(line[:end].endswith(value) for line in lines)


def test_mean_without_interval(comparison):
    """One run has a mean and no interval."""
    row = replace(comparison.rows[0], seeds=1, mean=61.25, ci_low=None, ci_high=None)
    (line,) = comparison_text(replace(comparison, rows=(row,))).splitlines()[3:]
    assert line.split()[:7] == ["geodesic", "auto", "10", "1", "0", "61.2", "-"]
