"""Modules that are imported when they are first used."""

import inspect
import subprocess
import sys

import pytest

import sklearn_koopman

LAZY = ("datasets", "diagnostics", "kinematics", "plotting")

UNTOUCHED = """
import sys
import sklearn_koopman
loaded = [name for name in sys.modules if name.startswith("sklearn_koopman.")]
for name in {lazy}:
    assert not any(f"{{module}}.".startswith(f"sklearn_koopman.{{name}}.")
                   for module in loaded), name
    assert name in dir(sklearn_koopman)
assert "matplotlib" not in sys.modules
for name in ("kernels", "trajectories", "scoring", "solvers"):
    assert getattr(sklearn_koopman, name) is sys.modules[f"sklearn_koopman.{{name}}"]
sklearn_koopman.plotting.ForecastDisplay
assert "matplotlib" not in sys.modules
"""

THREADS = """
import sys
from threading import Barrier, Thread
import sklearn_koopman

sys.setswitchinterval(1e-6)
names = {lazy}
barrier, found, errors = Barrier(16), [], []

def touch(first):
    barrier.wait()
    try:
        for i in range(len(names)):
            name = names[(first + i) % len(names)]
            module = getattr(sklearn_koopman, name)
            assert all(hasattr(module, public) for public in module.__all__)
            found.append((name, id(module)))
    except BaseException as error:
        errors.append(error)

threads = [Thread(target=touch, args=(i,)) for i in range(16)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert not errors, errors
assert len(found) == 64
assert len(set(found)) == 4
for name in names:
    assert getattr(sklearn_koopman, name) is sys.modules[f"sklearn_koopman.{{name}}"]
"""


@pytest.mark.parametrize("code", [UNTOUCHED, THREADS], ids=["untouched", "threads"])
def test_in_a_fresh_process(code):
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code.format(lazy=LAZY)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr


def test_other_names_are_no_attributes():
    with pytest.raises(AttributeError, match="has no attribute 'ploting'"):
        sklearn_koopman.ploting  # noqa: B018
    for name in sklearn_koopman.__all__:
        assert hasattr(sklearn_koopman, name)
        assert name in dir(sklearn_koopman)


@pytest.mark.parametrize("module", LAZY)
def test_signatures_fit_on_a_screen(module):
    module = getattr(sklearn_koopman, module)
    for name in module.__all__:
        member = getattr(module, name)
        members = [member]
        if inspect.isclass(member):
            members += [
                method
                for key, method in inspect.getmembers(member, callable)
                if not key.startswith("_")
            ]
        for one in members:
            assert len(str(inspect.signature(one))) < 400, one
