"""The examples that reproduce the figures of the paper: what they print."""

import re

import numpy as np
import pytest
from test_examples import number, run

from sklearn_koopman.datasets import make_walking


def table(text, first_cell):
    """Return the numbers of each line that starts with the pattern, by its match."""
    lines = {}
    for line in text.splitlines():
        if found := re.match(first_cell, line):
            rest = line[found.end() :].replace("\N{PLUS-MINUS SIGN}", " ")
            numbers = re.findall(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?", rest)
            lines[found[0].strip()] = [float(x) for x in numbers]
    return lines


@pytest.mark.slow
def test_pendulum_surface(tmp_path):
    out = run("plot_pendulum_surface.py", tmp_path)
    assert "256 samples" in out
    assert number(r"M = (\d+) centres", out) == 37  # as in the paper
    separation = number(r"separation distance ([\d.]+)", out)
    assert 0.115 < separation < 0.12  # half of 0.23, and a little more
    assert separation < number(r"fill distance ([\d.]+)", out) < 0.23
    kernels = table(out, r"(Matern-3/2|Wendland C4) +(?=\d)")
    (on, off, nothing), (on_compact, off_compact, nothing_compact) = kernels.values()
    assert on < 0.002
    assert 0.01 < on_compact < 0.05
    assert 1 < off < off_compact
    # The one decays, the other vanishes away from the orbit, as the paper has it.
    assert nothing == 0
    assert 5 < nothing_compact < 50
    assert number(r"Matern-3/2: \+([\d.]+)", out) > 0.005
    assert number(r"as printed: (-[\d.]+), not positive definite", out) < -0.1
    assert number(r"as printed: off by up to ([\d.e+-]+)", out) > 0.01
    assert number(r"matrix of the centres: off by up to ([\d.e+-]+)", out) < 1e-12


@pytest.mark.slow
def test_beta(tmp_path):
    out = run("plot_beta.py", tmp_path)
    assert number(r"M = (\d+) centres", out) == 37
    lines = table(out, r" +(5|1|0\.5|0\.2)(?= )")
    assert list(lines) == ["5", "1", "0.5", "0.2"]
    on, largest, mean, condition, digits, norm = np.array(list(lines.values())).T
    assert (np.diff([on, largest, mean]) > 0).all()  # the larger, the better
    assert (np.diff(condition) < 0).all()  # and the worse conditioned
    assert on[0] < 1e-3
    assert on[-1] > 0.1
    assert condition[0] > 1e5
    assert np.allclose(digits, np.log10(condition), rtol=0, atol=0.06)
    assert norm.argmin() == 1


@pytest.mark.slow
def test_convergence(tmp_path):
    out = run("plot_convergence.py", tmp_path)
    lines = table(out, r"(Matern \d/2|Wendland C\d)(?=  )")
    orders = {f"Matern {2 * k - 1}/2": k for k in (1, 2, 3)}
    orders |= {f"Wendland C{2 * k - 2}": k for k in (1, 2, 3, 4)}
    assert lines.keys() == orders.keys()
    for name, values in lines.items():
        _, slope, half, rms_slope, rms_half, guaranteed, twice, error, _ = values
        order = orders[name]
        assert guaranteed == order - 0.5
        assert twice == 2 * order
        assert slope >= guaranteed
        assert abs(slope - twice) < 0.5
        assert abs(rms_slope - twice) < 0.5
        assert 0 < max(half, rms_half) < 1
        assert error < 10 ** -(1 + twice)
    assert lines["Matern 3/2"][1] == pytest.approx(3.8, abs=0.3)
    assert lines["Wendland C4"][1] == pytest.approx(5.7, abs=0.3)
    assert lines["Wendland C6"][-2] < 1e-12  # rounding
    assert "at least the guaranteed one: True" in out
    assert 1e-4 < number(r"half the time step: ([\d.e+-]+),", out) < 1e-2


@pytest.mark.slow
def test_conditioning(tmp_path):
    out = run("plot_conditioning.py", tmp_path)
    assert "2 to 64 centres of 256 samples" in out
    lines = table(out, r"(Wendland C\d|Matern-3/2), beta = [\d.]+(?= )")
    assert len(lines) == 7
    for few, _, many, _, expected, *condition in lines.values():
        assert abs(many - expected) < 0.4
        assert abs(many - expected) < abs(few - expected)
        assert condition[1] > 1000 * condition[0]
    expected = [line[4] for line in lines.values()]
    assert expected == [-4, -6, -8, -4, -4, -4, -4]
    by_scale = [line[-1] for line in list(lines.values())[3:]]
    assert (np.diff(by_scale) < 0).all()  # a smaller scale is better conditioned
    assert "in this order: 64\n" in out
    assert re.search(r"kernel +M = 7 +M = 13 +M = 19 +M = 37 ", out)
    crowded = table(out, r"Wendland C\d(?=  )")
    assert len(crowded) == 4
    for name, (*slopes, bound) in crowded.items():
        smoothness = int(name[-1])
        assert bound == smoothness + 1
        # One pair costs the square of its distance, whatever the bound allows.
        assert np.allclose(slopes, 2 if smoothness else 1, rtol=0, atol=0.2)


@pytest.mark.slow
def test_kinematics_on_the_trial_of_gaitkit(tmp_path):
    pytest.importorskip("gaitkit", reason="gaitkit carries the recorded trial")
    out = run("plot_kinematics.py", tmp_path)
    assert "SYNTHETIC" not in out
    assert "748 samples of 2 trials or legs at 150 Hz, 746 pairs" in out
    assert 700 < number(r"M = (\d+) centres", out) < 746  # most
    forward, up = map(float, re.findall(r"a range of (\d+)", out))
    assert forward > 2 * up
    assert number(r"at the centres +([\d.e+-]+)", out) < 1e-3
    (third, trial), (delayed, delayed_trial) = (
        table(out, rf"{name} +(?=\d)").popitem()[1]
        for name in ("these two angles", "with two delayed copies")
    )
    assert delayed < third / 2  # gait has a memory
    assert delayed_trial < trial / 2


@pytest.mark.slow
def test_kinematics_with_as_many_centres_as_the_paper(tmp_path, walking_file):
    out = run(
        *("plot_kinematics.py", tmp_path),
        *("--data", walking_file, "--samples", "5000"),
    )
    # Two trials, and no pair across them.
    assert "5000 samples of 2 trials or legs at 150 Hz, 4998 pairs" in out
    assert number(r"M = (\d+) centres", out) == 4249
    assert number(r"0.5 rad as printed: (\d+)", out) == 3
    stays = table(out, r"the ankle stays +(?=\d)").popitem()[1]
    angles = table(out, r"these two angles +(?=\d)").popitem()[1]
    assert angles[1] > 0.8 * stays[1]  # next to nothing on another trial


@pytest.mark.slow
def test_kinematics_on_synthetic_walking(tmp_path):
    out = run("plot_kinematics.py", tmp_path, "--synthetic")
    assert "SYNTHETIC walking, nothing measured" in out
    assert number(r"at the centres +([\d.e+-]+)", out) < 1e-3


@pytest.mark.slow
def test_kinematics_on_a_single_trial(tmp_path):
    """One trial has a last third to leave out, but no other trial to learn from."""
    walking = make_walking(speeds=[1.2], n_strides=3, rate=100.0, random_state=0)
    (markers,) = walking.markers
    path = tmp_path / "trial.npz"
    np.savez(path, trial=np.ones(len(markers["hip"])), rate=100.0, **markers)
    out = run("plot_kinematics.py", tmp_path, "--data", path, "--samples", "150")
    assert "150 samples of 1 trial at 100 Hz, 149 pairs" in out
    assert "last trial" not in out
    assert len(table(out, r"these two angles +(?=\d)").popitem()[1]) == 1
