"""The layout of a C3D file, checked before a library in C++ trusts it.

The first block says where the parameters are. They are a chain of records, each of
which says where the next one begins.
"""

import math
import struct
from collections.abc import Iterator

BLOCK = 512
# The second byte of every file.
MAGIC = 0x50
INTEL, DEC, MIPS = 84, 85, 86
# Bytes of a character, a byte, an integer and a number, by the number of their type.
N_BYTES = {-1: 1, 1: 1, 2: 2, 4: 4}
ROTATION_BYTES = 68  # a matrix of 4 by 4 numbers and its residual
# ezc3d relies on these bounds,
MAX_DIMENSIONS, MAX_VALUES, MAX_DESCRIPTION = 7, 65_535, 127
MAX_RATIO = 1000  # of the rates of channels and frames
# and on a value of each of these.
FILLED = [
    *("POINT:USED", "POINT:SCALE", "POINT:RATE", "POINT:FRAMES", "POINT:DATA_START"),
    *("ANALOG:USED", "ANALOG:RATE", "ANALOG:GEN_SCALE"),
    *("ROTATION:USED", "ROTATION:RATE", "ROTATION:RATIO", "ROTATION:DATA_START"),
]


def check_layout(data: bytes) -> None:
    """Refuse a file that was cut, or whose parameters are damaged.

    ezc3d would crash, never return or take all memory, or read some of the frames.
    """
    try:
        n_bytes = _count_bytes(data, _read_counts(data))
    except (struct.error, IndexError, KeyError) as error:
        raise ValueError(
            "the file is no C3D, or its parameters are damaged; export it again."
        ) from error
    if len(data) < n_bytes:
        raise ValueError(
            f"the file was cut: its frames end at byte {n_bytes:.0f}, and the file at "
            f"byte {len(data)}; copy or export it again."
        )


def _read_counts(data: bytes) -> dict[str, float]:
    """Return the first value of each parameter of numbers, by its full name."""
    groups: dict[int, str] = {}
    counts: dict[tuple[int, str], float] = {}
    start = BLOCK * (data[0] - 1)
    processor = data[start + 3]
    if data[1] != MAGIC or start < BLOCK or processor not in (INTEL, DEC, MIPS):
        raise KeyError(processor)
    if processor == MIPS:
        raise ValueError(
            "the file was written by a MIPS processor, which ezc3d does not read; save "
            "it again in the format of Intel."
        )
    for group, name, content in _records(data, start + 4):
        if group < 0:
            groups[-group] = name
            _check_description(content)
        else:
            counts[group, name] = _read_count(content, processor)
    named = {f"{groups[group]}:{name}": n for (group, name), n in counts.items()}
    if any(math.isnan(named.get(name, 0.0)) for name in FILLED):
        raise KeyError("no value")
    return named


def _records(data: bytes, place: int) -> Iterator[tuple[int, str, bytes]]:
    """Yield the group, which is below 0 for itself, the name and content of each."""
    while data[place]:
        n_name, group = struct.unpack_from("bb", data, place)
        place += 2
        name = data[place : place + abs(n_name)].decode("latin-1")
        place += abs(n_name)
        (n_bytes,) = struct.unpack_from("<H", data, place)
        end = place + n_bytes if n_bytes else len(data)
        yield group, name, data[place + 2 : end]
        if not n_bytes:
            return
        place = end


def _read_count(content: bytes, processor: int) -> float:
    """Return the first value of a parameter; NaN for texts, and if there is none."""
    kind, n_dimensions = struct.unpack_from("bb", content)
    shape = content[2 : 2 + n_dimensions]
    is_sound = 0 <= n_dimensions <= MAX_DIMENSIONS and (kind > 0 or n_dimensions > 0)
    if not is_sound or math.prod(max(n, 1) for n in shape) > MAX_VALUES:
        raise IndexError(n_dimensions)
    size = N_BYTES[kind] * math.prod(shape)
    values = content[2 + n_dimensions : 2 + n_dimensions + size]
    _check_description(content[2 + n_dimensions + size :])
    if kind < 0 or not size:
        return math.nan
    if kind < 4:
        return float(int.from_bytes(values[:kind], "little"))
    if processor == DEC:  # the halves change places, and the exponent counts from 2
        return float(struct.unpack("<f", values[2:4] + values[:2])[0]) / 4
    return float(struct.unpack_from("<f", values)[0])


def _check_description(content: bytes) -> None:
    """Refuse a description that is longer than its record."""
    if content[0] > min(len(content) - 1, MAX_DESCRIPTION):
        raise IndexError(content[0])


def _count_bytes(data: bytes, counts: dict[str, float]) -> float:
    """Return where the frames end."""
    first, last = struct.unpack_from("<HH", data, 6)
    (block,) = struct.unpack_from("<H", data, 16)
    n_frames = counts["POINT:FRAMES"] or last - first + 1
    n_values = 4 * counts["POINT:USED"] + _count_samples(counts, "ANALOG")
    width = N_BYTES[4 if counts["POINT:SCALE"] < 0 else 2]
    ends = [BLOCK * (block - 1) + n_frames * n_values * width]
    if n_rotations := _count_samples(counts, "ROTATION"):
        block = counts["ROTATION:DATA_START"]
        ends.append(BLOCK * (block - 1) + n_frames * n_rotations * ROTATION_BYTES)
    if not all(map(math.isfinite, ends)):
        raise IndexError(ends)
    return max(ends)


def _count_samples(counts: dict[str, float], group: str) -> float:
    """Return how many samples of channels or rotations a frame has."""
    n_channels = counts.get(f"{group}:USED", 0)
    ratio = counts.get(f"{group}:RATE", 0) / (counts["POINT:RATE"] or math.inf)
    ratio = counts.get(f"{group}:RATIO", ratio)
    if not n_channels and ratio > MAX_RATIO:
        raise IndexError(ratio)
    return n_channels * max(ratio, 1)
