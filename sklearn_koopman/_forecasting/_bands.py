"""Bands about forecasts, from a calibration."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from sklearn.utils import Bunch

from .._utils._typing import Array
from ._calibration import (
    check_coverage,
    check_level,
    count_units,
    expected_quantile,
    largest_scores,
    minmax_band,
    mixture_quantile,
    plus_band,
    pooled_quantile,
    symmetric_band,
)

Scaled = tuple[Array, Array]  # forecasts of a recording, and the scale of their errors


def usable_scores(made: Bunch, coverage: float, simultaneous: bool) -> Array:
    """Return the scores that bands are made of; refuse a coverage beyond them.

    Parameters
    ----------
    made : Bunch
        The calibration of a forecaster.
    coverage : float
        The coverage of the bands.
    simultaneous : bool
        Whether they are to hold at all horizons and outputs at once.
    """
    scores: Array = largest_scores(made.scores) if simultaneous else made.scores
    if made.method == "pooled":
        check_level(coverage)
    else:
        check_coverage(coverage, count_units(scores, made.units))
    return scores


def refuse_empty(scores: Sequence[Array]) -> None:
    """Refuse recordings that have no errors to calibrate with."""
    empty = [f"X[{i}]" for i, part in enumerate(scores) if not np.isfinite(part).any()]
    if empty:
        raise ValueError(
            f"{', '.join(empty[:5])}{', ...' * (len(empty) > 5)} have no row with a "
            "forecast and outputs that came, and calibrate nothing; leave them out."
        )


def bands_about(
    pairs: Iterable[Scaled], made: Bunch, scores: Array, coverage: float
) -> Iterator[tuple[Array, Array]]:
    """Yield the forecasts of each recording, and the intervals about them."""
    key = f"{coverage} {scores.shape[1:]}"  # simultaneous bands have one score a row
    if key not in made.quantiles:
        if made.method == "draws":
            quantile = expected_quantile(scores, made.units, coverage)
        elif made.method == "mixture":
            quantile = mixture_quantile(scores, made.units, coverage)
        else:
            quantile = pooled_quantile(scores, coverage)
        made.quantiles[key] = quantile
    quantile = made.quantiles[key]
    for forecasts, scale in pairs:
        yield forecasts, symmetric_band(forecasts, quantile * scale)


def bands_of_models(
    pairs: Iterable[Scaled],
    by_model: Sequence[Iterable[Scaled]],
    made: Bunch,
    scores: Array,
    coverage: float,
) -> Iterator[tuple[Array, Array]]:
    """Yield the forecasts of each recording, and intervals of models without a unit."""
    make = plus_band if made.method == "plus" else minmax_band
    for (forecasts, _), *each in zip(pairs, *by_model, strict=True):
        predictions, scale = map(np.stack, zip(*each, strict=True))
        yield (
            forecasts,
            make(predictions, scores, made.units, made.models, scale, coverage),
        )
