"""C3D files as several processors and programs write them, and damaged ones."""

import struct
import sys

import numpy as np
import pytest

from sklearn_koopman.datasets import load_markers

ezc3d = pytest.importorskip("ezc3d", reason="C3D is read by ezc3d")

BLOCK = 512
INTEL, DEC, MIPS = 84, 85, 86
# Four frames of two markers in mm; whole numbers are exact in any number format.
POSITIONS = np.array(
    [[[10.0 + k, 900, 80], [150 + k, 480, 85], [7, 8, 9]] for k in range(4)]
)[:, :2]


def floats(values, processor=INTEL):
    """Return numbers of four bytes; those of DEC are IEEE times 4, halves swapped."""
    if processor == MIPS:
        return np.asarray(values, ">f4").tobytes()
    if processor == DEC:
        halves = (4 * np.asarray(values, "<f4")).view("<u2")
        return halves.reshape(-1, 2)[:, ::-1].tobytes()
    return np.asarray(values, "<f4").tobytes()


def record(name, group, content):
    content += b"\0"  # no description
    head = struct.pack("bb", len(name), group) + name.encode()
    return head + struct.pack("<H", len(content) + 2) + content


def parameter(name, group, value, processor):
    """Return a record of an integer, a number, a tuple of them, or a list of texts."""
    if isinstance(value, list):
        width = max(map(len, value), default=0)
        content = struct.pack("bbBB", -1, 2, width, len(value))
        content += "".join(text.ljust(width) for text in value).encode()
    elif isinstance(value, int):
        content = struct.pack("<bbH", 2, 0, value)
    elif isinstance(value, float):
        content = struct.pack("bb", 4, 0) + floats([value], processor)
    else:
        content = struct.pack("bbB", 4, 1, len(value)) + floats(value, processor)
    return record(name, group, content)


def c3d(
    positions=POSITIONS,
    labels=("Hip", "Knee"),
    *,
    residuals=0.0,
    scale=-1.0,
    processor=INTEL,
    first=1,
    point=None,
    analog=None,
    more=b"",
):
    """Return the bytes of a file; a positive scale asks for whole numbers."""
    n_frames, n_points = positions.shape[:2]
    residuals = np.broadcast_to(residuals, (n_frames, n_points))
    point = {
        "USED": n_points,
        "SCALE": scale,
        "RATE": 100.0,
        "DATA_START": 0,
        "FRAMES": n_frames,
        "LABELS": list(labels),
        "UNITS": ["mm"],
    } | (point or {})
    analog = {"USED": 0, "RATE": 100.0, "GEN_SCALE": 1.0, "SCALE": ()} | (analog or {})
    analog = {"LABELS": [], "UNITS": [], "OFFSET": 0} | analog
    records = b""
    for group, section in enumerate([point, analog], 1):
        records += record(["POINT", "ANALOG"][group - 1], -group, b"")
        for name, value in section.items():
            records += parameter(name, group, value, processor)
    records += more
    n_blocks = -(-(len(records) + 5) // BLOCK)
    head = struct.pack("<BB5H", 2, 0x50, n_points, 0, first, first + n_frames - 1, 10)
    head += floats([scale], processor) + struct.pack("<HH", 2 + n_blocks, 0)
    head += floats([point["RATE"]], processor)
    parameters = bytes([1, 0x50, n_blocks, processor]) + records
    if scale < 0:
        data = floats(np.dstack([positions, residuals]), processor)
    else:
        words = np.dstack([np.rint(positions / scale), np.where(residuals < 0, -1, 0)])
        data = words.astype("<i2").tobytes()
    return head.ljust(BLOCK, b"\0") + parameters.ljust(BLOCK * n_blocks, b"\0") + data


CHANNELS = {"USED": 2, "LABELS": ["a", "b"], "SCALE": (1.0, 1.0)}


@pytest.fixture
def write(tmp_path):
    def write(data, name="walk.c3d"):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write


@pytest.mark.parametrize("processor", [INTEL, DEC])
@pytest.mark.parametrize("scale", [-1.0, -0.1, 0.5])
def test_numbers_of_any_format(write, processor, scale):
    residuals = np.zeros((4, 2))
    residuals[2, 1] = -1.0
    path = write(c3d(residuals=residuals, processor=processor, scale=scale))
    trial = load_markers(path, gaps="nan")
    lost = np.array([480.0, 480, np.nan, 480])
    np.testing.assert_array_equal(trial.markers["Hip"], POSITIONS[:, 0])
    np.testing.assert_array_equal(trial.markers["Knee"][:, 1], lost)
    assert np.isnan(trial.markers["Knee"][2]).all()
    assert (trial.rate, trial.unit) == (100.0, "mm")
    with pytest.raises(ValueError, match=r"'Knee' in 1 frames, first in frame 3\."):
        load_markers(path)


def test_numbers_of_mips_are_refused(write):
    with pytest.raises(ValueError, match=r"walk\.c3d: .* MIPS .* save it again"):
        load_markers(write(c3d(processor=MIPS)))


def test_a_coordinate_that_is_no_number_is_a_gap(write):
    positions = POSITIONS.copy()
    positions[1, 0, 2] = np.nan
    positions[3, 1] = 0.0
    path = write(c3d(positions))
    hip, knee = load_markers(path, gaps="nan").markers.values()
    np.testing.assert_array_equal(np.isnan(hip).any(axis=1), [0, 1, 0, 0])
    np.testing.assert_array_equal(np.isnan(knee).all(axis=1), [0, 0, 0, 1])
    kept = load_markers(path, markers=["Knee"], zeros="keep").markers["Knee"]
    np.testing.assert_array_equal(kept, positions[:, 1])


def test_files_that_ezc3d_writes(tmp_path):
    # As all programs that use it do, with more points than a list of names holds.
    names = [f"M{i}" for i in range(300)]
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [50.0]
    content["parameters"]["POINT"]["UNITS"]["value"] = ["m"]
    content["parameters"]["POINT"]["LABELS"]["value"] = names
    points = np.ones((4, 300, 2))
    points[0] = np.arange(300)[:, np.newaxis] / 128
    points[:3, 299, 1] = np.nan
    content["data"]["points"] = points
    path = str(tmp_path / "walk.c3d")
    content.write(path)
    trial = load_markers(path, gaps="nan")
    assert trial.names == names
    assert (trial.rate, trial.unit, trial.filename) == (50.0, "m", path)
    np.testing.assert_array_equal(trial.markers["M298"][:, 0], 298 / 128)
    np.testing.assert_array_equal(trial.markers["M299"][1], np.nan)


def test_time_begins_at_the_first_frame_of_the_file(write):
    residuals = np.array([[0, 0], [0, -1], [0, 0], [0, 0.0]])
    path = write(c3d(first=101, residuals=residuals))
    trial = load_markers(path, markers=["Hip"])
    np.testing.assert_allclose(trial.time, [1.0, 1.01, 1.02, 1.03], rtol=1e-15)
    with pytest.raises(ValueError, match="first in frame 102"):
        load_markers(path)


def test_outputs_of_models_are_no_markers(write):
    groups = ["ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS"]
    labels = ["Anna:Hip", *(f"Anna:{group.title()}" for group in groups), "Knee"]
    outputs = {g: [x] for g, x in zip(groups, labels[1:6], strict=True)}
    positions = POSITIONS[:, [0, 1, 1, 1, 1, 1, 1]]
    trial = load_markers(write(c3d(positions, labels, point=outputs)))
    assert trial.names == ["Hip", "Knee"]
    assert trial.individuals == ["Anna"]
    alone = load_markers(trial.filename, individual="Anna", unit="mm")
    np.testing.assert_array_equal(alone.markers["Hip"], POSITIONS[:, 0])


def test_two_persons(write):
    path = write(c3d(labels=["Anna:Hip", "Ben:Hip"]))
    with pytest.raises(ValueError, match=r"'Anna', 'Ben'.*pass individual"):
        load_markers(path)
    ben = load_markers(path, individual="Ben", unit="mm")
    np.testing.assert_array_equal(ben.markers["Hip"], POSITIONS[:, 1])


def test_points_without_names_are_left_out(write):
    assert load_markers(write(c3d(labels=["Hip"]))).names == ["Hip"]
    assert load_markers(write(c3d(labels=["", "Knee"]))).names == ["Knee"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"point": {"RATE": 0.0}}, "does not say how many frames .* pass rate"),
        ({"point": {"UNITS": []}}, "does not say the unit .* pass unit"),
        ({"point": {"UNITS": [""]}}, "does not say the unit .* pass unit"),
        ({"point": {"UNITS": ["inch"]}}, "in inches: pass unit='mm', .* by 25.4"),
        ({"point": {"UNITS": ["m"]}}, "pass unit='mm'"),
        ({"labels": []}, "no positions of markers"),
        ({"positions": POSITIONS[:, :0], "labels": []}, "no positions of markers"),
        ({"positions": POSITIONS[:0]}, "no frames"),
        ({"labels": ["Hip", "Hip"]}, "2 markers have the name 'Hip'"),
    ],
)
def test_what_a_file_does_not_say(write, options, message):
    path = write(c3d(**options))
    with pytest.raises(ValueError, match=message) as info:
        load_markers(path)
    assert str(info.value).startswith(f"{path}: ")


def test_rate_and_unit_settle_what_a_file_does_not_say(write):
    path = write(c3d(point={"RATE": 0.0, "UNITS": []}))
    trial = load_markers(path, rate=50, unit="cm")
    np.testing.assert_allclose(trial.time, [0, 0.02, 0.04, 0.06], rtol=1e-15)
    assert trial.unit == "cm"


def test_channels_lie_between_the_points(write):
    # Two channels at twice the rate: 2 x 2 numbers after the points of each frame.
    data, n_points = c3d(analog=CHANNELS | {"RATE": 200.0}), 4 * 32
    head, points = data[:-n_points], data[-n_points:]
    frames = [points[i : i + 32] + bytes(16) for i in range(0, n_points, 32)]
    trial = load_markers(write(head + b"".join(frames)))
    np.testing.assert_array_equal(trial.markers["Knee"], POSITIONS[:, 1])
    with pytest.raises(ValueError, match="the file was cut"):
        load_markers(write(head + b"".join(frames)[:-1]))


def test_files_of_shadow_have_no_scales_of_channels(write):
    data = c3d(analog=CHANNELS | {"SCALE": ()}, more=record("SHADOW", -3, b""))
    data += bytes(64)
    assert load_markers(write(data), gaps="nan").names == ["Hip", "Knee"]


def test_a_file_is_recognised_by_its_bytes(write):
    path = write(c3d(), name="walk.dat")
    np.testing.assert_array_equal(load_markers(path).markers["Hip"], POSITIONS[:, 0])


def test_without_ezc3d_the_message_says_what_to_install(write, monkeypatch):
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    path = write(c3d())
    with pytest.raises(ImportError, match=r"pip install ezc3d, or with .*\[c3d\]"):
        load_markers(path)


def test_a_file_that_was_cut_is_refused(write):
    data = c3d()
    for end in (0, 1, 2, 511, 513, 600, 700, len(data) - 128, len(data) - 1):
        with pytest.raises(ValueError, match=r"walk\.c3d: "):
            load_markers(write(data[:end]))


def damage(old, new, data=None):
    data = data or c3d()
    assert data.count(old) == 1
    return data.replace(old, new)


@pytest.mark.parametrize(
    "data",
    [
        # ezc3d 1.7.2 crashes on these, takes all memory or reads a part.
        c3d(point={"SCALE": ()}),
        c3d(point={"USED": ()}),
        damage(b"UNITS\x09\0\xff\x02\x02\x01", b"UNITS\x09\0\xff\x00\x02\x01"),
        damage(b"UNITS\x09\0\xff\x02\x02\x01", b"UNITS\x09\0\xff\x02\xff\xff"),
        damage(b"LABELS\x0f\0\xff\x02\x04\x02", b"LABELS\x0f\0\xff\x09\x04\x02"),
        damage(b"mm\0", b"mm\xff"),
        c3d(analog={"USED": 2, "SCALE": ()}) + bytes(64),
        damage(b"OFFSET", b"OFFSEX", c3d(analog=CHANNELS) + bytes(64)),
        damage(b"POINT\x03\0\0", b"POINT\x03\0\xff"),
        c3d(analog={"USED": 65_000, "RATE": 1e9}),
        c3d(analog={"USED": 1, "RATE": np.inf}),
        c3d(analog={"USED": 0, "RATE": 1e9}),
        c3d(point={"USED": 65_535}),
        c3d(point={"FRAMES": 65_535}),
        c3d(point={"FRAMES": 60_000, "USED": 60_000}),
        # It refuses these, but for the last one.
        b"Po",
        b"\2P" + 2000 * b"\xff",
        b"\2P" + bytes(2000),
        c3d()[:512] + bytes(2000),
        b"text, which is named .c3d\n" * 100,
        damage(b"USED\7\0\2\0\2", b"USEX\7\0\2\0\2"),
    ],
)
def test_damage_is_refused_before_it_crashes(write, data):
    path = write(data)
    with pytest.raises(ValueError, match=r"damaged|cut") as info:
        load_markers(path)
    assert str(info.value).startswith(f"{path}: ")


@pytest.mark.parametrize("counted", [65_535, 70_000 - 65_536])
def test_more_frames_than_a_head_counts_are_refused(write, counted):
    positions = np.resize(POSITIONS[:, :1], (70_000, 1, 3))
    frames = floats(np.dstack([positions, np.zeros((70_000, 1))]))
    data = c3d(positions[:counted], ["Hip"])
    whole = data[: -16 * counted] + frames
    with pytest.raises(ValueError, match=rf"counts {counted} frames, and .* in parts"):
        load_markers(write(whole))
    # Blocks are filled up by zeros.
    assert len(load_markers(write(data + bytes(2000))).time) == counted


def test_a_number_that_signals_its_damage_does_not_warn(write):
    scale = b"GEN_SCALE\x09\0\x04\0"
    data = damage(scale + floats([1.0]), scale + b"\1\0\x80\x7f")
    assert load_markers(write(data)).names == ["Hip", "Knee"]
