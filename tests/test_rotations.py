"""Angles on their circle and rotations in SO(3), there and back, and what that brings.

The systems are maps of the circle, of the torus and of SO(3) that can be computed
exactly. Errors are those around the circle, and angles between rotations.
"""

import pickle

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from sklearn.base import clone
from sklearn.compose import TransformedTargetRegressor
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline

from sklearn_koopman import KernelEDMD, KoopmanKernelRegressor, trajectory_pairs
from sklearn_koopman.kinematics import RotationEncoder, unwrap_angles

TURN = {"radians": 2 * np.pi, "degrees": 360.0}


def around(difference, turn=2 * np.pi):
    """Bring differences of angles to within half a turn of zero."""
    return (difference + turn / 2) % turn - turn / 2


def rms(error):
    return np.sqrt(np.mean(error**2))


def random_rotations(n_rotations, seed):
    quaternions = np.random.default_rng(seed).normal(size=(n_rotations, 4))
    return Rotation.from_quat(quaternions)


# --- there and back -----------------------------------------------------------------


def test_angles_by_hand():
    X = np.array([[0.0, 5.0, 90.0], [180.0, 6.0, -30.0]])
    encoder = RotationEncoder([0, 2], unit="degrees").fit(X)
    half = np.sqrt(3) / 2
    expected = [[1, 0, 5, 0, 1], [-1, 0, 6, half, -0.5]]
    assert_allclose(encoder.transform(X), expected, rtol=0, atol=1e-15)
    assert_allclose(encoder.inverse_transform(expected), X, rtol=0, atol=1e-13)


def test_rotations_by_hand():
    # A quarter of a turn about z carries x to y.
    matrix = [0, -1, 0, 1, 0, 0, 0, 0, 1]
    half = np.sqrt(0.5)
    for encoder, row in (
        (RotationEncoder([], quaternions=range(4)), [0, 0, half, half]),
        (
            RotationEncoder([], quaternions=range(4), scalar_first=True),
            [half, 0, 0, half],
        ),
        (RotationEncoder([], rotation_vectors=range(3)), [0, 0, np.pi / 2]),
        (RotationEncoder([], rotation_vectors=range(3), unit="degrees"), [0, 0, 90]),
    ):
        encoded = encoder.fit_transform([row])
        assert_allclose(encoded, [matrix], rtol=0, atol=1e-15)
        assert_allclose(encoder.inverse_transform(encoded), [row], rtol=0, atol=1e-13)


def test_matrices_are_those_of_the_formula():
    """The formula of the notes, and Rodrigues' for the vectors."""
    rotations = random_rotations(50, 0)
    quaternions = rotations.as_quat()
    encoded = RotationEncoder([], quaternions=range(4)).fit_transform(quaternions)
    for (*vector, w), found in zip(quaternions, encoded, strict=True):
        v = np.array(vector)
        cross = np.cross(v, np.eye(3)).T  # cross @ u is the cross product of v and u
        expected = (w**2 - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * cross
        assert_allclose(found.reshape(3, 3), expected, rtol=0, atol=1e-14)
    vectors = rotations.as_rotvec()
    same = RotationEncoder([], rotation_vectors=range(3)).fit_transform(vectors)
    assert_allclose(same, encoded, rtol=0, atol=1e-14)


@pytest.mark.parametrize("unit", TURN)
def test_all_kinds_at_once_return(unit):
    """Columns in any order, those of a quaternion apart and not sorted."""
    rng = np.random.default_rng(1)
    turn, n_rows = TURN[unit], 40
    first, second = (
        random_rotations(2 * n_rows, 2).as_quat(canonical=True).reshape(2, n_rows, 4)
    )
    vectors = random_rotations(n_rows, 3).as_rotvec() * turn / (2 * np.pi)
    angles = rng.uniform(-turn / 2, turn / 2, (n_rows, 2))
    others = rng.normal(size=(n_rows, 2))
    names = ["other", "qz", "hip", "vx", "qx", "qy", "qw", "knee"]
    names += ["vy", "vz", "py", "pz", "px", "pw", "another"]
    X = pd.DataFrame(index=range(n_rows), columns=names, dtype=float)
    X[["qx", "qy", "qz", "qw"]], X[["px", "py", "pz", "pw"]] = first, second
    X[["vx", "vy", "vz"]], X[["hip", "knee"]] = vectors, angles
    X[["other", "another"]] = others
    encoder = RotationEncoder(
        ["knee", "hip"],
        quaternions=["qw", "qx", "qy", "qz", "pw", "px", "py", "pz"],
        rotation_vectors=["vx", "vy", "vz"],
        unit=unit,
        scalar_first=True,
    ).set_output(transform="pandas")
    encoded = encoder.fit_transform(X)
    matrix = [f"r{i}{j}" for i in "123" for j in "123"]
    assert list(encoded) == [
        "other",
        *(f"qz_{entry}" for entry in matrix),
        *("hip_cos", "hip_sin"),
        *(f"vx_{entry}" for entry in matrix),
        *("knee_cos", "knee_sin"),
        *(f"py_{entry}" for entry in matrix),
        "another",
    ]
    assert_array_equal(encoded[["other", "another"]], others)
    radians = X["hip"] * 2 * np.pi / turn
    assert_allclose(encoded["hip_sin"], np.sin(radians), rtol=0, atol=1e-15)
    expected = Rotation.from_quat(second).as_matrix().reshape(-1, 9)
    assert_allclose(encoded.filter(like="py_"), expected, rtol=0, atol=1e-14)
    assert_allclose(encoder.inverse_transform(encoded), X, rtol=0, atol=1e-11)
    # Numbers in place of names, and an array.
    numbers = {
        name: [names.index(column) for column in getattr(encoder, name)]
        for name in ("angles", "quaternions", "rotation_vectors")
    }
    same = clone(encoder).set_params(**numbers).set_output(transform="default")
    assert_array_equal(same.fit_transform(X.to_numpy()), encoded)
    assert_array_equal(same.fit_transform(X), encoded)


def test_all_columns_that_are_named_nowhere_else_are_angles():
    X = np.random.default_rng(0).uniform(-1, 1, (9, 5))
    assert_array_equal(RotationEncoder().fit(X).angle_columns_, range(5))
    encoder = RotationEncoder(rotation_vectors=[3, 1, 2]).fit(X)
    assert_array_equal(encoder.angle_columns_, [0, 4])
    assert_array_equal(encoder.rotation_vector_columns_, [[3, 1, 2]])
    nothing = RotationEncoder([])
    assert_array_equal(nothing.fit_transform(X), X)
    assert_array_equal(nothing.inverse_transform(X), X)


def test_signs_and_turns_of_what_returns():
    """A quaternion and its negative are one rotation, so are a vector and a longer."""
    quaternions = random_rotations(200, 4).as_quat()
    encoder = RotationEncoder([], quaternions=range(4)).fit(quaternions)
    encoded = encoder.transform(quaternions)
    assert_allclose(encoder.transform(-quaternions), encoded, rtol=0, atol=1e-15)
    back = encoder.inverse_transform(encoded)
    sign = np.sign(quaternions[:, [3]])
    assert (sign < 0).any()
    assert_allclose(back, sign * quaternions, rtol=0, atol=1e-13)
    # 270 degrees about an axis are 90 about its opposite.
    encoder = RotationEncoder([], rotation_vectors=range(3), unit="degrees")
    encoded = encoder.fit_transform([[0, 270, 0]])
    assert_allclose(encoder.inverse_transform(encoded), [[0, -90, 0]], atol=1e-12)


@pytest.mark.parametrize("unit", TURN)
@pytest.mark.parametrize(
    ("parts", "middle"),
    [
        ([-0.5, 0, 0.5], 0),  # parts of a turn
        ([-0.1, 0.2], 0),
        ([0, 0.3, 0.999], 0.5),
        ([0, 1], 0.5),
        ([0.4, 0.5, 0.6], 0.5),  # a knee that is straight at 180 degrees
        ([-0.45, -0.6], -0.5),
        ([-1, 0], -0.5),
        ([1.2, 1.7], 1.5),
        ([0.8, 1.3], 1),
        ([-0.1, -1], -0.5),
        ([0, -0.7, -0.3], -0.5),
        ([-0.4, 0.8], 0),  # more than a turn
        ([0, 1.9], 0),
    ],
)
def test_turn_of_the_angles_that_were_seen(unit, parts, middle):
    turn = TURN[unit]
    X = turn * np.array(parts)[:, np.newaxis]
    encoder = RotationEncoder(unit=unit).fit(X)
    assert_allclose(encoder.middles_, [middle * turn], rtol=0, atol=0)
    back = encoder.inverse_transform(encoder.transform(X))
    assert_allclose(around(back - X, turn), 0, atol=1e-12)
    assert (np.abs(back - middle * turn) <= turn / 2 * (1 + 1e-15)).all()
    if np.ptp(parts) <= 1:
        assert_allclose(back, X, rtol=0, atol=1e-12)


@pytest.mark.parametrize("unit", ["degrees", "radians"])
@pytest.mark.parametrize("ends", [(0, 360), (-360, 0), (-180, 180), (360, 540)])
def test_a_zero_with_a_sign_returns_as_zero(unit, ends):
    turn = 360.0 if unit == "degrees" else 2 * np.pi
    angles = np.array([[*ends]]).T * turn / 360
    zeros = np.array([[0.0], [-0.0]])
    encoder = RotationEncoder(unit=unit).fit(angles)
    returned = encoder.inverse_transform(encoder.transform(zeros))
    np.testing.assert_array_equal(
        returned, np.full((2, 1), max(ends[0], 0) * turn / 360)
    )


def test_copies_with_delays_are_named_one_after_another():
    turns = Rotation.random(30, random_state=0).as_quat(canonical=True)
    pairs = trajectory_pairs([turns], delays=3)
    encoder = RotationEncoder([], quaternions=list(range(12))).fit(pairs.X)
    matrices = Rotation.from_quat(turns).as_matrix().reshape(-1, 9)
    encoded = encoder.transform(pairs.X)
    for copy in range(3):
        np.testing.assert_allclose(
            encoded[:, 9 * copy : 9 * copy + 9],
            matrices[2 - copy : 29 - copy],
            rtol=0,
            atol=1e-14,
        )


def test_radians_that_are_degrees_warn():
    knee = np.array([[0.0, 1.0], [60.0, 1.2], [np.nan, 1.1]])
    with pytest.warns(UserWarning, match=r"reach 60 radians\. .*unit='degrees'; .*%"):
        RotationEncoder().fit(knee)
    # A crank that turns on and on.
    turns = np.arange(0, 30, 0.7)[:, np.newaxis]
    with pytest.warns(UserWarning, match="reach 29.4 radians"):
        encoded = RotationEncoder().fit_transform(turns)
    once = RotationEncoder().fit_transform(turns % (2 * np.pi))
    assert_allclose(once, encoded, rtol=0, atol=1e-14)
    RotationEncoder(unit="degrees").fit(knee)


def test_each_angle_has_its_own_turn():
    X = np.array([[-10.0, 170.0, np.nan], [20.0, 190.0, np.nan]])
    encoder = RotationEncoder(unit="degrees").fit(X)
    assert_array_equal(encoder.middles_, [0, 180, 0])
    assert not np.signbit(encoder.middles_).any()
    back = encoder.inverse_transform(encoder.transform(X))
    assert_allclose(back, X, rtol=0, atol=1e-12)


# --- the nearest rotation -----------------------------------------------------------


def nearest_by_eigenvectors(matrix):
    """Davenport's q method: the quaternion is an eigenvector of a 4 x 4 matrix."""
    antisymmetric = matrix - matrix.T
    vector = [antisymmetric[2, 1], antisymmetric[0, 2], antisymmetric[1, 0]]
    whole = np.empty((4, 4))
    whole[:3, :3] = matrix + matrix.T - np.trace(matrix) * np.eye(3)
    whole[3, :3] = whole[:3, 3] = vector
    whole[3, 3] = np.trace(matrix)
    quaternion = np.linalg.eigh(whole)[1][:, -1]
    return quaternion * np.sign(quaternion[3])


@pytest.mark.parametrize("noise", [1e-6, 0.1, 0.5, 2.0])
def test_nearest_rotation_is_that_of_another_method(noise):
    """Also where the determinant is negative, which polar factors get wrong."""
    rng = np.random.default_rng(5)
    exact = random_rotations(200, 6).as_matrix()
    matrices = exact + noise * rng.normal(size=exact.shape)
    if noise > 1:
        assert (np.linalg.det(matrices) < 0).sum() > 50
    encoder = RotationEncoder([], quaternions=range(4)).fit([[0, 0, 0, 1.0]])
    found = encoder.inverse_transform(matrices.reshape(-1, 9))
    assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-14)
    assert (found[:, 3] >= 0).all()
    expected = np.array([nearest_by_eigenvectors(matrix) for matrix in matrices])
    assert_allclose(found, expected, rtol=0, atol=1e-9)
    # No other rotation is nearer.
    rotations = Rotation.from_quat(found).as_matrix()
    distance = np.linalg.norm(rotations - matrices, axis=(1, 2))
    others = random_rotations(500, 7).as_matrix()
    for matrix, least in zip(matrices, distance, strict=True):
        assert (np.linalg.norm(others - matrix, axis=(1, 2)) > least).all()


def test_nearest_rotation_does_not_hang_on_scale():
    matrices = 0.01 * random_rotations(20, 8).as_matrix().reshape(-1, 9)
    encoder = RotationEncoder([], rotation_vectors=range(3)).fit([[0, 0, 0.0]])
    expected = random_rotations(20, 8).as_rotvec()
    assert_allclose(encoder.inverse_transform(matrices), expected, rtol=0, atol=1e-12)


def test_two_rows_of_a_matrix_are_enough():
    """Of rank two the nearest rotation is unique still; the third row is a product."""
    matrices = random_rotations(20, 9).as_matrix()
    known = matrices.copy()
    known[:, 2] = 0
    encoder = RotationEncoder([], quaternions=range(4)).fit([[0, 0, 0, 1.0]])
    found = Rotation.from_quat(encoder.inverse_transform(known.reshape(-1, 9)))
    assert_allclose(found.as_matrix(), matrices, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    "matrix",
    [
        np.zeros((3, 3)),
        np.diag([1.0, 0, 0]),
        np.ones((3, 3)),
        np.diag([1.0, 1, -1]),
        -np.eye(3),
        1e-9 * np.eye(3),
    ],
)
def test_what_tells_no_rotation_becomes_nan_with_a_warning(matrix):
    good = np.concatenate([np.eye(3).ravel(), [5.0]])
    bad = np.concatenate([matrix.ravel(), [6.0]])
    for encoder, n_columns in (
        (RotationEncoder([], quaternions=range(4)), 4),
        (RotationEncoder([], rotation_vectors=range(3)), 3),
    ):
        unit = np.eye(1, n_columns + 1)
        encoder.fit(unit)
        with pytest.warns(UserWarning, match="1 of 3 rows tell no .* first is row 1"):
            found = encoder.inverse_transform([good, bad, good])
        assert_array_equal(np.isnan(found[:, :n_columns]).all(axis=1), [0, 1, 0])
        assert not np.isnan(found[[0, 2]]).any()
        assert_array_equal(found[:, n_columns], [5, 6, 5])


def test_vectors_without_a_direction_become_nan_with_a_warning():
    encoder = RotationEncoder([0], unit="degrees").fit([[10.0, 1.0]])
    with pytest.warns(UserWarning, match="2 of 3 rows .* first is row 0") as record:
        found = encoder.inverse_transform([[0, 0, 1], [1e-6, 1e-6, 2], [1e-9, 0, 3]])
    assert record[0].filename == __file__
    assert_allclose(found, [[np.nan, 1], [45, 2], [np.nan, 3]], rtol=1e-14)


@pytest.mark.filterwarnings("ignore::sklearn_koopman.ExtrapolationWarning")
def test_predictions_far_from_all_data_are_nan_not_an_angle():
    """A kernel estimate is zero there, and so are cosine and sine."""
    X = np.linspace(0, 1, 20)[:, np.newaxis]
    model = TransformedTargetRegressor(
        KoopmanKernelRegressor("wendland_c2", beta=1.0),
        transformer=RotationEncoder(unit="degrees"),
    ).fit(X, 100 * X.ravel())
    with pytest.warns(UserWarning, match="tell no rotation"):
        found = model.predict([[0.5], [30.0]])
    assert_allclose(found, [50, np.nan], rtol=1e-3)


# --- gaps ---------------------------------------------------------------------------


def test_gaps_stay_gaps():
    rng = np.random.default_rng(10)
    X = np.column_stack(
        [rng.normal(size=(9, 2)), random_rotations(9, 11).as_quat(canonical=True)]
    )
    encoder = RotationEncoder([0], quaternions=range(2, 6)).fit(X)
    whole = encoder.transform(X)
    gappy = X.copy()
    gappy[2, 0] = gappy[3, 1] = gappy[5, 4] = np.nan
    expected = whole.copy()
    expected[2, :2] = expected[3, 2] = expected[5, 3:] = np.nan
    encoded = clone(encoder).fit_transform(gappy)
    assert_array_equal(encoded, expected)
    back = encoder.inverse_transform(encoded)  # without a warning
    expected = gappy.copy()
    expected[5, 2:] = np.nan
    assert_allclose(back, expected, rtol=0, atol=1e-13)
    masked = np.ma.masked_invalid(gappy)
    assert_array_equal(clone(encoder).fit_transform(masked), encoded)
    frame = pd.DataFrame(gappy).add_prefix("x").convert_dtypes()
    assert frame.isna().to_numpy().any()
    assert_array_equal(clone(encoder).fit_transform(frame), encoded)


def test_gaps_split_recordings_after_encoding():
    crank = np.arange(0, 1000, 10.0)[:, np.newaxis] % 360
    crank[40:43] = np.nan
    encoded = RotationEncoder(unit="degrees").fit_transform(crank)
    pairs = trajectory_pairs(encoded, gaps="split")
    assert len(pairs.X) == 39 + 56
    assert_allclose(np.hypot(*pairs.X.T), 1, rtol=1e-15)


# --- the interface ------------------------------------------------------------------

UNIT = np.array([[0.0, 0, 0, 1], [0, 0, 0, 1]])
FRAME = pd.DataFrame(UNIT, columns=["hip", "b", "c", "d"])


@pytest.mark.parametrize(
    ("options", "X", "message"),
    [
        ({"angles": ["knee"]}, FRAME, r"=\['knee'\] holds 'knee'.* names \['hip'"),
        ({"angles": ["hip"]}, UNIT, "holds 'hip'.* no names.*TransformedTarget"),
        ({"angles": [4]}, UNIT, r"angles=\[4\] holds 4, .* from 0 to 3"),
        ({"angles": [-1]}, UNIT, "holds -1, which is no column"),
        ({"angles": [True]}, UNIT, "holds True, which is no column"),
        ({"angles": [0.0]}, UNIT, r"holds 0\.0, which is no column"),
        ({"angles": [[0, 1]]}, UNIT, r"holds the list \[0, 1\]; name all col"),
        ({"quaternions": [(0, 1, 2, 3)]}, UNIT, "in one list, one after another"),
        ({"angles": "hip"}, FRAME, "angles='hip' must be a list"),
        ({"angles": 0}, UNIT, "angles=0 must be a list"),
        ({"angles": [0, 0]}, UNIT, "column 0 is named twice, in angles and in angles="),
        ({"angles": ["hip", 0]}, FRAME, "column 'hip' is named twice"),
        (
            {"angles": [3], "quaternions": range(4)},
            UNIT,
            "column 3 is named twice, in quaternions and in angles=",
        ),
        ({"quaternions": [0, 1, 2]}, UNIT, "3 columns, .* no whole quaternions of 4"),
        ({"rotation_vectors": range(4)}, UNIT, "4 columns, .* rotation vectors of 3"),
        ({"unit": "degree"}, UNIT, "one of 'radians', 'degrees', got 'degree'"),
        ({"scalar_first": 1}, UNIT, "scalar_first must be True or False, got 1"),
        ({}, [[0.0, np.inf]], "infinity"),
        (
            {"quaternions": range(4)},
            [*UNIT, [0, 0, 0, 0], [np.nan, 0, 0, 3], [1, 1, 0, 0]],
            r"2 quaternions whose length is not 1, first in row 2, in the columns "
            r"\[0, 1, 2, 3\], of length 0;",
        ),
        ({"quaternions": range(4)}, 1.02 * UNIT, "in row 0, .* of length 1.02"),
        ({"quaternions": range(4)}, 1e200 * UNIT, "length"),
    ],
)
def test_bad_input(options, X, message):
    encoder = RotationEncoder(unit="degrees").fit(np.zeros((1, 3)))
    before = vars(encoder).copy()
    encoder.set_params(**options)
    with pytest.raises(ValueError, match=message):
        encoder.fit(X)
    # What was fitted before is there still.
    assert {name for name in vars(encoder) if name.endswith("_")} == {
        name for name in before if name.endswith("_")
    }
    assert encoder.n_features_in_ == 3


def test_rounded_quaternions_pass():
    """Two digits in a file; the rotation is that of the quaternion made longer."""
    exact = random_rotations(100, 12)
    rounded = exact.as_quat().round(2)
    assert np.abs(np.linalg.norm(rounded, axis=1) - 1).max() > 0.004
    encoder = RotationEncoder([], quaternions=range(4)).fit(rounded)
    matrices = encoder.transform(rounded).reshape(-1, 3, 3)
    for matrix in matrices:
        assert_allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.abs(matrices - exact.as_matrix()).max() < 0.03


def test_bad_quaternions_are_refused_after_fit_too():
    encoder = RotationEncoder([], quaternions=range(4)).fit(UNIT)
    with pytest.raises(ValueError, match="first in row 1"):
        encoder.transform([*UNIT[:1], [3.0, 0, 0, 0]])


def test_bad_predictions():
    encoder = RotationEncoder([0]).fit([[0.0, 1.0]])
    with pytest.raises(ValueError, match="X has 2 columns, but transform returns 3"):
        encoder.inverse_transform([[1.0, 2.0]])
    with pytest.raises(ValueError, match="infinity"):
        encoder.inverse_transform([[1.0, np.inf, 0.0]])


def test_names_that_are_taken_are_refused():
    encoder = RotationEncoder(["hip"])
    X = pd.DataFrame([[0.0, 1.0]], columns=["hip", "hip_cos"])
    with pytest.raises(ValueError, match="two columns would get the name 'hip_cos'"):
        encoder.fit(X).get_feature_names_out()
    assert encoder.transform(X).shape == (1, 3)


def test_input_is_left_alone():
    X = np.column_stack([np.ones(4), random_rotations(4, 13).as_quat()])
    X[1] = np.nan
    copy = X.copy()
    encoder = RotationEncoder(quaternions=range(1, 5), unit="degrees").fit(X)
    encoded = encoder.transform(X)
    assert_array_equal(X, copy)
    copy = encoded.copy()
    encoder.inverse_transform(encoded)
    assert_array_equal(encoded, copy)


def test_storage():
    X = np.column_stack([np.full(4, 200.0), random_rotations(4, 13).as_quat()])
    encoder = RotationEncoder(quaternions=range(1, 5), unit="degrees").fit(X)
    data = pickle.dumps(encoder)
    assert b"sklearn_koopman.kinematics\x94" in data
    assert b"_rotations" not in data
    loaded = pickle.loads(data)
    encoded = encoder.transform(X)
    assert_array_equal(loaded.transform(X), encoded)
    found, expected = (one.inverse_transform(encoded) for one in (loaded, encoder))
    assert_array_equal(found, expected)


def test_skops():
    skops = pytest.importorskip("skops.io")
    encoder = RotationEncoder([1], unit="degrees").fit([[1.0, 2.0], [3.0, 300.0]])
    data = skops.dumps(encoder)
    trusted = skops.get_untrusted_types(data=data)
    assert trusted == ["sklearn_koopman.kinematics.RotationEncoder"]
    loaded = skops.loads(data, trusted=trusted)
    encoded = encoder.transform([[1.0, 2.0]])
    found, expected = (one.inverse_transform(encoded) for one in (loaded, encoder))
    assert_array_equal(found, expected)


# --- outputs ------------------------------------------------------------------------


def test_outputs_return_as_angles_without_a_warning():
    """One output or several, of one turn each; an array and a DataFrame."""
    X = np.linspace(0, 1, 30)[:, np.newaxis]
    y = np.column_stack([1 + 358 * X[:, 0], 150 + 50 * X[:, 0], X[:, 0] ** 2])
    for outputs, columns in ((y[:, 0], None), (y, [0, 1]), (pd.DataFrame(y), [0, 1])):
        model = TransformedTargetRegressor(
            KoopmanKernelRegressor("matern52"),
            transformer=RotationEncoder(columns, unit="degrees"),
        ).fit(X, outputs)
        found = model.predict(X)
        assert found.shape == np.shape(outputs)
        assert_allclose(found, outputs, rtol=0, atol=1e-7)
        assert model.score(X, outputs) > 1 - 1e-9


def test_names_are_lost_in_the_transformation_of_outputs():
    """Column numbers work there, and the error says so."""
    X = np.arange(3.0)[:, np.newaxis]
    y = pd.DataFrame({"hip": [0.1, 0.2, 0.3], "force": [1.0, 2.0, 3.0]})
    model = TransformedTargetRegressor(transformer=RotationEncoder(["hip"]))
    with pytest.raises(ValueError, match="no names, which TransformedTargetRegressor"):
        model.fit(X, y)


def test_which_outputs_are_not_their_own_inverse():
    X = np.arange(30.0)[:, np.newaxis]
    unwrapped = 50 * X.ravel()
    quaternions = random_rotations(30, 14).as_quat()
    for y, encoder in (
        (unwrapped, RotationEncoder(unit="degrees")),
        (quaternions, RotationEncoder(quaternions=range(4))),
    ):
        model = TransformedTargetRegressor(LinearRegression(), transformer=encoder)
        with pytest.warns(UserWarning, match="check_inverse=False"):
            model.fit(X, y)
        model.set_params(check_inverse=False).fit(X, y)  # silent
    canonical = np.where(quaternions[:, [3]] < 0, -quaternions, quaternions)
    model.set_params(check_inverse=True).fit(X, canonical)


def test_bad_outputs_are_named_by_their_own_row():
    """`TransformedTargetRegressor` looks at every third row only, but fits all."""
    y = np.tile([0.0, 0, 0, 1], (30, 1))
    y[7] = 0
    encoder = RotationEncoder(quaternions=range(4))
    model = TransformedTargetRegressor(transformer=encoder)
    with pytest.raises(ValueError, match="first in row 7"):
        model.fit(np.arange(30.0)[:, np.newaxis], y)


# --- maps of the circle, the torus and SO(3) ----------------------------------------


def learn(kernel, states, outputs, encoder, which):
    """Fit raw states and outputs, encode the outputs, or encode both."""
    regressor = KoopmanKernelRegressor(kernel)
    if which == "both":
        regressor = make_pipeline(clone(encoder), regressor)
    if which != "neither":
        regressor = TransformedTargetRegressor(
            regressor, transformer=clone(encoder), check_inverse=False
        )
    return regressor.fit(states, outputs)


def orbit(step, start, n_steps):
    states = [np.asarray(start)]
    for _ in range(n_steps):
        states.append(step(states[-1]))
    return np.array(states)


def test_map_of_the_circle():
    """Turn by the golden part of a circle, and 0.4 sin(angle) more."""

    def step(angle):
        return angle + np.pi * (np.sqrt(5) - 1) + 0.4 * np.sin(angle)

    states = around(orbit(step, [0.3], 200))
    X = np.random.default_rng(0).uniform(-np.pi, np.pi, (2000, 1))
    errors = {}
    for which in ("neither", "outputs", "both"):
        model = learn("matern32", states[:-1], states[1:], RotationEncoder(), which)
        predicted = model.predict(X).reshape(-1, 1)
        errors[which] = np.abs(around(predicted - step(X))).max()
    # Measured: 3.1, 7.9e-4 and 1.5e-7 rad.
    assert errors["neither"] > 1.0
    assert 1e-4 < errors["outputs"] < 5e-3
    assert errors["both"] < 1.6e-6


def test_map_of_the_torus():
    """Two angles that turn on, each pushed by the other."""

    def step(angles):
        first, second = np.moveaxis(angles, -1, 0)
        turn = np.pi * (np.sqrt(5) - 1), 2 * np.pi * np.sqrt(2)
        push = np.stack([0.3 * np.sin(second), 0.3 * np.cos(first)], axis=-1)
        return angles + turn + push

    states = around(orbit(step, [0.0, 0.0], 600))
    X = np.random.default_rng(1).uniform(-np.pi, np.pi, (1000, 2))
    errors = {}
    for which in ("neither", "outputs", "both"):
        model = learn("matern52", states[:-1], states[1:], RotationEncoder(), which)
        errors[which] = rms(around(model.predict(X) - step(X)))
    # Measured: 0.45, 1.7e-4 and 3.0e-7 rad.
    assert errors["neither"] > 0.1
    assert errors["outputs"] > 3e-5
    assert errors["both"] < 2e-6


def push_rotation(rotation, size=0.3):
    """Twist about z, about x, by angles that depend on the state, then turn on.

    Each twist leaves its own angle as it is, so that the map preserves volume.
    """
    for axis, entry in ((2, 0), (0, 1)):
        twist = np.zeros((len(rotation), 3))
        twist[:, axis] = size * rotation.as_matrix()[:, entry, axis]
        rotation = rotation * Rotation.from_rotvec(twist)
    return Rotation.from_rotvec([0.4, 1.1, -0.7]) * rotation


def test_map_of_rotations():
    """120 trajectories of 10 steps from random starts; other rotations are tested."""
    trajectory = [random_rotations(120, 15)]
    for _ in range(10):
        trajectory.append(push_rotation(trajectory[-1]))
    quaternions = np.array([rotation.as_quat() for rotation in trajectory])
    now, after = (
        Rotation.from_quat(part.reshape(-1, 4))
        for part in (quaternions[:-1], quaternions[1:])
    )
    new = random_rotations(1000, 16)
    true = push_rotation(new)

    def error(predicted):
        return rms((Rotation.from_quat(predicted) * true.inv()).magnitude())

    encoder = RotationEncoder([], quaternions=range(4))
    euler, new_euler = now.as_euler("xyz"), new.as_euler("xyz")
    neither = learn("matern52", euler, after.as_euler("xyz"), encoder, "neither")
    predicted = Rotation.from_euler("xyz", neither.predict(new_euler)).as_quat()
    assert error(predicted) > 0.3
    outputs = learn("matern52", euler, after.as_quat(), encoder, "outputs")
    both = learn("matern52", now.as_quat(), after.as_quat(), encoder, "both")
    # Measured: 9.9e-3 and 1.4e-4 rad.
    assert error(outputs.predict(new_euler)) > 5e-3
    assert error(both.predict(new.as_quat())) < 4.1e-4


# --- a crank ------------------------------------------------------------------------


def pedal(n_frames, start):
    """Crank angle [degrees] of somebody who is slower at the dead centres."""

    def step(angle):
        return angle + 17 + 6 * np.cos(np.radians(2 * angle - 30))

    return orbit(step, start, n_frames - 1)


def test_crank_is_predicted_across_the_wrap():
    crank = pedal(300, 5.0)
    recording = pd.DataFrame(
        {"crank": crank % 360, "height": np.cos(np.radians(crank))}
    )
    encoder = RotationEncoder(["crank"], unit="degrees").set_output(transform="pandas")
    pairs = trajectory_pairs(encoder.fit_transform(recording))
    assert list(pairs.X) == ["crank_cos", "crank_sin", "height"]
    model = KoopmanKernelRegressor("matern52").fit(pairs.X, pairs.y)
    new = pedal(400, 111.0)
    states = recording.iloc[[0] * 399].assign(
        crank=new[:-1] % 360, height=np.cos(np.radians(new[:-1]))
    )
    predicted = encoder.inverse_transform(model.predict(encoder.transform(states)))
    wraps = np.diff(new % 360) < 0
    assert wraps.sum() >= 15
    error = np.abs(around(predicted[:, 0] - new[1:], 360))
    assert error.max() < 1e-3
    # In the turn of the recording, so that these differences are no full turns.
    assert (predicted[:, 0] >= 0).all()
    assert (predicted[:, 0] <= 360).all()
    # Raw angles miss the same frames by tens of degrees at the wrap.
    raw = KoopmanKernelRegressor("matern52").fit(
        recording.to_numpy()[:-1], recording.to_numpy()[1:]
    )
    missed = np.abs(around(raw.predict(states.to_numpy())[:, 0] - new[1:], 360))
    assert missed[wraps].max() > 10


def test_crank_as_an_output():
    """From the place of the pedal, by unwrapped and by wrapped angles."""
    crank = pedal(300, 5.0)
    new = pedal(400, 111.0)

    def place(angle):
        radians = np.radians(angle)
        return 170 * np.column_stack([np.cos(radians), np.sin(radians)])

    with pytest.warns(UserWarning, match=r"RotationEncoder.*unwrap_angles"):
        wrapped = trajectory_pairs(place(crank), crank % 360)
    unwrapped = unwrap_angles(crank % 360, period=360)
    pairs = trajectory_pairs(place(crank), unwrapped)
    for y, inverse, low in ((pairs.y, False, -180), (wrapped.y, True, 0)):
        model = TransformedTargetRegressor(
            KoopmanKernelRegressor("matern52"),
            transformer=RotationEncoder(unit="degrees"),
            check_inverse=inverse,
        ).fit(pairs.X, y)
        predicted = model.predict(place(new[:-1]))
        assert np.abs(around(predicted - new[1:], 360)).max() < 1e-3
        assert (predicted >= low).all()
        assert (predicted <= low + 360).all()


def test_crank_is_forecast_for_several_turns():
    crank = pedal(400, 5.0)
    encoder = RotationEncoder(unit="degrees")
    states = encoder.fit_transform(crank[:, np.newaxis] % 360)
    model = KernelEDMD("matern52", alpha=1e-10).fit(states)
    new = pedal(61, 222.0)
    start = encoder.transform([[222.0]])
    forecast = encoder.inverse_transform(np.squeeze(model.forecast(start, 60)))
    assert new[-1] - new[0] > 900
    assert np.abs(around(forecast[:, 0] - new[1:], 360)).max() < 0.05
