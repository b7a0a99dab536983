"""The examples, run as a user runs them."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sklearn_koopman.datasets import make_walking

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name, tmp_path, *arguments):
    """Run an example in an empty folder and return what it printed."""
    figure = tmp_path / "figure.png"
    result = subprocess.run(
        [sys.executable, EXAMPLES / name, "--figure", figure, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""  # no warnings, either
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert figure.stat().st_size > 20_000
    return result.stdout


def number(pattern, text):
    return float(re.search(pattern, text)[1])


@pytest.mark.slow
def test_walking_on_the_trial_of_gaitkit(tmp_path):
    pytest.importorskip("gaitkit", reason="gaitkit carries the recorded trial")
    out = run("plot_walking.py", tmp_path)
    persistence = number(r"persistence: +([\d.]+) mm", out)
    error = number(r"this model: +([\d.]+) mm", out)
    assert 120 < persistence < 140
    assert 8 * error < persistence


@pytest.mark.slow
def test_walking_on_a_marker_file(tmp_path):
    """A synthetic leg in a file of the tab-separated format, in metres."""
    trial = make_walking(speeds=[1.2], n_strides=4, rate=100.0, random_state=0)
    names = {"hip": "hip", "knee": "knee", "ankle": "ankle"}
    header = ["Time"] + [f"{n}{axis}" for n in names for axis in "XYZ"]
    positions = np.hstack([trial.markers[0][n] / 1000 for n in names])
    rows = np.column_stack([np.arange(len(positions)), positions])
    path = tmp_path / "trial.txt"
    np.savetxt(
        path, rows, fmt="%.8g", delimiter="\t", header="\t".join(header), comments=""
    )
    out = run(
        "plot_walking.py",
        tmp_path,
        *["--data", path, "--rate", "100", "--unit", "m", "--pieces", "4"],
        *["--hip", "hip", "--knee", "knee", "--ankle", "ankle"],
    )
    persistence = number(r"persistence: +([\d.]+) mm", out)
    assert 80 < persistence < 200  # in mm, though the file is in metres
    assert 10 * number(r"this model: +([\d.]+) mm", out) < persistence


@pytest.mark.slow
def test_walking_on_files_of_several_persons(tmp_path):
    """Two trials of each of three persons, one in TRC and one of Vicon, which has z up.

    The last person, a child, is never seen in training.
    """
    for person, size in {"A": 1.0, "B": 0.9, "C": 0.7}.items():
        trials = make_walking(2, n_strides=4, rate=60.0, random_state=ord(person))
        for take, markers in enumerate(trials.markers):
            joints = [size * markers[joint] for joint in ("hip", "knee", "ankle")]
            if take:
                joints = [joint[:, [0, 2, 1]] for joint in joints]
            rows = np.column_stack([np.arange(len(joints[0])), *joints])
            rows = np.insert(rows, 1, rows[:, 0] / 60 if take == 0 else 0, axis=1)
            names = ["RHip", "RKnee", "RAnkle"]
            if take:
                head = "Trajectories\n60\n,,{},,,{},,,{},,\nFrame,Sub Frame"
                head = head.format(*(f"P:{name}" for name in names))
                head += ",X,Y,Z" * 3 + "\n," + ",mm" * 9
            else:
                head = "PathFileType\t4\nDataRate\tUnits\n60\tmm\nFrame#\tTime\t"
                head += "\t\t\t".join(names) + "\n\t" + "\tX\tY\tZ" * 3
            name = f"{person}.csv" if take else f"{person}.trc"
            mark = "," if take else "\t"
            np.savetxt(tmp_path / name, rows, "%.9g", mark, header=head, comments="")
    files = [tmp_path / f"{p}.{end}" for p in "ABC" for end in ("trc", "csv")]
    out = run("plot_walking.py", tmp_path, "--data", *files, "--person", *"AABBCC")
    assert "18 trajectories of 6 legs at 60 Hz" in out
    persistence = number(r"persistence: +([\d.]+) mm", out)
    assert 60 < persistence < 160
    assert 10 * number(r"this model: +([\d.]+) mm", out) < persistence


@pytest.mark.slow
def test_walking_asks_for_the_joints(tmp_path):
    path = tmp_path / "trial.txt"
    path.write_text("Time\tm1X\tm1Y\tm1Z\n0\t1\t2\t3\n1\t1\t2\t3\n")
    command = [sys.executable, EXAMPLES / "plot_walking.py", "--data", path]
    result = subprocess.run(
        [*command, "--rate", "60"], capture_output=True, text=True, check=False
    )
    assert result.returncode == 1
    assert "Name them by --hip, --knee and --ankle" in result.stderr
    assert "There are m1." in result.stderr


@pytest.mark.slow
def test_grid_search(tmp_path):
    out = run("plot_grid_search.py", tmp_path)
    assert number(r"two spellings: ([\d.e+-]+)", out) < 1e-10
    assert number(r"new pendulums: ([\d.]+)", out) < 0.01
    assert "loaded, predicts the same: True" in out


@pytest.mark.slow
def test_spectrum(tmp_path):
    out = run("plot_spectrum.py", tmp_path)
    assert number(r"off by ([\d.]+) %", out) < 0.1
    # The paper's 37 centres resolve six harmonics; their conjugates and 1 count, too.
    assert "13 of 37 eigenvalues have a residual below 0.01" in out


@pytest.mark.slow
def test_forecast(tmp_path):
    out = run("plot_forecast.py", tmp_path)
    persistence, repetition, _, relifted = (
        float(line.split()[-1])
        for line in out.splitlines()
        if re.match(r"persistence|repetition|this model,", line)
    )
    assert 300 < persistence < 400
    assert 10 < repetition < 30
    assert relifted < repetition


@pytest.mark.slow
def test_recordings(tmp_path):
    out = run("plot_recordings.py", tmp_path)
    assert "16 recordings of 8 persons to learn from, 22 of 11 to calibrate" in out
    errors = {
        name: np.array([float(cell) for cell in cells.split()])
        for name, cells in re.findall(
            r"^(forecast|last|linear|analogs) +(.+)$", out, re.M
        )
    }
    assert len(errors) == 4
    for name in ("last", "linear", "analogs"):
        assert (errors["forecast"] < errors[name]).all()
    assert errors["analogs"][0] > 5 * errors["forecast"][0]  # 0.1 s ahead
    assert 80 <= number(r"the bands hold (\d+)%", out) <= 100
