"""The README says what is so."""

import re
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_main_job_runs_as_printed():
    (code,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names = {}
    exec(code, names)
    pairs = names["pairs"]
    assert names["ankle"].shape == names["std"].shape == (5, 2)
    # It has learned: a tenth of a second of walking moves the ankle by 100 mm.
    now = names["trajectory_pairs"](
        names["walking"].outputs, lag=15, delays=3, delay_step=5
    ).X[:, :2]
    persistence = np.sqrt(np.mean((now - pairs.y) ** 2))
    assert -names["search"].best_score_ < 0.1 * persistence


def test_files_that_it_points_to_exist():
    for path in re.findall(r"\]\(([\w/.]+)\)|python ([\w/]+\.py)", README):
        assert (ROOT / "".join(path)).exists()
