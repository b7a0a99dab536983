"""Joint angles from markers: known poses, the inverse formula, invariances."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_koopman import KoopmanKernelRegressor, SeparatedCenterSelector
from sklearn_koopman.datasets import make_walking
from sklearn_koopman.kinematics import fill_gaps, leg_angles, leg_length, unwrap_angles
from sklearn_koopman.trajectories import trajectory_pairs


def pose(hip_degrees, knee_degrees, thigh=400.0, shank=380.0):
    """Hip, knee and ankle of a leg in the X-Y plane, the hip at (50, 900, 80)."""
    first = np.radians(hip_degrees)
    second = first - np.radians(knee_degrees)
    hip = np.array([50.0, 900.0, 80.0])
    knee = hip + thigh * np.array([np.sin(first), -np.cos(first), 0])
    ankle = knee + shank * np.array([np.sin(second), -np.cos(second), 0])
    return hip[None], knee[None], ankle[None]


@pytest.fixture
def walk():
    """Markers that move in all three directions, with segments of changing length."""
    rng = np.random.default_rng(0)
    hip = rng.normal([0, 900, 80], [300, 20, 20], (200, 3))
    knee = hip + rng.normal([80, -390, 5], [120, 20, 15], (200, 3))
    ankle = knee + rng.normal([-90, -370, -5], [150, 30, 15], (200, 3))
    return hip, knee, ankle


@pytest.mark.parametrize(
    ("hip", "knee"),
    [(0, 0), (30, 0), (-20, 0), (25, 60), (-10, 5), (0, -8), (90, 90), (10, 134)],
)
def test_known_poses(hip, knee):
    angles, _ = leg_angles(*pose(hip, knee), forward=0, up=1)
    assert_allclose(np.degrees(angles), [[hip, knee]], rtol=0, atol=1e-12)


def test_signs_by_hand():
    # Knee 1 in front of the hip and 1 below it; the shank hangs straight down.
    angles, ankle = leg_angles([[0, 2, 0]], [[1, 1, 0]], [[1, 0, 0]], forward=0, up=1)
    assert_allclose(angles, [[np.pi / 4, np.pi / 4]], rtol=1e-15)
    assert_array_equal(ankle, [[1, -2]])
    # The same seen from the other side: knee behind the hip, bent the wrong way.
    angles, ankle = leg_angles(
        [[0, 2, 0]], [[1, 1, 0]], [[1, 0, 0]], forward=[-1, 0, 0], up=1
    )
    assert_allclose(angles, [[-np.pi / 4, -np.pi / 4]], rtol=1e-15)
    assert_array_equal(ankle, [[-1, -2]])


@pytest.mark.filterwarnings("ignore:the leg stands", "ignore:the knee is bent")
def test_angles_lie_in_the_half_open_interval():
    # Shank folded back onto the thigh, and a thigh straight up: pi, never -pi.
    angles, _ = leg_angles([[0, 0, 0]], [[0, 4, 0]], [[0, 1, 0]], forward=0, up=1)
    assert_array_equal(angles, [[np.pi, np.pi]])
    angles, _ = leg_angles([[0, 0, 0]], [[-0.0, 4, 0]], [[0, 1, 0]], forward=0, up=1)
    assert_array_equal(angles, [[np.pi, np.pi]])
    angles, _ = leg_angles([[0, 4, 0]], [[0, 0, 0]], [[0, 3, 0]], forward=0, up=1)
    assert_array_equal(angles, [[0, np.pi]])
    angles, _ = leg_angles(*pose(10, 179), forward=0, up=1)
    assert_allclose(np.degrees(angles), [[10, 179]], rtol=1e-12)
    # Hip 170 degrees and shank at -170: 340 wraps to -20.
    angles, _ = leg_angles(*pose(170, 340), forward=0, up=1)
    assert_allclose(np.degrees(angles), [[170, -20]], rtol=1e-12)


def test_inverse_formula_returns_the_ankle(walk):
    hip, knee, ankle = walk
    angles, output = leg_angles(*walk, forward=0, up=1)
    first, second = angles.T
    thigh = np.hypot(*(knee - hip)[:, :2].T)
    shank = np.hypot(*(ankle - knee)[:, :2].T)
    expected = np.column_stack(
        [
            thigh * np.sin(first) + shank * np.sin(first - second),
            -thigh * np.cos(first) - shank * np.cos(first - second),
        ]
    )
    assert_allclose(output, expected, rtol=0, atol=1e-10)
    assert_allclose(output, (ankle - hip)[:, :2], rtol=0, atol=1e-12)


def test_knee_angle_has_the_cosine_of_the_dot_product(walk):
    # The paper's definition: the angle between the two projected segments.
    hip, knee, ankle = (marker[:, :2] for marker in walk)
    thigh, shank = knee - hip, ankle - knee
    cosine = np.sum(thigh * shank, axis=1) / (
        np.linalg.norm(thigh, axis=1) * np.linalg.norm(shank, axis=1)
    )
    angles, _ = leg_angles(*walk, forward=0, up=1)
    assert_allclose(np.cos(angles[:, 1]), cosine, rtol=0, atol=1e-13)
    assert (angles[:, 1] < 0).any()
    assert (angles[:, 1] > 0).any()


def test_projection_ignores_the_third_direction(walk):
    hip, knee, ankle = (marker.copy() for marker in walk)
    before = leg_angles(hip, knee, ankle, forward=0, up=1)
    knee[:, 2] += 40
    ankle[:, 2] -= 25
    for one, other in zip(
        before, leg_angles(hip, knee, ankle, forward=0, up=1), strict=True
    ):
        assert_array_equal(one, other)


def test_rotated_axes_give_the_same(walk):
    rotation, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    expected = leg_angles(*walk, forward=0, up=1)
    found = leg_angles(
        *(marker @ rotation.T for marker in walk),
        forward=7.0 * rotation[:, 0],
        up=0.1 * rotation[:, 1],
    )
    for one, other in zip(expected, found, strict=True):
        assert_allclose(one, other, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("column", [1, np.int64(1), [0, 1, 0], np.array([0, 2.0, 0])])
def test_column_or_vector(walk, column):
    for one, other in zip(
        leg_angles(*walk, forward=0, up=1),
        leg_angles(*walk, forward=0, up=column),
        strict=True,
    ):
        assert_array_equal(one, other)


def test_normalize_divides_by_the_mean_length(walk):
    hip, knee, ankle = walk
    length = (
        np.linalg.norm(knee - hip, axis=1).mean()
        + np.linalg.norm(ankle - knee, axis=1).mean()
    )
    angles, raw = leg_angles(*walk, forward=0, up=1)
    same, scaled = leg_angles(*walk, forward=0, up=1, normalize=True)
    assert_array_equal(angles, same)
    assert_allclose(scaled * length, raw, rtol=1e-14)
    # A child of 0.6 times the size is the same person, and metres are millimetres.
    small, in_metres = leg_angles(
        *(0.6e-3 * marker for marker in walk), forward=0, up=1, normalize=True
    )
    assert_allclose(small, angles, rtol=1e-9, atol=1e-12)
    assert_allclose(in_metres, scaled, rtol=1e-9, atol=1e-12)


def test_input_is_left_alone_and_lists_will_do(walk):
    copies = [marker.copy() for marker in walk]
    expected = leg_angles(*walk, forward=0, up=1)
    for marker, copy in zip(walk, copies, strict=True):
        assert_array_equal(marker, copy)
    found = leg_angles(*(m.tolist() for m in walk), forward=0, up=1)
    for one, other in zip(expected, found, strict=True):
        assert_array_equal(one, other)


# --- planar markers, and the length of a leg ----------------------------------------


def test_planar_markers_are_those_with_a_third_column_of_zeros(walk):
    flat = [marker[:, :2] for marker in walk]
    solid = [np.pad(marker, [(0, 0), (0, 1)]) for marker in flat]
    for forward, up in ((0, 1), (1, 0), ([-1, 0], [0, 2]), ([3, 4], [-4, 3])):
        axes, more = ({"forward": forward, "up": up} for _ in range(2))
        for name in ("forward", "up"):
            if np.ndim(axes[name]):
                more[name] = [*axes[name], 0]
        for normalize in (False, True):
            for one, other in zip(
                leg_angles(*flat, **axes, normalize=normalize),
                leg_angles(*solid, **more, normalize=normalize),
                strict=True,
            ):
                assert_allclose(one, other, rtol=1e-14)
    assert leg_length(*flat) == leg_length(*solid)


def test_image_whose_rows_are_counted_from_the_top(walk):
    """A camera of 2 mm a pixel that looks at the left side of somebody."""
    expected, ankle = leg_angles(*(marker[:, :2] for marker in walk), forward=0, up=1)
    pixels = [np.array([900, 800]) - marker[:, :2] / 2 for marker in walk]
    angles, reach = leg_angles(*pixels, forward=[-1, 0], up=[0, -1])
    assert_allclose(angles, expected, rtol=0, atol=1e-12)
    assert_allclose(2 * reach, ankle, rtol=0, atol=1e-9)
    with pytest.warns(UserWarning, match=r"on its head .* pass up=\[0, -1\]"):
        leg_angles(*pixels, forward=[-1, 0], up=1)


@pytest.mark.parametrize("n_axes", [2, 3])
def test_length_is_what_normalize_divides_by(walk, n_axes):
    markers = [marker[:, :n_axes] for marker in walk]
    _, raw = leg_angles(*markers, forward=0, up=1)
    _, scaled = leg_angles(*markers, forward=0, up=1, normalize=True)
    length = leg_length(*markers)
    assert type(length) is float
    assert_allclose(scaled * length, raw, rtol=1e-14)
    segments = np.linalg.norm(np.diff(markers, axis=0), axis=-1)
    assert_allclose(length, segments.mean(axis=1).sum(), rtol=1e-14)
    # In metres, the length is in metres.
    assert_allclose(leg_length(*(m / 1000 for m in markers)), length / 1000)


def test_length_of_a_leg_in_any_direction():
    hip, knee, ankle = [[0, 0, 9], [0, 0, 0]], [[0, 3, 5], [3, 4, 0]], np.zeros((2, 3))
    ankle[0], ankle[1] = [0, 3, 11], [3, 4, 8]
    assert leg_length(hip, knee, ankle) == 5 + 7


def person(thigh, shank, seed):
    """Markers [mm] of somebody of this size who walks at two speeds."""
    walking = make_walking(speeds=[0.9, 1.2], n_strides=6, random_state=seed)
    trials = []
    for angles, markers in zip(walking.trajectories, walking.markers, strict=True):
        first, second = angles[:, 0], angles[:, 0] - angles[:, 1]
        down = [
            np.column_stack([np.sin(angle), -np.cos(angle), 0 * angle])
            for angle in (first, second)
        ]
        hip = markers["hip"]
        knee = hip + thigh * down[0]
        trials.append((hip, knee, knee + shank * down[1]))
    return trials


def test_ankle_of_a_person_never_seen_in_mm():
    """A child, after adults whose shanks are a little shorter or longer."""
    adults = [(420, 425, 0), (465, 480, 1), (390, 385, 2)]
    child = person(300, 305, 3)
    errors = {}
    for normalize in (True, False):
        options = {"forward": 0, "up": 1, "normalize": normalize}
        legs = [leg_angles(*m, **options) for a in adults for m in person(*a)]
        new = [leg_angles(*markers, **options) for markers in child]
        pairs = trajectory_pairs(*zip(*legs, strict=True), delays=3)
        model = KoopmanKernelRegressor(
            "matern52",
            centers=SeparatedCenterSelector(0.1),
            method="least_squares",
            alpha=1e-6,
            trend="linear",
        ).fit(pairs.X, pairs.y)
        others = trajectory_pairs(*zip(*new, strict=True), delays=3)
        lengths = np.array([leg_length(*markers) for markers in child])
        assert_allclose(lengths, 605, rtol=1e-12)
        unit = lengths[others.groups][:, np.newaxis] if normalize else 1.0
        error = unit * (model.predict(others.X) - others.y)
        errors[normalize] = np.sqrt((error**2).sum(axis=1).mean())
    # Measured: 0.91 and 243 mm.
    assert errors[True] < 2
    assert errors[False] > 100


# --- legs that stand on their head --------------------------------------------------


def turn(hip_degrees, knee_degrees):
    """Markers of a leg in the X-Y plane that runs through these angles."""
    frames = zip(*np.broadcast_arrays(hip_degrees, knee_degrees), strict=True)
    poses = [pose(*angles) for angles in frames]
    return [np.vstack(marker) for marker in zip(*poses, strict=True)]


def pedal():
    """One turn of a crank of 170 mm, 150 mm ahead of the hip and 550 mm below it."""
    crank = np.linspace(0, 2 * np.pi, 101)[:-1]
    ankle = [150, -550] + 170 * np.column_stack([np.sin(crank), np.cos(crank)])
    reach = np.linalg.norm(ankle, axis=1)
    knee = np.pi - np.arccos((400**2 + 380**2 - reach**2) / (2 * 400 * 380))
    lift = np.arccos((400**2 + reach**2 - 380**2) / (2 * 400 * reach))
    hip = np.arctan2(ankle[:, 0], -ankle[:, 1]) + lift
    return turn(np.degrees(hip), np.degrees(knee))


PHASE = np.linspace(0, 2 * np.pi, 101)[:-1]
WALK = [make_walking(1, random_state=0).markers[0][k] for k in ("hip", "knee", "ankle")]
RUN = turn(15 + 35 * np.cos(PHASE), 65 - 50 * np.cos(PHASE - 1.5))
CYCLE = pedal()
UPRIGHT = {"walk": WALK, "run": RUN, "cycle": CYCLE}
OTHERS = {
    "kick": turn(35 - 55 * np.cos(PHASE), 55 + 50 * np.cos(PHASE)),
    "sit": turn(90 + 15 * np.cos(PHASE), 90),
    "lie on the back": turn(92 + 5 * np.cos(PHASE), 0),
    "lie with bent knees": turn(135, 90 + 10 * np.cos(PHASE)),
    "leg raised in bed": turn(90 + 25 * (1 + np.cos(PHASE)), 0),
    "curl on the belly": turn(-90, 65 - 65 * np.cos(PHASE)),
}


@pytest.mark.parametrize("markers", [*UPRIGHT.values(), *OTHERS.values()])
def test_leg_as_it_should_be_is_silent(markers):
    leg_angles(*markers, forward=0, up=1)
    leg_angles(*markers, forward=[-1, 0, 0], up=1)


@pytest.mark.parametrize("name", UPRIGHT)
def test_leg_upside_down_warns(name):
    hip, knee, ankle = UPRIGHT[name]
    length = 850 if name == "walk" else 780
    above = (hip - ankle)[:, 1] > length / 2
    head = rf"stands on its head in {above.sum()} of {len(hip)} frames.*hip, knee and"
    with pytest.warns(UserWarning, match=head) as record:
        leg_angles(hip, knee, ankle, forward=0, up=[0, -1, 0])
    assert "up=[0, -1, 0]" in str(record[0].message)
    assert record[0].filename == __file__
    with pytest.warns(UserWarning, match=head):
        leg_angles(ankle, knee, hip, forward=0, up=1)
    # Both errors together make a leg again.
    leg_angles(ankle, knee, hip, forward=0, up=[0, -1, 0])


@pytest.mark.parametrize("order", [(1, 0, 2), (0, 2, 1), (1, 2, 0), (2, 0, 1)])
@pytest.mark.parametrize("name", [*UPRIGHT, "lie on the back"])
def test_swapped_markers_warn(name, order):
    markers = (UPRIGHT | OTHERS)[name]
    swapped = [markers[i] for i in order]
    thigh, shank = np.diff(swapped, axis=0)[..., :2]
    lengths = np.linalg.norm(thigh, axis=1) * np.linalg.norm(shank, axis=1)
    n_folded = np.sum((thigh * shank).sum(axis=1) < -np.sqrt(0.5) * lengths)
    message = rf"135 degrees in {n_folded} of {len(thigh)} .*Pass hip, knee and ankle"
    with pytest.warns(UserWarning, match=message):
        leg_angles(*swapped, forward=0, up=1)


@pytest.mark.parametrize(
    ("up", "opposite"),
    [
        ([0, -1, 0], "[0, 1, 0]"),
        ((0, -2.5, 0), "[0, 2.5, 0]"),
        (np.array([0, -1, 0]), "[0, 1, 0]"),
        (1, "[0, -1, 0]"),
        ([0, 0.1, 0], "[0, -0.1, 0]"),
    ],
)
def test_remedy_is_the_opposite_of_what_was_given(up, opposite):
    sign = 1 if np.ndim(up) == 0 else np.sign(up[1])
    markers = [marker * [1, -sign, 1] for marker in WALK]
    with pytest.warns(UserWarning, match="on its head") as record:
        leg_angles(*markers, forward=0, up=up)
    assert f"If up={up!r} points down, pass up={opposite};" in str(record[0].message)
    leg_angles(*markers, forward=0, up=eval(opposite))


def test_half_of_the_frames_may_be_upside_down():
    markers = [np.vstack([m, m * [1, -1, 1]]) for m in turn(np.zeros(9), 0)]
    leg_angles(*markers, forward=0, up=1)
    with pytest.warns(UserWarning, match="on its head in 9 of 17 frames"):
        leg_angles(*(m[1:] for m in markers), forward=0, up=1)


@pytest.mark.parametrize("normalize", [False, True])
def test_frames_with_a_lost_marker_are_nan(walk, normalize):
    lost = np.isin(np.arange(200), [3, 50, 51, 199])
    markers = [marker.copy() for marker in walk]
    markers[1][3, 1] = markers[0][50:52] = markers[2][199, 2] = np.nan
    options = {"forward": 0, "up": 1, "normalize": normalize}
    whole = leg_angles(*(marker[~lost] for marker in walk), **options)
    for values, right in zip(leg_angles(*markers, **options), whole, strict=True):
        assert values.shape == (200, 2)
        assert_array_equal(np.isnan(values), lost[:, None] | [[False] * 2])
        assert_array_equal(values[~lost], right)
    assert leg_length(*markers) == leg_length(*(marker[~lost] for marker in walk))


def test_pairs_are_cut_where_a_marker_is_lost(walk):
    markers = [marker.copy() for marker in walk]
    markers[1][50:52] = np.nan
    states, ankle = leg_angles(*markers, forward=0, up=1)
    pairs = trajectory_pairs([states], [ankle], gaps="split")
    assert len(pairs.X) == 49 + 147
    whole, _ = leg_angles(*walk, forward=0, up=1)
    assert_array_equal(pairs.X, np.vstack([whole[:49], whole[52:199]]))


@pytest.mark.parametrize("sign", [1, -1])
def test_wrong_axes_warn(sign):
    turned = [marker[:, [0, 2, 1]] * [1, 1, sign] for marker in WALK]
    up = "2" if sign > 0 else r"\[0, 0, -1\]"
    message = rf"outside of .* forward=0 and up=1.*along axis 2: pass up={up}, and"
    with pytest.warns(UserWarning, match=message):
        leg_angles(*turned, forward=0, up=1)
    right = leg_angles(*turned, forward=0, up=2 if sign > 0 else [0, 0, -1])
    for values, same in zip(right, leg_angles(*WALK, forward=0, up=1), strict=True):
        assert_array_equal(values, same)


@pytest.mark.parametrize(("degrees", "warns"), [(0, 0), (40, 0), (50, 1)])
def test_a_leg_may_be_spread(degrees, warns, recwarn):
    angle = np.radians(degrees)
    points = np.array([[0, 0, 0], [0, -400, 0], [0, -780.0, 0]])
    turned = points @ [[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, 0, 1]]
    leg_angles(*turned[:, None], forward=0, up=1)
    assert len(recwarn) == warns


# --- gaps ---------------------------------------------------------------------------


def cubic(frames):
    return 1e-3 * frames**3 - 0.05 * frames**2 + frames - 7.0


def test_cubic_is_filled_exactly():
    frames = np.arange(60.0)
    lost = [0, 1, 5, 6, 7, 20, 21, 22, 23, 40, 57, 59]
    # The gap of four stays, and so do those at both ends.
    filled_frames = [5, 6, 7, 40, 57]
    expected = cubic(frames)
    recording = expected.copy()
    recording[lost] = np.nan
    before = recording.copy()
    filled, rows = fill_gaps(recording, max_gap=3)
    assert_array_equal(rows, filled_frames)
    expected[np.setdiff1d(lost, filled_frames)] = np.nan
    assert_allclose(filled, expected, rtol=0, atol=1e-12)
    assert_array_equal(recording, before)
    assert_array_equal(
        np.isnan(fill_gaps(recording, max_gap=4)[0]),
        [i in (0, 1, 59) for i in range(60)],
    )


@pytest.mark.parametrize("n_lost", [1, 2, 5, 10])
def test_sine_is_filled_to_the_error_of_splines(n_lost):
    frames = np.arange(-200, 200)
    lost = 200 - n_lost // 2 + np.arange(n_lost)  # around a crest
    errors = []
    for period in (100, 200):
        sine = np.cos(2 * np.pi * frames / period)
        recording = sine.copy()
        recording[lost] = np.nan
        filled, rows = fill_gaps(recording, max_gap=n_lost)
        assert_array_equal(rows, lost)
        errors.append(np.abs(filled - sine).max())
        step = 2 * np.pi * (n_lost + 1) / period
        # Hermite interpolation alone would leave 1/384 at the middle.
        assert step**4 / 1000 < errors[-1] < 5 / 384 * step**4
    assert_allclose(errors[0] / errors[1], 16, rtol=0.1)


@pytest.mark.parametrize("n_lost", [1, 2, 5, 10, 20])
@pytest.mark.parametrize("n_before", [1, 2, 30])
def test_noise_grows_with_the_gap(n_lost, n_before):
    # What each sample alone contributes to the gap.
    impulses = np.eye(n_before + n_lost + 30)
    impulses[n_before : n_before + n_lost] = np.nan
    weights, rows = fill_gaps(impulses, max_gap=n_lost)
    largest = np.linalg.norm(weights[rows], axis=1).max()
    expected = 2 + 0.35 * n_lost**2 if n_before == 1 else 1 + 0.35 * n_lost
    assert_allclose(largest, expected, rtol=0.2)


def test_gap_of_one_frame_more_stays():
    recording = np.arange(30.0)
    recording[10:15] = np.nan
    filled, rows = fill_gaps(recording, max_gap=4)
    assert_array_equal(filled, recording)
    assert_array_equal(rows, [])
    filled, rows = fill_gaps(recording, max_gap=5)
    assert_allclose(filled, np.arange(30.0), rtol=0, atol=1e-13)
    assert_array_equal(rows, range(10, 15))


def test_long_gap_has_no_influence():
    """The same fill, whatever lies beyond a long gap."""
    rng = np.random.default_rng(0)
    left = rng.normal(size=20)
    left[[4, 5, 18]] = np.nan
    alone, _ = fill_gaps(left, max_gap=2)
    for beyond in (0.0, 1e6):
        both = np.concatenate([left, np.full(3, np.nan), np.full(20, beyond)])
        assert_array_equal(fill_gaps(both, max_gap=2)[0][:20], alone)


@pytest.mark.parametrize(
    ("samples", "expected"),
    [
        ([1, np.nan, 5], [1, 3, 5]),  # a line
        ([0, np.nan, 4, 9], [0, 1, 4, 9]),  # a parabola
        ([0, 1, np.nan, np.nan, 16], [0, 1, 4, 9, 16]),
        ([np.nan, 7, np.nan], [np.nan, 7, np.nan]),
        ([np.nan, np.nan], [np.nan, np.nan]),
    ],
)
def test_few_samples(samples, expected):
    filled, rows = fill_gaps(samples, max_gap=2)
    assert_allclose(filled, expected, rtol=1e-14, atol=1e-14)
    assert_array_equal(rows, np.flatnonzero(np.isnan(samples) & ~np.isnan(expected)))


def test_columns_are_filled_on_their_own():
    table = cubic(np.arange(40.0)[:, None] + np.arange(3))
    recording = table.copy()
    recording[4:7, 0] = recording[5:8, 2] = recording[30:36, 1] = np.nan
    filled, rows = fill_gaps(recording, max_gap=3)
    assert_array_equal(rows, [4, 5, 6, 7])
    assert_array_equal(np.isnan(filled), np.isnan(recording) & [False, True, False])
    assert_allclose(filled[:8], table[:8], rtol=0, atol=1e-12)
    # Markers, and columns that are not contiguous.
    for other in (recording.reshape(40, 1, 3), np.asfortranarray(recording)):
        again, same = fill_gaps(other, max_gap=3)
        assert again.shape == other.shape
        assert_array_equal(again.reshape(40, 3), filled)
        assert_array_equal(same, rows)


def test_markers_by_name():
    complete = np.arange(60.0).reshape(20, 3)
    markers = {"hip": complete.copy(), "knee": complete + 5}
    markers["hip"][4, 1] = markers["knee"][[4, 9]] = np.nan
    filled, rows = fill_gaps(markers, max_gap=1)
    assert list(filled) == ["hip", "knee"]
    assert_allclose(filled["hip"], complete, rtol=0, atol=1e-12)
    assert_allclose(filled["knee"], complete + 5, rtol=0, atol=1e-12)
    assert_array_equal(rows, [4, 9])
    assert np.isnan(markers["hip"][4, 1])


def test_masked_values_are_gaps():
    recording = np.ma.masked_array(cubic(np.arange(20.0)), mask=False)
    recording[3] = 9000.0
    recording[[3, 10, 11]] = np.ma.masked
    filled, rows = fill_gaps(recording, max_gap=1)
    assert type(filled) is np.ndarray
    assert_array_equal(rows, [3])
    assert_allclose(filled[:10], cubic(np.arange(10.0)), rtol=0, atol=1e-12)
    assert_array_equal(np.isnan(filled), np.isin(np.arange(20), [10, 11]))
    whole = np.ma.masked_array([1, 2, 3], mask=[False, True, False])
    assert_array_equal(fill_gaps(whole, max_gap=1)[0], [1.0, 2.0, 3.0])


def test_dataframes_keep_index_and_columns():
    frames = np.arange(10.0)
    frame = pd.DataFrame(
        {
            "x": cubic(frames),
            "n": pd.array([0, 1, None, 3, 4, 5, 6, None, None, 9], dtype="Int64"),
        },
        index=pd.Index(frames / 100, name="time"),
    )
    frame.loc[0.05, "x"] = np.nan
    before = frame.copy()
    filled, rows = fill_gaps(frame, max_gap=1)
    assert_array_equal(rows, [2, 5])
    pd.testing.assert_index_equal(filled.index, frame.index)
    assert list(filled.columns) == ["x", "n"]
    assert_allclose(filled["x"], cubic(frames), rtol=0, atol=1e-12)
    assert_allclose(filled["n"], [0, 1, 2, 3, 4, 5, 6, np.nan, np.nan, 9], atol=1e-12)
    pd.testing.assert_frame_equal(frame, before)
    series, rows = fill_gaps(frame["x"], max_gap=1)
    pd.testing.assert_series_equal(series, filled["x"])
    assert_array_equal(rows, [5])


def test_dataframes_that_lack_frames_are_refused():
    values = {"x": cubic(np.arange(10.0))}
    frame = pd.DataFrame(values, index=np.arange(10) / 150)
    frame.iloc[[3, 4]] = np.nan
    dropped = frame.dropna()
    with pytest.raises(ValueError, match=r"goes from 0\.013\d* to 0\.033.*reindex"):
        fill_gaps(dropped, max_gap=2)
    filled, rows = fill_gaps(dropped.reindex(frame.index), max_gap=2)
    assert_array_equal(rows, [3, 4])
    assert_allclose(filled["x"], values["x"], rtol=0, atol=1e-12)
    times = pd.to_datetime(np.arange(10) * 10, unit="ms")
    fill_gaps(frame.set_index(times), max_gap=2)
    with pytest.raises(ValueError, match=r"goes from 1970.*00.020.* to 1970.*00.050"):
        fill_gaps(frame.set_index(times).dropna(), max_gap=2)
    # Two trials below each other, with one clock each or one for both.
    trials = pd.concat([frame, frame], keys=[1, 2])
    with pytest.raises(ValueError, match=r"holds 2 recordings; pass them one by one"):
        fill_gaps(trials, max_gap=2)
    names = pd.Index(list("abcdefghij"))
    assert_array_equal(fill_gaps(frame.set_index(names), max_gap=2)[1], [3, 4])
    assert len(fill_gaps(frame.iloc[:1], max_gap=2)[1]) == 0


@pytest.mark.parametrize(
    ("recording", "options", "message"),
    [
        ([1.0], {"max_gap": 0}, "max_gap must be an integer of at least 1, got 0"),
        ([1.0], {"max_gap": 1.5}, "max_gap must be .* got 1.5"),
        ([1.0], {"max_gap": True}, "max_gap must be .* got True"),
        (1.0, {}, r"recording is a float of shape \(\)"),
        ([], {}, r"recording is a list of shape \(0,\)"),
        (np.zeros((5, 0)), {}, r"recording is a ndarray of shape \(5, 0\)"),
        (np.zeros((4, 5, 9)), {}, r"ndarray of shape \(4, 5, 9\); .*one by one"),
        ([np.zeros((9, 3))] * 2, {}, r"recording is a list of shape \(2, 9, 3\)"),
        (["a", "b"], {}, "recording must be an array of numbers"),
        ([[1, 2], [3]], {}, "recording must be an array of numbers"),
        ([1, np.inf, np.nan, -np.inf], {}, r"infinity in 2 of 4 .* frame 1; replace"),
        ({}, {}, r"holds markers of \{\} frames; pass at least one"),
        ({"a": [1.0], "b": [1.0, 2.0]}, {}, r"\{'a': 1, 'b': 2\} frames"),
    ],
)
def test_bad_recordings(recording, options, message):
    with pytest.raises(ValueError, match=message):
        fill_gaps(recording, **({"max_gap": 1} | options))


# --- angles that wrap ---------------------------------------------------------------


def rotation(turn, n_frames=200):
    """An angle in two columns that rotates four times with uneven speed, and back."""
    phase = np.arange(n_frames) * 0.14
    angle = phase + 0.5 * np.sin(phase)
    return np.column_stack([angle, 6.0 - angle]) * turn / (2 * np.pi)


@pytest.mark.parametrize("period", [360, 360.0, 2 * np.pi, 1])
def test_unwrapping_is_that_of_numpy_without_gaps(period):
    angle = rotation(period)
    wrapped = angle % period
    found = unwrap_angles(wrapped, period=period)
    assert_array_equal(found, np.unwrap(wrapped, axis=0, period=period))
    assert_allclose(found - found[0], angle - angle[0], rtol=0, atol=1e-12 * period)
    assert_array_equal(unwrap_angles(wrapped[:, 0], period=period), found[:, 0])
    assert_array_equal(unwrap_angles(wrapped.tolist(), period=period), found)
    joints = np.stack([wrapped, wrapped], axis=1)
    assert_array_equal(unwrap_angles(joints, period=period)[:, 1], found)


@pytest.mark.parametrize("period", [360, 2 * np.pi])
def test_unwrapping_goes_on_across_gaps(period):
    angle = rotation(period)
    wrapped = angle % period
    # One gap over a wrap, one elsewhere, one column, both ends.
    wraps = np.flatnonzero(np.abs(np.diff(wrapped[:, 0])) > period / 2)
    assert len(wraps) == 4
    for rows in (slice(wraps[1], wraps[1] + 3), slice(50, 53), 0, [198, 199]):
        wrapped[rows] = np.nan
    wrapped[70:75, 1] = np.nan
    before = wrapped.copy()
    found = unwrap_angles(wrapped, period=period)
    assert_array_equal(wrapped, before)
    assert_array_equal(np.isnan(found), np.isnan(wrapped))
    shift = found - angle
    assert_allclose(shift, np.ones((200, 1)) * shift[1] + 0 * shift, atol=1e-9)
    # The frames to come are those of the angle that never wrapped.
    whole = np.where(np.isnan(wrapped), np.nan, angle)
    pairs, expected = (trajectory_pairs(x, gaps="split") for x in (found, whole))
    assert len(pairs.X) == len(expected.X) > 180
    assert_allclose(pairs.X - shift[1], expected.X, rtol=0, atol=1e-9)
    # And gaps are filled as if the angle had never wrapped.
    filled, rows = fill_gaps(found, max_gap=5)
    same, same_rows = fill_gaps(whole, max_gap=5)
    assert_array_equal(rows, same_rows)
    assert_allclose(filled - shift[1], same, rtol=0, atol=1e-9)


def test_the_last_valid_frame_tells_the_turn():
    # Half a turn lies between 348 and 350.
    for first, turns in ((348.0, 0), (350.0, 360)):
        angles = np.array([first, np.nan, np.nan, 169, np.nan, 190, np.nan])
        expected = angles + turns * (np.arange(7) > 0)
        assert_array_equal(unwrap_angles(angles, period=360), expected)
    assert_array_equal(unwrap_angles([np.nan, np.nan], period=360), [np.nan] * 2)


def test_columns_that_do_not_wrap_keep_their_bits():
    rng = np.random.default_rng(0)
    table = rng.uniform(-0.49, 0.49, (500, 3)) * 2 * np.pi / 3
    table[:, 2] = rotation(2 * np.pi, 500)[:, 0] % (2 * np.pi)
    table[7:9] = np.nan
    found = unwrap_angles(table, period=2 * np.pi)
    assert_array_equal(found[:, :2], table[:, :2])
    assert np.nanmax(found[:, 2]) > 60


def test_unwrapping_keeps_the_form():
    values = [340.0, 350, np.nan, 10, 20]
    expected = [340.0, 350, np.nan, 370, 380]
    masked = np.ma.masked_invalid(values)
    masked.data[2] = 9000.0
    found = unwrap_angles(masked, period=360)
    assert type(found) is np.ndarray
    assert_array_equal(found, expected)
    index = pd.Index(np.arange(5) / 100, name="time")
    counts = pd.array([1, 2, None, 4, 5], dtype="Int64")
    frame = pd.DataFrame({"thigh": values, "n": counts}, index=index)
    before = frame.copy()
    found = unwrap_angles(frame, period=360)
    pd.testing.assert_frame_equal(frame, before)
    pd.testing.assert_frame_equal(
        found,
        pd.DataFrame({"thigh": expected, "n": [1, 2, np.nan, 4, 5.0]}, index=index),
    )
    series = unwrap_angles(frame["thigh"], period=360)
    pd.testing.assert_series_equal(series, found["thigh"])
    trials = pd.concat([frame, frame], keys=[1, 2])
    with pytest.raises(ValueError, match="index of angles holds 2 recordings; pass"):
        unwrap_angles(trials, period=360)


@pytest.mark.parametrize(
    ("angles", "period", "message"),
    [
        ([1.0], 0, "period must be .* got 0"),
        ([1.0], -360, "period must be .* got -360"),
        ([1.0], np.inf, "period must be .* got inf"),
        ([1.0], "360", "period must be .* got '360'"),
        ([], 360, r"angles is a list of shape \(0,\)"),
        ([np.zeros((9, 3))] * 2, 360, r"angles is a list of shape .*one by one"),
        (["a"], 360, "angles must be an array of numbers"),
        ([1, np.inf], 360, "angles holds infinity in 1 of 2 frames, first in frame 1"),
    ],
)
def test_bad_angles(angles, period, message):
    with pytest.raises(ValueError, match=message):
        unwrap_angles(angles, period=period)


@pytest.mark.parametrize(
    ("turn", "period"), [(360, "period=360"), (2 * np.pi, r"period=2 \* np.pi")]
)
def test_filling_angles_that_wrap_warns(turn, period):
    wrapped = rotation(turn) % turn
    frame = pd.DataFrame(wrapped, columns=["thigh", "shank"])
    frame["smooth"] = np.sin(np.arange(200) * 0.1)
    frame.loc[50:52, ["thigh", "smooth"]] = np.nan
    message = rf"^recording jumps .* column thigh: .*unwrap_angles\(\.\.\., {period}\)"
    with pytest.warns(UserWarning, match=message) as record:
        fill_gaps(frame, max_gap=3)
    assert len(record) == 1
    assert record[0].filename == __file__
    fill_gaps(frame, max_gap=2)  # which fills nothing
    fill_gaps(frame[["shank", "smooth"]], max_gap=3)
    fill_gaps(unwrap_angles(frame, period=turn), max_gap=3)
    with pytest.warns(UserWarning, match=r"^recording jumps .* column 0:"):
        fill_gaps(frame["thigh"], max_gap=3)


def test_a_wrap_that_was_filled_does_not_mute_the_others():
    angle = 340.0 + 5.2 * np.arange(400)
    wrapped = angle % 360
    wrapped[212] = np.nan  # where it passes zero
    with pytest.warns(UserWarning, match="unwrap_angles"):
        filled, rows = fill_gaps(wrapped, max_gap=1)
    assert_array_equal(rows, [212])
    assert 90 < filled[212] < 270  # far from both ends of the circle
    with pytest.warns(UserWarning, match=r"trajectories\[0\] jumps .*unwrap_angles"):
        trajectory_pairs(filled[:, None])
    filled, _ = fill_gaps(unwrap_angles(wrapped, period=360), max_gap=1)
    assert_allclose(filled, angle, rtol=0, atol=1e-9)


def test_columns_of_one_turn_are_named_together():
    angles = np.column_stack([rotation(360) % 360, rotation(2 * np.pi) % (2 * np.pi)])
    angles[30:32] = np.nan
    with pytest.warns(UserWarning, match="wrap") as record:
        fill_gaps(angles, max_gap=2)
    [text] = [str(warning.message) for warning in record]  # the others come next
    assert "column 0, 1: " in text
    assert "period=360)" in text


def test_masked_markers_are_refused_then_filled(walk):
    markers = [np.ma.masked_array(marker, mask=False) for marker in walk]
    smooth = [np.ma.masked_array(marker) for marker in WALK]
    expected, _ = leg_angles(*smooth, forward=0, up=1)
    markers[1][7, 2] = 9000.0
    markers[1][7, 2] = np.ma.masked
    with pytest.raises(ValueError, match=r"knee .* masked in 1 .* 7; .*fill_gaps"):
        leg_angles(*markers, forward=0, up=1)
    smooth[1][100:103] = np.ma.masked
    filled = [fill_gaps(marker, max_gap=3)[0] for marker in smooth]
    angles, _ = leg_angles(*filled, forward=0, up=1)
    # 20 ms at 150 Hz.
    assert np.abs(angles - expected).max() < np.radians(0.05)


def _with(marker, frame, value):
    def change(markers):
        markers[marker][frame] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_with("ankle", 7, np.inf), r"ankle holds infinity .* 1 of 200 .* frame 7"),
        (
            lambda m: [
                _with("hip", slice(100, None), np.nan)(m),
                m.update(
                    knee=np.where(np.arange(200)[:, None] < 100, np.nan, m["knee"])
                ),
            ],
            r"no frame of 200 .* NaN in \{'hip': 100, 'knee': 100, 'ankle': 0\} frames",
        ),
        (
            lambda m: [_with("hip", 2, np.nan)(m), _with("ankle", 5, m["knee"][5])(m)],
            r"shank has no length .* frame 5",
        ),
        (
            lambda m: m.update(hip=m["hip"][:-1]),
            r"'hip': \(199, 3\), 'knee': \(200, 3\), 'an",
        ),
        (lambda m: m.update(hip=m["hip"][:, :2]), r"'hip': \(200, 2\), .* \(200, 3\)"),
        (lambda m: m.update(knee=[[1, 2, 3], [4]]), r"knee must be an array of num"),
        (lambda m: m.update(hip=m["hip"][0]), r"'hip': \(3,\)"),
        (lambda m: m.update(hip=1), r"'hip': \(\), "),
        (lambda m: m.update(hip=m["hip"][:0]), r"'hip': \(0, 3\)"),
        (lambda m: m.update(knee=m["hip"]), r"thigh has no length .* frame 0"),
        (
            lambda m: m["ankle"].__setitem__(5, m["knee"][5] + [0, 0, 99]),
            r"shank has no length .* frame 5",
        ),
        (lambda m: m.update(ankle=m["ankle"] * 100), r"thigh length is .* unit"),
        (lambda m: m.update(ankle=m["knee"] + [0, -0.4, 0]), r"shank length 0\.4;"),
    ],
)
def test_bad_markers(walk, change, message):
    markers = dict(zip(("hip", "knee", "ankle"), walk, strict=True))
    change(markers)
    with pytest.raises(ValueError, match=message):
        leg_angles(**markers, forward=0, up=1)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({"forward": 3, "up": 1}, r"forward=3 is no direction; pass .* \(0, 1 or 2\)"),
        ({"forward": 0, "up": -1}, "up=-1 is no direction"),
        ({"forward": 0, "up": 0}, "forward=0 and up=0 are not orthogonal"),
        ({"forward": [1, 1e-5, 0], "up": 1}, "not orthogonal"),
        ({"forward": [0, 0, 0], "up": 1}, "forward=.* is no direction"),
        ({"forward": [1, np.nan, 0], "up": 1}, "forward=.* is no direction"),
        ({"forward": 0, "up": [0, 1]}, "up=.* is no direction"),
        ({"forward": 0, "up": True}, "up=True is no direction"),
        ({"forward": "x", "up": 1}, "forward must be an array of numbers"),
        ({"forward": 0.0, "up": 1}, "forward=0.0 is no direction"),
    ],
)
def test_bad_axes(walk, axes, message):
    with pytest.raises(ValueError, match=message):
        leg_angles(*walk, **axes)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ({"forward": 2, "up": 1}, r"forward=2 is no direction; .*\(0 or 1\).* 2 compo"),
        ({"forward": [1, 0, 0], "up": 1}, r"forward=\[1, 0, 0\] is no direction"),
        ({"forward": 1, "up": 1}, "not orthogonal"),
    ],
)
def test_bad_axes_of_planar_markers(walk, axes, message):
    with pytest.raises(ValueError, match=message):
        leg_angles(*(marker[:, :2] for marker in walk), **axes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_with("knee", (3, 1), -np.inf), r"knee holds infinity .* 1 of 200 .* frame 3"),
        (_with("knee", slice(None), np.nan), r"'knee': 200, .* seen together"),
        (lambda m: m.update(hip=m["hip"][:, :2]), r"'hip': \(200, 2\), .* \(200, 3\)"),
        (lambda m: {m.update({k: m[k][:, :1]}) for k in m}, r"'hip': \(200, 1\)"),
        (lambda m: m.update(ankle=m["ankle"] * 100), r"thigh length is .* unit"),
        (
            lambda m: m["ankle"].__setitem__(5, m["knee"][5]),
            "the shank has no length in frame 5; check the markers.$",
        ),
    ],
)
def test_length_of_bad_markers(walk, change, message):
    markers = dict(zip(("hip", "knee", "ankle"), walk, strict=True))
    change(markers)
    with pytest.raises(ValueError, match=message):
        leg_length(**markers)


def test_nearly_orthogonal_axes_pass(walk):
    leg_angles(*walk, forward=[1, 1e-7, 0], up=1)
