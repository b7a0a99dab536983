"""Pairs of samples along trajectories, and cross-validation by trajectories."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn import get_config
from sklearn.model_selection import BaseCrossValidator, GroupKFold, KFold
from sklearn.utils import Bunch

from ._utils._clocks import count_recordings, find_index, read_labels
from ._utils._embedding import EMBEDDINGS, check_offsets, embed, embedded_names
from ._utils._recordings import Samples, read_recordings
from ._utils._rows import distinct_rows
from ._utils._typing import Array, Indices
from ._utils._validation import check_choice, check_integer

__all__ = [
    "TrajectoryKFold",
    "current_states",
    "join_recordings",
    "successor_rows",
    "trajectory_pairs",
]


def trajectory_pairs(
    trajectories: ArrayLike | Sequence[ArrayLike],
    outputs: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    lag: int = 1,
    delays: int | Sequence[int] = 1,
    delay_step: int | None = None,
    embedding: str = "copies",
    outputs_in_state: bool = False,
    gaps: str = "raise",
    rates: float | Sequence[float] | None = None,
    resample: float | None = None,
) -> Bunch:
    """Pair every state with the output one lag after it, within each trajectory.

    From samples :math:`x_0, x_1, \\dots` of one trajectory and its outputs
    :math:`y_k = G(x_k)`, row `k` of the result pairs the (delay-embedded) state

    .. math:: (x_k, x_{k-o_1}, \\dots, x_{k-o_{p-1}})

    with the output :math:`y_{k + \\ell} = (U_{f^\\ell} G)(x_k)` for `lag`
    :math:`\\ell` and the offsets :math:`0 < o_1 < \\dots < o_{p-1}` of `delays`. Here f
    is the map from one sample to the next, and :math:`U_f` its Koopman operator. These
    are the pairs :math:`(\\xi, \\upsilon)` of [1]_, Section 3.2. The samples of a pair
    always come from one trajectory, and never from both sides of a gap.

    Parameters
    ----------
    trajectories : array-like of shape (n_samples, n_features), or list of them
        One trajectory, or several of any lengths. NaN and masked values are gaps. The
        index of a DataFrame is its clock: whole numbers and periods are frames, floats,
        timedeltas and datetimes are time stamps in seconds, anything else is not used.
        A step of the index longer than usual is a gap: in frames, longer than the
        smallest step; in seconds, than 1.5 usual steps. Time stamps may jitter by a
        quarter of a step.
    outputs : array-like of shape (n_samples,) or (n_samples, n_outputs), or list \
of them, default=None
        The quantities to predict, sampled together with the states: one array for each
        trajectory, of the same length. By default the states themselves.
    lag : int, default=1
        Number of samples from a state to its output.
    delays : int or sequence of int, default=1
        Number of copies of the state in a row, the current one included; or their ages
        in samples, newest first, such as ``(0, 1, 2, 5, 10)``. Motion whose measured
        state does not determine its future (such as gait in joint angles) needs more
        than one copy.
    delay_step : int, default=None
        Number of samples between two copies of the state, where `delays` is their
        number. None means 1.
    embedding : {"copies", "differences"}, default="copies"
        Whether a row holds copies of earlier states, or Newton's divided differences
        over the same offsets, per sample: the state, its velocity, half its
        acceleration, and so on (column block j is the j-th derivative over j! to first
        order). Both have the same rows and width, and a linear map leads from one to
        the other. They differ in what a kernel takes as near: standardise the columns
        of differences. These amplify noise where offsets are close. Neither is better
        on all data; let trajectories left out choose.
    outputs_in_state : bool, default=False
        Whether to append the current outputs, delayed like the states, to each row.
        They follow all columns of the state. Use this where the output is also measured
        at the time of prediction.
    gaps : {"raise", "split"}, default="raise"
        What to do about gaps in states or outputs: an error, or cut the trajectory
        there. Its pieces keep its group, frames and time. Pieces too short for a pair
        are left out.
    rates : float or sequence of float, default=None
        Samples a second, of all trajectories or of each. None reads them off indices
        of time stamps. Trajectories of unequal rates (by more than 1 % if read off)
        need `resample`.
    resample : float, default=None
        Samples a second to interpolate all trajectories to, by cubic splines, within
        each piece between gaps from its first sample on (by splines of a lower degree
        if it has fewer than 4 samples). Nothing is extrapolated. No filter removes
        frequencies above half of the new rate: filter before, where there are some.
        `lag` and `delays` count the new samples. None keeps all samples.

    Returns
    -------
    pairs : :class:`~sklearn.utils.Bunch`
        With the attributes

        X : ndarray or DataFrame of shape (n_pairs, n_columns)
            The states, the current copy first, then older ones. A DataFrame where
            `trajectories` are pandas' DataFrames, or where scikit-learn's setting
            ``transform_output`` is "pandas". Its index has the levels "trial" and
            "sample_index", the `groups` and `sample_index` below.
        y : ndarray, DataFrame or Series of shape (n_pairs,) or (n_pairs, n_outputs)
            The outputs one `lag` after each row, with the same index.
        X_next : ndarray or DataFrame of shape (n_pairs, n_columns)
            The states one `lag` after each row, with the same index.
        groups : ndarray of shape (n_pairs,)
            The number of the trajectory that each row comes from.
        sample_index : ndarray of shape (n_pairs,)
            The place of each row on its trajectory. Row j follows row i (one `lag`
            later on the same trajectory) exactly if
            ``sample_index[j] == sample_index[i] + 1``. Several steps later only if all
            numbers in between occur.
        time : ndarray of shape (n_pairs,)
            When the newest sample of each row was taken: its time stamp; or seconds
            from the start of its trajectory if there are `rates`, else samples.
            Datetimes become seconds from the first.
        frame : ndarray of shape (n_pairs,)
            The number of that sample in its trajectory, or its label in an index of
            whole numbers. After resampling, new samples are counted from the start of
            the trajectory; the number of the first one of a piece is rounded.
        feature_names : list of str
            The names of the columns of `X`: those of the DataFrames, else "x0", "x1",
            ... for states and "y0", "y1", ... for outputs. A copy that is 5 samples
            old has the suffix "_t-5", and the difference of order 2 the suffix "_d2".
            An output in the state that has the name of a state gets "output_" in front.

    Raises
    ------
    ValueError
        If a trajectory is too short for one pair, holds gaps (unless they split it) or
        infinity, has three axes, or differs from the others in its columns or rate; if
        outputs and trajectories differ in number, length or index; if an index does not
        increase, lacks labels or repeats them, its time stamps are irregular, or its
        whole numbers are milliseconds; if `outputs_in_state` is set without `outputs`;
        if a parameter is outside its range.

    Warns
    -----
    UserWarning
        If columns hold angles that wrap at 360 degrees or 2 pi: unwrap them by
        :func:`~sklearn_koopman.kinematics.unwrap_angles`, since the jumps are no
        motion, or encode them by :class:`~sklearn_koopman.kinematics.RotationEncoder`.

    See Also
    --------
    current_states : The states at the end of a recording, which are in no pair.
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

    A gap cuts a trajectory in two, and no pair reaches across it:

    >>> walk[2] = np.nan
    >>> pairs = trajectory_pairs(walk, gaps="split", rates=100)
    >>> pairs.X.ravel(), pairs.y.ravel(), pairs.time
    (array([0., 3.]), array([1., 4.]), array([0.  , 0.03]))
    """
    check_integer(lag, "lag", 1)
    offsets = check_offsets(delays, delay_step)
    _check_embedding(embedding, outputs, outputs_in_state)
    recordings, names, output_names, is_pandas, _ = read_recordings(
        trajectories, outputs, gaps=gaps, rates=rates, resample=resample
    )
    least = offsets[-1] + lag + 1
    parts = []
    clock = 0
    for number, recording in enumerate(recordings):
        pieces = recording.cut(resample)
        longest = max((len(piece.time) for piece in pieces), default=0)
        if longest < least:
            where = "" if len(pieces) == 1 else " in its longest piece between gaps"
            raise ValueError(
                f"trajectory {number} has {longest} samples{where}, but {lag=}, "
                f"{delays=} and {delay_step=} need {least}; leave it out, or lower "
                "them."
            )
        for piece in pieces:
            n_pairs = len(piece.time) - least + 1
            if n_pairs < 1:
                continue
            state = _embedded(piece, offsets, embedding, outputs_in_state)
            newest = slice(offsets[-1], offsets[-1] + n_pairs)
            # With a lag of several samples, a piece consists of `lag` interleaved
            # runs. Each of them is a trajectory of the map over `lag` samples.
            step, run = np.divmod(np.arange(n_pairs), lag)
            run_length = -(-n_pairs // lag) + 1
            part = Bunch(
                X=state[:n_pairs],
                y=piece.outputs[offsets[-1] + lag :],
                X_next=state[lag:],
                groups=np.full(n_pairs, number),
                sample_index=clock + run * run_length + step,
                time=piece.time[newest],
                frame=piece.frame[newest],
            )
            parts.append(part)
            clock += lag * run_length
    pairs = Bunch(
        **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    )
    pairs.feature_names = _feature_names(
        names, output_names, offsets, embedding, outputs_in_state
    )
    if is_pandas or get_config()["transform_output"] == "pandas":
        import pandas as pd

        index = pd.MultiIndex.from_arrays(
            [pairs.groups, pairs.sample_index], names=["trial", "sample_index"]
        )
        for name in ("X", "X_next"):
            pairs[name] = pd.DataFrame(pairs[name], index, pairs.feature_names)
        pairs.y = (
            pd.Series(pairs.y, index, name=output_names[0])
            if pairs.y.ndim == 1
            else pd.DataFrame(pairs.y, index, output_names)
        )
    return pairs


def current_states(
    recording: ArrayLike,
    outputs: ArrayLike | None = None,
    *,
    lag: int = 1,
    delays: int | Sequence[int] = 1,
    delay_step: int | None = None,
    embedding: str = "copies",
    outputs_in_state: bool = False,
    gaps: str = "raise",
    rates: float | None = None,
    resample: float | None = None,
) -> Any:
    """Return the newest states of a recording, whose future is still to come.

    These are the states of the last `lag` samples. They are in no pair of
    :func:`trajectory_pairs`, since their outputs are not recorded yet; a model that was
    fitted to the pairs predicts them. The parameters are those of
    :func:`trajectory_pairs`, so that one dict of settings serves both.

    Parameters
    ----------
    recording : array-like of shape (n_samples, n_features)
        The states of one recording: a window of ``max(offsets) + 1`` samples gives one
        row.
    outputs : array-like of shape (n_samples,) or (n_samples, n_outputs), default=None
        The outputs of the recording. They are used with `outputs_in_state` only.
    lag : int, default=1
        Number of samples from a state to the output to be predicted.
    delays : int or sequence of int, default=1
        Number of copies of the state in a row, or their ages in samples.
    delay_step : int, default=None
        Number of samples between two copies of the state.
    embedding : {"copies", "differences"}, default="copies"
        Copies of earlier states, or divided differences.
    outputs_in_state : bool, default=False
        Whether the outputs are part of the state.
    gaps : {"raise", "split"}, default="raise"
        Whether a gap in the recording is an error, or leaves out the states whose past
        it interrupts.
    rates : float, default=None
        Samples a second.
    resample : float, default=None
        Samples a second to interpolate the recording to. The new samples are counted
        back from the last one.

    Returns
    -------
    X : ndarray or DataFrame of shape (n_states, n_columns)
        The states in the order of time, at most `lag` of them, fewer where the
        recording is short or a gap leaves some out. A DataFrame where
        :func:`trajectory_pairs` would return one, indexed by "frame", or by "time" in
        seconds after resampling.

    Raises
    ------
    ValueError
        If no state is left; and where :func:`trajectory_pairs` raises.

    Warns
    -----
    UserWarning
        If columns hold angles that wrap.

    See Also
    --------
    trajectory_pairs : The states before, with their outputs.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.trajectories import current_states, trajectory_pairs
    >>> walk = np.arange(10.0).reshape(-1, 1)
    >>> settings = {"lag": 2, "delays": (0, 1, 4)}
    >>> trajectory_pairs(walk, **settings).X[-1]
    array([7., 6., 3.])
    >>> current_states(walk, **settings)
    array([[8., 7., 4.],
           [9., 8., 5.]])
    """
    check_integer(lag, "lag", 1)
    offsets = check_offsets(delays, delay_step)
    _check_embedding(embedding, outputs, outputs_in_state)
    # Outputs that are still to be measured must not cut the states.
    used = outputs if outputs_in_state else None
    recordings, names, output_names, is_pandas, _ = read_recordings(
        recording, used, gaps=gaps, rates=rates, resample=resample, name="recording"
    )
    if len(recordings) > 1:
        raise ValueError(
            f"recording holds {len(recordings)} recordings; call current_states for "
            "each of them."
        )
    rows, labels = [], []
    for piece in recordings[0].cut(resample, from_end=True):
        is_current = piece.remaining[offsets[-1] :] < lag
        state = _embedded(piece, offsets, embedding, outputs_in_state)
        rows.append(state[is_current])
        label = piece.frame if resample is None else piece.time
        labels.append(label[offsets[-1] :][is_current])
    X = np.vstack(rows) if rows else np.empty((0, 0))
    if len(X) == 0:
        raise ValueError(
            f"none of the last {lag} samples has a whole past: {delays=} and "
            f"{delay_step=} need {offsets[-1] + 1} samples without a gap up to one of "
            "them; pass a longer recording, or fill its gaps by kinematics.fill_gaps."
        )
    if not is_pandas and get_config()["transform_output"] != "pandas":
        return X
    import pandas as pd

    features = _feature_names(names, output_names, offsets, embedding, outputs_in_state)
    name = "frame" if resample is None else "time"
    index = pd.Index(np.concatenate(labels), name=name)
    return pd.DataFrame(X, index, features)


def _check_embedding(embedding: Any, outputs: Any, outputs_in_state: Any) -> None:
    """Refuse parameters that define no state."""
    check_choice(embedding, "embedding", EMBEDDINGS)
    if outputs is None and outputs_in_state:
        raise ValueError(
            "outputs_in_state=True needs outputs; pass the outputs, or raise delays to "
            "extend the states by earlier ones."
        )


def _embedded(
    piece: Samples, offsets: Indices, embedding: str, outputs_in_state: bool
) -> Array:
    """Return the states of a piece with their past."""
    state = embed(piece.states, offsets, embedding)
    if not outputs_in_state:
        return state
    measured = piece.outputs.reshape(len(piece.outputs), -1)
    return np.hstack([state, embed(measured, offsets, embedding)])


def _feature_names(
    names: list[str],
    output_names: list[str],
    offsets: Indices,
    embedding: str,
    outputs_in_state: bool,
) -> list[str]:
    """Name the columns of the embedded states."""
    features = embedded_names(names, offsets, embedding)
    if outputs_in_state:
        appended = [f"output_{y}" if y in names else y for y in output_names]
        features += embedded_names(appended, offsets, embedding)
    twice = sorted(name for name, n in Counter(features).items() if n > 1)
    if twice:
        raise ValueError(
            f"The columns of the states would have the names {twice} more than once, "
            "with those of their past; rename the columns of trajectories."
        )
    return features


def join_recordings(recordings: Sequence[ArrayLike]) -> Any:
    """Join recordings to a single one, with a row of NaN between two of them.

    A :class:`~sklearn_koopman.KoopmanForecaster` finds analogs in all that comes
    before a row. So earlier trials of the same person serve a new one, which stands
    last. No past, and nothing that followed, reaches across a row of NaN.

    New in version 0.1.

    Parameters
    ----------
    recordings : list of array-like of shape (n_samples, n_features)
        The recordings in the order of time, of any lengths, with the same columns and
        rate; arrays, DataFrames, or both.

    Returns
    -------
    recording : ndarray or DataFrame of shape (n_rows, n_features)
        All samples as floats. Masked values are NaN, and a hole in an index becomes a
        row of NaN, too; without holes, `n_rows` is the sum of `n_samples` and of the
        number of recordings less one. A DataFrame where one of the recordings is one,
        with rows numbered from 0: labels of several recordings are no clock.

    Raises
    ------
    ValueError
        If `recordings` is no list of recordings with the same columns and rate, or if
        one of them holds infinity.

    Warns
    -----
    UserWarning
        If columns hold angles that wrap.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_koopman.trajectories import join_recordings
    >>> earlier, now = np.arange(3.0).reshape(-1, 1), np.array([[7.0], [8.0]])
    >>> join_recordings([earlier, now]).ravel()
    array([ 0.,  1.,  2., nan,  7.,  8.])
    """
    read, names, _, is_pandas, _ = read_recordings(
        recordings, None, gaps="split", rates=None, resample=None, name="recordings"
    )
    gap = np.full((1, len(names)), np.nan)
    parts = []
    for recording in read:
        # Only a hole in an index parts samples that stand side by side.
        holes = [
            earlier.stop
            for earlier, later in pairwise(recording.pieces)
            if earlier.stop == later.start
        ]
        parts += [np.insert(recording.samples.states, holes, np.nan, axis=0), gap]
    joined = np.concatenate(parts[:-1])
    if not is_pandas:
        return joined
    import pandas as pd

    frames: Any = [recordings] if hasattr(recordings, "iloc") else recordings
    columns = next(each.columns for each in frames if hasattr(each, "iloc"))
    return pd.DataFrame(joined, columns=columns)


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
        As of :func:`successor_rows`, for the columns that link to most rows. None if no
        columns link to more than half of them, or if 1 % of the outputs occur
        repeatedly.
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
        successors = first[group[n:][rows]]
        # Outputs that are a state by chance may be the same one again and again.
        n_states = len(np.unique(successors))
        if n_states > most and np.mean(occurrences > 1) < 0.01:
            best, most = (rows, successors), n_states
    return best


def find_trials(X: Any, y: Any) -> Array | None:
    """Find the trial of each row by an index.

    Parameters
    ----------
    X : array-like of shape (n_samples, n_features)
        The states.
    y : array-like or None
        The outputs, whose index counts where X has none.

    Returns
    -------
    trials : ndarray of shape (n_samples,), or None
        All levels of the index but "sample_index", as one; without this level, the
        level "trial" and those before it. None if there are none, or only one trial.

    Raises
    ------
    ValueError
        If the index shows several trajectories, but has no such level.
    """
    index = find_index(X, y)
    if index is None:
        return None
    names, trials = list(index.names), None
    if "sample_index" in names and len(names) > 1:
        trials = index.droplevel("sample_index")
    elif "trial" in names:
        trials = index.droplevel([*range(names.index("trial") + 1, len(names))])
    if trials is not None:
        groups = trials.factorize()[0] if trials.nlevels > 1 else trials.to_numpy()
        return groups if trials.nunique(dropna=False) > 1 else None
    labels = read_labels(index, "X")
    falls = labels is not None and (np.diff(labels) <= 0).any()
    if falls or count_recordings(index) > 1:
        raise ValueError(
            "the index restarts or repeats, as it does for several trajectories one "
            "after the other; pass the trajectory of each row as groups=, or frames of "
            "trajectory_pairs."
        )
    return None


class TrajectoryKFold(BaseCrossValidator):
    """K-fold cross-validation that keeps trajectories, or blocks of one, together.

    Rows that follow each other on a trajectory are nearly equal. If they are shuffled
    into training and test folds, the errors of a model appear smaller by orders of
    magnitude than on motion that was left out as a whole.

    With `groups` given to :meth:`split` (one label a row, such as the `groups` of
    :func:`trajectory_pairs`), every fold leaves out whole trajectories, and the folds
    have about equal numbers of samples. Without `groups`, the level "trial" of the
    index of X, else of y, takes their place, as it stands in the DataFrames of
    :func:`trajectory_pairs`, with all levels that :func:`pandas.concat` puts before
    it. Where there is no such level, or one trial only, the rows are taken as one
    trajectory in the order of time: every fold leaves out one contiguous block, and
    `gap` rows on both sides of the block are neither in its training nor its test set.

    A :class:`KernelEDMD` does not see in arrays that a block is missing from its
    training rows. Pass the `sample_index` of :func:`trajectory_pairs` to its fit, which
    cross-validation divides as it divides the rows (for one recording with a lag of 1
    and without gaps, ``np.arange(n_samples)`` is the same). DataFrames need nothing.

    Parameters
    ----------
    n_splits : int, default=5
        Number of folds, at least 2 and at most the number of trajectories.
    gap : int, default=0
        Number of rows dropped from the training set on both sides of a block. With a
        lag and delay-embedded states, rows closer than
        ``lag + (delays - 1) * delay_step`` (for offsets, the lag and the largest one)
        share samples; a `gap` of this size keeps them apart. It is not used with
        `groups`, as trajectories share no samples.

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
            The rows to split; only their number and their index are used.
        y : array-like, default=None
            Outputs, whose index is used where X has none.
        groups : array-like of shape (n_samples,), default=None
            The trajectory of each row. None takes the level "trial" of the index, or
            all rows as one trajectory.

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
            rows, than folds; if `gap` leaves no training rows; if `groups` are missing,
            but the index shows several trajectories: whole numbers or times that do
            not rise, names that repeat, or outer levels.
        """
        # Checked when splitting, so that the constructor only stores.
        check_integer(self.n_splits, "n_splits", 2)
        check_integer(self.gap, "gap", 0)
        if groups is None:
            groups = find_trials(X, y)
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
