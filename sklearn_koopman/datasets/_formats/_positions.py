"""From a recording, as its file holds it, to the markers that a user asks for."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from difflib import get_close_matches
from typing import Any, NamedTuple, NoReturn

import numpy as np
from sklearn.utils import Bunch

from ..._utils._typing import Array, Mask
from ..._utils._validation import check_choice, check_names, check_number
from ._clock import read_clock
from ._recording import PIXELS, PREFIX_END, Marker, Recording
from ._units import IN_MM, check_size, spell

FRAMES_TO_MEASURE = 200
MAX_NAMED = 5  # markers with gaps in a message
# What programs write for each coordinate of a marker that is lost.
LOST = (0.0, *(10.0**n - 1 for n in range(4, 16)))


class Choices(NamedTuple):
    """What a user asks for."""

    markers: Sequence[str] | None
    rate: float | None
    unit: str | None
    gaps: str
    zeros: str
    min_likelihood: float | None
    individual: str | None


def check_choices(choices: Choices) -> None:
    """Refuse choices that suit no file."""
    if choices.rate is not None:
        check_number(choices.rate, "rate", positive=True)
    check_choice(choices.unit, "unit", (None, *IN_MM, PIXELS))
    check_choice(choices.gaps, "gaps", ("raise", "nan"))
    check_choice(choices.zeros, "zeros", ("gap", "keep"))
    if choices.min_likelihood is not None:
        check_number(choices.min_likelihood, "min_likelihood")
    check_names(choices.markers, "markers")
    individual = choices.individual
    if individual is not None and not isinstance(individual, str):
        raise ValueError(
            f"individual={individual!r}; pass one name, or None and markers with full "
            "names, such as markers=['a:Hip', 'b:Hip']."
        )


def select_positions(recording: Recording, choices: Choices, where: str) -> Bunch:
    """Return the markers that are asked for, with their time and unit."""
    table = recording.table
    chosen = _select(recording.markers, choices.markers, choices.individual)
    unit = choices.unit or (spell(recording.unit) if recording.unit else None)
    if unit == PIXELS != recording.unit:
        raise ValueError(
            "unit='px', but only poses in a video are in pixels; pass the unit of "
            "length of the file."
        )
    positions = {n: _positions(recording, m, choices) for n, m in chosen.items()}
    time, rate = read_clock(recording, choices.rate)
    if np.isnan(rate) or unit is None:
        _refuse_unsaid(rate, unit)
    if choices.gaps == "raise":
        _refuse_gaps(recording, chosen, positions, choices)
    if choices.unit is None:
        check_size(unit, _body(recording, choices))
    likelihood = {
        name: table.read([marker.likelihood])[:, 0]
        for name, marker in chosen.items()
        if marker.likelihood is not None
    }
    individuals = _individuals(recording.markers)
    optional: dict[str, Any] = {"likelihood": likelihood, "individuals": individuals}
    return Bunch(
        markers=positions,
        names=list(positions),
        time=time,
        rate=float(rate),
        unit=unit,
        **{name: values for name, values in optional.items() if values},
        filename=where,
        DESCR=f"{len(chosen)} markers in {len(time)} frames at {rate:g} Hz, "
        f"coordinates in {unit}, read from {where}",
    )


def _refuse_unsaid(rate: float, unit: str | None) -> NoReturn:
    """Ask for the rate and the unit that a file does not tell."""
    unsaid = {}
    if np.isnan(rate):
        unsaid["how many frames it has a second"] = "rate, such as rate=100"
    if unit is None:
        unsaid["the unit of its positions"] = "unit, one of 'mm', 'cm' and 'm'"
    raise ValueError(
        f"the file does not say {', nor '.join(unsaid)}; pass "
        f"{', and '.join(unsaid.values())}."
    )


def _individuals(markers: Sequence[Marker]) -> list[str]:
    return list(dict.fromkeys(m.individual for m in markers if m.individual))


def _full_name(marker: Marker) -> str:
    individual = marker.individual
    return f"{individual}{PREFIX_END}{marker.name}" if individual else marker.name


def _select(
    markers: Sequence[Marker], names: Sequence[str] | None, individual: str | None
) -> dict[str, Marker]:
    """Return the markers to read, by the names that they are asked for by."""
    individuals = _individuals(markers)
    if individual is not None:
        if individual not in individuals:
            raise ValueError(
                f"individual={individual!r}, but the file holds the individuals "
                f"{individuals}."
                if individuals
                else f"individual={individual!r}, but the file names no individuals; "
                "leave individual out."
            )
        markers = [m for m in markers if m.individual == individual]
    full = [_full_name(marker) for marker in markers]
    bare = [marker.name for marker in markers]
    if not markers:
        raise ValueError("the file holds no positions of markers; export them, too.")
    chosen = {}
    for name in bare if names is None else names:
        places = [i for i, label in enumerate(full) if label == name]
        if names is None or not places:
            places = [i for i, label in enumerate(bare) if label == name]
        if not places:
            close = get_close_matches(str(name), bare, n=4, cutoff=0.5)
            hint = f"did you mean one of {close}? " * bool(close)
            raise ValueError(f"no marker {name!r}; {hint}The file holds {bare}.")
        if len({full[i] for i in places}) > 1:
            raise ValueError(
                f"the file holds the individuals {individuals}; pass individual, such "
                f"as individual={individuals[0]!r}, or markers with full names, such "
                f"as {full[places[0]]!r}."
            )
        if len(places) > 1:
            raise ValueError(
                f"{len(places)} markers have the name {name!r}; give each its own "
                "name, or pass markers without it."
            )
        chosen[name] = markers[places[0]]
    return chosen


def _positions(recording: Recording, marker: Marker, choices: Choices) -> Array:
    """Return the coordinates of a marker, NaN where there is a gap."""
    values = recording.table.read(marker.columns)
    is_lost = ~np.isfinite(values)
    if choices.zeros == "gap":
        is_lost |= _is_sentinel(values)[:, np.newaxis]
    is_lost |= _is_unlikely(recording, marker, choices)[:, np.newaxis]
    return np.where(is_lost, np.nan, values)


def _is_sentinel(values: Array) -> Mask:
    """Return where all coordinates are one number that stands for a lost marker."""
    first = values[:, :1]
    return (np.isin(np.abs(first), LOST) & (values == first)).all(axis=1)


def _is_unlikely(recording: Recording, marker: Marker, choices: Choices) -> Mask:
    """Return where the likelihood is too small; below zero it always is."""
    smallest = choices.min_likelihood
    if marker.likelihood is None:
        if smallest is not None:
            raise ValueError(
                f"min_likelihood={smallest}, but the file holds no likelihood of "
                f"{marker.name!r}; leave min_likelihood out."
            )
        return np.zeros(len(recording.table), dtype=bool)
    likelihood = recording.table.read([marker.likelihood])[:, 0]
    return likelihood < 0 if smallest is None else ~(likelihood >= smallest)


def _body(recording: Recording, choices: Choices) -> Array:
    """Return all markers of the file in some of its frames, spread over it evenly."""
    step = max(len(recording.table) // FRAMES_TO_MEASURE, 1)
    body = []
    for marker in recording.markers:
        with suppress(ValueError):  # what is not read may be damaged
            body.append(_positions(recording, marker, choices)[::step])
    return np.stack(body)


def _refuse_gaps(
    recording: Recording,
    chosen: dict[str, Marker],
    positions: dict[str, Array],
    choices: Choices,
) -> None:
    """Refuse gaps, all of them at once."""
    table = recording.table
    gaps, n_unlikely = [], 0
    sentinels: Counter[str] = Counter()
    for name, marker in chosen.items():
        lost = np.flatnonzero(np.isnan(positions[name]).any(axis=1))
        if len(lost):
            gaps.append(
                f"{name!r} in {len(lost)} frames, first in {table.place(lost[0])}"
            )
            raw = table.read(marker.columns)[lost]
            n_unlikely += int(_is_unlikely(recording, marker, choices)[lost].sum())
            if choices.zeros == "gap":
                sentinels.update(
                    ", ".join(f"{x:.16g}" for x in row)
                    for row in raw[_is_sentinel(raw)]
                )
    if not gaps:
        return
    if len(gaps) > MAX_NAMED:
        gaps[MAX_NAMED:] = [f"{len(gaps) - MAX_NAMED} more"]
    remarks = [
        f"{count} of them stand at exactly {place}; zeros='keep' says that they are no "
        "gaps. "
        for place, count in sentinels.most_common(1)
    ]
    if n_unlikely:
        remarks.append(
            f"{n_unlikely} of them have a likelihood below "
            f"{choices.min_likelihood or 0:g}, or none. "
        )
    raise ValueError(
        f"of {len(table)} frames, coordinates are missing for {'; '.join(gaps)}. "
        f"{''.join(remarks)}Pass gaps='nan'; then fill short gaps by "
        "kinematics.fill_gaps, and cut at others by trajectory_pairs(gaps='split'). Or "
        "leave these markers out."
    )
