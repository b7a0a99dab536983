"""Columns that repeat others some rows on: what they tell of the order of the rows."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .._utils._typing import Array, Indices, Mask

# Values agree within this part of a column's range (and the rounding of single
# precision). Those that differ by more than `APART` are others, whatever was rounded.
AGREEMENT, APART = 1e-6, 1e-3
SINGLE = np.finfo(np.float32).eps
# A column with fewer distinct values in the rows that are sampled, such as a contact,
# may repeat another one by chance.
N_SAMPLED, MIN_LEVELS = 24, 8
LONGEST_SHIFT = 128
# So many shifts of columns are held at a time: fewer shifts of very wide states.
MAX_SHIFTED = 200_000
# So many pairs of columns are searched for a shift, of wide states some columns only.
MAX_PAIRS = 5_000
# A column of few values may agree by chance in the rows that are sampled, many a time.
MAX_FAILED = 10
# Rows that two columns must have in common, at least, to be compared.
MIN_ROWS = 10


class Repeat(NamedTuple):
    """A column that repeats another one.

    Attributes
    ----------
    column : int
        The column that repeats another one.
    other : int
        The column that it repeats.
    shift : int
        Row i of the former is row ``i + shift`` of the latter, up to scale and offset.
    rows : ndarray of shape (n_rows,)
        The rows that have a row `shift` after them.
    is_equal : ndarray of shape (n_rows,)
        Which of them hold the same value. Most do.
    """

    column: int
    other: int
    shift: int
    rows: Indices
    is_equal: Mask


class Columns:
    """Columns to be compared with others, a number of rows later.

    Scalers change the scale and the offset of columns. So values are compared after a
    line has been drawn through those of two rows.

    Parameters
    ----------
    outputs : ndarray of shape (n_samples, n_outputs)
        The columns that may repeat others.
    states : ndarray of shape (n_samples, n_features)
        The columns that may be repeated.
    clock : ndarray of shape (n_samples,)
        The place of each row, rising. A step of more than 1 is a hole.
    """

    def __init__(self, outputs: Array, states: Array, clock: Indices) -> None:
        self.outputs, self.states, self.clock = outputs, states, clock
        at_most = max(MAX_SHIFTED // states.shape[1], 2)
        self.longest = min(LONGEST_SHIFT, len(clock) // 4, at_most)
        n_starts = len(clock) - self.longest
        rng = np.random.default_rng(0)  # regular rows may hit the same phases
        self.sample = rng.choice(n_starts, min(N_SAMPLED, n_starts), replace=False)
        levels = np.sort(outputs[self.sample], axis=0)
        n_levels = 1 + (np.diff(levels, axis=0) > 0).sum(axis=0)
        extent, rounding = np.ptp(outputs, axis=0), SINGLE * np.abs(outputs).max(axis=0)
        self.candidates = np.flatnonzero(
            (n_levels >= min(MIN_LEVELS, len(self.sample)))
            & (rounding < APART * extent)
        )

    def drop(self, columns: set[int]) -> None:
        """Leave out some outputs."""
        kept = [column for column in self.candidates if column not in columns]
        self.candidates = np.array(kept, dtype=np.intp)

    def repeats_of_all(self, shift: int) -> Iterator[Repeat]:
        """Find the outputs that repeat a state in all rows, `shift` rows later."""
        rows = self._rows(shift)
        if len(rows) < 2:
            return
        later = self.states[rows[0] + shift :]
        starts = self.states[rows + shift] if len(rows) < len(later) else later
        low, high = rows[starts.argmin(axis=0)], rows[starts.argmax(axis=0)]
        columns = np.arange(self.states.shape[1])
        floor = self.states[low + shift, columns]
        extent = self.states[high + shift, columns] - floor
        some = rows[:: max(len(rows) // N_SAMPLED, 1)]
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = (self.states[some + shift] - floor) / extent
            for column in self.candidates.tolist():
                u = self.outputs[:, column]
                line = u[low] + relative * (u[high] - u[low])
                fits = np.abs(u[some, np.newaxis] - line) <= APART * np.ptp(u)
                for other in np.flatnonzero(fits.all(axis=0)).tolist():
                    ends = low[other], high[other]
                    found = self._compare(column, other, shift, rows, *ends)
                    if found and found.is_equal.all():
                        yield found

    def repeats(self, shifts: Indices, *, itself: bool = True) -> Iterator[Repeat]:
        """Find the outputs that repeat a state in most rows, some rows later.

        Parameters
        ----------
        shifts : ndarray of shape (n_shifts,)
            The numbers of rows.
        itself : bool, default=True
            Whether an output may repeat the state of its own number.

        Yields
        ------
        repeat : Repeat
            Every output and state that agree, with the first of the shifts.
        """
        later = self.sample + shifts[:, np.newaxis]
        if not later.size:
            return
        values = self.states[later].transpose(0, 2, 1)
        reach = self.clock[later] - self.clock[self.sample]
        is_linked = (reach == shifts[:, np.newaxis])[:, np.newaxis]
        # Where nothing moves, any shift agrees.
        now = self.states[self.sample].T
        counts = is_linked & (
            np.abs(values - now) > AGREEMENT * np.ptp(now, axis=1)[:, np.newaxis]
        )
        least = np.maximum(counts.sum(axis=2) / 3, 3)
        most = max(MAX_PAIRS // self.states.shape[1], 1)
        for column in self.candidates[:: -(-len(self.candidates) // most) or 1]:
            u = self.outputs[self.sample, column]
            order, near = np.argsort(u), AGREEMENT * np.ptp(u)
            done, n_failed = set() if itself else {column}, 0
            # Rows at the ends of recordings agree with nothing: draw several lines.
            for k in range(0, len(order) // 2, 3):
                low, high = order[k], order[-1 - k]
                if u[low] == u[high]:
                    break
                with np.errstate(divide="ignore", invalid="ignore"):
                    slope = (u[high] - u[low]) / (
                        values[..., [high]] - values[..., [low]]
                    )
                    line = u[low] + slope * (values - values[..., [low]])
                    agrees = (np.abs(u - line) <= near) & counts & (slope > 0)
                for s, other in np.argwhere(agrees.sum(axis=2) > least):
                    if other in done or n_failed == MAX_FAILED:
                        continue
                    rows = self._rows(shifts[s])
                    ends = self.sample[low], self.sample[high]
                    found = self._compare(column, other, shifts[s], rows, *ends)
                    if found:
                        done.add(other)
                        yield found
                    else:
                        n_failed += 1

    def _rows(self, shift: int) -> Indices:
        """Return the rows that have a row `shift` after them, without a hole."""
        n = len(self.clock) - shift
        rows: Indices = np.flatnonzero(self.clock[shift:] - self.clock[:n] == shift)
        return rows

    def _compare(
        self, column: int, other: int, shift: int, rows: Indices, low: int, high: int
    ) -> Repeat | None:
        """Compare two columns by the line through two rows; None if few rows agree."""
        u, v = self.outputs[:, column], self.states[:, other]
        floor = v[low + shift]
        slope = (u[high] - u[low]) / (v[high + shift] - floor)
        distance = np.abs(u[rows] - u[low] - slope * (v[rows + shift] - floor))
        extent = np.ptp(u)
        near = AGREEMENT * extent + SINGLE * np.abs(u).max()
        # Columns at rest, or clipped, agree by chance.
        other_row = rows + shift - 1 if shift else np.minimum(rows + 1, len(u) - 1)
        moves = np.abs(slope * (v[rows + shift] - v[other_row])) > near
        agrees, is_equal = distance[moves] <= near, distance <= APART * extent
        if len(agrees) < min(MIN_ROWS, len(rows)) or agrees.mean() <= 0.5:
            return None
        if not is_equal.all() and not (shift and _breaks_off(is_equal, shift)):
            return None
        return Repeat(column, other, int(shift), rows, is_equal)


def _breaks_off(is_equal: Mask, shift: int) -> bool:
    """Tell whether rows differ as they do at the ends of recordings.

    There, as many rows differ as the shift has, and all rows agree between the ends.
    Where values agree by chance, since they are rounded, others differ all over.
    """
    n_breaks = np.count_nonzero(is_equal[:-1] & ~is_equal[1:]) + (not is_equal[0])
    n_equal = np.count_nonzero(is_equal)
    n_differing = len(is_equal) - n_equal
    is_whole = 0.8 <= n_differing / (shift * n_breaks) <= 1.25
    return bool(is_whole and n_equal > n_breaks * max(MIN_ROWS, shift))


def find_contradiction(outputs: Array, states: Array, clock: Indices) -> Repeat | None:
    """Tell whether outputs are states of other rows than those that follow.

    Parameters
    ----------
    outputs : ndarray of shape (n_samples, n_outputs)
        The outputs, which may be states of the next row.
    states : ndarray of shape (n_samples, n_features)
        The states.
    clock : ndarray of shape (n_samples,)
        The place of each row, rising. A step of more than 1 is a hole.

    Returns
    -------
    repeat : Repeat or None
        Outputs of most rows that are states of a row `shift` later. If `shift` is 1,
        not all of them are. None if nothing is found. Outputs that are states of a row
        2 or more later are no contradiction if one is that of the next row throughout.
    """
    columns = Columns(outputs, states, clock)
    # Outputs that are the state of their own row tell nothing of successors.
    columns.drop({repeat.column for repeat in columns.repeats_of_all(0)})
    next_rows = list(columns.repeats(np.array([1])))
    whole = {r.column for r in next_rows if r.is_equal.all()}
    whole |= {repeat.column for repeat in columns.repeats_of_all(1)}
    # One column may go on across a break by chance; another one shows the break.
    found = next((r for r in next_rows if r.column not in whole), None)
    if found is not None or whole:
        return found
    for repeat in columns.repeats(np.arange(2, columns.longest)):
        if not _is_quarter_turn(states[:, repeat.other], repeat.shift - 1):
            return repeat
    return None


def find_break(states: Array) -> Repeat | None:
    """Tell whether delayed copies among the states break off, as recordings end.

    Parameters
    ----------
    states : ndarray of shape (n_samples, n_features)
        The states in the order of time.

    Returns
    -------
    repeat : Repeat or None
        Columns of which most rows, but not all, are copies. None if all are in some
        columns, or if there are no copies.
    """
    columns = Columns(states, states, np.arange(len(states)))
    found = None
    for repeat in columns.repeats(np.arange(1, columns.longest), itself=False):
        if repeat.is_equal.all():
            return None
        if found is None or repeat.shift < found.shift:
            found = repeat
    return found


def _is_quarter_turn(values: Array, shift: int) -> bool:
    """Tell whether a shift makes a sine of a cosine, which is no step of many rows."""
    if len(values) <= 2 * shift:
        return False
    ends = values[: -2 * shift] + values[2 * shift :]
    return bool(np.ptp(ends) <= APART * np.ptp(values))
