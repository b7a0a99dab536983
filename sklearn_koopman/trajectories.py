"""Pairs of samples along trajectories, and cross-validation by trajectories."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.model_selection import BaseCrossValidator, GroupKFold, KFold
from sklearn.utils import Bunch, check_array

from ._utils._rows import distinct_rows
from ._utils._typing import Array, Indices
from ._utils._validation import check_columns, check_integer

__all__ = ["TrajectoryKFold", "successor_rows", "trajectory_pairs"]


def trajectory_pairs(
    trajectories: ArrayLike | Sequence[ArrayLike],
    outputs: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    lag: int = 1,
    delays: int = 1,
    delay_step: int = 1,
    outputs_in_state: bool = False,
) -> Bunch:
    """Pair every state with the output one lag after it, within each trajectory.

    From samples :math:`x_0, x_1, \\dots` of one trajectory and its outputs
    :math:`y_k = G(x_k)`, row `k` of the result pairs the (delay-embedded) state

    .. math:: (x_k, x_{k-\\tau}, \\dots, x_{k-(p-1)\\tau})

    with the output :math:`y_{k + \\ell} = (U_{f^\\ell} G)(x_k)` for `lag`
    :math:`\\ell`, `delays` :math:`p` and `delay_step` :math:`\\tau`. Here f is the map
    from one sample to the next, and :math:`U_f` its Koopman operator. These are the
    pairs :math:`(\\xi, \\upsilon)` of [1]_, Section 3.2. The samples of a pair always
    come from one trajectory.

    Parameters
    ----------
    trajectories : array-like of shape (n_samples, n_features), or list of them
        One trajectory, or several of any lengths, all sampled at the same rate. A NumPy
        array with three axes is taken as a list of trajectories.
    outputs : array-like of shape (n_samples,) or (n_samples, n_outputs), or list \
of them, default=None
        The quantities to predict, sampled together with the states: one array for each
        trajectory, of the same length. By default the states themselves.
    lag : int, default=1
        Number of samples from a state to its output.
    delays : int, default=1
        Number of copies of the state in a row, the current one included. Motion whose
        measured state does not determine its future (such as gait in joint angles)
        needs more than one.
    delay_step : int, default=1
        Number of samples between two copies of the state.
    outputs_in_state : bool, default=False
        Whether to append the current outputs, delayed like the states, to each row.
        They follow all copies of the state. Use this where the output is also measured
        at the time of prediction.

    Returns
    -------
    pairs : :class:`~sklearn.utils.Bunch`
        With the attributes

        X : ndarray of shape (n_pairs, n_columns)
            The states, the current copy first, then older ones.
        y : ndarray of shape (n_pairs,) or (n_pairs, n_outputs)
            The outputs one `lag` after each row.
        X_next : ndarray of shape (n_pairs, n_columns)
            The states one `lag` after each row.
        groups : ndarray of shape (n_pairs,)
            The number of the trajectory that each row comes from.
        sample_index : ndarray of shape (n_pairs,)
            The place of each row on its trajectory. Row j follows row i (one `lag`
            later on the same trajectory) exactly if
            ``sample_index[j] == sample_index[i] + 1``.

    Raises
    ------
    ValueError
        If a trajectory is too short for one pair, holds NaN or infinity, or differs
        from the others in its number of columns; if outputs and trajectories differ
        in number or length; if `outputs_in_state` is set without `outputs`.

    See Also
    --------
    TrajectoryKFold : Cross-validation that leaves out whole trajectories.

    References
    ----------
    .. [1] N. Powell, B. Liu, J. Guo, S. T. Parachuri and A. Kurdila, "Koopman Methods
       for Estimation of Animal Motions over Unknown Submanifolds",
       arXiv:2203.05646, 2022.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.trajectories import trajectory_pairs
    >>> walk, run = np.arange(5.0).reshape(-1, 1), np.arange(10.0, 14).reshape(-1, 1)
    >>> pairs = trajectory_pairs([walk, run], lag=1, delays=2)
    >>> pairs.X
    array([[ 1.,  0.],
           [ 2.,  1.],
           [ 3.,  2.],
           [11., 10.],
           [12., 11.]])
    >>> pairs.y.ravel()
    array([ 2.,  3.,  4., 12., 13.])
    >>> pairs.groups
    array([0, 0, 0, 1, 1])
    """
    for name, value in (("lag", lag), ("delays", delays), ("delay_step", delay_step)):
        check_integer(value, name, 1)
    if outputs is None and outputs_in_state:
        raise ValueError(
            "outputs_in_state=True needs outputs; pass the outputs, or raise delays to "
            "extend the states by earlier ones."
        )
    states = _as_trajectories(trajectories, "trajectories")
    measured = states if outputs is None else _as_trajectories(outputs, "outputs")
    if len(states) != len(measured):
        raise ValueError(
            f"outputs holds {len(measured)} arrays for {len(states)} trajectories; "
            "pass one array of outputs for every trajectory."
        )

    reach = (delays - 1) * delay_step
    starts = range(reach, -1, -delay_step)  # of the copies in a state
    parts = []
    clock = 0
    for number, (x, y) in enumerate(zip(states, measured, strict=True)):
        if len(x) != len(y):
            raise ValueError(
                f"trajectory {number} has {len(x)} samples but its outputs have "
                f"{len(y)}; states and outputs must be sampled together."
            )
        n_pairs = len(x) - reach - lag
        if n_pairs < 1:
            raise ValueError(
                f"trajectory {number} has {len(x)} samples, but {lag=}, {delays=} and "
                f"{delay_step=} need {reach + lag + 1}; leave it out, or lower them."
            )
        sources = [x, y.reshape(len(y), -1)] if outputs_in_state else [x]
        copies = [z[k : k + n_pairs + lag] for z in sources for k in starts]
        state = np.hstack(copies)
        # With a lag of several samples, a trajectory consists of `lag` interleaved
        # runs. Each of them is a trajectory of the map over `lag` samples.
        step, run = np.divmod(np.arange(n_pairs), lag)
        run_length = -(-n_pairs // lag) + 1
        part = Bunch(
            X=state[:n_pairs],
            y=y[reach + lag :],
            X_next=state[lag:],
            groups=np.full(n_pairs, number),
            sample_index=clock + run * run_length + step,
        )
        parts.append(part)
        clock += lag * run_length
    return Bunch(
        **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    )


def successor_rows(sample_index: Any) -> tuple[Indices, Indices]:
    """Find the rows that follow each other on a trajectory.

    Parameters
    ----------
    sample_index : array-like of shape (n_samples,)
        The place of each row on its trajectory, as :func:`trajectory_pairs` returns it.
        The rows may be in any order.

    Returns
    -------
    rows : ndarray of shape (n_links,)
        The rows that have a successor, in rising order.
    successors : ndarray of shape (n_links,)
        For each of these rows, the row whose index is one higher.

    Raises
    ------
    ValueError
        If the indices are not distinct integers.

    Examples
    --------
    >>> from sklearn_koopman.trajectories import successor_rows
    >>> successor_rows([7, 0, 2, 1])
    (array([1, 3]), array([3, 2]))
    """
    index = np.asarray(sample_index)
    is_exact = index.dtype.kind in "iu"
    if index.dtype.kind == "f":
        is_exact = bool(((np.abs(index) < 2**53) & (index == np.floor(index))).all())
    if index.ndim != 1 or not is_exact:
        raise ValueError(
            "sample_index must hold integers: pass a one-dimensional array of integers "
            "(floats from 2**53 on are not exact), got shape "
            f"{index.shape} and dtype {index.dtype}."
        )
    order = np.argsort(index, kind="stable")
    steps = np.diff(index[order].astype(np.int64))
    equal = np.flatnonzero(steps == 0)
    if len(equal):
        first, second = order[equal[0]], order[equal[0] + 1]
        raise ValueError(
            f"sample_index must be distinct, but rows {first} and {second} both have "
            f"{index[first]}; give each trajectory a range of its own."
        )
    linked = np.flatnonzero(steps == 1)
    rows, successors = order[linked], order[linked + 1]
    in_order = np.argsort(rows)
    return rows[in_order], successors[in_order]


def match_successors(X: Any, y: Any) -> tuple[Indices, Indices] | None:
    """Find the rows that follow each other by outputs that are columns of the states.

    Row j follows row i if the outputs of row i are the values of row j in some adjacent
    columns of the states, and of no other row.

    Parameters
    ----------
    X : array-like of shape (n_samples, n_features)
        The states.
    y : array-like of shape (n_samples,) or (n_samples, n_outputs)
        The outputs one step after each row.

    Returns
    -------
    rows, successors : ndarrays of shape (n_links,), or None
        As of :func:`successor_rows`, for the columns that link most rows. None if no
        columns link more than half of them, or if 1 % of the outputs occur repeatedly.
    """
    states, outputs = np.asarray(X), np.asarray(y)
    if states.dtype.kind not in "iuf" or outputs.dtype.kind not in "iuf":
        return None
    # Where one of them is in single precision, the other is rounded to it.
    single = np.float32 in (states.dtype, outputs.dtype)
    states, outputs = (a.astype("f4" if single else "f8") for a in (states, outputs))
    n = len(states)
    outputs = outputs.reshape(n, -1)
    width = outputs.shape[1]
    best, most = None, n // 2
    for start in range(states.shape[1] - width + 1):
        columns = states[:, start : start + width]
        first, group, _ = distinct_rows(np.vstack([columns, outputs]))
        occurrences = np.bincount(group[:n], minlength=len(first))[group[n:]]
        rows = np.flatnonzero(occurrences == 1)
        if len(rows) > most and np.mean(occurrences > 1) < 0.01:
            best, most = (rows, first[group[n:][rows]]), len(rows)
    return best


def _as_trajectories(data: Any, name: str) -> list[Array]:
    """Validate one trajectory or a list of them into a list of float arrays."""
    if isinstance(data, np.ndarray) and data.dtype == object and data.ndim == 1:
        data = list(data)  # of arrays of unequal length
    if getattr(data, "ndim", 3) < 3:
        data = [data]
    is_list = hasattr(data, "__len__") and not isinstance(data, str | bytes | dict)
    if not is_list or len(data) == 0:
        raise ValueError(
            f"{name} must be an array or a non-empty list of arrays, got a "
            f"{type(data).__name__}."
        )
    arrays: list[Array] = []
    for number, item in enumerate(data):
        label = f"{name}[{number}]"
        try:
            array = check_array(
                item, dtype=np.float64, ensure_2d=False, ensure_all_finite="allow-nan"
            )
        except (ValueError, TypeError) as error:
            raise ValueError(f"{label}: {error}") from error
        if array.ndim != 2 and (array.ndim != 1 or name != "outputs"):
            raise ValueError(
                f"{label} has shape {array.shape}, not (n_samples, n_features); pass "
                "several trajectories as a list, a scalar one with .reshape(-1, 1)."
            )
        gaps = np.flatnonzero(np.isnan(array).reshape(len(array), -1).any(axis=1))
        if len(gaps):
            raise ValueError(
                f"{label} holds NaN in {len(gaps)} of {len(array)} samples, first in "
                f"sample {gaps[0]}; fill the gaps, or split the trajectory there."
            )
        arrays.append(array)
        if array.shape[1:] != arrays[0].shape[1:]:
            raise ValueError(
                f"{label} has shape {array.shape}, but {name}[0] has "
                f"{arrays[0].shape}; pass arrays with the same columns."
            )
        check_columns(item, label, data[0], f"{name}[0]")
    return arrays


class TrajectoryKFold(BaseCrossValidator):
    """K-fold cross-validation that keeps trajectories, or blocks of one, together.

    Rows that follow each other on a trajectory are nearly equal. If they are shuffled
    into training and test folds, the errors of a model appear smaller by orders of
    magnitude than on motion that was left out as a whole.

    With `groups` given to :meth:`split` (one label a row, such as the `groups` of
    :func:`trajectory_pairs`), every fold leaves out whole trajectories, and the folds
    have about equal numbers of samples. Without `groups`, the rows are taken as one
    trajectory in the order of time: every fold leaves out one contiguous block, and
    `gap` rows on both sides of the block are neither in its training nor its test set.

    Parameters
    ----------
    n_splits : int, default=5
        Number of folds, at least 2 and at most the number of trajectories.
    gap : int, default=0
        Number of rows dropped from the training set on both sides of a block. With a
        lag and delay-embedded states, rows closer than
        ``lag + (delays - 1) * delay_step`` share samples; a `gap` of this size keeps
        them apart. It is not used with `groups`, as trajectories share no samples.

    See Also
    --------
    trajectory_pairs : Returns rows, and the `groups` to split them by.
    sklearn.model_selection.GroupKFold : The same folds where `groups` are given.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.trajectories import TrajectoryKFold
    >>> X = np.zeros((6, 1))
    >>> for train, test in TrajectoryKFold(3, gap=1).split(X):
    ...     print(train, test)
    [3 4 5] [0 1]
    [0 5] [2 3]
    [0 1 2] [4 5]
    >>> for train, test in TrajectoryKFold(2).split(X, groups=[7, 7, 8, 8, 9, 9]):
    ...     print(train, test)
    [2 3] [0 1 4 5]
    [0 1 4 5] [2 3]
    """

    # Asks for `groups` under metadata routing without a set_split_request.
    __metadata_request__split = {"groups": True}

    def __init__(self, n_splits: int = 5, *, gap: int = 0) -> None:
        self.n_splits = n_splits
        self.gap = gap

    def split(
        self, X: Any, y: Any = None, groups: Any = None
    ) -> Iterator[tuple[Indices, Indices]]:
        """Generate the row numbers of the training and test set of each fold.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            The rows to split; only their number is used.
        y : array-like, default=None
            Not used.
        groups : array-like of shape (n_samples,), default=None
            The trajectory of each row. None takes all rows as one trajectory.

        Yields
        ------
        train : ndarray
            The training rows of that fold.
        test : ndarray
            The test rows of that fold.

        Raises
        ------
        ValueError
            If a parameter is outside its range; if there are fewer trajectories, or
            rows, than folds; if `gap` leaves no training rows.
        """
        # Checked when splitting, so that the constructor only stores.
        check_integer(self.n_splits, "n_splits", 2)
        check_integer(self.gap, "gap", 0)
        if groups is not None:
            yield from GroupKFold(self.n_splits).split(X, y, groups)
            return
        for train, test in KFold(self.n_splits).split(X, y):
            train = train[(train < test[0] - self.gap) | (train > test[-1] + self.gap)]
            if len(train) == 0:
                raise ValueError(
                    f"gap={self.gap} leaves no training rows beside the block of "
                    f"{len(test)} rows; lower gap, or raise n_splits={self.n_splits}."
                )
            yield train, test

    def get_n_splits(self, X: Any = None, y: Any = None, groups: Any = None) -> int:
        """Return the number of folds.

        Parameters
        ----------
        X : array-like, default=None
            Not used.
        y : array-like, default=None
            Not used.
        groups : array-like, default=None
            Not used.

        Returns
        -------
        n_splits : int
            The number of folds.
        """
        return self.n_splits
