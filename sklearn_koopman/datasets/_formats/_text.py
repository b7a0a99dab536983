"""The text of a file, its lines, fields and numbers."""

import codecs
import operator
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self, SupportsIndex

import numpy as np

from ..._utils._typing import Array

LINE_ENDS = re.compile(r"\r{0,2}\n|\r")  # CR CR LF comes from copies in text mode
BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
# The first that occurs separates the fields of a file; blanks do if there is none.
DELIMITERS = ("\t", ";", ",")
SPELLED = {"\t": "tabs", ";": "semicolons", ",": "commas", None: "blanks"}
# How programs write that there is no number.
MISSING = frozenset(
    {
        *("", "nan", "-nan", "null", "none", "na", "n/a", "#n/a", "nodata", "no data"),
        *("nan(ind)", "-nan(ind)", "nan(snan)", "-nan(snan)"),
        *("1.#ind", "-1.#ind", "1.#qnan", "-1.#qnan", "1.#snan", "-1.#snan"),
    }
)
# A comma before each three digits is no decimal one, or cannot be told from it.
THOUSANDS = re.compile(r"\d{1,3}(,\d{3})+")
SHOWN = 40  # characters of a line in a message

Line = tuple[int, str]  # the number of a line, from 1, and its text


@dataclass(frozen=True)
class File:
    """A file of a person's motion, as bytes and as lines."""

    path: Path
    data: bytes

    @classmethod
    def read(cls, path: Any) -> Self:
        """Read a file; refuse what is no path, and folders."""
        try:
            where = Path(os.fsdecode(path))
        except TypeError as error:
            raise TypeError(f"path must be that of a file, got {path!r}.") from error
        if where.is_dir():
            raise IsADirectoryError(
                f"{where} is a folder; pass the path of each of its files, as by "
                "sorted(pathlib.Path(folder).glob('*.trc'))."
            )
        return cls(where, where.read_bytes())

    @property
    def suffix(self) -> str:
        """The end of the name, such as ``.trc``, in lower case."""
        return self.path.suffix.lower()

    @cached_property
    def lines(self) -> list[str]:
        """The lines of the text."""
        return LINE_ENDS.split(decode(self.data))

    @property
    def first_line(self) -> str:
        """The first line, without blanks at its ends."""
        return self.lines[0].strip()


def decode(data: bytes) -> str:
    """Decode text in UTF-8, UTF-16 or, where it is neither, the Western code page."""
    for mark, encoding in BYTE_ORDER_MARKS.items():
        if data.startswith(mark):
            return data.decode(encoding, errors="replace")
    # Latin letters and digits in UTF-16 have zero as every other byte.
    for encoding, zeros in (("utf-16-le", data[1:200:2]), ("utf-16-be", data[:200:2])):
        if len(zeros) > 1 and not any(zeros):
            return data.decode(encoding, errors="replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def find_delimiter(line: str) -> str | None:
    """Return what separates the fields of a line; None means blanks."""
    return next((mark for mark in DELIMITERS if mark in line), None)


def split(line: str, delimiter: str | None) -> list[str]:
    """Return the fields of a line without blanks and quotes around them."""
    return [field.strip().strip('"').strip() for field in line.split(delimiter)]


def find_row_delimiter(line: str, delimiter: str | None, n_columns: int) -> str | None:
    """Return what separates the numbers of a line, if the names have a delimiter."""
    if len(split(line, delimiter)) > 1:
        return delimiter
    for other in (*DELIMITERS, None):
        fields = drop_end(split(line, other))
        if len(fields) == n_columns and all(map(is_number, fields)):
            return other
    return delimiter


def drop_end(fields: list[str]) -> list[str]:
    """Drop the empty fields at the end of a line."""
    n_fields = max((i for i, field in enumerate(fields, 1) if field), default=0)
    return fields[:n_fields]


def is_number(field: str) -> bool:
    """Whether a field holds a number, with a decimal point or comma."""
    try:
        to_float(field.replace(",", "."))
    except ValueError:
        return False
    return True


def to_float(field: str) -> float:
    """Convert a field; what stands for a missing number becomes NaN."""
    if field.lower() in MISSING:
        return np.nan
    if "_" in field:  # Python reads 1_000 as a number
        raise ValueError(field)
    return float(field)


def to_setting(field: str) -> float:
    """Convert a number in the head, with a decimal comma or not; NaN if it is none."""
    is_plain = is_number(field) and not THOUSANDS.fullmatch(field)
    return to_float(field.replace(",", ".")) if is_plain else np.nan


def to_rate(field: str) -> float | None:
    """Convert a number of frames per second; None for what is none."""
    rate = to_setting(field)
    return rate if 0 < rate < np.inf else None


@dataclass(frozen=True)
class Table:
    """Numbers in columns, and where in the file each row stands."""

    values: Array  # (n_rows, n_columns), NaN where there is no number
    labels: Sequence[str]  # of the columns
    places: Sequence[int]  # of the rows in the file
    faults: dict[int, tuple[int, str]]  # the first field that is no number, its row
    kind: str = "line"  # what the places count

    def place(self, row: SupportsIndex) -> str:
        """Say where a row stands in the file."""
        return f"{self.kind} {self.places[operator.index(row)]}"

    def read(self, columns: Sequence[int]) -> Array:
        """Return some columns; refuse those that hold what is no number."""
        for column in sorted({*columns} & {*self.faults}, key=self.faults.__getitem__):
            row, field = self.faults[column]
            raise ValueError(
                f"{self.place(row)}: {field!r} in column {self.labels[column]!r} "
                "is not a number; leave missing numbers blank, and write a decimal "
                "point or comma, but no two of them in one file."
            )
        return self.values[:, list(columns)]

    def __len__(self) -> int:
        return len(self.values)


def read_table(
    lines: Sequence[Line], labels: Sequence[str], delimiter: str | None
) -> Table:
    """Read lines of numbers into columns; lines of words alone are comments."""
    lines = _with_points(lines, delimiter)
    n_columns = len(labels)
    values: list[list[float]] = []
    places: list[int] = []
    faults: dict[int, tuple[int, str]] = {}
    for number, line in lines:
        row = _read_plain(line, delimiter)
        if len(row) != n_columns:
            fields = split(line, delimiter)
            row, wrong = _read_fields(fields)
            if wrong and not any(map(is_number, filter(None, fields))):
                continue
            if len(fields) < n_columns or any(fields[n_columns:]):
                raise ValueError(
                    f"line {number}: found {len(fields)} fields separated by "
                    f"{SPELLED[delimiter]}, expected {n_columns}; the line is damaged, "
                    "export the file again."
                )
            for column, field in wrong.items():
                faults.setdefault(column, (len(values), field))
        values.append(row[:n_columns])
        places.append(number)
    if not values:
        raise ValueError("the file has a head, but no frames; export it again.")
    return Table(np.array(values, dtype=np.float64), labels, places, faults)


def _read_plain(line: str, delimiter: str | None) -> list[float]:
    """Return the numbers of a line, none if a field is anything else; this is fast."""
    try:
        return [] if "_" in line else [*map(float, line.rstrip().split(delimiter))]
    except ValueError:
        return []


def _read_fields(fields: Sequence[str]) -> tuple[list[float], dict[int, str]]:
    """Return the numbers of fields, and what those hold that are no numbers."""
    row, wrong = [], {}
    for column, field in enumerate(fields):
        try:
            row.append(to_float(field))
        except ValueError:
            row.append(np.nan)
            wrong[column] = field
    return row, wrong


def number_lines(lines: Sequence[str], first: int) -> list[Line]:
    """Return the lines from a place on that are not blank, with their numbers."""
    return [
        (number, line)
        for number, line in enumerate(lines[first:], first + 1)
        if line.strip(" \t,;")
    ]


def _with_points(lines: Sequence[Line], delimiter: str | None) -> Sequence[Line]:
    """Write decimal points for decimal commas, if the numbers have no points."""
    if delimiter == "," or any("." in line for _, line in lines):
        return lines
    return [(number, line.replace(",", ".")) for number, line in lines]
