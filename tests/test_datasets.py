"""Simulated data against mechanics, and marker files good and bad."""

import io
import pickle

import numpy as np
import pytest
from designs import every_pair
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from sklearn_koopman.datasets import (
    load_markers,
    load_trials,
    make_pendulum,
    make_walking,
)
from sklearn_koopman.kinematics import fill_gaps, leg_angles
from sklearn_koopman.trajectories import trajectory_pairs

# --- the pendulum -------------------------------------------------------------------


def energy(states):
    return states[..., 0] ** 2 / 2 - np.cos(states[..., 1])


def test_separation_of_the_paper_keeps_37_centres():
    kept = []
    for state in make_pendulum().X:
        if all(np.linalg.norm(state - other) > 0.23 for other in kept):
            kept.append(state)
    assert len(kept) == 37


def test_first_step_by_hand():
    data = make_pendulum(n_samples=1, step=0.1)
    half = -0.05 * np.sin(2.0)
    position = 2.0 + 0.1 * half
    momentum = half - 0.05 * np.sin(position)
    assert_array_equal(data.X, [[0.0, 2.0]])
    assert_allclose(data.X_next, [[momentum, position]], rtol=1e-15)
    assert_allclose(data.y, 1.5 - np.sin(position) + momentum**2 / 9, rtol=1e-15)


def test_rows_satisfy_their_maps():
    data = make_pendulum(40, initial=[[0, 2], [1.5, -0.3], [3.0, 0.0]], step=0.07)
    assert data.X.shape == (120, 2)
    assert_allclose(data.f(data.X), data.X_next, rtol=0, atol=1e-14)
    assert_allclose(data.G(data.X_next), data.y, rtol=0, atol=1e-14)
    assert_allclose(data.f(data.X[5]), data.X_next[5], rtol=0, atol=1e-14)
    assert_allclose(data.G(data.X[5]), data.outputs[0][5], rtol=0, atol=1e-14)
    assert_array_equal(data.groups, np.repeat([0, 1, 2], 40))
    assert_array_equal(data.X[data.groups == 1][0], [1.5, -0.3])


def test_two_step_form_of_the_recursion():
    # Second difference and central difference of the positions, as in the paper.
    h = 0.1
    states = make_pendulum(step=h).trajectories[0]
    momentum, position = states.T
    second = position[2:] - 2 * position[1:-1] + position[:-2]
    assert_allclose(second, -(h**2) * np.sin(position[1:-1]), rtol=0, atol=1e-14)
    central = (position[2:] - position[:-2]) / (2 * h)
    assert_allclose(central, momentum[1:-1], rtol=0, atol=1e-13)


def test_second_order_convergence_to_the_flow():
    flow = solve_ivp(
        lambda _, x: [-np.sin(x[1]), x[0]], (0, 4), [0.0, 2.0], rtol=1e-12, atol=1e-12
    ).y[:, -1]
    errors = [
        np.abs(make_pendulum(n, step=4 / n).X_next[-1] - flow).max()
        for n in (40, 80, 160, 320)
    ]
    assert_allclose(np.divide(errors[:-1], errors[1:]), 4, rtol=0.03)


def test_energy_oscillates_but_does_not_drift():
    deviations = []
    for step in (0.1, 0.05):
        states = make_pendulum(int(1000 / step), step=step).trajectories[0]
        deviation = np.abs(energy(states) - energy(states[0]))
        half = len(deviation) // 2
        assert_allclose(deviation[half:].max(), deviation[:half].max(), rtol=1e-3)
        deviations.append(deviation.max())
    assert_allclose(deviations[0] / deviations[1], 4, rtol=0.02)


def test_modified_energy_is_kept_to_fourth_order():
    # Backward error analysis: H + h^2 (p^2 U'' / 12 - U'^2 / 24), Hairer et al., IX.
    spans = []
    for h in (0.1, 0.05):
        momentum, position = make_pendulum(int(50 / h), step=h).trajectories[0].T
        modified = (
            momentum**2 / 2
            - np.cos(position)
            + h**2 * (momentum**2 * np.cos(position) / 12 - np.sin(position) ** 2 / 24)
        )
        spans.append(np.ptp(modified))
    assert_allclose(spans[0] / spans[1], 16, rtol=0.05)


def test_map_is_reversible_and_keeps_area():
    data = make_pendulum(50, initial="random", n_trajectories=4, random_state=3)
    flip = np.array([-1.0, 1.0])
    assert_allclose(flip * data.f(flip * data.X_next), data.X, rtol=0, atol=1e-14)
    shifts = 1e-6 * np.eye(2)
    columns = [(data.f(data.X + s) - data.f(data.X - s)) / 2e-6 for s in shifts]
    jacobian = np.stack(columns, axis=-1)
    assert_allclose(np.linalg.det(jacobian), 1, rtol=0, atol=1e-8)


def test_random_starts_are_librations():
    data = make_pendulum(
        2000, initial="random", n_trajectories=40, step=0.1, random_state=0
    )
    starts = np.array([states[0] for states in data.trajectories])
    amplitude = np.arccos(-energy(starts))
    assert 0.5 <= amplitude.min() < 0.8
    assert 2.2 < amplitude.max() <= 2.5
    assert all(np.abs(states[:, 1]).max() < 2.6 for states in data.trajectories)
    assert {tuple(quadrant) for quadrant in np.sign(starts)} == {
        (-1, -1),
        (-1, 1),
        (1, -1),
        (1, 1),
    }


def test_random_starts_by_formula():
    data = make_pendulum(1, initial="random", n_trajectories=50, random_state=0)
    rng = np.random.RandomState(0)
    amplitude, phase = rng.uniform(0.5, 2.5, 50), rng.uniform(0, 2 * np.pi, 50)
    momentum, position = data.X.T
    assert_allclose(position, amplitude * np.cos(phase), rtol=1e-14)
    assert_array_equal(np.sign(momentum), -np.sign(np.sin(phase)))
    assert_allclose(energy(data.X), -np.cos(amplitude), rtol=0, atol=1e-14)


def test_scattered_starts_have_the_stated_distribution():
    data = make_pendulum(1, initial="random", n_trajectories=2000, random_state=0)
    assert len(np.unique(data.groups)) == 2000
    amplitude = np.arccos(-energy(data.X))
    phase = np.arctan2(
        -np.sign(data.X[:, 0]) * np.sqrt(1 - (data.X[:, 1] / amplitude) ** 2),
        data.X[:, 1] / amplitude,
    )
    uniform = (np.arange(2000) + 0.5) / 2000
    # Kolmogorov-Smirnov distance; 0.036 has a level of 1 % at 2000 draws.
    assert np.abs(np.sort((amplitude - 0.5) / 2) - uniform).max() < 0.036
    assert np.abs(np.sort(phase % (2 * np.pi)) / (2 * np.pi) - uniform).max() < 0.036


def test_noise_has_its_size_and_states_are_measured_once():
    clean = make_pendulum(2000, initial="random", n_trajectories=3, random_state=5)
    data = make_pendulum(
        2000,
        initial="random",
        n_trajectories=3,
        noise=0.2,
        state_noise=0.05,
        random_state=5,
    )
    assert_allclose(np.std(data.y - clean.y), 0.2, rtol=0.03)
    assert_allclose(np.std(data.X - clean.X, axis=0), 0.05, rtol=0.03)
    correlation = np.corrcoef((data.X - clean.X).T, data.y - clean.y)
    assert np.abs(correlation - np.eye(3)).max() < 0.05
    follows = np.flatnonzero(np.diff(data.sample_index) == 1)
    assert len(follows) == 3 * 1999
    assert_array_equal(data.X_next[follows], data.X[follows + 1])
    # f and G stay free of noise.
    assert_array_equal(data.f(clean.X), clean.f(clean.X))
    assert_allclose(data.G(clean.X_next), clean.y, rtol=0, atol=1e-14)


def test_pendulum_feeds_trajectory_pairs():
    data = make_pendulum(
        20, initial="random", n_trajectories=3, noise=0.1, random_state=1
    )
    pairs = trajectory_pairs(data.trajectories, data.outputs)
    for name, part in pairs.items():
        assert_array_equal(data[name], part)


def test_pendulum_is_reproducible_and_its_maps_are_picklable():
    options = {"initial": "random", "n_trajectories": 2, "noise": 0.1}
    data = make_pendulum(9, **options, random_state=7)
    again = make_pendulum(9, **options, random_state=np.random.RandomState(7))
    assert_array_equal(data.X, again.X)
    assert_array_equal(data.y, again.y)
    assert (data.y != make_pendulum(9, **options, random_state=8).y).all()
    restored = pickle.loads(pickle.dumps(data))
    assert_array_equal(restored.f(data.X), data.f(data.X))
    assert_array_equal(restored.G(data.X), data.G(data.X))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_samples": 0}, "n_samples must be .* got 0"),
        ({"step": 0.0}, "step must be .* got 0.0"),
        ({"step": np.nan}, "step must be .* got nan"),
        ({"noise": -0.1}, "noise must be .* got -0.1"),
        ({"state_noise": np.inf}, "state_noise must be .* got inf"),
        ({"initial": "radnom"}, "initial='radnom'"),
        ({"initial": [1.0, 2.0, 3.0]}, r"initial=\[1.0, 2.0, 3.0\]; pass"),
        ({"initial": 2.0}, "initial=2.0; pass"),
        ({"initial": [np.nan, 2.0]}, "initial contains NaN"),
        ({"initial": [[0, 1], [0, 2]], "n_trajectories": 2}, "n_trajectories=2"),
        ({"initial": "random", "n_trajectories": 0}, "n_trajectories must be .* got 0"),
    ],
)
def test_bad_pendulum(options, message):
    with pytest.raises(ValueError, match=message):
        make_pendulum(**options)


# --- the synthetic leg --------------------------------------------------------------


def test_leg_angles_of_the_markers_are_the_trajectories():
    walking = make_walking(3, n_strides=6, random_state=0)
    for angles, output, markers in zip(
        walking.trajectories, walking.outputs, walking.markers, strict=True
    ):
        found, ankle = leg_angles(**markers, forward=0, up=1)
        assert_allclose(found, angles, rtol=0, atol=1e-12)
        assert_allclose(ankle, output, rtol=0, atol=1e-9)
        thigh, shank = (
            np.linalg.norm(np.diff([markers[a], markers[b]], axis=0)[0], axis=1)
            for a, b in (("hip", "knee"), ("knee", "ankle"))
        )
        assert_allclose(thigh, 420, rtol=1e-12)
        assert_allclose(shank, 430, rtol=1e-12)


def test_walking_looks_like_walking():
    walking = make_walking(speeds=[1.3], variability=0)
    hip, knee = np.degrees(walking.trajectories[0]).T
    assert_allclose([hip.min(), hip.max()], [-10, 32], atol=0.5)
    assert_allclose([knee.min(), knee.max()], [4.2, 61.4], atol=0.2)
    stride = round(150 / 0.93)
    stance = knee[: round(0.4 * stride)]
    assert 17 < stance.max() < 20
    assert 10 < np.argmax(stance) / stride * 100 < 20
    assert 68 < np.argmax(knee[:stride]) / stride * 100 < 78
    # The foot is in front of the hip at heel strike and behind it before the swing.
    forward, up = walking.outputs[0].T
    assert forward[0] > 250
    assert forward[stride // 2] < -100
    assert up.max() < -600
    heights = walking.markers[0]["ankle"][:, 1]
    assert heights.min() > 0


def test_speed_sets_cadence_length_and_amplitude():
    walking = make_walking(4, n_strides=8, variability=0)
    assert_allclose(walking.speeds, [0.6, 0.9, 1.2, 1.5])
    lengths = [len(angles) for angles in walking.trajectories]
    durations = 8 / (0.93 * np.sqrt(walking.speeds / 1.3))
    assert lengths == [int(duration * 150) + 1 for duration in durations]
    excursions = [np.ptp(angles, axis=0) for angles in walking.trajectories]
    exponents = np.polyfit(np.log(walking.speeds), np.log(excursions), 1)[0]
    assert_allclose(exponents, [0.3, 0.2], rtol=0, atol=2e-3)
    for markers, speed in zip(walking.markers, walking.speeds, strict=True):
        velocity = np.diff(markers["hip"][:, 0]) * 150
        assert_allclose(velocity, 1000 * speed, rtol=1e-9)


def test_without_variability_the_motion_is_periodic():
    # A rate that puts 100 samples into a stride.
    walking = make_walking(speeds=[1.3], rate=93.0, variability=0, n_strides=3)
    angles = walking.trajectories[0]
    assert_allclose(angles[100:], angles[:-100], rtol=0, atol=1e-12)


def test_variability_has_its_size():
    walking = make_walking(speeds=[1.3], n_strides=600, random_state=0)
    knee = walking.trajectories[0][:, 1]
    inside = (knee[1:-1] >= knee[:-2]) & (knee[1:-1] > knee[2:])
    peaks = 1 + np.flatnonzero(inside & (knee[1:-1] > np.radians(45)))
    assert len(peaks) == 600
    assert_allclose(np.std(np.log(knee[peaks])), 0.03, rtol=0.15)
    durations = np.diff(peaks) / 150
    # From peak to peak a duration mixes two strides: below the 2 % of one stride.
    assert 0.014 < np.std(np.log(durations)) < 0.021
    assert 0.3 < np.corrcoef(durations[1:], durations[:-1])[0, 1] < 0.8
    doubled = make_walking(
        speeds=[1.3], n_strides=600, variability=2.0, random_state=0
    ).trajectories[0][:, 1]
    assert doubled.max() > knee.max() > np.radians(61.4)


def test_rate_samples_one_smooth_motion():
    coarse = make_walking(2, n_strides=12, rate=150, random_state=4)
    fine = make_walking(2, n_strides=12, rate=1200, random_state=4)
    for one, other in zip(coarse.trajectories, fine.trajectories, strict=True):
        assert_allclose(one, other[::8], rtol=0, atol=1e-12)


def test_angles_have_continuous_derivatives():
    # At a kink the second difference quotient would grow with the rate.
    bends = [
        np.abs(np.diff(angles, n=2, axis=0)).max(axis=0) * rate**2
        for rate in (1_000, 32_000)
        for angles in make_walking(
            speeds=[1.3], n_strides=5, variability=3, rate=rate, random_state=1
        ).trajectories
    ]
    assert_allclose(bends[1], bends[0], rtol=0.3)


def test_walking_says_that_it_is_synthetic_and_is_reproducible():
    walking = make_walking(random_state=2)
    assert "SYNTHETIC" in walking.DESCR
    assert "SYNTHETIC" in make_walking.__doc__
    assert len(walking.trajectories) == 4
    for one, other in zip(
        walking.outputs, make_walking(random_state=2).outputs, strict=True
    ):
        assert_array_equal(one, other)
    assert len(make_walking(random_state=3).outputs[0]) != len(walking.outputs[0])


def test_walking_without_persons_is_what_it_was():
    # Numbers of the version before persons were drawn.
    walking = make_walking(3, n_strides=4, random_state=7)
    assert [len(angles) for angles in walking.trajectories] == [971, 711, 594]
    expected = [
        [0.43760914645459464, 0.6919105687299989],
        [0.3984411346619127, 0.32967159919025296],
        [0.07455774650189922, 0.16398451447972037],
    ]
    found = [angles[200] for angles in walking.trajectories]
    assert_allclose(found, expected, rtol=1e-12)
    assert_allclose(walking.outputs[0][200], [69.81072641328097, -796.5932100236557])
    expected = [869.8107264132809, 103.11279895451707, 80.073633302036]
    assert_allclose(walking.markers[0]["ankle"][200], expected)
    assert_array_equal(walking.persons, [0, 0, 0])
    assert_array_equal(walking.segments, [[420, 430]])


def test_markers_have_the_segments_of_their_persons():
    walking = make_walking(2, n_persons=3, n_strides=3, random_state=0)
    assert_array_equal(walking.persons, [0, 0, 1, 1, 2, 2])
    assert_array_equal(walking.speeds, [0.6, 1.5] * 3)
    assert len(np.unique(walking.segments)) == 6
    for angles, output, markers, person in zip(
        walking.trajectories,
        walking.outputs,
        walking.markers,
        walking.persons,
        strict=True,
    ):
        found, ankle = leg_angles(**markers, forward=0, up=1)
        assert_allclose(found, angles, rtol=0, atol=1e-12)
        assert_allclose(ankle, output, rtol=0, atol=1e-9)
        hip, knee, ankle = (markers[name] for name in ("hip", "knee", "ankle"))
        lengths = [
            np.linalg.norm(lower - upper, axis=1)
            for upper, lower in ((hip, knee), (knee, ankle))
        ]
        expected = walking.segments[person]
        assert_allclose(np.transpose(lengths), np.tile(expected, (len(hip), 1)))
        # The foot is as far above the ground as that of the mean person.
        assert ankle[:, 1].min() > 0
        assert_allclose(hip[:, 1].mean(), 30 + expected.sum(), rtol=0, atol=1)


def test_persons_differ_by_what_is_stated():
    n_persons = 2000
    options = {"speeds": [1.3], "n_strides": 1, "variability": 0, "rate": 100}

    def logarithms(walking):
        durations = [[0.01 / phase[1]] for phase in walking.phases]
        excursions = [np.ptp(angles, axis=0) for angles in walking.trajectories]
        return np.log(np.hstack([walking.segments, durations, excursions]))

    drawn = logarithms(make_walking(**options, n_persons=n_persons, random_state=0))
    factors = (drawn - logarithms(make_walking(**options))) / ([0.05] * 3 + [0.1] * 2)
    # Five standard errors, at most, of a mean, a deviation and a correlation.
    error = 5 / np.sqrt(n_persons)
    assert_allclose(factors.mean(axis=0), 0, atol=error)
    assert_allclose(factors.std(axis=0), 1, atol=error)
    expected = np.eye(5)
    expected[0, 1] = expected[1, 0] = 0.8
    assert_allclose(np.corrcoef(factors.T), expected, rtol=0, atol=error)


def test_a_person_keeps_to_one_manner():
    options = {"speeds": [1.3, 1.3], "n_strides": 2, "variability": 0}
    walking = make_walking(**options, n_persons=2, random_state=1)
    one, again, other, _ = walking.trajectories
    assert_array_equal(one, again)
    assert len(one) != len(other)


def test_phases_count_strides():
    walking = make_walking(2, n_strides=5, rate=200, random_state=0)
    for phase, angles in zip(walking.phases, walking.trajectories, strict=True):
        assert phase.shape == (len(angles),)
        assert phase[0] == 0
        assert (np.diff(phase) > 0).all()
        assert 4.98 < phase[-1] <= 5
    regular = make_walking(speeds=[1.3], rate=93.0, variability=0, n_strides=3)
    assert_allclose(regular.phases[0], np.arange(301) / 100, rtol=0, atol=1e-12)


def test_persons_are_reproducible_at_every_rate():
    options = {"n_persons": 3, "n_strides": 2, "random_state": 5}
    coarse, fine = (make_walking(2, rate=rate, **options) for rate in (100, 400))
    assert_array_equal(coarse.segments, fine.segments)
    for one, other in zip(coarse.outputs, fine.outputs, strict=True):
        assert_allclose(one, other[::4], rtol=0, atol=1e-9)
    single = make_walking(2, n_persons=1, n_strides=2, random_state=5)
    assert (single.segments != [420, 430]).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_trials": 0}, "n_trials must be .* got 0"),
        ({"n_strides": 0}, "n_strides must be .* got 0"),
        ({"n_persons": 0}, "n_persons must be .* got 0"),
        ({"n_persons": 2.5}, "n_persons must be .* got 2.5"),
        ({"rate": 0}, "rate must be .* got 0"),
        ({"rate": np.nan}, "rate must be .* got nan"),
        ({"variability": -1}, "variability must be .* got -1"),
        ({"n_trials": 3, "speeds": [1.0, 1.2]}, "n_trials=3 but speeds holds 2"),
        ({"speeds": [1.0, 0.0]}, "speeds must be a list of positive"),
        ({"speeds": [[1.0, 1.2]]}, "speeds must be a list of positive"),
        ({"speeds": [1.0, np.nan]}, "speeds must be .* finite"),
        ({"speeds": []}, "speeds must be a list"),
    ],
)
def test_bad_walking(options, message):
    with pytest.raises(ValueError, match=message):
        make_walking(**options)


# --- marker files -------------------------------------------------------------------

TSV = """\
Time\tR.HipX\tR.HipY\tR.HipZ\tR.KneeX\tR.KneeY\tR.KneeZ
1\t0.5\t900\t80\t150\t480.25\t81
2\t10\t901.5\t80.5\t160\t481\t82
3\t20\t902\t-8e1\t170\t482\t83
"""

TRC = """\
PathFileType\t4\t(X/Y/Z)\tgait.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
100.00\t100.00\t3\t2\tmm\t100.00\t1\t3
Frame#\tTime\tR.Hip\t\t\tR.Knee\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0.000\t0.5\t900\t80\t150\t480.25\t81
2\t0.010\t10\t901.5\t80.5\t160\t481\t82
3\t0.020\t20\t902\t-8e1\t170\t482\t83
"""

# What a file does not say is asked for.
RATES = {TSV: 150.0, TRC: None}

HIP = [[0.5, 900, 80], [10, 901.5, 80.5], [20, 902, -80]]
KNEE = [[150, 480.25, 81], [160, 481, 82], [170, 482, 83]]


@pytest.fixture
def write(tmp_path):
    def write_file(text, name="trial.txt", newline="\n"):
        path = tmp_path / name
        path.write_bytes(text.replace("\n", newline).encode())
        return path

    return write_file


def test_tab_separated_file(write):
    path = write(TSV)
    data = load_markers(path, rate=50)
    assert data.names == list(data.markers) == ["R.Hip", "R.Knee"]
    assert_array_equal(data.markers["R.Hip"], HIP)
    assert_array_equal(data.markers["R.Knee"], KNEE)
    assert_array_equal(data.time, [0.02, 0.04, 0.06])
    assert (data.rate, data.unit, data.filename) == (50.0, "mm", str(path))
    assert "2 markers in 3 frames at 50 Hz" in data.DESCR
    assert load_markers(str(path), rate=150).rate == 150.0
    with pytest.raises(ValueError, match=r"trial.txt: .* does not say how .* rate=100"):
        load_markers(path)


@pytest.mark.parametrize("name", ["gait.trc", "GAIT.TRC", "gait.txt"])
def test_trc_file(write, name):
    data = load_markers(write(TRC, name))
    assert data.names == ["R.Hip", "R.Knee"]
    assert_array_equal(data.markers["R.Hip"], HIP)
    assert_array_equal(data.markers["R.Knee"], KNEE)
    assert_array_equal(data.time, [0, 0.01, 0.02])
    assert (data.rate, data.unit) == (100.0, "mm")


@pytest.mark.parametrize("text", [TSV, TRC])
def test_line_ends_trailing_tabs_blank_lines_and_byte_order_mark(write, text):
    lines = text.rstrip("\n").split("\n")
    messy = "\ufeff" + "\t\n".join(lines) + "\t\n\n\t\t\n"
    data = load_markers(write(messy, newline="\r\n"), rate=RATES[text])
    assert_array_equal(data.markers["R.Hip"], HIP)
    assert_array_equal(data.markers["R.Knee"], KNEE)


def test_trc_without_blank_line_and_in_metres(write):
    text = TRC.replace("\n\n", "\n").replace("\tmm\t", "\tm\t")
    data = load_markers(write(text), unit="m")
    assert data.unit == "m"
    assert_array_equal(data.markers["R.Knee"], KNEE)


def test_markers_are_a_subset_in_the_order_asked_for(write):
    data = load_markers(write(TSV), markers=["R.Knee"], rate=150)
    assert data.names == list(data.markers) == ["R.Knee"]
    data = load_markers(write(TSV), markers=("R.Knee", "R.Hip", "R.Knee"), rate=150)
    assert list(data.markers) == ["R.Knee", "R.Hip"]


def test_only_markers_that_are_read_are_checked(write):
    text = TSV.replace("901.5", "").replace("902", "lost")
    data = load_markers(write(text), markers=["R.Knee"], rate=150)
    assert_array_equal(data.markers["R.Knee"], KNEE)


def seconds(stamps):
    """The tab-separated format with one marker and these texts as Time."""
    rows = "".join(f"{stamp}\t{i}\t900\t80\n" for i, stamp in enumerate(stamps))
    return f"Time\tHipX\tHipY\tHipZ\n{rows}"


@every_pair(
    rate=[50.0, 59.94, 100.0, 120.0, 150.0, 250.0, 1000.0],
    n_frames=[1, 2, 3, 700],
    first=[0, 37],
)
def test_seconds_rounded_to_milliseconds(write, rate, n_frames, first):
    frames = first + np.arange(n_frames)
    text = seconds(f"{frame / rate:.3f}" for frame in frames)
    data = load_markers(write(text), rate=rate)
    assert_allclose(data.time, frames / rate, rtol=1e-14)


def test_slightly_wrong_rate_is_accepted_but_not_another(write):
    path = write(seconds(f"{i / 150:.3f}" for i in range(600)))
    assert load_markers(path, rate=149.0).rate == 149.0
    with pytest.raises(ValueError, match=r"trial.txt: .* by 150 .* rate is 147;"):
        load_markers(path, rate=147.0)
    with pytest.raises(ValueError, match=r"by 150 .* but rate is 120; correct T.*=150"):
        load_markers(path, rate=120)


def scaled(text, factor):
    """The same marker file with all coordinates of its body times a factor."""
    head, body = text.split("\n1\t")
    rows = [line.split("\t") for line in f"1\t{body}".splitlines()]
    n_clocks = len(rows[0]) - 6
    return "\n".join(
        [head]
        + [
            "\t".join(r[:n_clocks] + [repr(factor * float(x)) for x in r[n_clocks:]])
            for r in rows
        ]
    )


IN_MM = {"mm": 1, "cm": 10, "m": 1000}


@pytest.mark.parametrize("true", IN_MM)
@pytest.mark.parametrize("header", [*IN_MM, None])
def test_unit_of_another_size_is_told_in_every_format(write, header, true):
    """A hip 420 mm above the knee, in one unit under the header of another."""
    text = TSV if header is None else TRC.replace("\tmm\t", f"\t{header}\t")
    path = write(scaled(text, 1 / IN_MM[true]))
    claimed = header or "mm"
    rate = RATES[TSV] if header is None else None
    if claimed == true:
        assert load_markers(path, rate=rate).unit == true
    else:
        size = f"{420 / IN_MM[true]:.3g}"
        message = f"{path.name}: the markers of a frame are {size} apart, like {true} "
        message += f"instead of {claimed}; pass unit='{true}', or unit='{claimed}' if"
        with pytest.raises(ValueError, match=message):
            load_markers(path, rate=rate)
    # A unit that is given wins over the header and the size.
    for unit in IN_MM:
        data = load_markers(path, unit=unit, rate=rate)
        assert data.unit == unit
        assert f"coordinates in {unit}," in data.DESCR


def test_size_is_that_of_most_frames_and_of_the_whole_file(write):
    # One frame of three in metres, another marker's frame lost.
    text = TSV.replace(
        "10\t901.5\t80.5\t160\t481\t82", "0.01\t0.9\t0.08\t0.16\t0.48\t0.08"
    )
    assert load_markers(write(text), rate=150).unit == "mm"
    message = r"0.42[0-9]* apart, like m instead of mm"
    path = write(scaled(TSV, 0.001).replace("0.482", "nan"))
    with pytest.raises(ValueError, match=message):
        load_markers(path, rate=150, gaps="nan")
    # It is the body that tells, whichever of its markers are read.
    with pytest.raises(ValueError, match=message):
        load_markers(write(scaled(TSV, 0.001)), rate=150, markers=["R.Hip"])


def test_one_marker_has_no_size(write):
    assert load_markers(write(seconds(["1", "2", "3"])), rate=150).unit == "mm"


FOOT = {"ankle": (0, 100, 0), "heel": (-60, 30, 0), "toe": (100, 20, 0)}
BODY = FOOT | {"head": (10, 1700, 0), "hip": (20, 900, 0)}


def trc(points, unit="mm"):
    """A TRC file of three frames in which these points move along X."""
    names = "\t\t\t".join(points)
    axes = "\t".join(f"{a}{i}" for i in range(1, len(points) + 1) for a in "XYZ")
    rows = "".join(
        f"{n}\t{(n - 1) / 100}\t"
        + "\t".join(f"{x + n}\t{y}\t{z}" for x, y, z in points.values())
        + "\n"
        for n in (1, 2, 3)
    )
    return (
        "PathFileType\t4\t(X/Y/Z)\tbody.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n"
        f"100\t3\t{len(points)}\t{unit}\nFrame#\tTime\t{names}\n\t\t{axes}\n\n{rows}"
    )


def test_a_foot_of_a_whole_body_is_read(write):
    path = write(trc(BODY))
    data = load_markers(path, markers=["ankle", "heel", "toe"])
    assert data.unit == "mm"
    assert data.names == list(data.markers) == ["ankle", "heel", "toe"]
    assert_array_equal(data.markers["toe"], [[101, 20, 0], [102, 20, 0], [103, 20, 0]])
    # What is not read may have gaps, or be damaged.
    damaged = trc(BODY).replace("\t900\t", "\t\t", 1).replace("\t900\t", "\tlost\t", 1)
    assert load_markers(write(damaged), markers=[*FOOT]).unit == "mm"
    # The size of the body tells on a foot, whose own size would pass.
    with pytest.raises(ValueError, match=r"1.68e\+03 apart, like mm instead of cm"):
        load_markers(write(trc(BODY, "cm")), markers=[*FOOT])
    # A file of a foot holds no body.
    path = write(trc(FOOT))
    with pytest.raises(ValueError, match=r"160 apart, like cm .* or unit='mm' if"):
        load_markers(path, markers=[*FOOT])
    assert load_markers(path, unit="mm").unit == "mm"


@pytest.mark.parametrize(
    ("size", "unit", "accepted"),
    [
        (6000.0, "mm", True),
        (199.0, "mm", False),
        (201.0, "mm", True),
        (12.0, "cm", True),  # of a hand; in metres it would be larger than a house
        (9.0, "cm", False),
        (320.0, "cm", False),
        (299.0, "cm", True),
        (6.0, "m", True),  # of two people; in centimetres it would be a finger
        (11.0, "m", False),
        (0.21, "m", True),
    ],
)
def test_sizes_that_are_accepted(write, size, unit, accepted):
    text = scaled(TRC, size / 420).replace("\tmm\t", f"\t{unit}\t")
    path = write(text)
    if accepted:
        assert load_markers(path).unit == unit
    else:
        with pytest.raises(ValueError, match=f"{size:.3g} apart, like .* of {unit};"):
            load_markers(path)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("meters", "m"), ("Metres", "m"), ("millimeters", "mm"), ("CM", "cm")],
)
def test_units_are_spelled_in_many_ways(write, name, unit):
    text = TRC.replace("\tmm\t", f"\t{name}\t")
    assert load_markers(write(scaled(text, 1 / IN_MM[unit]))).unit == unit


@pytest.mark.parametrize("name", ["inch", ""])
def test_unit_settles_a_header_without_one(write, name):
    path = write(TRC.replace("\tmm\t", f"\t{name}\t"))
    assert load_markers(path, unit="mm").unit == "mm"


@pytest.mark.parametrize("text", [TSV, TRC])
def test_gaps_can_be_read_and_filled(write, text):
    rate = RATES[text]
    text = text.replace("\t481\t", "\t\t").replace("\t80.5\t", "\tinf\t")
    with pytest.raises(ValueError, match=r"'R.Knee'.*gaps='nan'.*kinematics.fill_gaps"):
        load_markers(write(text), rate=rate)
    markers = load_markers(write(text), rate=rate, gaps="nan").markers
    assert_array_equal(
        np.isnan(markers["R.Hip"]), np.isinf(HIP) | [[0] * 3, [0, 0, 1], [0] * 3]
    )
    assert_array_equal(np.argwhere(np.isnan(markers["R.Knee"])), [[1, 1]])
    filled, frames = fill_gaps(markers, max_gap=1)
    assert_array_equal(frames, [1])
    # A line through the two samples beside the gap.
    assert filled["R.Knee"][1, 1] == (480.25 + 482) / 2
    assert filled["R.Hip"][1, 2] == 0


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (TSV.split("\n")[0], {}, r"trial.txt: the file has a head, but no frames"),
        (TSV, {"markers": ["R.Knie"]}, r"no marker 'R.Knie'; .*\['R.Knee'.*holds"),
        (TSV, {"markers": ["r.knee"]}, r"did you mean one of \['R.Knee'"),
        (TSV, {"markers": ["Q"]}, r"no marker 'Q'; The file holds \['R.Hip', 'R.K"),
        (TSV, {"markers": "R.Hip"}, r"markers='R.Hip'; pass a list"),
        (TSV, {"markers": []}, r"markers=\[\]; pass a list"),
        (TSV, {"rate": 0}, "rate must be .* got 0"),
        (TSV, {"rate": np.nan}, "rate must be .* got nan"),
        (TSV, {"unit": "inch"}, "'mm', 'cm', 'm', 'px', got 'inch'"),
        (TSV, {"gaps": "keep"}, "gaps must be one of 'raise', 'nan', got 'keep'"),
        (
            TSV.replace("\t481\t", "\t\t").replace("\t482\t", "\tNaN\t"),
            {},
            r"of 3 frames, .* 'R.Knee' in 2 frames, first in line 3\. Pass",
        ),
        (
            TSV.replace("\t902\t", "\tinf\t").replace("\t480.25\t", "\t \t"),
            {},
            r"'R.Hip' in 1 frames, first in line 4; 'R.Knee' in 1 .* line 2\.",
        ),
        (TSV.replace("\t482", ""), {}, r"line 4: found 6 fields .* expected 7"),
        (TSV.replace("82\n", "82\t9\n"), {}, r"line 3: found 8 fields .* expected 7"),
        (TSV.replace("480.25", "480,25"), {}, r"line 2: '480,25' in column 'R.KneeY'"),
        (TSV.replace("R.KneeY", "R.Knee.Y2"), {}, r"column 'R.Knee.Y2' is not the X"),
        (TSV.replace("R.KneeY", "Z"), {}, r"column 'Z' is not the X, Y or Z of"),
        (TSV.replace("R.KneeY", "R.ShinY"), {}, r"'R.Knee' has 0 columns 'R.KneeY'"),
        (TSV.replace("R.KneeY", "R.HipY"), {}, r"'R.Hip' has 2 columns 'R.HipY'"),
        (TSV.replace("\n3\t", "\n4\t"), {}, r"line 4: Time goes from 2 to 4"),
        (TSV.replace("\n3\t", "\n2\t"), {}, r"line 4: Time goes from 2 to 2"),
        (TSV.replace("\n3\t", "\n1\t"), {}, r"line 4: Time goes from 2 to 1"),
        (TSV.replace("\n2\t", "\n\t"), {}, r"line 3: Time is blank"),
        (TSV.replace("\n2\t", "\nb\t"), {}, r"line 3: 'b' in column 'Time'"),
        (
            seconds(["0", "0.007", "0.013", "0.027", "0.033"]),
            {},
            r"line 5: Time goes from 0.013 to 0.027;",
        ),
        (seconds(["0", "0.007", "0.007"]), {}, r"line 4: Time goes from"),
        (seconds(["1", "6", "11"]), {}, r"line 3: Time goes from 1 to 6"),
    ],
)
def test_bad_tab_separated_file(write, text, options, message):
    # The rate suits those that hold seconds, too.
    with pytest.raises(ValueError, match=message) as info:
        load_markers(write(text), **{"rate": 150.0} | options)
    if not options:
        assert "trial.txt" in str(info.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("PathFileType", "FileType", r"line 1: found 'FileType.*PathFileType"),
        ("100.00\t100.00\t3", "fast\t100.00\t3", r"line 3: DataRate is 'fast'"),
        ("100.00\t100.00\t3", "50\t100.00\t3", r"by 100 .* DataRate in line 3 is 50;"),
        ("\tmm\t", "\tmil\t", r"gives 'mil' as its unit, .* pass unit, which wins"),
        ("\tUnits\t", "\tunit\t", r"does not say the unit of .*; pass unit, one"),
        ("Frame#\t", "#\t", r"line 4: found '#.*expected 'Frame#', 'Time'"),
        ("R.Knee\t\t", "R.Hip\t\t", r"2 markers have the name 'R.Hip'"),
        ("Y2\tZ2", "Y2", r"lines 4 and 5: .* 2 .* and 5 columns, and 'R.Knee'"),
        ("Y1\t", "Q1\t", r"'R.Hip' does not stand above an X, a Y and a Z"),
        ("\tZ2\n", "\tZ2\tX3\n", r"line 7: found 8 fields .* expected 9"),
        ("\t481\t", "\t\t", r"'R.Knee' in 1 frames, first in line 8"),
        ("\t481\t", "\tx\t", r"line 8: 'x' in column 'R.KneeY'"),
        ("\t481\t", "\t", r"line 8: found 7 fields .* expected 8"),
        ("0.010", "0.000", r"line 8: Time goes from"),
        ("0.020", "0.030", r"line 9: Time goes from 0.01 to 0.03"),
    ],
)
def test_bad_trc_file(write, old, new, message):
    assert old in TRC
    with pytest.raises(ValueError, match=message) as info:
        load_markers(write(TRC.replace(old, new, 1), "gait.trc"))
    assert "gait.trc" in str(info.value)


def test_truncated_trc_and_binary_file(write, tmp_path):
    with pytest.raises(ValueError, match="line 2 is the last one, but a TRC header"):
        load_markers(write("PathFileType\t4\n"))
    (tmp_path / "movie.bin").write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match=r"movie.bin: no known format .it is not text"):
        load_markers(tmp_path / "movie.bin")


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"No such file.*nowhere.txt"):
        load_markers(tmp_path / "nowhere.txt")
    with pytest.raises(OSError, match=tmp_path.name):
        load_markers(tmp_path)


def test_written_walking_comes_back(write):
    markers = make_walking(1, n_strides=2, random_state=0).markers[0]
    names = "\t".join(f"{name}{axis}" for name in markers for axis in "XYZ")
    table = np.hstack(list(markers.values()))
    rows = "\n".join(
        f"{i / 150:.3f}\t" + "\t".join(repr(float(v)) for v in row)
        for i, row in enumerate(table)
    )
    data = load_markers(write(f"Time\t{names}\n{rows}\n"))
    for name, positions in markers.items():
        assert_array_equal(data.markers[name], positions)


# --- archives of trials -------------------------------------------------------------


def test_trials_are_split_and_keep_their_order(tmp_path):
    rng = np.random.default_rng(0)
    hip, knee = rng.standard_normal((2, 7, 3))
    trial = np.array([4, 2, 2, 4, 2, 4, 4])
    path = tmp_path / "walking.npz"
    np.savez(path, hip=hip, knee=knee, trial=trial, rate=50, belt_speed=[1.0, 2.0])
    data = load_trials(path)
    assert_array_equal(data.trials, [2, 4])
    assert data.rate == 50.0
    assert data.filename == str(path)
    assert "2 markers in 2 trials" in data.DESCR
    for number, markers in zip(data.trials, data.markers, strict=True):
        assert list(markers) == ["hip", "knee"]
        assert_array_equal(markers["hip"], hip[trial == number])
        assert_array_equal(markers["knee"], knee[trial == number])
    assert len(load_trials(str(path)).markers) == 2


GOOD = {"hip": np.zeros((4, 3)), "trial": np.ones(4), "rate": 100.0}


@pytest.mark.parametrize(
    "arrays",
    [
        {"trial": None},
        {"rate": None},
        {"hip": None},
        {"hip": np.zeros((3, 3))},
        {"hip": np.zeros((4, 2))},
        {"knee": np.zeros((5, 3))},
        {"trial": np.ones((4, 1))},
        {"trial": np.ones(0), "hip": np.zeros((0, 3))},
        {"rate": 0.0},
        {"rate": np.nan},
        {"rate": [100.0, 100.0]},
        {"rate": "fast"},
    ],
    ids=str,
)
def test_archives_without_the_arrays_are_refused(tmp_path, arrays):
    path = tmp_path / "walking.npz"
    held = {name: x for name, x in (GOOD | arrays).items() if x is not None}
    np.savez(path, **held)
    with pytest.raises(ValueError, match=r"walking.npz must hold .trial. of") as info:
        load_trials(path)
    for name, x in held.items():
        assert f"{name!r} {np.shape(x)}" in str(info.value)


def test_other_files_are_no_archives_of_trials(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere.npz"):
        load_trials(tmp_path / "nowhere.npz")
    path = tmp_path / "walking.npz"
    single, objects = io.BytesIO(), io.BytesIO()
    np.save(single, np.ones(3))
    np.savez(objects, **GOOD, note=np.array([None]))
    texts = [b"", b"PK\x03\x04 damaged", TSV.encode()]
    for content in [*texts, single.getvalue(), objects.getvalue()]:
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"walking.npz is not an .npz archive"):
            load_trials(path)


def test_recorded_trials(walking_file):
    data = load_trials(walking_file)
    assert_array_equal(data.trials, [1, 2, 3, 4])
    assert [len(markers["hip"]) for markers in data.markers] == [3199, 2724, 2505, 2184]
    assert data.rate == 150.0


# --- recorded walking ---------------------------------------------------------------


@pytest.fixture
def recording(data_file):
    return load_markers(data_file("WBDS01walkO01Cmkr.txt"), rate=150)


def test_recorded_trial(recording):
    assert len(recording.names) == 22
    assert_allclose(recording.time, np.arange(374) / 150, rtol=1e-14)
    assert_array_equal(recording.markers["R.ASIS"][0], [-351.984, 911.983, 58.5327])
    for side in "LR":
        hip, knee, ankle = (
            recording.markers[f"{side}.{name}"] for name in ("GTR", "Knee", "Ankle")
        )
        angles, output = leg_angles(hip, knee, ankle, forward=0, up=1)
        flexion = np.degrees(angles)
        # Overground at a comfortable speed.
        assert -25 < flexion[:, 0].min() < -5
        assert 20 < flexion[:, 0].max() < 40
        assert -10 < flexion[:, 1].min() < 10
        assert 55 < flexion[:, 1].max() < 75
        assert_allclose(output, (ankle - hip)[:, :2], rtol=0, atol=1e-9)
        _, scaled = leg_angles(hip, knee, ankle, forward=0, up=1, normalize=True)
        assert -1.02 < scaled[:, 1].min() < -0.95


def test_recorded_trial_is_the_one_of_gaitkit(recording):
    gaitkit = pytest.importorskip("gaitkit", reason="gaitkit ships the same trial")
    frames = gaitkit.load_example("healthy")["angle_frames"]
    landmarks = {"hip": "GTR", "knee": "Knee", "ankle": "Ankle"}
    for side in ("left", "right"):
        for landmark, name in landmarks.items():
            theirs = [f["landmark_positions"][f"{side}_{landmark}"] for f in frames]
            # They keep four decimals, the file six significant digits.
            ours = recording.markers[f"{side[0].upper()}.{name}"]
            assert_allclose(ours, theirs, rtol=5.1e-6, atol=6e-5)
