"""Rows to learn from, of whole recordings, and what is learned for one baseline."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils.parallel import Parallel, delayed

from .._utils._parallel import one_thread
from .._utils._typing import Array, Indices
from ._baselines import ANALOGS, LAST, Baselines
from ._blending import MAX_SILENT, Blend, LeftOut, StandIns, blend, find_stand_ins
from ._corrections import Ahead, Rows, is_operator, learn
from ._tracks import Track


class Design(NamedTuple):
    """How the rows of a recording are made.

    Attributes
    ----------
    offsets : ndarray of shape (n_offsets,)
        The ages of the samples that are the past of a row.
    embedding : {"copies", "differences"}
        How they stand in the row.
    baselines : Baselines
        What the baselines need to know; with them the horizons.
    """

    offsets: Indices
    embedding: str
    baselines: Baselines

    @property
    def reach(self) -> int:
        """The distance from the first sample of the past to the last target."""
        return int(self.offsets[-1] + self.baselines.horizons.max())

    def tabulate(self, recordings: Sequence[Any], tracks: Sequence[Track]) -> Table:
        """Return the rows that have a past, and outputs at all horizons."""
        horizons = self.baselines.horizons
        past = [track.embedded(self.offsets, self.embedding) for track in tracks]
        truth = [track.following(horizons) for track in tracks]
        known = [
            np.flatnonzero(np.isfinite(p).all(axis=1) & np.isfinite(t).all(axis=(1, 2)))
            for p, t in zip(past, truth, strict=True)
        ]
        short = [
            f"X[{number}] ({len(track.states)} rows)"
            for number, (track, rows) in enumerate(zip(tracks, known, strict=True))
            if not len(rows)
        ]
        if short:
            raise ValueError(
                f"no row of {', '.join(short[:5])}{', ...' * (len(short) > 5)} has a "
                "past and outputs at all horizons: that takes "
                f"{self.reach + 1} rows without a gap. Leave them out, fill short gaps "
                "by kinematics.fill_gaps, or lower horizons and delays."
            )
        return Table(
            recordings,
            tracks,
            past,
            known,
            np.concatenate([t[rows] for t, rows in zip(truth, known, strict=True)]),
        )


class Table(NamedTuple):
    """The rows of recordings that have a past, and outputs at all horizons.

    Attributes
    ----------
    recordings : list of array-like
        The recordings as they were given.
    tracks : list of Track
        The recordings.
    past : list of ndarray of shape (n_all_rows, n_embedded)
        The past of all rows of each recording.
    known : list of ndarray of int
        The rows of each recording.
    truth : ndarray of shape (n_rows, n_horizons, n_outputs)
        The outputs.
    """

    recordings: Sequence[Any]
    tracks: Sequence[Track]
    past: Sequence[Array]
    known: Sequence[Indices]
    truth: Array

    @property
    def groups(self) -> Indices:
        """The number of the recording of each row."""
        return np.repeat(np.arange(len(self.known)), [len(rows) for rows in self.known])

    @property
    def current(self) -> Array:
        """The outputs of the rows themselves, of shape (n_rows, 1, n_outputs)."""
        parts = [t.outputs[k] for t, k in zip(self.tracks, self.known, strict=True)]
        return np.concatenate(parts)[:, np.newaxis]

    def sample_index(self, step: int) -> Indices:
        """Return places on a clock that advances by 1 every `step` rows of a piece."""
        parts, start = [], 0
        for track, rows in zip(self.tracks, self.known, strict=True):
            turn, run = np.divmod(rows, step)
            # Runs and pieces are apart by more than 1.
            length = len(track.states) // step + 2
            piece = track.piece[rows]
            parts.append(start + (piece * step + run) * length + turn)
            start += len(track.pieces) * step * length
        return np.concatenate(parts)

    def next_outputs(self, step: int) -> Array:
        """Return the outputs `step` rows later."""
        ahead = np.array([step])
        parts = [
            track.following(ahead)[rows, 0]
            for track, rows in zip(self.tracks, self.known, strict=True)
        ]
        return np.concatenate(parts)


class Candidate(NamedTuple):
    """What was learned on top of one baseline.

    Attributes
    ----------
    fitted : estimator instance
        The fit to all rows.
    scale : ndarray of shape (n_horizons, n_outputs)
        What its predictions are multiplied by.
    left_out : LeftOut
        The forecasts of all rows by fits that they were left out of.
    """

    fitted: Any
    scale: Array
    left_out: LeftOut


class Learned(NamedTuple):
    """What was learned for the baselines that are used, and how they are mixed.

    Attributes
    ----------
    estimators : dict of str to estimator
        The fits.
    scales : dict of str to ndarray of shape (n_horizons, n_outputs)
        What their predictions are multiplied by.
    blend : Blend
        The baselines and weights of each horizon.
    stand_ins : StandIns
        What is forecast where there is no analog.
    """

    estimators: dict[str, Any]
    scales: dict[str, Array]
    blend: Blend
    stand_ins: StandIns


def train(
    names: Sequence[str],
    design: Design,
    table: Table,
    make_estimator: Callable[[Indices], Any],
    folds: Any,
    unit: Array,
    n_jobs: int | None,
) -> Learned:
    """Learn the corrections to some baselines, and choose from them at each horizon.

    Parameters
    ----------
    names : sequence of str
        The baselines.
    design : Design
        How rows are made.
    table : Table
        The rows.
    make_estimator : callable
        Returns what learns, from the numbers of the recordings of its rows.
    folds : splitter
        Which rows are left out, by recordings if there are several.
    unit : ndarray of shape (n_outputs,)
        The unit of each output.
    n_jobs : int or None
        Number of jobs.

    Returns
    -------
    learned : Learned
        What was learned.
    """
    groups = table.groups if len(table.tracks) > 1 else None
    splits = list(folds.split(table.truth, groups=groups))
    least_share = 0.0 if len(names) == 1 else 1 - MAX_SILENT
    # Matrices of some hundred columns are slower with several threads of BLAS.
    with one_thread():
        fits = Parallel(n_jobs)(
            delayed(fit_candidate)(
                name, design, table, make_estimator, splits, least_share
            )
            for name in names
        )
    candidates = {
        name: fit for name, fit in zip(names, fits, strict=True) if fit is not None
    }
    if not candidates:
        raise ValueError(
            f"the baseline {names[0]!r} says nothing of any row: the recordings are "
            "too short for it; pass longer ones, or baseline='auto'."
        )
    left_out = {name: each.left_out for name, each in candidates.items()}
    mixed = blend(left_out, table.truth, unit)
    stand_ins = find_stand_ins(left_out, table.truth, table.current, unit)
    used = {*mixed.names.tolist()}
    if ANALOGS in used:
        is_learned = (stand_ins.names != LAST) | (stand_ins.weights > 0)
        used |= {*stand_ins.names[is_learned].tolist()}
    return Learned(
        {name: candidates[name].fitted for name in sorted(used)},
        {name: candidates[name].scale for name in sorted(used)},
        mixed,
        stand_ins,
    )


def fit_candidate(
    name: str,
    design: Design,
    table: Table,
    make_estimator: Callable[[Indices], Any],
    splits: Sequence[tuple[Indices, Indices]],
    least_share: float,
) -> Candidate | None:
    """Learn the correction to one baseline.

    Parameters
    ----------
    name : str
        The baseline.
    design : Design
        How rows are made.
    table : Table
        The rows.
    make_estimator : callable
        Returns what learns, from the numbers of the recordings of its rows. Corrections
        are scaled to a root mean square of 1 before, so that each horizon and output
        counts alike.
    splits : sequence of (train, test)
        The rows of the fits that leave rows out.
    least_share : float
        The share of the rows of which the baseline has to speak.

    Returns
    -------
    candidate : Candidate or None
        What was learned; None if the baseline speaks of no rows, or too few.
    """
    said = [
        design.baselines.say(name, *each)
        for each in zip(
            table.recordings, table.tracks, table.past, table.known, strict=True
        )
    ]
    features = np.concatenate(
        [
            np.hstack([past[rows], part.features])
            for past, rows, part in zip(table.past, table.known, said, strict=True)
        ]
    )
    forecasts = np.concatenate([part.forecasts for part in said])
    speaks = np.isfinite(np.hstack([features, forecasts.reshape(len(features), -1)]))
    usable = np.asarray(speaks.all(axis=1))
    if not usable.any() or usable.mean() < least_share:
        return None
    estimator = make_estimator(table.groups[usable])
    _, n_horizons, n_outputs = table.truth.shape
    if is_operator(estimator):
        step = horizon_step(design.baselines.horizons)
        values, scale = table.next_outputs(step), np.ones((n_horizons, n_outputs))
    else:
        step, correction = 1, table.truth - forecasts
        scale = np.sqrt(np.nanmean(correction**2, axis=0))
        scale[scale == 0] = 1.0
        values = (correction / scale).reshape(len(correction), -1)
    rows = Rows(features, values, table.groups, table.sample_index(step))
    fitted, left_out = learn(
        estimator, rows, splits, Ahead(design.baselines.horizons // step, n_outputs)
    )
    return Candidate(fitted, scale, LeftOut(forecasts, scale * left_out))


def horizon_step(horizons: Indices) -> int:
    """Return the longest step that all horizons are multiples of."""
    return int(np.gcd.reduce(horizons))
