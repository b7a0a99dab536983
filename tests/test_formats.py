"""Files of markers and angles as many programs write them, with known numbers."""

import io
import json
import pathlib
import re
import textwrap

import numpy as np
import pytest
import scipy.io
from conftest import DATA
from numpy.testing import assert_allclose, assert_array_equal

import sklearn_koopman
from sklearn_koopman.datasets import load_angles, load_markers
from sklearn_koopman.datasets._formats import FORMATS
from sklearn_koopman.kinematics import fill_gaps

N_FRAMES = 4
FRAMES = np.arange(N_FRAMES)
HIP = np.column_stack([10.5 + FRAMES, np.full(4, 900.25), np.full(4, 80.1)])
KNEE = np.column_stack([150.5 + FRAMES, np.full(4, 480.5), np.full(4, 80.2)])


@pytest.fixture
def write(tmp_path):
    def write_file(content, name="trial.trc"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


def rows(*columns):
    """Lines of these columns, separated by tabs."""
    table = np.column_stack([np.asarray(c, dtype=object) for c in columns])
    return "".join("\t".join(map(str, line)) + "\n" for line in table)


BODY = rows(1 + FRAMES, FRAMES / 100, HIP, KNEE)
HEAD = [
    "PathFileType\t4\t(X/Y/Z)\tgait.trc",
    "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate",
    "100\t100\t4\t2\tmm\t100",
    "Frame#\tTime\tHip\t\t\tKnee\t\t",
    "\t\tX1\tY1\tZ1\tX2\tY2\tZ2",
    "",
    "",
]
TRC = "\n".join(HEAD) + BODY


def changed(old, new, text=TRC):
    assert old in text
    return text.replace(old, new, 1)


def check(data, *, rate=100.0, unit="mm", rtol=0.0):
    assert data.names == list(data.markers) == ["Hip", "Knee"]
    assert_allclose(data.markers["Hip"], HIP, rtol=rtol, atol=0)
    assert_allclose(data.markers["Knee"], KNEE, rtol=rtol, atol=0)
    assert_allclose(data.time, FRAMES / rate, rtol=1e-14)
    assert (data.rate, data.unit) == (rate, unit)


# --- TRC ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "content",
    {
        "plain": TRC,
        "byte order mark": "\ufeff" + TRC,
        "lines end in CR LF": TRC.replace("\n", "\r\n"),
        "lines end in CR": TRC.replace("\n", "\r"),
        "lines end in CR CR LF": TRC.replace("\n", "\r\r\n"),
        "UTF-16 with a mark": TRC.encode("utf-16"),
        "UTF-16 without, little-endian": TRC.encode("utf-16-le"),
        "UTF-16 without, big-endian": TRC.encode("utf-16-be"),
        "Western code page": changed("gait.trc", "gehen für Ö.trc").encode("cp1252"),
        "values with empty fields between": changed(
            "100\t100\t4\t2\tmm\t100", "100\t\t100\t\t4\t\t2\t\tmm\t\t100\t"
        ),
        "an empty field before the names": changed(
            "Time\tHip\t\t\tKnee\t\t\n\t\tX1", "Time\t\tHip\t\t\tKnee\t\t\n\t\t\tX1"
        ),
        "axes that are not numbered from 1": changed(
            "X1\tY1\tZ1\tX2\tY2\tZ2", "X5\tY5\tZ5\tX6\tY6\tZ6"
        ),
        "axes without numbers": changed("X1\tY1\tZ1\tX2\tY2\tZ2", "X\tY\tZ\tX\tY\tZ"),
        "no line of axes": changed("\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n", ""),
        "no blank line": changed("\n\n", "\n"),
        "a comment at the end": TRC + "exported by the lab\n",
        "a comment with a number": changed("\n2\t", "\nno. 2 follows, by hand\n2\t"),
        "a person before the names": TRC.replace("Hip", "S1:Hip").replace(
            "Knee", "S1:Knee"
        ),
        "decimal commas": "\n".join(HEAD) + BODY.replace(".", ","),
        "commas": TRC.replace("\t", ","),
        "semicolons and decimal commas": "\n".join(HEAD).replace("\t", ";")
        + BODY.replace(".", ",").replace("\t", ";"),
        "blanks": re.sub(r"\t+", "  ", TRC),
        "rows in blanks": "\n".join(HEAD) + BODY.replace("\t", "  "),
        "rows in blanks with decimal commas": "\n".join(HEAD)
        + BODY.replace("\t", " ").replace(".", ","),
        "rows in commas": "\n".join(HEAD) + BODY.replace("\t", ","),
        "quotes": TRC.replace("Hip", '"Hip"').replace("Knee", '"Knee"'),
        "no rate": changed("\n100\t", "\n\t"),
        "no counts": changed("NumFrames\tNumMarkers\tUnits", "Frames\tMarkers\tUnits"),
        "columns without a name": "\n".join(HEAD)
        .replace("Hip\t\t\tKnee\t\t", "Hip\t\t\t\t\t\tKnee\t\t")
        .replace("X2\tY2\tZ2", "X2\tY2\tZ2\tX3\tY3\tZ3")
        + rows(1 + FRAMES, FRAMES / 100, HIP, np.tile([7, 8, 9], (4, 1)), KNEE),
        "virtual markers without columns": changed(
            "\tKnee\t\t\n", "\tKnee\t\t\tV_Ankle\t\t\tV_Ankle\n"
        ),
        "axes in another order": changed(
            "X1\tY1\tZ1\tX2\tY2\tZ2", "Z1\tY1\tX1\tX2\tY2\tZ2"
        ).replace(BODY, rows(1 + FRAMES, FRAMES / 100, HIP[:, ::-1], KNEE)),
    }.items(),
    ids=lambda item: item[0],
)
def test_trc_as_programs_write_it(write, content):
    check(load_markers(write(content[1])))


def test_a_first_frame_without_its_last_marker_hides_no_columns(write):
    text = changed("\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n", "")
    text = changed("\t150.5\t480.5\t80.2", "\t\t\t", text)
    knee = load_markers(write(text), gaps="nan").markers["Knee"]
    assert_array_equal(np.isnan(knee[:, 0]), FRAMES == 0)
    assert_array_equal(knee[1:], KNEE[1:])


@pytest.mark.parametrize("mark", ["", " ", ".", "_"])
def test_tab_separated_names_and_axes(write, mark):
    head = "Time" + "".join(f"\tR {n}{mark}{a}" for n in ("Hip", "Knee") for a in "XYZ")
    path = write(f"{head}\n" + rows(FRAMES, HIP, KNEE), "trial.txt")
    data = load_markers(path, rate=100)
    assert data.names == ["R Hip", "R Knee"]
    assert_array_equal(data.markers["R Knee"], KNEE)


def test_names_of_persons(write):
    text = TRC.replace("Hip", "S1:Hip").replace("Knee", "S1:Knee")
    path = write(text)
    assert load_markers(path).individuals == ["S1"]
    check(load_markers(path, markers=["Hip", "Knee"], individual="S1"))
    data = load_markers(path, markers=["S1:Knee", "Hip"])
    assert data.names == list(data.markers) == ["S1:Knee", "Hip"]
    assert_array_equal(data.markers["S1:Knee"], KNEE)
    with pytest.raises(ValueError, match=r"individual='S2', but .* \['S1'\]"):
        load_markers(path, individual="S2")
    path = write(TRC)
    assert "individuals" not in load_markers(path)
    with pytest.raises(ValueError, match=r"names no individuals; leave individual"):
        load_markers(path, individual="S2")
    # A hip with a person, and one without.
    for first, second in (("S1:Hip", "Hip"), ("Hip", "S1:Hip")):
        path = write(TRC.replace("Knee", second).replace("\tHip", f"\t{first}", 1))
        with pytest.raises(ValueError, match=r"\['S1'\]; pass individual, .*'S1'"):
            load_markers(path)
        data = load_markers(path, markers=[first, second])
        assert_array_equal(data.markers[first], HIP)
        assert_array_equal(data.markers[second], KNEE)
    # Two people with a hip each.
    path = write(TRC.replace("Hip", "S1:Hip").replace("Knee", "S2:Hip"))
    with pytest.raises(ValueError, match=r"\['S1', 'S2'\]; pass individual, .*'S1'"):
        load_markers(path)
    with pytest.raises(ValueError, match=r"individuals \['S1', 'S2'\].*'S1:Hip'"):
        load_markers(path, markers=["Hip"])
    assert_array_equal(load_markers(path, individual="S2").markers["Hip"], KNEE)
    data = load_markers(path, markers=["S2:Hip", "S1:Hip"])
    assert_array_equal(data.markers["S1:Hip"], HIP)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\t4\t2\tmm", "\t900\t2\tmm", r"NumFrames in line 3 is 900, .* holds 4,"),
        ("\t4\t2\tmm", "\t3\t2\tmm", r"NumFrames in line 3 is 3, .* holds 4,"),
        ("\t4\t2\tmm", "\t4\t5\tmm", r"NumMarkers in line 3 is 5, .* holds 2,"),
    ],
)
def test_counts_that_nothing_depends_on_warn(write, old, new, message):
    with pytest.warns(UserWarning, match=message):
        data = load_markers(write(changed(old, new)))
    check(data)


@pytest.mark.parametrize("spelled", ["m", "meters", "Metres", "METER"])
def test_metres_are_spelled_in_many_ways(write, spelled):
    text = "\n".join(HEAD).replace("\tmm\t", f"\t{spelled}\t")
    path = write(text + rows(1 + FRAMES, FRAMES / 100, HIP / 1000, KNEE / 1000))
    data = load_markers(path)
    assert data.unit == "m"
    assert_array_equal(data.markers["Knee"], KNEE / 1000)


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ("in", r"in inches: pass unit='mm', and multiply the positions by 25\.4\."),
        ("Inches", r"in inches: pass unit='mm', and multiply the positions by 25\.4\."),
        ("ft", r"in feet: pass unit='mm', and multiply .* by 304\.8\."),
        ("dm", r"in decimetres: pass unit='mm', and multiply .* by 100\."),
        ("\N{MICRO SIGN}m", r"in micrometres: pass unit='mm', and .* by 0\.001\."),
        ("micrometres", r"in micrometres: pass unit='mm', and .* by 0\.001\."),
        ("px", "unit='px', but"),
    ],
)
def test_other_units_say_how_to_convert(write, unit, message):
    options = {"unit": "px"} if unit == "px" else {}
    unit = unit.replace("px", "mm")
    with pytest.raises(ValueError, match=message):
        load_markers(write(changed("\tmm\t", f"\t{unit}\t")), **options)


def test_thousands_are_not_taken_for_decimals(write):
    text = "\n".join(HEAD) + BODY.replace("900.25", "1,900.25")
    with pytest.raises(ValueError, match=r"trial.trc: line 7: '1,900.25' in .*HipY"):
        load_markers(write(text))


@pytest.mark.parametrize("rate", ["100,00", "100.0", "1e2", "100,"])
def test_rates_with_decimal_commas(write, rate):
    text = TRC.replace("\n100\t", f"\n{rate}\t").replace("\t4\t2\t", "\t4,0\t2,0\t")
    data = load_markers(write(text))
    assert data.rate == 100.0


def test_thousands_are_no_rate(write):
    text = QUALISYS.replace("\t120", "\t1,200") + rows(HIP, KNEE)
    with pytest.raises(ValueError, match="does not say how many frames"):
        load_markers(write(text, "trial.tsv"))


@pytest.mark.parametrize(
    "spelled", ["na", "NA", "#N/A", "NoData", "-1.#IND", "1.#QNAN", "NaN", "null"]
)
def test_spellings_of_what_is_missing(write, spelled):
    text = changed("\t12.5\t", f"\t{spelled}\t")
    hip = load_markers(write(text), gaps="nan").markers["Hip"]
    assert_array_equal(np.isnan(hip[:, 0]), FRAMES == 2)


def test_python_spellings_are_no_numbers(write):
    with pytest.raises(ValueError, match=r"line 7: '1_0.5' in column 'HipX'"):
        load_markers(write(changed("\t10.5\t", "\t1_0.5\t")))


# --- gaps, zeros, likelihoods -------------------------------------------------------

LOST = "0\t0\t0"


def test_zeros_are_gaps_unless_kept(write):
    path = write(changed("152.5\t480.5\t80.2", LOST))
    message = r"'Knee' in 1 frames, first in line 9\. 1 of them .* zeros='keep'"
    with pytest.raises(ValueError, match=message):
        load_markers(path)
    data = load_markers(path, gaps="nan")
    assert_array_equal(
        np.isnan(data.markers["Knee"]), (FRAMES == 2)[:, None] | [[0] * 3]
    )
    filled, frames = fill_gaps(data.markers, max_gap=1)
    assert_array_equal(frames, [2])
    assert_allclose(filled["Knee"], KNEE, rtol=1e-14)
    kept = load_markers(path, zeros="keep").markers["Knee"]
    assert_array_equal(kept[2], [0, 0, 0])
    # A coordinate of zero is a place like any other.
    data = load_markers(write(changed("152.5\t480.5\t80.2", "0\t480.5\t0")))
    assert_array_equal(data.markers["Knee"][2], [0, 480.5, 0])
    # Markers that are not read may be lost.
    check_only = load_markers(path, markers=["Hip"])
    assert_array_equal(check_only.markers["Hip"], HIP)


@pytest.mark.parametrize("number", ["9999", "-99999", "9999999.0", "9.999E+03"])
def test_nines_are_gaps_unless_kept(write, number):
    path = write(changed("152.5\t480.5\t80.2", "\t".join([number] * 3)))
    place = f"{float(number):.0f}"
    message = rf"1 of them stand at exactly {place}, {place}, {place}; zeros='keep'"
    with pytest.raises(ValueError, match=message):
        load_markers(path)
    knee = load_markers(path, gaps="nan").markers["Knee"]
    assert_array_equal(np.isnan(knee), (FRAMES == 2)[:, None] | [[False] * 3])
    kept = load_markers(path, zeros="keep", unit="mm").markers["Knee"]
    assert_array_equal(kept[2], [float(number)] * 3)


@pytest.mark.parametrize("place", ["999\t999\t999", "9999\t9999\t999", "98\t98\t98"])
def test_other_places_are_no_gaps(write, place):
    knee = load_markers(write(changed("152.5\t480.5\t80.2", place)), unit="mm")
    assert_array_equal(knee.markers["Knee"][2], np.array(place.split(), dtype=float))


def test_zeros_do_not_change_the_size_of_the_body(write):
    # Two of four frames at the origin would make a body of more than 900 mm: in
    # decimetres, a unit of metres would be nearer to it than the true one.
    text = TRC.replace("\tmm\t", "\tcm\t")
    small = rows(1 + FRAMES, FRAMES / 100, HIP / 10, KNEE / 10)
    data = load_markers(write(text.replace(BODY, small)))
    assert data.unit == "cm"


DLC = """\
scorer,net,net,net,net,net,net
bodyparts,Hip,Hip,Hip,Knee,Knee,Knee
coords,x,y,likelihood,x,y,likelihood
0,100.5,200.1,0.99,120.5,260.4,0.98
1,101.5,200.1,0.99,121.5,260.4,0.98
2,102.5,200.1,0.99,122.5,260.4,0.2
3,103.5,200.1,0.99,123.5,260.4,0.98
"""
TWO = """\
scorer,net,net,net,net,net,net
individuals,a,a,a,b,b,b
bodyparts,Hip,Hip,Hip,Hip,Hip,Hip
coords,x,y,likelihood,x,y,likelihood
0,100.5,200.1,0.99,120.5,260.4,0.98
1,101.5,200.1,0.99,,,
2,102.5,200.1,0.99,122.5,260.4,0.98
"""


def test_deeplabcut(write):
    path = write(DLC, "dlc.csv")
    with pytest.raises(ValueError, match=r"dlc.csv: .* does not say how many .* rate"):
        load_markers(path)
    data = load_markers(path, rate=50)
    x = 100.5 + FRAMES
    assert_array_equal(data.markers["Hip"], np.column_stack([x, [200.1] * 4]))
    assert_array_equal(data.markers["Knee"], np.column_stack([x + 20, [260.4] * 4]))
    assert_array_equal(data.likelihood["Knee"], [0.98, 0.98, 0.2, 0.98])
    assert_array_equal(data.time, FRAMES / 50)
    assert data.unit == "px"
    assert load_markers(path, rate=50, unit="mm").unit == "mm"
    assert load_markers(path, rate=50, unit="px").unit == "px"
    with pytest.raises(
        ValueError, match=r"line 6\. 1 of them have a likelihood below 0\.6"
    ):
        load_markers(path, rate=50, min_likelihood=0.6)
    knee = load_markers(path, rate=50, min_likelihood=0.6, gaps="nan").markers["Knee"]
    assert_array_equal(np.isnan(knee), (FRAMES == 2)[:, np.newaxis] | [[False] * 2])
    negative = changed("0.2\n", "-1\n", DLC).replace("120.5,260.4", "0,0")
    with pytest.raises(
        ValueError,
        match=r"'Knee' in 2 .* 1 of them .* exactly 0, 0; .* 1 of them .* below 0,",
    ):
        load_markers(write(negative, "other.csv"), rate=50)
    lost = load_markers(write(negative, "other.csv"), rate=50, gaps="nan")
    assert_array_equal(np.isnan(lost.markers["Knee"][:, 0]), [1, 0, 1, 0])
    kept = load_markers(path, rate=50, min_likelihood=0.2)
    assert not np.isnan(kept.markers["Knee"]).any()


def test_deeplabcut_with_three_coordinates_and_without_likelihood(write):
    text = DLC.replace("likelihood", "z")
    with pytest.raises(ValueError, match=r"does not say the unit of .*; pass unit"):
        load_markers(write(text, "dlc.csv"), rate=50)
    data = load_markers(write(text, "dlc.csv"), rate=50, unit="mm")
    assert_array_equal(data.markers["Knee"][2], [122.5, 260.4, 0.2])
    assert "likelihood" not in data
    with pytest.raises(ValueError, match=r"min_likelihood=0.5, but the file holds no"):
        load_markers(write(text, "dlc.csv"), rate=50, unit="mm", min_likelihood=0.5)


def test_deeplabcut_in_quotes_and_with_sets_of_frames(write):
    lines = DLC.splitlines()
    more = [",set", ",set", ",", *[",train"] * 4]
    text = "\n".join(x + y for x, y in zip(lines, more, strict=True))
    text = text.replace("scorer", '"scorer"').replace("bodyparts", '"bodyparts"')
    data = load_markers(write(text, "dlc.csv"), rate=50)
    assert data.names == ["Hip", "Knee"]
    assert_array_equal(data.markers["Knee"][:, 0], 120.5 + FRAMES)


def test_deeplabcut_of_several_animals(write):
    path = write(TWO, "dlc.csv")
    with pytest.raises(ValueError, match=r"individuals \['a', 'b'\]; pass individual"):
        load_markers(path, rate=50)
    data = load_markers(path, rate=50, individual="a")
    assert_array_equal(data.markers["Hip"][:, 0], [100.5, 101.5, 102.5])
    assert data.individuals == ["a", "b"]
    with pytest.raises(ValueError, match=r"'Hip' in 1 frames, first in line 6\."):
        load_markers(path, rate=50, individual="b")
    hip = load_markers(path, rate=50, individual="b", gaps="nan").markers["Hip"]
    assert_array_equal(hip, [[120.5, 260.4], [np.nan] * 2, [122.5, 260.4]])
    both = load_markers(path, rate=50, markers=["b:Hip", "a:Hip"], gaps="nan")
    assert_array_equal(both.markers["b:Hip"], hip)
    with pytest.raises(ValueError, match=r"individual='c', but .* \['a', 'b'\]"):
        load_markers(path, rate=50, individual="c")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\n0,", "\nlabeled-data/img000.png,", r"line 4: found 'labeled.*no recording"),
        ("\n3,", "\n2,", r"line 7: frame goes from 2 to 2"),
        ("Knee,Knee,Knee", "Knee,Knee", r"expected the rows 'scorer', .* same length"),
        ("coords,x,y", "coords,x,x", r"body part 'Hip' has the columns .* x and y"),
        ("bodyparts", "parts", r"expected the rows 'scorer'"),
        (",260.4,0.2\n", ",0.2\n", r"line 6: found 6 fields .* commas, expected 7"),
    ],
)
def test_bad_deeplabcut(write, old, new, message):
    with pytest.raises(ValueError, match=message):
        load_markers(write(changed(old, new, DLC), "dlc.csv"), rate=50)


# --- the programs of laboratories ---------------------------------------------------

QUALISYS = """\
NO_OF_FRAMES\t4
NO_OF_CAMERAS\t8
NO_OF_MARKERS\t2
FREQUENCY\t120
NO_OF_ANALOG\t0
DESCRIPTION\t--
TIME_STAMP\t2020-01-01, 10:00:00.000\t1.5
DATA_INCLUDED\t3D
MARKER_NAMES\tHip\tKnee
TRAJECTORY_TYPES\tMeasured\tMeasured
"""
AXES = "Hip X\tHip Y\tHip Z\tKnee X\tKnee Y\tKnee Z\n"


@pytest.mark.parametrize(
    "content",
    {
        "no clock": QUALISYS + rows(HIP, KNEE),
        "no clock, names": QUALISYS + AXES + rows(HIP, KNEE),
        "clock": QUALISYS
        + "Frame\tTime\t"
        + AXES
        + rows(FRAMES + 1, np.round(FRAMES / 120, 5), HIP, KNEE),
        "clock without names": QUALISYS
        + rows(FRAMES + 1, np.round(FRAMES / 120, 5), HIP, KNEE),
        "frames": QUALISYS + "Frame\t" + AXES + rows(FRAMES + 1, HIP, KNEE),
        "version 2": "FILE_VERSION\t2.0.0\n" + QUALISYS + rows(HIP, KNEE),
        "other columns in another order": QUALISYS
        + "Frame\tKnee Z\tKnee Y\tKnee X\tKnee Res\tHip X\tHip Res\tHip Y\tHip Z\n"
        + rows(FRAMES + 1, KNEE[:, ::-1], [7] * 4, HIP[:, 0], ["x"] * 4, HIP[:, 1:]),
        "CR CR LF": (QUALISYS + rows(HIP, KNEE)).replace("\n", "\r\r\n"),
        "decimal commas": (
            QUALISYS.replace("\t120", "\t120,00") + rows(HIP, KNEE)
        ).replace(".", ","),
        "a blank line, an event": QUALISYS.replace("TRAJ", "EVENT\ton\t3\t0.02\nTRAJ")
        + "\n"
        + rows(HIP, KNEE),
    }.items(),
    ids=lambda item: item[0],
)
def test_qualisys(write, content):
    check(load_markers(write(content[1], "trial.tsv")), rate=120.0)


def test_lost_frames_of_qualisys_keep_their_place(write):
    body = rows(HIP, KNEE).splitlines(keepends=True)
    body[1] = "\t" * 5 + "\n"
    body[2] = re.sub(r"^\S+\t\S+\t\S+", "null\tnull\tnull", body[2])
    path = write(QUALISYS + "".join(body), "trial.tsv")
    with pytest.raises(ValueError, match=r"'Hip' in 2 .* line 12; 'Knee' in 1 .* 12\."):
        load_markers(path)
    data = load_markers(path, gaps="nan")
    assert_array_equal(np.isnan(data.markers["Hip"][:, 0]), [0, 1, 1, 0])
    assert_array_equal(np.isnan(data.markers["Knee"][:, 0]), [0, 1, 0, 0])
    assert_array_equal(data.time, FRAMES / 120)


def test_bad_qualisys(write):
    path = write(QUALISYS.replace("MARKER_NAMES", "BODY_NAMES") + rows(HIP, KNEE))
    with pytest.raises(ValueError, match=r"no names after MARKER_NAMES; export"):
        load_markers(path.rename(path.with_suffix(".tsv")))
    path = write(QUALISYS.replace("\t4\n", "\t5\n", 1) + rows(HIP, KNEE), "trial.tsv")
    with pytest.warns(UserWarning, match=r"NO_OF_FRAMES is 5, but the file holds 4"):
        load_markers(path)
    path = write(
        QUALISYS.replace("MARKERS\t2", "MARKERS\t3") + rows(HIP, KNEE), "q.tsv"
    )
    with pytest.warns(UserWarning, match=r"NO_OF_MARKERS is 3, but the file holds 2"):
        check(load_markers(path), rate=120.0)
    other = QUALISYS + AXES.replace("Hip Y", "Hip V") + rows(HIP, KNEE)
    with pytest.raises(ValueError, match=r"0 columns are called 'Hip Y', not one"):
        load_markers(write(other, "trial.tsv"))


NEXUS = "Trajectories\n100\n,,S1:Hip,,,S1:Knee,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n"
UNITS = ",,mm,mm,mm,mm,mm,mm\n"
VICON = rows(FRAMES + 1, FRAMES * 0, HIP, KNEE).replace("\t", ",")
DEVICES = (
    "Devices\n1000\n,,Plate - Force,,\nFrame,Sub Frame,Fx,Fy,Fz\n,,N,N,N\n"
    "1,0,1,2,3\n1,1,4,5,6\n\n"
)


@pytest.mark.parametrize(
    "content",
    {
        "Nexus": NEXUS + UNITS + VICON,
        "CR LF": (NEXUS + UNITS + VICON).replace("\n", "\r\n"),
        "devices before": DEVICES + NEXUS + UNITS + VICON + "\n",
        "a section after": NEXUS + UNITS + VICON + "\n" + DEVICES,
        "velocities beside": NEXUS.replace(",,\n", ",,,S1:Hip,,\n").replace(
            "X,Y,Z\n", "X,Y,Z,X',Y',Z'\n"
        )
        + UNITS.replace("mm\n", "mm,mm/s,mm/s,mm/s\n")
        + VICON.replace("\n", ",1,2,3\n"),
        "empty fields at the ends": "\n".join(
            line + ",,," for line in (NEXUS + UNITS + VICON).splitlines()
        ),
        "Workstation": "TRAJECTORIES\n100,Hz\n,S1:Hip,,,S1:Knee,,\n"
        "Field #,X,Y,Z,X,Y,Z\n"
        + UNITS[1:]
        + rows(FRAMES + 1, HIP, KNEE).replace("\t", ","),
        "tabs": (NEXUS + UNITS + VICON).replace(",", "\t"),
    }.items(),
    ids=lambda item: item[0],
)
def test_vicon(write, content):
    check(load_markers(write(content[1], "trial.csv")))


@pytest.mark.parametrize("lines", ["\n", "\n,,,\n", "\nan event by hand\n"])
def test_blank_lines_do_not_end_a_section_of_vicon(write, lines):
    text = NEXUS + UNITS + VICON.replace("\n3,", f"{lines}\n3,")
    for end in ("", "\n" + DEVICES, "\n" + DEVICES.replace("Devices", "Gauges")):
        check(load_markers(write(text + end, "trial.csv")))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (DEVICES, r"holds \['Devices'\], but no section 'Trajectories'; exp"),
        ("Trajectories\n100\n", r"no section 'Trajectories'"),
        (NEXUS.replace("Frame", "Fr") + UNITS + VICON, r"line 4: found 'Fr,Sub Fr"),
        (NEXUS.replace("Z,X", "X,Y") + VICON, r"found 8 fields|stands above"),
        (NEXUS.replace("X,Y,Z", "X,Y") + VICON, r"lines 3 and 4: no name stands above"),
        (NEXUS + VICON, r"does not say the unit of its positions; pass unit"),
        (
            NEXUS + UNITS + VICON.replace("\n3,", "\n4,"),
            r"line 8: Frame goes from 2 to",
        ),
        (NEXUS + UNITS, r"the file has a head, but no frames"),
    ],
)
def test_bad_vicon(write, content, message):
    with pytest.raises(ValueError, match=message):
        load_markers(write(content, "trial.csv"))


V3D = (
    "\tc:\\walk.c3d" * 6
    + "\n"
    + "\tHip" * 3
    + "\tKnee" * 3
    + "\n"
    + "\tTARGET" * 6
    + "\n"
    + "\tORIGINAL" * 6
    + "\nITEM\tX\tY\tZ\tX\tY\tZ\n"
)


def test_visual3d(write):
    path = write(V3D + rows(FRAMES + 1, HIP, KNEE), "trial.txt")
    message = r"not say how many .*, nor the unit .*; pass rate.*, and unit"
    with pytest.raises(ValueError, match=message):
        load_markers(path)
    check(load_markers(path, rate=100, unit="mm"))
    # A model's angles beside the markers are none.
    mixed = V3D.replace("\tTARGET" * 6, "\tTARGET" * 3 + "\tLINK_MODEL_BASED" * 3)
    data = load_markers(
        write(mixed + rows(FRAMES + 1, HIP, KNEE), "trial.txt"), rate=100, unit="mm"
    )
    assert data.names == ["Hip"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\tc:\\walk.c3d\n", "\tc:\\run.c3d\n", r"line 1: .* several recordings"),
        ("\tTARGET" * 6, "\tMETRIC" * 6, r"line 3: .*METRIC.*, not the X, Y and Z"),
    ],
)
def test_bad_visual3d(write, old, new, message):
    text = changed(old, new, V3D) + rows(FRAMES + 1, HIP, KNEE)
    with pytest.raises(ValueError, match=message):
        load_markers(write(text, "trial.txt"), rate=100, unit="mm")


# --- clocks -------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [30.0, 59.94, 60.0, 100.0, 120.0, 200.0, 1000.0])
@pytest.mark.parametrize("first", [0.0, 3.0])
def test_rates_are_read_off_rounded_stamps(write, rate, first):
    stamps = [f"{first + i / rate:.6f}" for i in range(200)]
    body = np.column_stack([np.arange(1, 201), np.tile([*HIP[0], *KNEE[0]], (200, 1))])
    text = changed("\n100\t100\t4\t", "\n\t100\t200\t").replace(
        BODY, rows(body[:, 0].astype(int), stamps, body[:, 1:])
    )
    data = load_markers(write(text))
    if rate == np.rint(rate):
        assert data.rate == rate
    else:
        assert_allclose(data.rate, rate, rtol=1e-6)
    assert_allclose(data.time, first + np.arange(200) / rate, rtol=0, atol=2e-6)


def test_a_rate_that_is_given_wins_over_the_head_but_not_over_time(write):
    path = write(changed("\n100\t", "\n50\t"))
    with pytest.raises(ValueError, match=r"by 100 .* DataRate in line 3 is 50; .*=100"):
        load_markers(path)
    check(load_markers(path, rate=100))
    with pytest.raises(ValueError, match=r"by 100 frames per second, but rate is 50"):
        load_markers(path, rate=50)


def test_a_rate_that_differs_from_the_head_warns(write):
    path = write(QUALISYS + rows(HIP, KNEE), "trial.tsv")
    with pytest.warns(
        UserWarning, match=r"rate=50 is used, but FREQUENCY is 120; leave"
    ):
        check(load_markers(path, rate=50), rate=50.0)
    check(load_markers(path, rate=119.0), rate=119.0)
    path = write(NEXUS + UNITS + VICON, "trial.csv")
    with pytest.warns(UserWarning, match=r"rate=50 .*, but the rate in line 2 is 100"):
        check(load_markers(path, rate=50), rate=50.0)


def test_stamps_between_frames_are_kept(write):
    stamps = 0.237 + FRAMES / 100
    data = load_markers(write(TRC.replace(BODY, rows(FRAMES, stamps, HIP, KNEE))))
    assert_allclose(data.time, stamps, rtol=1e-12)


# --- angles -------------------------------------------------------------------------

COORDINATES = """\
Coordinates
version=1
nRows=4
nColumns=5
inDegrees=yes

Angles are in degrees.

endheader
time\tpelvis_tilt\tpelvis_tx\thip_flexion_r\tknee_angle_r
0.00\t-5\t0.1\t20\t10
0.01\t-6\t0.2\t21\t11
0.02\t-7\t0.3\t22\t12
0.03\t-8\t0.4\t23\t13
"""
DEGREES = np.array([[-5.0, 20, 10], [-6, 21, 11], [-7, 22, 12], [-8, 23, 13]])


@pytest.mark.parametrize("name", ["walk.mot", "walk.sto"])
def test_angles_come_in_radians(write, name):
    data = load_angles(write(COORDINATES, name))
    assert data.names == ["pelvis_tilt", "hip_flexion_r", "knee_angle_r"]
    assert data.left_out == ["pelvis_tx"]
    assert_allclose(data.angles, np.radians(DEGREES), rtol=1e-15)
    assert data.rate == 100.0
    assert_allclose(data.time, FRAMES / 100, rtol=1e-15)
    radians = load_angles(
        write(COORDINATES.replace("=yes", "=no"), name), unit="radians"
    )
    assert_array_equal(radians.angles, DEGREES)
    # The unit that is given wins.
    given = load_angles(write(COORDINATES.replace("=yes", "=no"), name), unit="degrees")
    assert_array_equal(given.angles, data.angles)
    data = load_angles(write(COORDINATES, name), angles=["knee_angle_r", "pelvis_tilt"])
    assert_allclose(data.angles, np.radians(DEGREES[:, [2, 0]]), rtol=1e-15)
    assert data.left_out == ["pelvis_tx", "hip_flexion_r"]


def test_radians_that_are_degrees_warn(write):
    path = write(COORDINATES.replace("=yes", "=no"), "walk.mot")
    message = r"walk.mot says .* radians, but 'hip_flexion_r' reaches 23\. .*'degrees'"
    with pytest.warns(UserWarning, match=message):
        load_angles(path)


def test_files_of_other_dialects(write):
    # Blanks for tabs; the head of SIMM, which names no unit.
    blanks = COORDINATES.replace("\t", "   ").replace("\n0", "\n   0")
    assert_allclose(
        load_angles(write(blanks, "walk.mot")).angles, np.radians(DEGREES), rtol=1e-15
    )
    _, body = COORDINATES.split("endheader\n")
    simm = f"name walk.mot\ndatacolumns 5\ndatarows 4\nrange 0 0.03\nendheader\n{body}"
    path = write(simm, "walk.mot")
    with pytest.raises(ValueError, match=r"inDegrees=yes or no is missing.*'degrees'"):
        load_angles(path)
    assert_allclose(
        load_angles(path, unit="degrees").angles, np.radians(DEGREES), rtol=1e-15
    )


@pytest.mark.parametrize(
    ("old", "new", "options", "message"),
    [
        (
            "endheader\n",
            "",
            {},
            r"walk.mot: line 1: .* no line 'endheader'.*load_markers",
        ),
        ("time\t", "t\t", {}, r"line 10: found 't.*expected 'time'"),
        ("", "", {"angles": ["knee"]}, r"0 columns are called 'knee'; the file holds"),
        ("", "", {"angles": ["pelvis_tx"]}, r"'pelvis_tx' is no angle by its name"),
        ("", "", {"angles": "knee_angle_r"}, r"angles='knee_angle_r'; pass a list"),
        ("", "", {"unit": "turns"}, r"unit must be .* got 'turns'"),
        ("knee_angle_r", "hip_flexion_r", {}, r"2 columns are called 'hip_flexion_r'"),
        ("\t12\n", "\n", {}, r"line 13: found 4 fields .* expected 5"),
        ("\t12\n", "\tx\n", {}, r"line 13: 'x' in column 'knee_angle_r'"),
        ("0.02\t", "0.01\t", {}, r"line 13: time goes from 0.01 to 0.01"),
        ("0.02\t", "0.05\t", {}, r"line 13: time goes from 0.01 to 0.05"),
        ("version=1", "DataType=Quaternion", {}, r"type Quaternion, .*RotationEncoder"),
        ("", "", {"angles": 5}, r"angles=5; pass a list of names, or None"),
        ("", "", {"angles": (x for x in "ab")}, r"angles=<gen.*; pass a list of nam"),
        ("Coordinates", "Speeds", {}, r"line 1: the file holds 'Speeds', no angles"),
        ("Coordinates", "Accelerations", {}, r"holds 'Accelerations', no angles"),
        ("Coordinates", "Positions ", {}, r"holds 'Positions', no angles"),
        ("Coordinates", "PositionErrors", {}, r"holds 'PositionErrors', no angles"),
        ("Coordinates", "Static Optimization", {}, r"'Static Optimization', no angl"),
        ("Coordinates", "MomentArm_hip_flexion_r", {}, r"'MomentArm_hip.*, no angles"),
        ("Coordinates", "Joint Reaction Loads", {}, r"'Joint Reaction L.*no angles"),
        ("Coordinates", "Model Marker Errors from IK", {}, r"'Model Mar.*no angles"),
    ],
)
def test_bad_angles(write, old, new, options, message):
    path = write(changed(old, new, COORDINATES), "walk.mot")
    with pytest.raises(ValueError, match=message):
        load_angles(path, **options)


def test_steps_of_an_integrator_are_refused(write):
    stamps = np.cumsum(np.r_[0, np.linspace(0.01, 0.02, 40)])
    text = COORDINATES[: COORDINATES.index("0.00\t")].replace("nRows=4", "nRows=41")
    text += rows(stamps, np.tile([-5, 0.1, 20, 10], (41, 1)))
    with pytest.raises(ValueError, match=r"steps of time vary from 0.01 to 0.02; exp"):
        load_angles(write(text, "states.sto"))


def test_forces_are_no_angles(write):
    text = COORDINATES.replace("pelvis_tilt", "ground_force_vx")
    for name, other in [
        ("hip_flexion_r", "1_torque_x"),
        ("knee_angle_r", "soleus.activation"),
    ]:
        text = text.replace(name, other)
    with pytest.raises(
        ValueError, match=r"not those of angles, but \['ground_force_vx"
    ):
        load_angles(write(text, "grf.mot"))


NO_ANGLES = [
    *("center_of_mass_X", "1_ground_force_vy", "ground_px", "hip_fz", "pin_my", "tx"),
    *("calcn_r_ty", "/jointset/pelvis/pelvis_tz/value", "total_squared_error"),
    *("marker_error_RMS", "hip_flexion_r_reserve", "hip_on_femur_in_ground_fx"),
    *("hip_flexion_r_moment", "/jointset/hip_r/hip_flexion_r/speed", "knee_angle_r_u"),
]
ANGLES = [
    *("pelvis_tilt", "subtalar_angle_r", "mtp_angle_l", "lumbar_bending", "pro_sup_r"),
    *("/jointset/hip_r/hip_flexion_r/value", "arm_flex_r", "wrist_dev_l"),
    *("ground_thorax_rot_x", "r1_z", "elv_angle"),
]


def test_names_tell_angles_from_others(write):
    names = [*NO_ANGLES, *ANGLES]
    values = np.tile(np.arange(len(names)) / 10, (3, 1))
    head = "walk_speeds.mot\ninDegrees=no\nendheader\ntime\t" + "\t".join(names) + "\n"
    data = load_angles(write(head + rows([0.0, 0.5, 1.0], values), "walk.mot"))
    assert data.names == ANGLES
    assert data.left_out == NO_ANGLES
    assert_array_equal(data.angles, values[:, len(NO_ANGLES) :])


def test_angles_that_are_not_finite_are_missing(write):
    text = COORDINATES.replace("\t21\t", "\tinf\t").replace("\t12\n", "\t-inf\n")
    data = load_angles(write(text, "walk.mot"))
    lost = np.zeros((4, 3), dtype=bool)
    lost[1, 1] = lost[2, 2] = True
    assert_allclose(
        data.angles, np.radians(np.where(lost, np.nan, DEGREES)), rtol=1e-15
    )


def test_paths(write, tmp_path):
    path = write(TRC)
    check(load_markers(bytes(path)))
    for reader in (load_markers, load_angles):
        with pytest.raises(IsADirectoryError, match=r"is a folder; pass .* its files"):
            reader(tmp_path)
        with pytest.raises(FileNotFoundError):
            reader(tmp_path / "none.trc")
        with pytest.raises(TypeError, match=r"path must be that of a file, got 5"):
            reader(5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"markers": 5}, r"markers=5; pass a list of names, or None"),
        ({"markers": (x for x in "ab")}, r"markers=<gen.*; pass a list of names"),
        ({"markers": b"Hip"}, r"markers=b'Hip'; pass a list of names, or None"),
        ({"individual": ["a", "b"]}, r"individual=\['a', 'b'\]; pass one name, or"),
        ({"individual": 5}, r"individual=5; pass one name"),
    ],
)
def test_choices_of_other_types(write, options, message):
    with pytest.raises(ValueError, match=message):
        load_markers(write(TRC), **options)


# --- other files --------------------------------------------------------------------


def npz():
    buffer = io.BytesIO()
    np.savez(buffer, hip=HIP, trial=[1, 1, 2, 2], rate=100.0)
    return buffer.getvalue()


def npy():
    buffer = io.BytesIO()
    np.save(buffer, np.stack([HIP, KNEE], axis=1))
    return buffer.getvalue()


def mat():
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"markers": np.stack([HIP, KNEE], axis=1)})
    return buffer.getvalue()


BVH = """\
HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  End Site
  { OFFSET 0 1 0 }
}
MOTION
Frames: 3
Frame Time: 0.01
-200 0 200 170 0 0
200 1 -200 -170 5 0
0 2 0 -160 10 0
"""
MOTIVE = """\
Format Version,1.23,Take Name,walk,Export Frame Rate,100.0

,Type,Marker,Marker,Marker
,Name,Hip,Hip,Hip
,ID,1,1,1
,,Position,Position,Position
Frame,Time (Seconds),X,Y,Z
0,0.00,1,2,3
1,0.01,4,5,6
2,0.02,7,8,9
"""
POSES = '{"people": [{"pose_keypoints_2d": [1, 2, 0.9, 3, 4, 0.8]}]}'
LOOKALIKES = {
    "walk.mot": (COORDINATES, "OpenSim's storage of angles", "trial.angles[0, 2]"),
    "walk.npz": (npz(), "an archive of NumPy", "trials.markers[1]['hip'][0, 0]"),
    "walk.npy": (npy(), "an array of NumPy", "pairs.X[2, 3]"),
    "walk.mat": (mat(), "arrays of MATLAB", "pairs.X[2, 3]"),
    "walk.bvh": (BVH, "BVH", "[*pairs.y[0]]"),
    "walk.csv": (MOTIVE, "OptiTrack's CSV", "pairs.X[1, 2]"),
    "table.csv": ("time,hip,knee\n0.0,1,2\n0.1,3,4\n", "a table", "[*pairs.X[0]]"),
    "last.csv": (
        "hip,knee,note,Time (s)\n1,2,x,0\n3,4,y,1\n",
        "a table",
        "[*pairs.X[0]]",
    ),
    "twice.csv": ("a, a,Frame\n1,2,0\n3,4,1\n", "a table", "[*pairs.X[0]]"),
    "comma.csv": ('"hip";knee;t\n1,5;2;0\n3;4;1\n', "a table", "[*pairs.X[0]]"),
    "blanks.txt": ("hip knee\n1 2\n3 4\n", "a table", "[*pairs.X[0]]"),
}
RIGHT = [np.radians(10), HIP[2, 0], KNEE[2, 0], KNEE[2, 0], [190, 5, 0], 6]
RIGHT += [[1, 2], [1, 2], [1, 2], [1.5, 2], [1, 2]]


@pytest.mark.parametrize(("name", "right"), zip(LOOKALIKES, RIGHT, strict=True))
def test_the_lines_that_bring_in_other_files_run(write, name, right):
    pytest.importorskip("pandas", reason="reads tables")
    content, kind, value = LOOKALIKES[name]
    path = write(content, name)
    with pytest.raises(
        ValueError, match=rf"{name}: the file looks like {kind}"
    ) as info:
        load_markers(path)
    lines, formats = str(info.value).split("Bring it in by:\n")[1].rsplit("\n", 1)
    assert all(form.name in formats for form in FORMATS)
    names = {"file": str(path), **vars(sklearn_koopman.datasets)}
    names |= {"trajectory_pairs": sklearn_koopman.trajectory_pairs}
    for module in ("numpy", "pandas", "pathlib", "scipy.io"):
        names[module.partition(".")[0]] = __import__(module)
    exec(textwrap.dedent(lines), names)
    assert_allclose(eval(value, names), right, rtol=1e-14)


def test_the_lines_that_bring_in_frames_of_openpose_run(write):
    for number in range(6):
        path = write(POSES.replace("[1,", f"[{number},"), f"pose_{number}.json")
    write('{"people": []}', "pose_6.json")
    write(POSES.replace("1, 2", "0, 0"), "pose_7.json")
    write(POSES, "pose_8.json")
    with pytest.raises(ValueError, match=r"key points in JSON") as info:
        load_markers(path)
    lines = str(info.value).split("Bring it in by:\n")[1].rsplit("\n", 1)[0]
    names = {"file": str(path), "numpy": np, "json": json, "pathlib": pathlib}
    names |= {"trajectory_pairs": sklearn_koopman.trajectory_pairs}
    exec(textwrap.dedent(lines), names)
    assert_array_equal(names["pairs"].X, [[k, 2, 3, 4] for k in range(5)])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("poses.h5", b"\x89HDF\r\n\x1a\n", r"HDF5.*load_dataset\(file, .*DeepLabCut"),
        ("poses.slp", b"\x89HDF\r\n\x1a\n", r"SLEAP.*markers_from_movement\(dataset\)"),
        (
            "a.csv",
            "track,frame_idx,instance.score,a.x\n,0,1,2\n",
            r"SLEAP.*\.slp.*movem",
        ),
        ("a.csv", "a_x,a_ncams,fnum\n1,2,0\n", r"Anipose.*\(file, .*'Anipose'\)"),
        ("walk.xlsx", b"PK\x03\x04", r"Excel.*pandas.read_excel\(file\)"),
        ("walk.amc", "#!OML:ASF\n", r"AMC.*C3D"),
        ("walk.mvnx", "<?xml?>\n", r"MVN.*C3D"),
        ("walk.txt", "1\t0.5\n2\t0.6\n", r"no known format .*an array of numbers"),
        ("walk.csv", "Objects,,\n100,,\n", r"no known format .*an array of numbers"),
        ("walk.txt", "hello\nworld\n", r"no known format \(line 1 is 'hello'\)"),
        ("walk.bin", bytes(range(256)), r"no known format \(it is not text\)"),
        ("walk.txt", "", r"the file is empty"),
        ("walk.txt", " \n\t\n", r"the file is empty"),
    ],
)
def test_other_files_are_named_with_a_remedy(write, name, content, message):
    with pytest.raises(ValueError, match=f"(?s){name}: .*{message}"):
        load_markers(write(content, name))


# --- the files of the cases ---------------------------------------------------------

AS_PLAIN = [
    "plain crlf cr bom prefix labels5 double_tabs extra_tab comma_sep comma_decimal",
    "utf16",
]


@pytest.fixture
def case():
    """Return the path of one of the cases, or skip without their folder."""

    def find(name):
        folder = DATA.parent / "cases"
        if not folder.is_dir():
            pytest.skip("no folder of cases beside the one of recorded motion")
        return folder / name

    return find


@pytest.mark.parametrize("name", " ".join(AS_PLAIN).split())
def test_cases_that_hold_the_same_numbers(case, name):
    check(load_markers(case(f"{name}.trc")))


@pytest.mark.parametrize("name", ["unlabelled", "comment"])
def test_cases_of_whole_numbers(case, name):
    data = load_markers(case(f"{name}.trc"))
    assert data.names == ["Hip", "Knee"]
    assert_array_equal(data.markers["Hip"], np.c_[HIP[:, 0], [900] * 4, [80] * 4])
    assert_array_equal(data.markers["Knee"], [[150, 480, 80]] * 4)


def test_cases_of_counts_and_units(case):
    for name in ("numframes_short", "numframes_long"):
        with pytest.warns(UserWarning, match="NumFrames"):
            data = load_markers(case(f"{name}.trc"))
        check(data)
    data = load_markers(case("meters.trc"))
    assert data.unit == "m"
    assert_array_equal(data.markers["Hip"][:, 1], [0.9] * 4)
    with pytest.raises(ValueError, match=r"pass unit, one of"):
        load_markers(case("nounit.trc"))
    check(load_markers(case("nounit.trc"), unit="mm"))
    with pytest.raises(ValueError, match=r"like m instead of mm; pass unit='m'"):
        load_markers(case("m_as_mm.trc"))
    assert load_markers(case("m_as_mm.trc"), unit="m").unit == "m"
    with pytest.raises(ValueError, match=r"'Knee' in 1 frames, first in line 9"):
        load_markers(case("zeros.trc"))
    knee = load_markers(case("zeros.trc"), gaps="nan").markers["Knee"]
    assert_array_equal(np.isnan(knee[:, 0]), [0, 0, 1, 0])


def test_cases_of_laboratories(case):
    data = load_markers(case("qualisys.tsv"))
    x = FRAMES + 10.5
    assert_array_equal(data.markers["Hip"], np.c_[x, [90.25] * 4, [980.1] * 4])
    assert_array_equal(data.markers["Knee"], np.c_[x + 140, [88.5] * 4, [480.2] * 4])
    assert data.rate == 120.0
    data = load_markers(case("vicon.csv"))
    assert_array_equal(data.markers["Hip"], np.c_[x, [90.2] * 4, [980.1] * 4])
    assert_array_equal(data.markers["Knee"], np.c_[x + 140, [88] * 4, [480] * 4])
    assert (data.rate, data.unit) == (100.0, "mm")
    with pytest.raises(ValueError, match=r"pass rate, .*, and unit"):
        load_markers(case("visual3d.txt"))
    data = load_markers(case("visual3d.txt"), rate=100, unit="m")
    assert_allclose(data.markers["Hip"][:, 0], [0.01, 0.11, 0.21, 0.31], rtol=0)


def test_cases_of_poses(case):
    data = load_markers(case("dlc.csv"), rate=30, min_likelihood=0.5, gaps="nan")
    assert_array_equal(data.markers["knee"][:2], [[120.5, 260.4], [121.5, 260.4]])
    assert_array_equal(np.isnan(data.markers["knee"][:, 0]), [0, 0, 1, 0])
    with pytest.raises(ValueError, match="rate=100"):
        load_markers(case("dlc.csv"))
    data = load_markers(case("dlc_individuals.csv"), rate=30, individual="a")
    assert_array_equal(data.markers["knee"][:, 0], 120.5 + FRAMES)
    with pytest.raises(ValueError, match=r"\['a', 'b'\]"):
        load_markers(case("dlc_individuals.csv"), rate=30)


def test_cases_of_c3d(case):
    pytest.importorskip("ezc3d", reason="C3D is read by ezc3d")
    single = np.finfo(np.float32).eps
    check(load_markers(case("plain.c3d")), rtol=single)
    with pytest.raises(ValueError, match=r"'Knee' in 1 frames, first in frame 3"):
        load_markers(case("gap.c3d"))
    knee = load_markers(case("gap.c3d"), gaps="nan").markers["Knee"]
    assert_array_equal(np.isnan(knee[:, 0]), [0, 0, 1, 0])
    assert_allclose(knee[3], KNEE[3], rtol=single)


def test_cases_of_angles(case):
    data = load_angles(case("ik.mot"))
    assert data.names == ["hip_flexion_r", "knee_angle_r"]
    degrees = np.column_stack([20.5 + FRAMES, -5.25 - FRAMES])
    assert_allclose(data.angles, np.radians(degrees), rtol=1e-15)
    assert data.rate == 60.0
    data = load_angles(case("ik.sto"))
    assert_array_equal(data.angles[1], [0.36, -0.10])
    assert data.rate == 100.0
