"""The layout of a C3D file, checked before a library in C++ trusts it.

The first block says where the parameters are. They are a chain of records, each of
which says where the next one begins.
"""

import math
import struct
from collections.abc import Iterator

import numpy as np

from ..._utils._typing import Array

BLOCK = 512
# The second byte of every file.
MAGIC = 0x50
INTEL, DEC, MIPS = 84, 85, 86
# Characters, bytes, integers and numbers, by the number of their type.
TYPES = {-1: np.dtype("S1"), 1: np.dtype("u1"), 2: np.dtype("<u2"), 4: np.dtype("<f4")}
ROTATION_BYTES = 68  # a matrix of 4 by 4 numbers and its residual
# ezc3d relies on these bounds,
MAX_DIMENSIONS, MAX_VALUES, MAX_DESCRIPTION = 7, 65_535, 127
MAX_RATIO = 1000  # of the rates of channels and frames
MAX_FRAMES = 65_535
# and on a value of each of these,
FILLED = {
    *("POINT:USED", "POINT:SCALE", "POINT:RATE", "POINT:FRAMES", "POINT:DATA_START"),
    *("ANALOG:USED", "ANALOG:RATE", "ANALOG:GEN_SCALE"),
    *("ROTATION:USED", "ROTATION:RATE", "ROTATION:RATIO", "ROTATION:DATA_START"),
}
# and of these where there are channels, unless Shadow wrote the file.
OF_CHANNELS = {"ANALOG:SCALE", "ANALOG:OFFSET"}
SHADOW = "SHADOW"
NONE = np.array([])


def count_frames(data: bytes) -> int:
    """Return the number of frames; refuse a file that was cut or is damaged.

    ezc3d would crash, never return or take all memory, or read some of the frames.
    """
    try:
        n_bytes, n_frames, frame_bytes = _measure(data, _read_parameters(data))
    except (struct.error, IndexError, KeyError) as error:
        raise ValueError(
            "the file is no C3D, or its parameters are damaged; export it again."
        ) from error
    if len(data) < n_bytes:
        raise ValueError(
            f"the file was cut: its frames end at byte {n_bytes:.0f}, and the file at "
            f"byte {len(data)}; copy or export it again."
        )
    rest = data[BLOCK * math.ceil(n_bytes / BLOCK) :]
    n_more = len(rest) // frame_bytes if rest.strip(b"\0") else 0
    if n_frames + n_more > MAX_FRAMES:
        raise ValueError(
            f"the head counts {n_frames:.0f} frames, and {n_more:.0f} more follow: C3D "
            f"counts to {MAX_FRAMES}, and ezc3d reads no more; export the file in "
            "parts, or in another format."
        )
    return int(n_frames)


def _read_parameters(data: bytes) -> dict[str, Array]:
    """Return the numbers of each parameter, by its full name; none of texts."""
    groups: dict[int, str] = {}
    parameters: dict[tuple[int, str], Array] = {}
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
            parameters[group, name] = _read_numbers(content, processor)
    named = {f"{groups[group]}:{name}": x for (group, name), x in parameters.items()}
    needed = {name for name in FILLED if name in named}
    if named.get("ANALOG:USED", NONE).any() and SHADOW not in groups.values():
        needed |= OF_CHANNELS
    if not all(named.get(name, NONE).size for name in needed):
        raise KeyError(needed)
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


def _read_numbers(content: bytes, processor: int) -> Array:
    """Return the numbers of a parameter; none of a text."""
    kind, n_dimensions = struct.unpack_from("bb", content)
    shape = content[2 : 2 + n_dimensions]
    is_sound = 0 <= n_dimensions <= MAX_DIMENSIONS and (kind > 0 or n_dimensions > 0)
    if not is_sound or math.prod(max(n, 1) for n in shape) > MAX_VALUES:
        raise IndexError(n_dimensions)
    end = 2 + n_dimensions + TYPES[kind].itemsize * math.prod(shape)
    _check_description(content[end:])
    if kind < 0:
        return NONE
    numbers = np.frombuffer(content[2 + n_dimensions : end], TYPES[kind])
    if processor == DEC and kind == 4:  # halves change places, the exponent is 2 more
        halves = numbers.view("<u2").reshape(-1, 2)[:, ::-1]
        numbers = np.ascontiguousarray(halves).view("<f4")[:, 0] / 4
    with np.errstate(invalid="ignore"):  # a NaN that signals is one, too
        return numbers.astype(np.float64)


def _check_description(content: bytes) -> None:
    """Refuse a description that is longer than its record."""
    if content[0] > min(len(content) - 1, MAX_DESCRIPTION):
        raise IndexError(content[0])


def _measure(data: bytes, parameters: dict[str, Array]) -> tuple[float, float, float]:
    """Return where the frames end, their number, and the bytes of points of each."""
    first, last = struct.unpack_from("<HH", data, 6)
    (block,) = struct.unpack_from("<H", data, 16)
    n_frames = parameters["POINT:FRAMES"][0] or last - first + 1
    n_channels = _count_samples(parameters, "ANALOG")
    n_values = 4 * parameters["POINT:USED"][0] + n_channels
    width = 4 if parameters["POINT:SCALE"][0] < 0 else 2
    frame_bytes = max(n_values * width, 1)
    ends = [BLOCK * (block - 1) + n_frames * n_values * width]
    if n_rotations := _count_samples(parameters, "ROTATION"):
        block = parameters["ROTATION:DATA_START"][0]
        ends.append(BLOCK * (block - 1) + n_frames * n_rotations * ROTATION_BYTES)
    if not all(map(math.isfinite, ends)):
        raise IndexError(ends)
    return max(ends), n_frames, frame_bytes


def _count_samples(parameters: dict[str, Array], group: str) -> float:
    """Return how many samples of channels or rotations a frame has."""
    point_rate = float(parameters["POINT:RATE"][0])
    n_channels, rate, ratio = (
        float(parameters.get(f"{group}:{name}", [default])[0])
        for name, default in (("USED", 0), ("RATE", 0), ("RATIO", math.nan))
    )
    if math.isnan(ratio):
        ratio = rate / (point_rate or math.inf)
    if not n_channels and ratio > MAX_RATIO:
        raise IndexError(ratio)
    return n_channels * max(ratio, 1)
