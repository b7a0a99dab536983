"""The README says what is so."""

import re
from pathlib import Path

import numpy as np
import pytest

from sklearn_koopman.datasets import make_walking

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
OF_FORECASTS = ("KoopmanForecaster(", "join_recordings(")


def write_walks(folder, walks):
    """Write synthetic trials as files of the tab-separated format."""
    folder.mkdir()
    for number, markers in enumerate(walks.markers):
        stamps = np.arange(len(markers["hip"])) / walks.rate
        rows = np.column_stack([stamps, *markers.values()])
        labels = [f"{name.title()}{axis}" for name in markers for axis in "XYZ"]
        head = "\t".join(["Time", *labels])
        path = folder / f"{number:02d}.txt"
        np.savetxt(path, rows, "%.10g", "\t", header=head, comments="")


def test_the_main_job_runs_as_printed(tmp_path, monkeypatch):
    walks = make_walking(3, n_strides=4, rate=100.0, random_state=0)
    write_walks(tmp_path / "walks", walks)
    monkeypatch.chdir(tmp_path)
    names = {}
    for code in BLOCKS:
        if not any(word in code for word in OF_FORECASTS):
            exec(code, names)
    pairs = names["pairs"]
    assert names["ankle"].shape == names["std"].shape == (5, 2)
    # It has learned: a tenth of a second of walking moves the ankle by 100 mm.
    now = names["trajectory_pairs"](
        names["walking"].outputs, lag=15, delays=3, delay_step=5
    ).X[:, :2]
    persistence = np.sqrt(np.mean((now - pairs.y) ** 2))
    assert -names["search"].best_score_ < 0.1 * persistence
    # A second of gait with gaps, from the angles alone; the hip moves by 30 degrees.
    fast = names["trials"][2].trajectories[0]
    ahead = fast[999 + 20 * np.arange(1, 11)]
    assert np.degrees(np.abs(names["angles"][0] - ahead)[:, 0].max()) < 3
    assert names["filled"].tolist() == [120, 121, 122]
    assert len(names["now"]) == 10
    assert np.degrees(-names["scores"].min()) < 2
    for states, angles in zip(names["states"], walks.trajectories, strict=True):
        assert np.abs(states - angles).max() < 1e-7
    steps = names["steps"]
    assert len(steps.X) == sum(len(x) - 20 for x in walks.outputs)
    came = np.concatenate([x[20:] for x in walks.outputs])  # segments of 850 mm
    assert np.abs(850 * steps.y - came).max() < 1e-5
    assert np.sqrt(np.mean((names["ankle_in_mm"] - came) ** 2)) < 0.1 * persistence
    error = names["turning"].predict([[345.0], [320.0], [10.0]]) - [[35], [10], [60]]
    assert np.abs(error).max() < 1e-3
    # The synthetic trials have 0.7 to 1.1 strides a second.
    strides = np.abs(names["trusted"][np.abs(names["trusted"]) > 0.1])
    assert len(strides) > 0
    assert ((strides > 0.6) & (strides < 1.2)).all()
    a_second_later = pairs.y[np.arange(5)[:, np.newaxis] + 15 * np.arange(10)]
    assert np.abs(names["second"] - a_second_later).max() < 0.3 * persistence
    assert -names["error"] < 0.2 * persistence
    smooth, later = names["smooth"], names["later"]
    error = np.abs(smooth.predict(later.X) - later.y)
    assert (error <= names["bound"]).all()
    assert names["bound"].max() < 0.02
    assert round(names["dimension"], 2) == 1.04
    assert round(names["standard_error"], 2) == 0.04
    assert round(names["study"].slope, 1) == 5.7
    assert names["study"].guaranteed_slope == 2.5


@pytest.mark.slow
def test_forecast_with_a_band_runs_as_printed(tmp_path, monkeypatch):
    walks = make_walking(1, n_persons=21, n_strides=5, rate=50.0, random_state=0)
    write_walks(tmp_path / "persons", walks)
    monkeypatch.chdir(tmp_path)
    first, second = (b for b in BLOCKS if any(word in b for word in OF_FORECASTS))
    lines = first.splitlines()
    assert len([x for x in lines if x and not x.startswith(("from", "import"))]) <= 10
    names = {}
    exec(first, names)
    exec(second, names)
    assert names["ahead"].shape == (1, 2, 2)
    came = walks.outputs[20][[174, 184]]
    assert np.abs(names["ahead"][0] - came).max() < 40
    came = walks.outputs[20][[154, 164]]
    assert np.abs(names["ankle"][0] - came).max() < 30
    lower, upper = names["band"][0, ..., 0], names["band"][0, ..., 1]
    assert (lower < names["ankle"][0]).all()
    assert (names["ankle"][0] < upper).all()
    assert (upper - lower).max() < 60


def test_files_that_it_points_to_exist():
    for path in re.findall(r"\]\(([\w/.]+)\)|python ([\w/]+\.py)", README):
        assert (ROOT / "".join(path)).exists()
