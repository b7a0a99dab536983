"""Joint angles from markers: known poses, the inverse formula, invariances."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_koopman.kinematics import leg_angles


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


def _with(marker, frame, value):
    def change(markers):
        markers[marker][frame] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_with("knee", (3, 1), np.nan), r"knee holds NaN .* 1 of 200 .* frame 3"),
        (_with("ankle", 7, np.inf), r"ankle holds NaN or infinity .* frame 7"),
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


def test_nearly_orthogonal_axes_pass(walk):
    leg_angles(*walk, forward=[1, 1e-7, 0], up=1)
