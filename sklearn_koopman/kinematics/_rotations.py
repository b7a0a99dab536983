"""Angles as points of the circle, and rotations as matrices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from numbers import Integral
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from sklearn.base import BaseEstimator, OneToOneFeatureMixin, TransformerMixin, clone
from sklearn.utils import Tags
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from .._utils._typing import Array, Indices, Mask
from .._utils._validation import check_choice, check_flag
from .._utils._warnings import warn
from .._utils._wraps import find_degrees

TURNS = {"radians": 2 * np.pi, "degrees": 360.0}
# Files round quaternions, some to two digits. Other columns taken for one are farther
# from length 1.
LENGTH_TOLERANCE = 0.01
# Below this the rounding of predictions decides which rotation is nearest.
MIN_DISTINCTNESS = 1e-8
ENTRIES = [f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)]


class RotationEncoder(TransformerMixin, BaseEstimator):
    r"""Encode angles by cosine and sine, and rotations by their matrices.

    An angle lives on a circle and a rotation in SO(3). Numbers in a row do not show
    that: 359 and 1 degrees are near each other, and the quaternions q and -q are one
    rotation. So the map from numbers to outputs jumps where the numbers do, and a
    kernel estimates continuous functions. Cosine and sine, and the entries of a
    rotation matrix, change as little as the rotation does: they are the embedding of
    the circles and copies of SO(3) that [1]_ describes a body by. Columns that hold
    neither angles nor rotations pass through.

    Used on states, this stands in a pipeline in front of an estimator. Used on
    outputs, it is the `transformer` of a
    :class:`~sklearn.compose.TransformedTargetRegressor`, whose predictions are angles
    and rotations again.

    Parameters
    ----------
    angles : list of str or list of int, default=None
        The columns that hold angles: names of a DataFrame, or numbers from 0. None
        means all columns that are not named below, ``[]`` none.
    quaternions : list of str or list of int, default=None
        The columns that hold unit quaternions, four by four: x, y, z and w of the
        first one, then those of the next. None means none.
    rotation_vectors : list of str or list of int, default=None
        The columns that hold rotation vectors, three by three: the axis times the
        angle, in `unit`. None means none.
    unit : {"radians", "degrees"}, default="radians"
        The unit of angles and rotation vectors.
    scalar_first : bool, default=False
        Whether w comes first in each quaternion, before x, y and z.

    Attributes
    ----------
    angle_columns_ : ndarray of shape (n_angles,)
        The numbers of the columns that hold angles.
    quaternion_columns_ : ndarray of shape (n_quaternions, 4)
        The numbers of the columns that hold x, y, z and w of each quaternion.
    rotation_vector_columns_ : ndarray of shape (n_rotation_vectors, 3)
        The numbers of the columns that hold each rotation vector.
    middles_ : ndarray of shape (n_angles,)
        The middle of the turn in which :meth:`inverse_transform` returns each angle,
        in `unit`: 0, or another multiple of half a turn. See the notes.
    n_features_in_ : int
        Number of columns seen during `fit`.
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Names of the columns, where `X` had string names.

    See Also
    --------
    unwrap_angles : Removes the jumps of angles that do not turn on and on.
    sklearn_koopman.trajectories.trajectory_pairs : Pairs states and outputs.
    sklearn.compose.TransformedTargetRegressor : Transforms outputs and predictions.

    Notes
    -----
    An angle :math:`\theta` becomes :math:`(\cos\theta, \sin\theta)`. A quaternion
    (x, y, z, w), or a rotation vector, becomes the nine entries of its rotation matrix
    R in SO(3), row by row. With the vector part v, that is

    .. math:: R = (w^2 - v^T v) I + 2 v v^T + 2 w [v]_\times .

    Each column is replaced in its place: the columns of a quaternion or of a rotation
    vector at the place of its leftmost one.

    Predictions lie near the circle and near SO(3), but not on them. The way back takes
    the nearest point, as means of directions and of rotations do [2]_. An angle is
    that of the vector (c, s) predicted. With the singular value decomposition
    :math:`U \Sigma V^T` of the matrix predicted, the rotation nearest to it in the
    Frobenius norm is :math:`U \operatorname{diag}(1, 1, \det U V^T)\, V^T` [3]_.

    Angles come back between -180 and 180 degrees if all those of `fit` lie there. If
    they lie in another turn that begins at a multiple of 180 degrees, such as from 0
    to 360, they come back there. If no such turn holds them all, as with unwrapped
    angles, they come back between -180 and 180 degrees, whole turns away from those of
    `fit`. Then `TransformedTargetRegressor` warns that the transformer is not its own
    inverse, and ``check_inverse=False`` is right. So it is for quaternions with
    negative w, which come back as -q, and for rotation vectors longer than half a
    turn.

    `TransformedTargetRegressor` turns a DataFrame of outputs into an array before it
    calls the transformer. Give columns by their numbers then, and not by names.

    States with delays hold copies of the recording side by side. Name the columns of
    each: ``quaternions=list(range(12))`` for three copies of one quaternion.

    :func:`~sklearn_koopman.trajectories.trajectory_pairs` warns of angles that wrap.
    Encode recordings before they are paired, and transform predictions back by
    :meth:`inverse_transform`; or pair angles that are unwrapped.

    Errors of angles are those around the circle: ``(predicted - y + 180) % 360 - 180``
    in degrees. R², the score of `TransformedTargetRegressor`, does not know that.

    The cost is linear in the number of values.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.

    .. [2] K. V. Mardia and P. E. Jupp, "Directional Statistics", Wiley, 2000,
       Chapters 2 and 13.

    .. [3] K. S. Arun, T. S. Huang and S. D. Blostein, "Least-Squares Fitting of Two
       3-D Point Sets", IEEE Transactions on Pattern Analysis and Machine
       Intelligence 9, 1987.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.kinematics import RotationEncoder
    >>> motion = np.array([[0.0, 1.5], [90.0, 1.6], [270.0, 1.7]])
    >>> encoder = RotationEncoder(angles=[0], unit="degrees").fit(motion)
    >>> encoder.transform(motion).round(9) + 0.0
    array([[ 1. ,  0. ,  1.5],
           [ 0. ,  1. ,  1.6],
           [ 0. , -1. ,  1.7]])
    >>> encoder.get_feature_names_out(["crank", "height"])
    array(['crank_cos', 'crank_sin', 'height'], dtype=object)
    >>> encoder.inverse_transform([[0.0, -0.9, 1.7]])
    array([[270. ,   1.7]])

    A crank that turns by 50 degrees a step, predicted across the wrap:

    >>> from sklearn.compose import TransformedTargetRegressor
    >>> from sklearn.pipeline import make_pipeline
    >>> from sklearn_koopman import KoopmanKernelRegressor
    >>> crank = (50.0 * np.arange(36)).reshape(-1, 1) % 360
    >>> model = TransformedTargetRegressor(
    ...     make_pipeline(RotationEncoder(unit="degrees"), KoopmanKernelRegressor()),
    ...     transformer=RotationEncoder(unit="degrees"),
    ... ).fit(crank[:-1], crank[1:])
    >>> model.predict([[305.0], [345.0]]).round(1)
    array([[355.], [ 35.]])
    """

    # A pickle names this class, and what it names is to stay where it is.
    __module__ = __package__

    def __init__(
        self,
        angles: Sequence[str] | Sequence[int] | None = None,
        *,
        quaternions: Sequence[str] | Sequence[int] | None = None,
        rotation_vectors: Sequence[str] | Sequence[int] | None = None,
        unit: str = "radians",
        scalar_first: bool = False,
    ) -> None:
        self.angles = angles
        self.quaternions = quaternions
        self.rotation_vectors = rotation_vectors
        self.unit = unit
        self.scalar_first = scalar_first

    def fit(self, X: Any, y: Any = None) -> Self:
        """Find the columns, and the turn that each angle lies in.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The motion. NaN and masked values are gaps.
        y : object, default=None
            Not used.

        Returns
        -------
        self : RotationEncoder
            The fitted encoder.

        Raises
        ------
        ValueError
            If a parameter names columns that do not exist, one column twice, or no
            whole number of quaternions or vectors; if `unit` or `scalar_first` is
            none of its choices; if `X` holds infinity, or quaternions whose length is
            not 1 within 0.01.

        Warns
        -----
        UserWarning
            If angles in radians exceed 4 pi, as those in degrees do.
        """
        check_choice(self.unit, "unit", TURNS)
        check_flag(self.scalar_first, "scalar_first")
        # Attributes are set last: a fit that fails leaves the encoder as it was.
        checker = clone(self)
        values = _validated(checker, X, reset=True)
        names = list(getattr(checker, "feature_names_in_", ()))
        columns = _find_columns(self, names, values.shape[1])
        _check_quaternions(values, columns["quaternions"])
        if self.unit == "radians":
            _warn_of_degrees(values[:, columns["angles"]])
        middles = _find_middles(values[:, columns["angles"]], TURNS[self.unit])
        validate_data(self, X, skip_check_array=True)
        self.angle_columns_ = columns["angles"]
        self.quaternion_columns_ = columns["quaternions"]
        self.rotation_vector_columns_ = columns["rotation_vectors"]
        self.middles_ = middles
        return self

    def transform(self, X: Any) -> Array:
        """Encode angles and rotations.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The motion. NaN and masked values are gaps.

        Returns
        -------
        encoded : ndarray or DataFrame of shape (n_samples, n_encoded)
            Cosines and sines, entries of matrices, and the other columns, in the place
            of what they encode. NaN where a value is missing, in all of the entries of
            a rotation of which a part is missing.

        Raises
        ------
        ValueError
            If `X` has other columns than in `fit`, holds infinity, or quaternions
            whose length is not 1 within 0.01.
        """
        check_is_fitted(self)
        values = _validated(self, X, reset=False)
        _check_quaternions(values, self.quaternion_columns_)
        values *= self._units()
        widths, starts, rest = self._layout()
        encoded = np.empty((len(values), widths.sum()))
        encoded[:, starts[rest]] = values[:, rest]
        angles, places = values[:, self.angle_columns_], starts[self.angle_columns_]
        encoded[:, places], encoded[:, places + 1] = np.cos(angles), np.sin(angles)
        for group in self._groups():
            place = starts[group.min()]
            encoded[:, place : place + 9] = _to_matrices(values[:, group])
        return encoded

    def inverse_transform(self, X: Any) -> Array:
        """Return the angles and rotations that are nearest to what was predicted.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_encoded)
            Predictions of what :meth:`transform` returns. They need not lie on the
            circle or be rotation matrices.

        Returns
        -------
        decoded : ndarray of shape (n_samples, n_features)
            The columns that :meth:`fit` has seen, in its order. Angles lie within half
            a turn of `middles_`. Quaternions have length 1 and w of at least 0.
            Rotation vectors are at most half a turn long. NaN where `X` holds NaN, and
            where it tells no rotation.

        Raises
        ------
        ValueError
            If `X` has another number of columns, or holds infinity.

        Warns
        -----
        UserWarning
            If rows tell no rotation: cosine and sine of length below 1e-8, or a
            matrix to which several rotations are equally near. They become NaN. Some
            estimators predict zeros far from all training data, and these do.
        """
        check_is_fitted(self)
        encoded = check_array(
            _unmasked(X),
            dtype=np.float64,
            ensure_all_finite="allow-nan",
            input_name="X",
        )
        widths, starts, rest = self._layout()
        if encoded.shape[1] != widths.sum():
            raise ValueError(
                f"X has {encoded.shape[1]} columns, but transform returns "
                f"{widths.sum()} for this motion; pass these, or predictions of them."
            )
        decoded = np.empty((len(encoded), self.n_features_in_))
        decoded[:, rest] = encoded[:, starts[rest]]
        places, turn = starts[self.angle_columns_], TURNS[self.unit]
        angles, is_lost = _nearest_angles(
            encoded[:, places], encoded[:, places + 1], 2 * self.middles_ / turn
        )
        decoded[:, self.angle_columns_] = angles
        lost = [is_lost]
        for group in self._groups():
            place = starts[group.min()]
            matrices, is_lost = _nearest_matrices(encoded[:, place : place + 9])
            decoded[:, group] = _from_matrices(matrices, len(group))
            lost.append(is_lost)
        _warn_of_lost(np.column_stack(lost))
        return decoded / self._units()

    def get_feature_names_out(self, input_features: ArrayLike | None = None) -> Any:
        """Name the columns that :meth:`transform` returns.

        Parameters
        ----------
        input_features : array-like of shape (n_features,), default=None
            Names of the columns of the motion, by default those seen by `fit`, else
            "x0", "x1" and so on.

        Returns
        -------
        names : ndarray of str of shape (n_encoded,)
            An angle "hip" becomes "hip_cos" and "hip_sin". A quaternion or a rotation
            vector whose leftmost column is "pelvis" becomes "pelvis_r11",
            "pelvis_r12", up to "pelvis_r33": row, then column. Others keep their names.

        Raises
        ------
        ValueError
            If the names are not those of `fit`, or if two columns get one name.
        """
        names = OneToOneFeatureMixin.get_feature_names_out(self, input_features)
        endings = {1: [""], 2: ["_cos", "_sin"], 9: [f"_{entry}" for entry in ENTRIES]}
        encoded = [
            name + ending
            for name, width in zip(names, self._layout()[0], strict=True)
            if width
            for ending in endings[int(width)]
        ]
        for name, count in Counter(encoded).items():
            if count > 1:
                raise ValueError(
                    f"two columns would get the name {name!r}; rename the one that has "
                    "this name already."
                )
        return np.asarray(encoded, dtype=object)

    def __sklearn_tags__(self) -> Tags:
        """Tell that NaN passes."""
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        return tags

    def _units(self) -> Array:
        """Return the unit of each column, in radians if it holds angles, else 1."""
        units = np.ones(self.n_features_in_)
        for columns in (self.angle_columns_, self.rotation_vector_columns_):
            units[columns] = 2 * np.pi / TURNS[self.unit]
        return units

    def _groups(self) -> list[Indices]:
        """Return the columns of each quaternion and each rotation vector."""
        return [*self.quaternion_columns_, *self.rotation_vector_columns_]

    def _layout(self) -> tuple[Indices, Indices, Indices]:
        """Return how columns are laid out when they are encoded.

        Returns
        -------
        widths : ndarray of shape (n_features,)
            The number of columns that each column becomes. The leftmost column of a
            rotation stands for all of it.
        starts : ndarray of shape (n_features,)
            The first of these columns.
        rest : ndarray of shape (n_others,)
            The columns that pass through.
        """
        widths = np.ones(self.n_features_in_, dtype=np.intp)
        widths[self.angle_columns_] = 2
        for group in self._groups():
            widths[group] = 0
            widths[group.min()] = 9
        return widths, np.cumsum(widths) - widths, np.flatnonzero(widths == 1)


def _unmasked(X: Any) -> Any:
    """Return an array whose masked values are NaN."""
    if isinstance(X, np.ma.MaskedArray):
        return np.ma.filled(X.astype(np.float64), np.nan)
    return X


def _validated(encoder: RotationEncoder, X: Any, *, reset: bool) -> Array:
    return np.array(
        validate_data(
            encoder,
            _unmasked(X),
            reset=reset,
            dtype=np.float64,
            ensure_all_finite="allow-nan",
        )
    )


def _find_columns(
    encoder: RotationEncoder, names: list[str], n_features: int
) -> dict[str, Indices]:
    """Return the numbers of the columns that the parameters name, one rotation a row.

    Parameters
    ----------
    encoder : RotationEncoder
        What has the parameters.
    names : list of str
        The names of the columns, if they have names.
    n_features : int
        The number of columns.

    Returns
    -------
    columns : dict of str to ndarray of shape (n,), (n, 4) or (n, 3)
        The numbers, by the name of the parameter.
    """
    columns: dict[str, Indices] = {}
    owners: dict[int, str] = {}
    for name, size in (("quaternions", 4), ("rotation_vectors", 3), ("angles", 1)):
        given = getattr(encoder, name)
        numbers = _find_numbers(given, name, names, n_features)
        if given is None and name == "angles":
            numbers = [number for number in range(n_features) if number not in owners]
        if len(numbers) % size:
            kind = name.replace("_", " ")
            raise ValueError(
                f"{name}={given!r} names {len(numbers)} columns, which are no whole "
                f"{kind} of {size}; name all {size} columns of each."
            )
        for number in numbers:
            if number in owners:
                label = repr(names[number]) if names else number
                raise ValueError(
                    f"column {label} is named twice, in {owners[number]} and in "
                    f"{name}={given!r}; name each column once."
                )
            owners[number] = name
        columns[name] = np.array(numbers, dtype=np.intp).reshape(-1, size)
    columns["angles"] = columns["angles"].ravel()
    if encoder.scalar_first:
        columns["quaternions"] = np.roll(columns["quaternions"], -1, axis=1)
    return columns


def _find_numbers(
    given: Any, name: str, names: list[str], n_features: int
) -> list[int]:
    """Return the numbers of columns that are given by names or numbers."""
    if given is None:
        return []
    if isinstance(given, str) or not np.iterable(given):
        raise ValueError(f"{name}={given!r} must be a list of columns; put it into [].")
    numbers = []
    for column in given:
        if isinstance(column, list | tuple | np.ndarray):
            raise ValueError(
                f"{name}={given!r} holds the list {column!r}; name all columns in one "
                "list, one after another."
            )
        is_number = isinstance(column, Integral) and not isinstance(column, bool)
        if is_number and 0 <= column < n_features:
            numbers.append(int(column))
        elif isinstance(column, str) and column in names:
            numbers.append(names.index(column))
        else:
            known = f"numbers from 0 to {n_features - 1}"
            if names:
                known += f", and the names {names}"
            elif isinstance(column, str):
                known += ", and no names, which TransformedTargetRegressor drops"
            raise ValueError(
                f"{name}={given!r} holds {column!r}, which is no column; X has the "
                f"{known}."
            )
    return numbers


def _check_quaternions(values: Array, columns: Indices) -> None:
    """Refuse quaternions that are not of length 1; NaN pass."""
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(values[:, columns], axis=-1)
    wrong = np.argwhere(np.abs(lengths - 1) > LENGTH_TOLERANCE)
    if len(wrong):
        row, number = wrong[0]
        raise ValueError(
            f"X holds {len(wrong)} quaternions whose length is not 1, first in row "
            f"{row}, in the columns {sorted(columns[number].tolist())}, of length "
            f"{lengths[row, number]:.4g}; name the columns of quaternions, divide "
            "quaternions by their lengths, and mark missing ones by NaN."
        )


def _warn_of_degrees(angles: Array) -> None:
    """Warn if angles that are said to be in radians are too large for a joint."""
    found = find_degrees(angles)
    if found:
        warn(
            f"angles of X reach {found[1]:.4g} radians. If they are in degrees, pass "
            "unit='degrees'; if they count many turns, pass X % (2 * numpy.pi), which "
            "is encoded as the same."
        )


def _find_middles(angles: Array, turn: float) -> Array:
    """Return the middle of a turn that holds all angles of each column.

    It is the multiple of half a turn that is nearest to 0, and 0 if none will do.
    """
    half = turn / 2
    low, high = (
        limit(angles, axis=0, initial=start, where=~np.isnan(angles))
        for limit, start in ((np.min, np.inf), (np.max, -np.inf))
    )
    least, largest = np.ceil(high / half - 1), np.floor(low / half + 1)
    return np.where(least <= largest, half * np.clip(0.0, least, largest), 0.0) + 0.0


def _nearest_angles(cosines: Array, sines: Array, middles: Array) -> tuple[Array, Mask]:
    """Return the angles of vectors, NaN for those that have no direction.

    Parameters
    ----------
    cosines, sines : ndarray of shape (n_samples, n_angles)
        The vectors.
    middles : ndarray of shape (n_angles,)
        The middles of the turns in which the angles lie, in half turns.

    Returns
    -------
    angles : ndarray of shape (n_samples, n_angles)
        Their angles in radians.
    is_lost : ndarray of shape (n_samples, n_angles)
        Whether a vector has no direction.
    """
    is_lost = np.hypot(cosines, sines) < MIN_DISTINCTNESS
    # Half a turn is exact, so that both ends of a turn remain what they were. A sine
    # of zero is at the end that is nearer to 0: the sums turn -0.0 into 0.0.
    side = np.where(middles % 2 == 1, -1.0, 1.0)
    sines = side * (sines + 0.0)
    sines = np.where(middles < 0, sines + 0.0, sines)
    angles = np.pi * middles + np.arctan2(sines, side * cosines)
    return np.where(is_lost, np.nan, angles), is_lost


def _nearest_matrices(entries: Array) -> tuple[Array, Mask]:
    """Return the rotation matrices that are nearest to some matrices.

    Parameters
    ----------
    entries : ndarray of shape (n_samples, 9)
        The matrices, row by row.

    Returns
    -------
    matrices : ndarray of shape (n_samples, 9)
        The rotation matrices, NaN where the entries hold NaN, and where several are
        nearest.
    is_lost : ndarray of shape (n_samples,)
        Whether several are nearest.

    Notes
    -----
    A matrix is at the same distance from several rotations if its two smallest
    singular values are equal and its determinant is negative, or if both are zero. In
    general their sum, or their difference for a negative determinant, is the curvature
    of half of the squared distance at the nearest rotation.
    """
    has_nan = _find_nan(entries)
    entries = np.where(has_nan[:, np.newaxis], np.eye(3).ravel(), entries)
    left, singular, right = np.linalg.svd(entries.reshape(-1, 3, 3))
    sign = np.sign(np.linalg.det(left @ right))
    left[:, :, 2] *= sign[:, np.newaxis]
    is_lost = singular[:, 1] + sign * singular[:, 2] < MIN_DISTINCTNESS
    matrices = (left @ right).reshape(-1, 9)
    matrices[is_lost | has_nan] = np.nan
    return matrices, is_lost


def _to_matrices(values: Array) -> Array:
    """Return the matrices of quaternions or rotation vectors, row by row.

    Parameters
    ----------
    values : ndarray of shape (n_samples, 4 or 3)
        Quaternions (x, y, z, w), or vectors in radians.

    Returns
    -------
    matrices : ndarray of shape (n_samples, 9)
        Their matrices, NaN where a value is NaN.
    """
    has_nan = _find_nan(values)
    # SciPy takes no NaN. Any unit vector will do in its place.
    values = np.where(has_nan[:, np.newaxis], np.eye(values.shape[1])[0], values)
    if values.shape[1] == 4:
        rotations = Rotation.from_quat(values)
    else:
        rotations = Rotation.from_rotvec(values)
    matrices = rotations.as_matrix().reshape(-1, 9)
    matrices[has_nan] = np.nan
    return matrices


def _from_matrices(matrices: Array, n_columns: int) -> Array:
    """Return the quaternions or rotation vectors of rotation matrices.

    Parameters
    ----------
    matrices : ndarray of shape (n_samples, 9)
        Rotation matrices, row by row.
    n_columns : int
        4 for quaternions, 3 for vectors.

    Returns
    -------
    values : ndarray of shape (n_samples, n_columns)
        Quaternions (x, y, z, w) with w of at least 0, or vectors in radians, not
        longer than pi; NaN where a matrix holds NaN.
    """
    has_nan = _find_nan(matrices)
    matrices = np.where(has_nan[:, np.newaxis], np.eye(3).ravel(), matrices)
    rotations = Rotation.from_matrix(matrices.reshape(-1, 3, 3))
    if n_columns == 4:
        values = rotations.as_quat(canonical=True)
    else:
        values = rotations.as_rotvec()
    values[has_nan] = np.nan
    return values


def _find_nan(rows: Array) -> Mask:
    """Tell which rows hold NaN."""
    return np.asarray(np.isnan(rows).any(axis=1))


def _warn_of_lost(is_lost: Mask) -> None:
    """Warn of rows with angles or rotations that cannot be told."""
    rows = np.flatnonzero(is_lost.any(axis=1))
    if len(rows):
        warn(
            f"{len(rows)} of {len(is_lost)} rows tell no rotation, the first is row "
            f"{rows[0]}; they become NaN. Their entries are (nearly) zero, or as near "
            "to one rotation as to others, like predictions far from all training "
            "data. Fit to motion that reaches there, or leave these rows out."
        )
