"""The task pursuit_design: command, saved folder, and what is impossible."""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import planopt
from planopt import NoPlanError
from planopt.problems.library import library_folder
from planopt.problems.load import with_changes
from planopt.report import comparison_text, draw_comparison

TEXT = (library_folder() / "pursuit_design.toml").read_text()
PLAIN = """
[problem]
schema = 1
name = "plain"
task = "pursuit_design"
[pursuit]
evader_speed_m_s = 1.0
pursuer_speed_m_s = 2.0
[network]
levels = 6
mote_spacing_m = 1.0
bit_rate_bit_s = 1e6
header_bits = 64
record_bits = 16
energy_j_per_bit = 1e-6
[design]
margin = 1e-9
[report]
figures = false
"""


@pytest.fixture
def written(tmp_path: Path):
    """Write a problem file with some texts replaced."""

    def write(text: str = PLAIN, **changes: str) -> Path:
        for old, new in changes.items():
            line = next(line for line in text.splitlines() if line.startswith(f"{old} ="))
            text = text.replace(line, f"{old} = {new}")
        file = tmp_path / "problem.toml"
        file.write_text(text)
        return file

    return write


def test_example(written, run):
    """4096 motes, alpha 2: 24.29 W at six bits, proven, the programme 24.2855 W below it."""
    code, found = run("solve", written())
    assert code == 0 and found["verdict"] == "verified" and found["sense"] == "min"
    assert found["bits_per_axis"] == 6 and found["rate_divisor"] == 1
    assert found["cost_w"] == pytest.approx(24.2876, abs=1e-4) == found["objective"]
    assert found["relaxed_cost_w"] == pytest.approx(24.2855, abs=1e-4)
    assert 0.0 <= found["gap"] <= 1e-8 and found["bound_method"]
    assert found["relaxed_cost_w"] <= found["bound"] <= found["cost_w"]
    slot_s = (1 - (0.5 + 1.5 * np.sqrt(2) / 2**6)) / (12 * 9)
    assert found["slot_width_s"] == pytest.approx(slot_s, rel=1e-7)
    assert found["binding"] == ["lemma"] and found["guarantee"]["theorem"] == "lemma"
    assert [row["bits_per_axis"] for row in found["cost_curve"] if row["fails"]][:2] == [1, 2]


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"pursuer_speed_m_s": "1.0"}, 2, "speed below the pursuer's: 1 m/s is not below"),
        ({"margin": "1e-9\nbits_per_axis = 2"}, 4, "1.03033 is not below 1"),
        ({"bit_rate_bit_s": "1e3"}, 4, "payload below the longest admissible slot: 0.876"),
        ({"margin": "1e-9\nbits_per_axis = 99"}, 2, "design.bits_per_axis"),
        ({"pursuer_speed_m_s": "2.0\ndeadline_s = 5.0"}, 2, "is not used by design.method"),
        ({"margin": "1e-9\nguarantee = 'snapshots'"}, 2, "which always uses the lemma"),
        ({"margin": "1e-9\nmethod = 'least_energy'"}, 2, "pursuit.first_distance_m is missing"),
        ({"levels": "3.5"}, 2, "network.levels"),
        ({"levels": "3\nlevel = 4"}, 2, "network.level is not a known key"),
    ],
)
def test_impossible(changes, code, words, written, run):
    """Each is named with the inequality that fails, by how much, or its key."""
    found, data = run("solve", written(**changes))
    text = data["error"] if code == 2 else data["message"]
    assert found == code
    assert words in text
    if code == 4:
        assert data["bound_method"] is data["bound"] is None
        assert data["verdict"] == "none" and data["inequality"]["margin"] < 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"capture_radius_m": "10.0"}, "floor below the capture radius"),
        ({"deadline_s": "20.0"}, "time to capture below the deadline"),
        ({"bit_rate_bit_s": "1e3"}, "slot of the payload below the longest admissible slot: 0."),
    ],
)
def test_requirements_out_of_reach(changes, words, written, run):
    """A radius under the floor, a deadline too soon, too slow a radio: no design; Python raises."""
    file = written(TEXT, **changes)
    code, data = run("solve", file)
    assert code == 4 and words in data["message"] and data["inequality"]["margin"] < 0.0
    with refused(NoPlanError):
        planopt.solve(planopt.load(file))


def test_energy_at_half_of_the_limit(written):
    """Least energy per capture is at exactly half of the Lemma's slot width."""
    text = PLAIN.replace("pursuer_speed", "first_distance_m = 30.0\npursuer_speed")
    power = planopt.solve(planopt.load(written(text, margin="1e-12\nbits_per_axis = 5"))).data
    half = written(text, margin="1e-12\nbits_per_axis = 5\nmethod = 'least_energy'")
    energy = planopt.solve(planopt.load(half)).data
    assert energy["slot_width_s"] == pytest.approx(0.5 * power["slot_width_s"], rel=1e-9)
    assert energy["binding"] == [] and energy["objective"] == energy["energy_per_capture_j"]
    front = [(row["capture_time_s"], row["energy_per_capture_j"]) for row in energy["pareto"]]
    times, energies = np.array(front).T
    assert len(front) > 10 and (np.diff(times) > 0.0).all() and (np.diff(energies) < 0.0).all()
    assert energies[-1] == pytest.approx(energy["objective"], rel=1e-6)


def test_slots_below_the_peak_load(written, run):
    """Slots of six blocks, the mean load, make records late: the guarantee is not proved.

    The default is the peak load: the same radio carries no design then.
    """
    code, data = run("solve", written(TEXT, bit_rate_bit_s="10e3\nslot_blocks = 6"))
    certificate = data["certificate"]
    assert (code, data["verdict"], certificate["slot_blocks"]) == (3, "feasible_unverified", 6)
    assert certificate["late_share"][3] == pytest.approx(0.464, abs=1e-3)
    assert "46.4 % of the level-3 records are late" in data["message"]
    assert certificate["reasons"] == [data["message"]]
    code, data = run("solve", written(TEXT, bit_rate_bit_s="10e3"))
    assert (code, data["verdict"]) == (4, "none")
    code, data = run("solve", written(TEXT, bit_rate_bit_s="37e3"))
    assert (code, data["certificate"]["slot_blocks"]) == (0, 30)
    assert data["certificate"]["late_share"] == [0.0] * 7


def test_library_problem(tmp_path, run):
    """Its picture is drawn, its guarantee checked; show, validate and schema know the task."""
    code, data = run("solve", "pursuit_design", "--out", tmp_path)
    assert code == 0 and data["binding"] and data["guarantee"]["holds"]
    assert data["capture_time_s"] <= 300.0
    assert (tmp_path / "design.png").stat().st_size > 10_000
    assert run("show", "pursuit_design")[1]["design"]["margin"] == 0.01
    assert run("validate", "pursuit_design") == (0, {"problem": "pursuit_design", "valid": True})
    assert "network" in run("schema", "--task", "pursuit_design")[1]["properties"]
    assert run("schema", "--task", "nothing")[0] == 2
    assert run("simulate", "pursuit_design")[0] == 2
    with refused():
        planopt.simulate(planopt.load("pursuit_design"))
    with refused():
        planopt.solve(planopt.load("pursuit_design"), horizon=3)


def test_designs_are_swept(tmp_path, run):
    """A comparison solves the design for each value of a key; a design that fails says so."""
    code, data = run(
        *("compare", "pursuit_design", "--sweep", "network.bit_rate_bit_s=64e3,250e3"),
        *("--out", tmp_path, "--first-seed", "0", "--seeds", "1"),
    )
    assert code == 0 and [one["seed"] for one in data["runs"]] == [0, 0]
    for one in data["runs"]:
        key, value = next(iter(one["sweep"].items()))
        changed = with_changes(planopt.load("pursuit_design"), {key: value})
        assert one["metrics"]["objective"] == planopt.solve(changed).data["objective"]
    assert planopt.check(tmp_path).verdict is planopt.Verdict.VERIFIED
    found = planopt.compare(
        planopt.load("pursuit_design"), sweep={"pursuit.deadline_s": [1e-3, 300.0]}
    )
    assert [one.outcome for one in found.runs] == ["no_plan", "verified"]
    lines = [line.split() for line in comparison_text(found).splitlines()]
    assert next(line for line in lines if line[:1] == ["0.001"])[1:5] == ["1", "1", "1", "-"]
    assert len(draw_comparison(found).axes) >= 2
