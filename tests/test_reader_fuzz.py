"""Damage to files of markers and angles: read as it was, or refused with its place."""

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sklearn_koopman.datasets import load_angles, load_markers

N_FRAMES = 6
FRAMES = np.arange(N_FRAMES)
# All numbers differ and have two digits behind the point.
HIP = 910.25 + 10.0 * np.arange(3) + 1.25 * FRAMES[:, np.newaxis]
KNEE = HIP - 450.5
SURE = np.full(N_FRAMES, 0.99)
# Warnings of a head that counts other frames, markers or rows than there are.
COUNTS = r"(NumFrames|NumMarkers|NO_OF_\w+|nRows).* is .*, but the file |rate=100 is "


@dataclass
class Sample:
    """A valid text of one format, and what it holds."""

    head: str
    columns: list
    right: dict  # the columns of each name
    delimiter: str = "\t"
    name: str = "trial.txt"
    options: dict = field(default_factory=lambda: {"rate": 100, "unit": "mm"})
    has_clock: bool = True
    reader: object = load_markers

    @property
    def lines(self):
        fields = np.column_stack([np.asarray(c, dtype=object) for c in self.columns])
        rows = [self.delimiter.join(map(str, row)) for row in fields]
        return [*self.head.splitlines(), *rows]

    @property
    def n_head(self):
        return len(self.head.splitlines())

    def read(self, content, **options):
        """Return the columns of each name, and the time."""
        with TemporaryDirectory() as folder, warnings.catch_warnings():
            path = Path(folder) / self.name
            path.write_bytes(content)
            warnings.filterwarnings("ignore", COUNTS)
            try:
                data = self.reader(path, **options)
            except ValueError as error:
                where, _, reason = str(error).partition(": ")
                if where != str(path):
                    raise
                raise Refused(reason) from error
        if self.reader is load_angles:
            angles = np.degrees(data.angles)
            return dict(zip(data.names, angles.T, strict=True)), data.time
        return data.markers, data.time


class Refused(Exception):
    """A file that was refused, for the reason that follows its path."""


MARKERS = {"Hip": HIP, "Knee": KNEE}
TIME = np.round(FRAMES / 100, 3)
POSES = {"hip": HIP[:, :2], "knee": KNEE[:, :2]}
POSE_COLUMNS = [FRAMES, HIP[:, :2], SURE, KNEE[:, :2], SURE]
SAMPLES = {
    "TRC": Sample(
        "PathFileType\t4\t(X/Y/Z)\ta.trc\n"
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n"
        "100\t100\t6\t2\tmm\n"
        "Frame#\tTime\tHip\t\t\tKnee\t\t\n"
        "\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n",
        [FRAMES + 1, TIME, HIP, KNEE],
        MARKERS,
        name="trial.trc",
    ),
    "Qualisys": Sample(
        "NO_OF_FRAMES\t6\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t2\nFREQUENCY\t100\n"
        "DATA_INCLUDED\t3D\nMARKER_NAMES\tHip\tKnee\n",
        [HIP, KNEE],
        MARKERS,
        name="trial.tsv",
        has_clock=False,
    ),
    "Qualisys with a clock": Sample(
        "NO_OF_FRAMES\t6\nNO_OF_MARKERS\t2\nFREQUENCY\t100\nMARKER_NAMES\tHip\tKnee\n"
        "Frame\tTime\tHip X\tHip Y\tHip Z\tKnee X\tKnee Y\tKnee Z\n",
        [FRAMES + 1, TIME, HIP, KNEE],
        MARKERS,
        name="trial.tsv",
    ),
    "Vicon": Sample(
        "Trajectories\n100\n,,S1:Hip,,,S1:Knee,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n"
        ",,mm,mm,mm,mm,mm,mm\n",
        [FRAMES + 1, 0 * FRAMES, HIP, KNEE],
        MARKERS,
        delimiter=",",
        name="trial.csv",
    ),
    "Visual3D": Sample(
        "".join(
            "\t" + "\t".join([text] * 6) + "\n" for text in ("walk.c3d", "TARGET", "O")
        ).replace("TARGET", "Hip\tHip\tHip\tKnee\tKnee\tKnee\n\tTARGET", 1)
        + "ITEM\tX\tY\tZ\tX\tY\tZ\n",
        [FRAMES + 1, HIP, KNEE],
        MARKERS,
    ),
    "DeepLabCut": Sample(
        "scorer,n,n,n,n,n,n\nbodyparts,hip,hip,hip,knee,knee,knee\n"
        "coords,x,y,likelihood,x,y,likelihood\n",
        POSE_COLUMNS,
        POSES,
        delimiter=",",
        name="trial.csv",
    ),
    "DeepLabCut of several": Sample(
        "scorer,n,n,n,n,n,n\nindividuals,a,a,a,b,b,b\nbodyparts,hip,hip,hip,hip,hip,hip"
        "\ncoords,x,y,likelihood,x,y,likelihood\n",
        POSE_COLUMNS,
        {"a:hip": POSES["hip"], "b:hip": POSES["knee"]},
        delimiter=",",
        name="trial.csv",
        options={"rate": 100, "unit": "mm", "markers": ["a:hip", "b:hip"]},
    ),
    "tab-separated": Sample(
        "Time\tHipX\tHipY\tHipZ\tKneeX\tKneeY\tKneeZ\n", [FRAMES, HIP, KNEE], MARKERS
    ),
    "storage": Sample(
        "Coordinates\nversion=1\nnRows=6\nnColumns=3\ninDegrees=yes\nendheader\n"
        "time\tflexion\trotation\n",
        [TIME, HIP[:, 0], KNEE[:, 0]],
        {"flexion": HIP[:, 0], "rotation": KNEE[:, 0]},
        name="trial.mot",
        options={"unit": "degrees"},
        reader=load_angles,
    ),
}
samples = pytest.mark.parametrize("sample", SAMPLES.values(), ids=SAMPLES)
with_clock = pytest.mark.parametrize(
    "sample",
    [sample for sample in SAMPLES.values() if sample.has_clock],
    ids=[name for name, sample in SAMPLES.items() if sample.has_clock],
)


def join(lines):
    return "".join(line + "\n" for line in lines).encode()


def test_nothing_is_damaged_at_first():
    for sample in SAMPLES.values():
        markers, time = sample.read(join(sample.lines), **sample.options)
        assert list(markers) == list(sample.right)
        for name, right in sample.right.items():
            np.testing.assert_allclose(markers[name], right, rtol=1e-15)
        np.testing.assert_allclose(time, FRAMES / 100, rtol=1e-15)


def refusal(sample, lines):
    with pytest.raises(Refused) as info:
        sample.read(join(lines), **sample.options)
    return str(info.value)


def names_line(message, place):
    """Whether a message begins with the line at a place of a file."""
    return message.startswith(f"line {place + 1}: ")


def some_rows(sample):
    """Places of the first frame, one in the middle and the last one."""
    return sample.n_head, sample.n_head + 3, len(sample.lines) - 1


def change_cell(sample, place, cell, change):
    """Return the lines of a sample; `change` returns fields in the place of one."""
    lines = sample.lines
    fields = lines[place].split(sample.delimiter)
    fields[cell : cell + 1] = change(fields[cell])
    lines[place] = sample.delimiter.join(fields)
    return lines


def n_cells(sample, place):
    return len(sample.lines[place].split(sample.delimiter))


def drop(field):
    return []


def double(field):
    return [field, field]


def empty(field):
    return [""]


@samples
@pytest.mark.parametrize("change", [drop, double])
def test_a_dropped_or_doubled_cell_is_told(sample, change):
    for row in some_rows(sample):
        for cell in range(n_cells(sample, row)):
            lines = change_cell(sample, row, cell, change)
            assert names_line(refusal(sample, lines), row)


@with_clock
@pytest.mark.parametrize("order", [[0, 0, 1], [1], [1, 0]])
def test_a_doubled_dropped_or_swapped_line_is_told(sample, order):
    for row in range(sample.n_head + 1, len(sample.lines) - 1):
        lines = sample.lines
        lines[row : row + 2] = [lines[row + i] for i in order]
        # The first line that does not follow on the one before.
        assert names_line(refusal(sample, lines), row + (order == [0, 0, 1]))


@samples
@pytest.mark.parametrize("other", [" ", ";", ":", "x"])
def test_another_delimiter_is_told(sample, other):
    for row in some_rows(sample):
        for cell in range(n_cells(sample, row) - 1):
            lines = sample.lines
            fields = lines[row].split(sample.delimiter)
            fields[cell : cell + 2] = [other.join(fields[cell : cell + 2])]
            lines[row] = sample.delimiter.join(fields)
            assert names_line(refusal(sample, lines), row)


@samples
@pytest.mark.parametrize("wrong", ["x", "_1", "1.", "-", "\0", "é"])
def test_a_number_that_is_none_is_told(sample, wrong):
    # The last column is that of a likelihood in some formats, the last but one is not.
    for row in some_rows(sample):
        lines = change_cell(
            sample, row, -2, lambda field: [field.replace(".", f".{wrong}")]
        )
        assert names_line(refusal(sample, lines), row)


@samples
def test_a_file_that_was_cut_loses_its_end_alone(sample):
    text, n_head = join(sample.lines), sample.n_head
    for end in range(len(join(sample.lines[: n_head + 4])), len(text)):
        *rows, rest = text[:end].decode().split("\n")[n_head:]
        if rest.count(sample.delimiter) < n_cells(sample, n_head) - 1 and rest:
            lines = text[:end].decode().split("\n")
            assert names_line(refusal(sample, lines), len(lines) - 1)
            continue
        if rest.endswith(sample.delimiter):  # the last number is a gap
            continue
        # It may have lost its last digits, which nothing tells.
        markers, time = sample.read(text[:end], **sample.options)
        assert len(time) == len(rows) + bool(rest)
        for name, right in sample.right.items():
            same = slice(len(rows))
            np.testing.assert_allclose(markers[name][same], right[same], rtol=1e-15)


def check_names(sample, content, options):
    """Check that a file is refused, or its columns have their own names."""
    try:
        markers, time = sample.read(content, **options)
    except Refused:
        return
    np.testing.assert_allclose(time, FRAMES / 100, rtol=1e-15)
    known = {name for name in markers if name in sample.right}
    for name in known:
        np.testing.assert_allclose(markers[name], sample.right[name], rtol=1e-15)
    for name in {*markers} - known:  # a name was damaged, or an individual
        assert any(
            np.allclose(markers[name], right, rtol=1e-15)
            for right in sample.right.values()
        )


@samples
def test_no_marker_comes_under_the_name_of_another(sample):
    for place in range(sample.n_head):
        for cell in range(n_cells(sample, place)):
            for change in (drop, double, empty):
                content = join(change_cell(sample, place, cell, change))
                check_names(sample, content, sample.options)
                check_names(sample, content, {})
        for order in ([0, 0, 1], [1], [1, 0]):
            lines = sample.lines
            if place + 1 == sample.n_head and not sample.has_clock:
                continue  # only a warning tells that a frame was lost
            lines[place : place + 2] = [lines[place + i] for i in order]
            check_names(sample, join(lines), sample.options)
            check_names(sample, join(lines), {})


def cut(data, draw):
    return data[: draw(len(data))]


def take(data, draw):
    start = draw(len(data))
    return data[:start] + data[start + 1 + draw(30) :]


def insert(data, draw):
    start = draw(len(data))
    garbage = bytes(draw(256) for _ in range(1 + draw(8)))
    return data[:start] + garbage + data[start:]


def replace(data, draw):
    start = draw(len(data))
    pool = b"\t,; .:-+eE0159nax_\"'#\r\n\0\xff\xc3"
    return data[:start] + pool[draw(len(pool)) :][:1] + data[start + 1 :]


def turn_lines(data, draw):
    lines = data.split(b"\n")
    first, second = draw(len(lines)), draw(len(lines))
    lines[first] = [lines[second], b"", b"\0" * 9, lines[first] * 2][draw(4)]
    return b"\n".join(lines)


def turn_cells(data, draw):
    parts = data.split([b"\t", b",", b"\n"][draw(3)])
    first, second = draw(len(parts)), draw(len(parts))
    parts[first : first + 1] = [[], [b""], [parts[second]], [parts[first]] * 2][draw(4)]
    return [b"\t", b",", b"\n"][draw(3)].join(parts)


def encode(data, draw):
    text = data.decode(errors="replace")
    return text.encode(["utf-16", "utf-16-le", "utf-8-sig"][draw(3)])


DAMAGE = [cut, take, insert, replace, replace, turn_lines, turn_cells, encode]


def check_any_damage(sample, draw):
    """Damage a file, and check that it is read as something sound, or refused."""
    content = join(sample.lines)
    for _ in range(1 + draw(3)):
        content = DAMAGE[draw(len(DAMAGE))](content + b"\n", draw)
    gaps = {} if sample.reader is load_angles else {"gaps": "nan"}
    for options in (sample.options | gaps, {}):
        try:
            columns, time = sample.read(content, **options)
        except Refused:
            continue
        assert columns
        assert all(columns)
        assert np.isfinite(time).all()
        assert (np.diff(time) > 0).all()
        for values in columns.values():
            assert len(values) == len(time)
            assert not np.isinf(values).any() or sample.reader is load_angles


@samples
@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.data())
def test_any_damage(sample, data):
    check_any_damage(sample, lambda n: data.draw(st.integers(0, max(n - 1, 0))))


@pytest.mark.slow
@samples
def test_much_damage(sample):
    rng = np.random.default_rng(0)
    for _ in range(2000):
        check_any_damage(sample, lambda n: int(rng.integers(max(n, 1))))


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("TRC", "\tHip\t", "\t", "lines 4 and 5: .* 'Knee' does not stand above"),
        ("Vicon", "Hip,,,", "Hip,,", r"lines 3 and 4: 'S1:Knee' stands above \['Z'"),
        ("Vicon", "\n,,mm", "\n,,", "does not say the unit of its positions; pass"),
        ("Vicon", "\n,,mm,mm,mm,mm,mm,mm", "\n,mm", "does not say the unit"),
        (
            "Visual3D",
            "\tHip",
            "",
            r"line 2: .* have the names \['Hip', 'Hip', 'Knee'\]",
        ),
        ("Visual3D", "\tHip\tHip\tHip", "\t\t\t", "no marker 'Hip'"),
        (
            "DeepLabCut of several",
            "individuals,a,a,a,b,b,b\n",
            "",
            r"body part 'hip' has the columns \['x', 'y', 'likelihood', 'x'",
        ),
        ("DeepLabCut", "coords,", "0,", "lines 1 to 4: expected the rows"),
        ("Qualisys", "\tHip", "\t", r"no marker 'Hip'.*holds \['Knee'\]"),
        ("Qualisys", "\t100\n", "\tinf\n", "does not say how many frames"),
        ("Qualisys", "\t100\n", "\tfast\n", "does not say how many frames"),
        ("Qualisys", "\n910.25\t", "\n910.25x", "^line 7: found 5 fields"),
    ],
)
def test_damage_that_was_told_by_nothing(name, old, new, message):
    sample = SAMPLES[name]
    text = join(sample.lines).decode()
    assert old in text
    with pytest.raises(Refused, match=message):
        sample.read(text.replace(old, new, 1).encode(), markers=[*sample.right])


def test_a_colon_at_the_end_of_a_name_belongs_to_it():
    sample = SAMPLES["Vicon"]
    text = join(sample.lines).replace(b"S1:Hip", b"S1:")
    assert list(sample.read(text)[0]) == ["S1:", "Knee"]
