"""Files that are not read here: what they look like, and the lines that bring them in.

Every remedy is Python that a user can paste; ``file`` stands for the path.
"""

import re
from collections.abc import Callable
from typing import NamedTuple

from ._text import SHOWN, File, decode, find_delimiter, is_number, split

HDF5 = b"\x89HDF\r\n\x1a\n"
ZIP = b"PK\x03\x04"
NUMPY = b"\x93NUMPY"
MATLAB = b"MATLAB 5.0 MAT-file"
TEXT_TO_LOOK_AT = 20_000
BLANKS = r"\s+"

MOVEMENT = """
    from movement.io import load_dataset  # pip install movement
    dataset = load_dataset({file}, source_software={software!r})
    trial = markers_from_movement(dataset)"""
POSITIONS = """
    pairs = trajectory_pairs([recording.reshape(len(recording), -1)])"""
EXPORT = """
    # export it as C3D, then
    trial = load_markers(file)"""


# Names of columns that hold no state, but the number or the time of a frame.
CLOCK = re.compile(r"time.*|frame.*|index|sample|t|#|", re.IGNORECASE)


class Foreign(NamedTuple):
    """A format of files that is not read here."""

    name: str
    recognize: Callable[[File], bool]
    remedy: str | Callable[[File], str]


def _begins(*starts: str) -> Callable[[File], bool]:
    return lambda file: file.first_line.startswith(starts)


def _ends(*suffixes: str) -> Callable[[File], bool]:
    return lambda file: file.suffix in suffixes


def _begins_bytes(start: bytes) -> Callable[[File], bool]:
    return lambda file: file.data.startswith(start)


def _look(file: File) -> str:
    return decode(file.data[:TEXT_TO_LOOK_AT])


def _is_storage(file: File) -> bool:
    return re.search(r"^[ \t]*endheader", _look(file), re.MULTILINE) is not None


def _is_table(file: File) -> bool:
    """Whether the file is a line of names and lines of as many numbers."""
    lines = [line for line in file.lines[:3] if line.strip()]
    if len(lines) < 2:
        return False
    delimiter = find_delimiter(lines[0])
    names, numbers = (split(line, delimiter) for line in lines[:2])
    named = [name for name in names if name]
    has_names = len(named) > 1 and not any(map(is_number, named))
    has_numbers = any(map(is_number, filter(None, numbers)))
    return has_names and has_numbers and len(names) == len(numbers)


def _read_table(file: File) -> str:
    """Return the lines that read the columns of a table, but for the clock."""
    head, first = [line for line in file.lines if line.strip()][:2]
    delimiter = find_delimiter(head)
    names, fields = split(head, delimiter), split(first, delimiter)
    places = [
        i
        for i, (name, field) in enumerate(zip(names, fields, strict=True))
        if not CLOCK.fullmatch(name) and is_number(field)
    ] or range(len(names))
    chosen = [names[i] for i in places]
    # pandas keeps blanks around names, and renames those that occur twice.
    raw = [name.strip('"') for name in head.split(delimiter)]
    is_plain = raw == names and len({*names}) == len(names)
    columns = f"[{chosen}]" if is_plain else f".iloc[:, {[*places]}]"
    has_commas = delimiter != "," and "," in first and "." not in first
    options = ', decimal=","' * has_commas
    return f"""
    table = pandas.read_csv(file, sep={delimiter or BLANKS!r}{options})
    states = table{columns}.to_numpy()  # a row a frame
    pairs = trajectory_pairs([states])"""


# The more particular ones first.
FOREIGN = (
    Foreign(
        "OpenSim's storage of angles",
        _is_storage,
        """
    trial = load_angles(file)  # angles are no positions""",
    ),
    Foreign(
        "an archive of NumPy",
        _ends(".npz"),
        """
    trials = load_trials(file)""",
    ),
    Foreign(
        "an array of NumPy",
        _begins_bytes(NUMPY),
        """
    recording = numpy.load(file)  # (n_frames, n_markers, 3), say"""
        + POSITIONS,
    ),
    Foreign(
        "poses of SLEAP",
        lambda file: (
            file.suffix == ".slp"
            or (file.data.startswith(HDF5) and b"track_names" in file.data)
        ),
        MOVEMENT.format(file="file", software="SLEAP"),
    ),
    Foreign(
        "a table of SLEAP",
        _begins("track,frame_idx"),
        """
    # take the .slp that it comes from, or its analysis in HDF5"""
        + MOVEMENT.format(file='"predictions.slp"', software="SLEAP"),
    ),
    Foreign(
        "poses of Anipose",
        lambda file: "_ncams" in file.first_line and "fnum" in file.first_line,
        MOVEMENT.format(file="file", software="Anipose"),
    ),
    Foreign(
        "HDF5, as DeepLabCut writes it",
        _begins_bytes(HDF5),
        MOVEMENT.format(file="file", software="DeepLabCut"),
    ),
    Foreign(
        "arrays of MATLAB",
        lambda file: file.data.startswith(MATLAB) or file.suffix == ".mat",
        """
    arrays = scipy.io.loadmat(file)  # by their names
    recording = arrays["markers"]  # (n_frames, n_markers, 3), say"""
        + POSITIONS,
    ),
    Foreign(
        "a workbook of Excel",
        lambda file: (
            file.suffix in (".xlsx", ".xls", ".ods") or file.data.startswith(ZIP)
        ),
        """
    table = pandas.read_excel(file)
    names = [name for name in table if str(name).lower() not in ("time", "frame")]
    states = table[names].to_numpy()  # a row a frame
    pairs = trajectory_pairs([states])""",
    ),
    Foreign(
        "BVH, a skeleton and its joint angles",
        _begins("HIERARCHY"),
        """
    head, motion = pathlib.Path(file).read_text().split("Frame Time:")
    channels = [x[1:] for x in head.split() if x[1:] in ("position", "rotation")]
    seconds, *lines = motion.strip().splitlines()
    values = numpy.loadtxt(lines, ndmin=2)[:, numpy.array(channels) == "rotation"]
    angles = numpy.unwrap(values, period=360, axis=0)  # degrees, as in CHANNELS
    pairs = trajectory_pairs([angles], rates=1 / float(seconds))""",
    ),
    Foreign("the angles of a skeleton, AMC", _ends(".amc", ".asf"), EXPORT),
    Foreign("a take of MVN", _ends(".mvnx", ".mvn"), EXPORT),
    Foreign(
        "OptiTrack's CSV",
        _begins("Format Version"),
        """
    text = pathlib.Path(file).read_text()
    lines = text[text.index("\\nFrame,") :].splitlines()[2:]
    numbers = numpy.genfromtxt(lines, delimiter=",")  # frame, time, X, Y, Z, ...
    pairs = trajectory_pairs([numbers[:, 2:]], gaps="split")""",
    ),
    Foreign(
        "key points in JSON, as OpenPose writes them",
        lambda file: file.first_line.startswith(("{", "[")),
        """
    files = sorted(pathlib.Path(file).parent.glob("*.json"))  # one a frame
    people = [json.loads(name.read_text())["people"] for name in files]
    poses = {i: p[0]["pose_keypoints_2d"] for i, p in enumerate(people) if p}
    recording = numpy.full((len(files), max(map(len, poses.values()))), numpy.nan)
    recording[[*poses]] = [*poses.values()]
    recording = recording.reshape(len(files), -1, 3)[:, :, :2]  # choose key points
    recording[(recording == 0).all(axis=2)] = numpy.nan  # those that are not seen
    recording = recording.reshape(len(files), -1)
    pairs = trajectory_pairs([recording], gaps="split")""",
    ),
    Foreign("a table of columns with names", _is_table, _read_table),
)


def describe(file: File) -> str:
    """Say what a file looks like, and how to bring it in."""
    for foreign in FOREIGN:
        if foreign.recognize(file):
            remedy = foreign.remedy
            lines = remedy if isinstance(remedy, str) else remedy(file)
            return f"the file looks like {foreign.name}. Bring it in by:{lines}"
    if not file.data.strip():
        return "the file is empty; export it again."
    is_text = b"\0" not in file.data[:TEXT_TO_LOOK_AT]
    begin = f"line 1 is {file.first_line[:SHOWN]!r}" if is_text else "it is not text"
    return (
        f"no known format ({begin}). Bring it in as an array of numbers, a row a "
        "frame:\n    pairs = trajectory_pairs([recording])"
    )
