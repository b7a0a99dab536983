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
    assert "held out, person: C" in out
    assert out.count("RHip, RKnee, RAnkle; forward x, up y; of ") == 3
    assert out.count("forward x, up z; of ") == 3
    persistence = number(r"persistence: +([\d.]+) mm", out)
    assert 60 < persistence < 160
    assert 10 * number(r"this model: +([\d.]+) mm", out) < persistence


@pytest.mark.slow
def test_walking_asks_for_the_joints(tmp_path):
    path = tmp_path / "trial.txt"
    names = ["m1", "r_hip", "l_hip"]
    head = "Time" + "".join(f"\t{name}{axis}" for name in names for axis in "XYZ")
    path.write_text(
        f"{head}\n" + "".join(f"{k}" + "\t1\t2\t3" * 3 + "\n" for k in "01")
    )
    message = refusal(tmp_path, "--data", path, "--rate", "60")
    assert "Name them by --hip, --knee and --ankle" in message
    assert "There are m1, r_hip, l_hip." in message
    assert "hip r_hip or l_hip, knee ?, ankle ?." in message


def refusal(tmp_path, *arguments):
    """Run the example of walking, which is to end with a message, and return it."""
    command = [sys.executable, EXAMPLES / "plot_walking.py", *map(str, arguments)]
    result = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode > 0
    assert "Traceback" not in result.stderr
    return result.stderr


@pytest.fixture
def walk(tmp_path):
    """Write the markers of some frames, and change them before."""

    def write(name="walk.trc", change=lambda markers: None, n_frames=None, rate="100"):
        trial = make_walking(speeds=[1.2], n_strides=3, rate=100.0, random_state=0)
        markers = {k: x[:n_frames] for k, x in trial.markers[0].items()}
        change(markers)
        frames = np.arange(len(markers["hip"]))
        rows = np.column_stack([frames, frames / 100, *markers.values()])
        head = f"PathFileType\t4\nDataRate\tUnits\n{rate}\tmm\nFrame#\tTime\t"
        head += "\t\t\t".join(markers) + "\n\t" + "\tX\tY\tZ" * 3
        path = tmp_path / name
        np.savetxt(path, rows, "%.9g", "\t", header=head, comments="")
        return path

    return write


DLC = "scorer{}\nindividuals{}\nbodyparts{}\ncoords{}\n0,1,2,3,4\n1,1,2,3,4\n".format(
    ",n" * 4, ",a,a,b,b", ",hip" * 4, ",x,y,x,y"
)


@pytest.mark.slow
def test_walking_says_what_is_wrong_by_its_options(tmp_path, walk):
    poses = tmp_path / "poses.csv"
    poses.write_text(DLC)
    for arguments, message in [
        (["--data", "none.trc"], "No such file or directory: 'none.trc'"),
        (["--data", poses], "pass --individual, such as --individual 'a'"),
        (["--data", poses, "--individual", "a"], "pass --rate, such as --rate 100"),
        (["--data", poses, "--up", "q"], "--up: invalid choice: 'q'"),
        (["--data", walk(), "--up=y", "--forward=-y"], "are not orthogonal"),
        (["--data", walk(), "--rate", "50"], "--rate 100"),
        (["--data", walk(), "--rate", "50", "60"], "one for each file of --data"),
        (["--data", walk(), "--pieces", "2"], "pass more --pieces"),
        (["--data", walk(), "--pieces", "0"], "at least one of --pieces"),
        (
            ["--data", walk(), "--hip", "hip", "--knee", "knee", "--ankle", "foot"],
            "walk.trc: foot is none of hip, knee, ankle",
        ),
        (
            ["--data", walk(), "--hip", "hip", "--knee", "knee", "--ankle", "knee"],
            "another --hip, --knee and --ankle",
        ),
    ]:
        assert message in refusal(tmp_path, *arguments), arguments
    path = walk("lost.trc", lambda m: m["knee"].fill(np.nan))
    assert "lost.trc: knee is lost in all frames" in refusal(tmp_path, "--data", path)


@pytest.mark.slow
def test_walking_prints_what_it_chose(tmp_path, walk):
    def lose(markers):
        markers["knee"][50:53] = np.nan  # filled
        markers["ankle"][100:130] = np.nan  # cut
        for marker in markers.values():
            marker[:, 0] *= -1.1
            marker[:, 1:] *= 1.1

    files = [walk("a.trc"), walk("b.trc", lose, rate="")]
    out = run("plot_walking.py", tmp_path, "--data", *files, "--rate", "100", "100")
    assert (
        "a.trc: hip, knee, ankle; forward x, up y; of 352 frames 0 filled, 0 c" in out
    )
    assert (
        "b.trc: hip, knee, ankle; forward -x, up y; of 352 frames 3 filled, 30" in out
    )
    assert re.search(r"The legs of the files are 850 to 935 mm long.* --person\.", out)
    assert re.search(r"held out, trial: .*b\.trc", out)


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
