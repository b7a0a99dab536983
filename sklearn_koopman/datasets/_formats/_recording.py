"""What all formats of markers are read into."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

from ..._utils._warnings import warn
from ._text import File, Table, to_setting

# Between a person and the name of a marker.
PREFIX_END = ":"
# The unit of a pose in a video, which has no other.
PIXELS = "px"


class Marker(NamedTuple):
    """The columns of one marker in a table."""

    name: str
    columns: Sequence[int]  # X and Y, and Z unless it is planar
    individual: str = ""
    likelihood: int | None = None  # its column

    @classmethod
    def from_label(cls, label: str, columns: Sequence[int]) -> Self:
        """Return the marker Hip of S01 from ``S01:Hip``; few labels name a person."""
        individual, _, name = label.rpartition(PREFIX_END)
        return cls(name, columns, individual) if name else cls(label, columns)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """The markers of a file, and what the file says of them.

    The rate, the unit and the stamps are None where the file does not tell.
    """

    table: Table
    markers: Sequence[Marker]
    rate: float | None = None
    rate_name: str = "the rate of the file"
    unit: str | None = None
    stamps: int | None = None  # the column of the clock
    is_seconds: bool | None = None  # None: if they are not all whole
    first_frame: int = 0  # the number of the frame at time 0


class Format(NamedTuple):
    """A format of files, how it is recognised and how it is read."""

    name: str
    recognize: Callable[[File], bool]
    read: Callable[[File], Recording]


def warn_of_count(name: str, claimed: str | None, found: Collection[float]) -> None:
    """Warn if the head of a file counts something otherwise than its lines do."""
    number = to_setting(claimed or "")
    if number == number and number not in found:  # NaN is no number
        warn(
            f"{name} is {claimed}, but the file holds {min(found):g}, which are read; "
            "if some were cut off, export the file again."
        )
