"""Datasets of the package movement, made by xarray as movement makes them."""

from pathlib import Path

import numpy as np
import pytest

from sklearn_koopman.datasets import load_markers, markers_from_movement

xr = pytest.importorskip("xarray", reason="movement's datasets are xarray's")

NAMES, ANIMALS = ["snout", "tail", "paw"], ["a", "b"]
N_FRAMES = 5


def positions(n_axes=2, n_individuals=2):
    """Return distinct numbers over time, space, keypoints and individuals."""
    shape = (N_FRAMES, n_axes, 3, n_individuals)
    return 100.0 + np.arange(np.prod(shape)).reshape(shape)


def poses(position=None, *, confidence=None, fps=50.0, plural=True, **attrs):
    """Return a dataset as movement makes it, before or after version 0.17."""
    position = positions() if position is None else position
    n_frames, n_axes, _, n_individuals = position.shape
    s = "s" * plural
    dims = ("time", "space", f"keypoint{s}", f"individual{s}")
    if confidence is None:
        confidence = np.full((n_frames, *position.shape[2:]), np.nan)
    time = np.arange(n_frames) if fps is None else np.arange(n_frames) / fps
    unit = "frames" if fps is None else "seconds"
    known = {} if fps is None else {"fps": fps}
    return xr.Dataset(
        {"position": (dims, position), "confidence": (dims[:1] + dims[2:], confidence)},
        coords=dict(
            zip(
                dims,
                [time, [*"xyz"][:n_axes], NAMES, ANIMALS[:n_individuals]],
                strict=True,
            )
        ),
        attrs={"source_software": "SLEAP", "ds_type": "poses", "time_unit": unit}
        | known
        | attrs,
    )


@pytest.mark.parametrize("plural", [True, False])
@pytest.mark.parametrize("individual", [0, 1])
def test_positions_of_an_individual(plural, individual):
    name = ANIMALS[individual]
    trial = markers_from_movement(poses(plural=plural), individual=name)
    assert trial.names == NAMES
    assert trial.individuals == ANIMALS
    assert (trial.rate, trial.unit, trial.filename) == (50.0, "px", "")
    assert "likelihood" not in trial  # movement writes NaN where it knows none
    np.testing.assert_allclose(trial.time, np.arange(5) / 50, rtol=1e-15)
    for keypoint, marker in enumerate(NAMES):
        right = positions()[:, :, keypoint, individual]
        np.testing.assert_array_equal(trial.markers[marker], right)


@pytest.mark.parametrize(
    "dims",
    [
        ("individuals", "keypoints", "space", "time"),
        ("time", "individuals", "keypoints", "space"),  # older versions of movement
    ],
)
def test_dimensions_come_in_any_order(dims):
    right = markers_from_movement(poses(), individual="b")
    trial = markers_from_movement(poses().transpose(*dims), individual="b")
    for name in NAMES:
        np.testing.assert_array_equal(trial.markers[name], right.markers[name])


def test_axes_come_in_any_order():
    dataset = poses(positions(3)).isel(space=[2, 0, 1])
    trial = markers_from_movement(dataset, individual="a", unit="mm")
    np.testing.assert_array_equal(trial.markers["paw"], positions(3)[:, :, 2, 0])


def test_several_individuals_must_be_told_apart():
    with pytest.raises(ValueError, match=r"'a', 'b'.*individual='a'"):
        markers_from_movement(poses())
    both = markers_from_movement(poses(), markers=["a:paw", "b:paw"])
    np.testing.assert_array_equal(both.markers["b:paw"], positions()[:, :, 2, 1])


def test_what_was_selected_keeps_its_name():
    dataset = poses()
    one = markers_from_movement(dataset.sel(individuals="b"))
    assert (one.names, one.individuals) == (NAMES, ["b"])
    np.testing.assert_array_equal(one.markers["tail"], positions()[:, :, 1, 1])
    snout = markers_from_movement(dataset.sel(individuals="a", keypoints="snout"))
    assert snout.names == ["snout"]
    np.testing.assert_array_equal(snout.markers["snout"], positions()[:, :, 0, 0])


def test_what_has_no_name_is_numbered():
    dataset = poses().drop_vars(["individuals", "keypoints"])
    trial = markers_from_movement(dataset, individual="id_1")
    assert trial.names == ["keypoint_0", "keypoint_1", "keypoint_2"]
    assert trial.individuals == ["id_0", "id_1"]
    bare = poses().mean(["individuals", "keypoints"])
    mean = markers_from_movement(bare, rate=50)
    assert mean.names == ["keypoint_0"]
    assert "individuals" not in mean
    np.testing.assert_allclose(
        mean.markers["keypoint_0"], positions().mean(axis=(2, 3)), rtol=1e-15
    )


def test_positions_that_are_no_numbers_are_gaps():
    position = positions(n_individuals=1)
    position[1, :, 0] = np.nan
    position[3, :, 2] = 0.0
    dataset = poses(position)
    with pytest.raises(ValueError, match=r"'snout' in 1 frames, first in frame 1;"):
        markers_from_movement(dataset)
    trial = markers_from_movement(dataset, gaps="nan")
    assert np.isnan(trial.markers["snout"][1]).all()
    assert np.isnan(trial.markers["paw"][3]).all()
    kept = markers_from_movement(dataset, markers=["paw"], zeros="keep")
    np.testing.assert_array_equal(kept.markers["paw"], position[:, :, 2, 0])


def test_confidence():
    confidence = np.linspace(0.5, 1.0, N_FRAMES * 6).reshape(N_FRAMES, 3, 2)
    dataset = poses(confidence=confidence)
    trial = markers_from_movement(
        dataset, individual="b", min_likelihood=0.75, gaps="nan"
    )
    for keypoint, name in enumerate(NAMES):
        known = confidence[:, keypoint, 1]
        np.testing.assert_array_equal(trial.likelihood[name], known)
        is_lost = np.isnan(trial.markers[name]).all(axis=1)
        np.testing.assert_array_equal(is_lost, known < 0.75)
    without = markers_from_movement(dataset.drop_vars("confidence"), individual="a")
    assert "likelihood" not in without
    with pytest.raises(ValueError, match="no likelihood of 'snout'"):
        markers_from_movement(poses(), individual="a", min_likelihood=0.5)


def test_frames_need_a_rate():
    dataset = poses(fps=None).sel(individuals="a")
    with pytest.raises(ValueError, match=r"how many frames .* pass rate"):
        markers_from_movement(dataset)
    trial = markers_from_movement(dataset.isel(time=slice(2, None)), rate=25)
    np.testing.assert_allclose(trial.time, [0.08, 0.12, 0.16], rtol=1e-15)
    known = markers_from_movement(dataset.assign_attrs(fps=25))
    assert known.rate == 25.0


def test_time_in_seconds_tells_the_rate():
    dataset = poses().sel(individuals="a")
    del dataset.attrs["fps"]
    part = markers_from_movement(dataset.isel(time=slice(1, None)))
    assert part.rate == 50.0
    np.testing.assert_allclose(part.time, [0.02, 0.04, 0.06, 0.08], rtol=1e-15)
    half = dataset.isel(time=slice(None, None, 2))
    assert markers_from_movement(half).rate == 25.0
    with pytest.raises(ValueError, match=r"but fps is 50; .* pass rate=25"):
        markers_from_movement(half.assign_attrs(fps=50))
    gap = dataset.isel(time=[0, 1, 3, 4])
    with pytest.raises(ValueError, match=r"frame 2: time goes from 0\.02 to 0\.06"):
        markers_from_movement(gap)


def test_time_without_stamps():
    dataset = poses().sel(individuals="a").drop_vars("time")
    trial = markers_from_movement(dataset)
    np.testing.assert_allclose(trial.time, np.arange(5) / 50, rtol=1e-15)


def test_positions_in_space_have_the_unit_of_their_calibration():
    dataset = poses(positions(3, n_individuals=1))
    with pytest.raises(ValueError, match=r"unit of its positions; pass unit"):
        markers_from_movement(dataset)
    trial = markers_from_movement(dataset, unit="mm")
    assert trial.unit == "mm"
    assert trial.markers["tail"].shape == (N_FRAMES, 3)


@pytest.mark.parametrize("fps", [0, -5.0, np.nan, np.inf, "50", [50]])
def test_rates_that_are_none_are_refused(fps):
    with pytest.raises(
        ValueError, match=r"the attribute fps must be a finite positive"
    ):
        markers_from_movement(poses(fps=None, individuals=1).assign_attrs(fps=fps))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"markers": 5}, r"markers=5; pass a list of names"),
        ({"individual": ["a", "b"]}, r"individual=\['a', 'b'\]; pass one name"),
        ({"unit": "inch"}, r"unit must be .*'px', got 'inch'"),
    ],
)
def test_choices_of_other_types(options, message):
    with pytest.raises(ValueError, match=message):
        markers_from_movement(poses(), **options)


def test_a_rate_that_differs_from_fps_warns_without_seconds():
    dataset = poses(fps=None).assign_attrs(fps=50.0)
    with pytest.warns(UserWarning, match=r"rate=25 is used, but fps is 50"):
        trial = markers_from_movement(dataset, rate=25, individual="a", unit="px")
    assert trial.rate == 25.0


def test_errors_name_the_file():
    dataset = poses(source_file="/data/mouse.slp")
    with pytest.raises(ValueError, match=r"^/data/mouse\.slp: .*no marker 'ear'"):
        markers_from_movement(dataset, markers=["ear"])
    trial = markers_from_movement(dataset, individual="a")
    assert trial.filename == "/data/mouse.slp"
    with pytest.raises(ValueError, match=r"^dataset: .*no marker 'ear'"):
        markers_from_movement(poses(), markers=["ear"])


def boxes():
    dataset = poses().isel(keypoints=0, drop=True)
    dataset["shape"] = dataset.position
    return dataset


@pytest.mark.parametrize(
    ("dataset", "error", "message"),
    [
        ("mouse.slp", TypeError, r"load_dataset\('mouse\.slp', source_software="),
        (Path("mouse.slp"), TypeError, r"load_dataset\('mouse\.slp', source_softw"),
        ({"position": positions()}, TypeError, r"is a dict without .*'position'"),
        (positions(), TypeError, r"is a ndarray without a variable 'position'"),
        (None, TypeError, r"is a NoneType without a variable 'position'"),
        (poses().position, TypeError, r"DataArray .* not one of its variables"),
        (poses().drop_vars("position"), TypeError, r"is a Dataset without .*'posit"),
        (boxes(), ValueError, r"bounding boxes, not poses"),
        (poses(ds_type="bboxes"), ValueError, r"bounding boxes, not poses"),
        (poses().expand_dims(view=["left"]), ValueError, r"isel\(view=0\)"),
        (poses().isel(time=0), ValueError, r"pass all of time and space"),
        (poses().isel(space=0), ValueError, r"pass all of time and space"),
        (poses().isel(space=[0]), ValueError, r"the axes \['x'\]"),
        (poses().assign_coords(space=["rho", "phi"]), ValueError, r"'rho', 'phi'"),
        (
            poses().assign_coords(time=np.arange(5).astype("M8[s]")),
            ValueError,
            r"time is of the type datetime64.* in seconds, or in frames",
        ),
        (poses().isel(time=[]), ValueError, r"no frames"),
        (poses().isel(keypoints=[]), ValueError, r"no positions of markers"),
    ],
)
def test_what_is_no_dataset_of_poses(dataset, error, message):
    with pytest.raises(error, match=message):
        markers_from_movement(dataset, individual=None)


def test_the_same_file_read_here_and_by_movement(tmp_path):
    # As movement reads it: the same numbers, whichever way they come.
    head = [["scorer"], ["bodyparts"], ["coords"]]
    for name in NAMES:
        head[0] += ["net"] * 3
        head[1] += [name] * 3
        head[2] += ["x", "y", "likelihood"]
    position, confidence = positions(n_individuals=1), np.full((N_FRAMES, 3, 1), 0.9)
    fields = np.concatenate([position[..., 0], confidence.transpose(0, 2, 1)], axis=1)
    rows = fields.transpose(0, 2, 1).reshape(N_FRAMES, -1)
    lines = [",".join(row) for row in head]
    lines += [f"{k}," + ",".join(map(str, row)) for k, row in enumerate(rows)]
    path = tmp_path / "mouse.csv"
    path.write_text("\n".join(lines))
    direct = load_markers(path, rate=50)
    trial = markers_from_movement(
        poses(position, confidence=confidence, source_file=str(path))
    )
    assert (trial.names, trial.unit) == (direct.names, direct.unit)
    np.testing.assert_allclose(trial.time, direct.time, rtol=1e-15)
    for name in NAMES:
        np.testing.assert_array_equal(trial.markers[name], direct.markers[name])
        np.testing.assert_array_equal(trial.likelihood[name], direct.likelihood[name])
