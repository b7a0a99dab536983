"""Time, memory and accuracy beside scikit-learn, SciPy and deeptime.

Every measurement is made in a process of its own, the repeats in turn between the
peers, so that a machine that slows down does so for all. Set-up and a warm-up at a
small size are not timed. Memory is the peak of the process less that after set-up. The
tables are in Markdown:

* seconds: median (least to largest), and their ratios to the first peer of the size and
  to the limit, which is the part of the work that no such method can do without;
* difference: the largest between the results and those of the first peer, relative to
  them;
* growth: the slope of the logarithm of the time against that of the size.

    python benchmarks/peers.py [--tasks select fit ...] [--repeats 5] [--quick]
        [--data path/to/walking_wbds01_T01-T04_left.npz]

The slowest measurements are made once whatever --repeats. In full, on two cores, it
takes some two hours and 17 GB; with --quick, a few minutes. Needs the extra
`bench`; what is not installed, and the search without its data, is skipped. What is
measured is in `peer_workers.py`.
"""

import argparse
import contextlib
import importlib.metadata
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

OURS = "KoopmanKernelRegressor"
SELECTOR = "SeparatedCenterSelector"


@dataclass
class Case:
    """One row of a table."""

    table: str
    peer: str
    worker: str  # function in peer_workers.py
    arguments: dict
    size: int | None = None
    once: bool = False
    matrix: int | None = None  # memory in matrices of this many rows and columns
    runs: list[dict] = field(default_factory=list)
    stopped: str = ""  # why there are no more runs
    answer: np.ndarray | None = None

    @property
    def seconds(self):
        return [run["seconds"] for run in self.runs]


def case(table, peer, worker, *, size=None, once=False, matrix=None, **arguments):
    return Case(table, peer, worker, arguments, size, once, matrix)


def select_cases(quick, data):
    n, separation = (10**5, 0.3) if quick else (10**6, 0.096)
    name = "select: trajectory on a surface, and volume, 3 features"
    both = {"size": n, "n": n, "separation": separation, "volume": True}
    yield case(name, SELECTOR, "select", **both)
    yield case(name, "deeptime RegularSpace", "select", once=True, deep=True, **both)
    sizes = [10**4, 3 * 10**4, 10**5] if quick else [10**5, 3 * 10**5, 10**6]
    for name, power in (("fixed", 0.0), ("falling as n^(-1/2)", 0.5)):
        for n in sizes:
            eta = 0.15 * (sizes[0] / n) ** power
            title = f"select: trajectory on a surface, separation {name}"
            yield case(title, SELECTOR, "select", size=n, n=n, separation=eta)


def fit_cases(quick, data):
    name, beta = "fit: Matern-3/2, 2 features, 2 outputs", 0.3
    M, large = (1000, 2000) if quick else (4249, 20_000)
    both = {"size": M, "matrix": M, "M": M}
    for peer in (OURS, "GaussianProcessRegressor", "KernelRidge", "RBFInterpolator"):
        yield case(name, peer, "fit", peer_name=peer, beta=beta, **both)
    yield case(name, "limit: cdist, potrf, potrs", "fit_limit", **both)
    both = {"size": large, "matrix": large, "M": large}
    yield case(name, OURS, "fit", once=True, peer_name=OURS, beta=beta, **both)


def predict_cases(quick, data):
    n, M = (10_000, 1000) if quick else (100_000, 4249)
    name = f"predict: {n:,} rows from {M:,} centres, 2 outputs"
    both = {"n": n, "M": M}
    threads = [("", {}), (", n_jobs=2", {"n_jobs": 2})]
    for title, more in threads:
        more = both | more | {"peer_name": OURS, "beta": 0.3}
        yield case(name, OURS + title, "predict", **more)
    for peer in ("GaussianProcessRegressor", "KernelRidge", "RBFInterpolator"):
        yield case(name, peer, "predict", peer_name=peer, beta=0.3, **both)
    yield case(name, "limit: exp, one thread", "predict_limit", **both)
    for title, more in threads:
        more = both | more | {"peer_name": OURS, "beta": 2.0, "d": 30}
        yield case(name, f"{OURS}, 30 features{title}", "predict", **more)


def search_cases(quick, data):
    if data is None or not data.exists():
        print("\nsearch: skipped, its data is absent (--data)")
        return
    for method, folds, n_rows, share in (
        ("interpolation", "trial", 2500, 1.0),
        ("interpolation", "stride", 2500, 0.1),
        ("least_squares", "trial", None, 0.1),
        ("least_squares", "stride", None, 0.025),
    ):
        name = f"search: {method}, leave one {folds} out"
        both = {
            **{"path": str(data), "method": method, "folds": folds},
            "n_rows": 500 if quick else n_rows,  # None takes all
            "separation": 0.3 if quick else 0.098,
            "shape": (2, 3, 2) if quick else (4, 10, 5),  # kernels, betas, alphas
        }
        slow = method == "least_squares"
        yield case(name, f"{OURS}CV", "search_closed", once=slow, **both)
        # Every row would be a centre of KernelRidge, and least squares has them all.
        for peer in (OURS, "KernelRidge")[: 1 if slow else 2]:
            both |= {"once": True, "peer_name": peer, "share": share}
            yield case(name, f"GridSearchCV({peer})", "search_refits", **both)


def sparse_cases(quick, data):
    name = "sparse: Wendland C2, 40 neighbours, on a surface, 2 outputs"
    sizes = [10**4, 3 * 10**4, 10**5, 3 * 10**5, 10**6]
    for M in [6000, 10_000, 15_000] if quick else sizes:
        yield case(name, OURS, "sparse_fit", size=M, once=M > 10**5, M=M)
        if M <= 30_000:
            for peer in ("spsolve", "splu"):
                title = f"SciPy {peer}"
                yield case(name, title, "sparse_scipy", size=M, M=M, function=peer)
    n, sizes = (10_000, [10**4]) if quick else (100_000, [10**5, 10**6])
    name = f"sparse: predict {n:,} rows"
    for M in sizes:
        both = {"size": M, "once": M > 10**5, "n": n, "M": M}
        yield case(name, OURS, "sparse_predict", **both)
        title = "SciPy sparse_distance_matrix"
        yield case(name, title, "sparse_predict", scipy=True, **both)


def iterative_cases(quick, data):
    name = "iterative: Matern-3/2, random points in 2-D, 2 outputs"
    for M in [500, 1000, 2000] if quick else [5000, 10_000, 20_000, 50_000]:
        both = {"size": M, "once": M > 10_000, "matrix": M, "M": M, "beta": 0.1}
        yield case(name, "ConjugateGradient(tol=1e-6)", "iterative", tol=1e-6, **both)
        if M <= 20_000:
            yield case(name, 'solver="cholesky"', "iterative", **both)


def stream_cases(quick, data):
    n, size = (10**5, 10**4) if quick else (10**7, 10**5)
    name = f"stream: {n:,} rows in batches of {size:,}"
    both = {"n": n, "batch": size, "separation": 0.15}
    yield case(name, f"{SELECTOR}.partial_fit", "stream", **both)
    yield case(name, f"{SELECTOR}.fit of all", "stream", whole=True, **both)
    title = "deeptime RegularSpace.partial_fit"
    yield case(name, title, "stream", once=True, deep=True, **both)
    M = 1000 if quick else 4000
    name = f"stream: 100 rows more than {M:,} centres"
    both = {"matrix": M, "M": M, "n_new": 100, "beta": 0.3}
    yield case(name, f"{OURS}.partial_fit", "update", **both)
    yield case(name, f"{OURS}.fit of all", "update", refit=True, **both)


TASKS = {
    "select": select_cases,
    "fit": fit_cases,
    "predict": predict_cases,
    "search": search_cases,
    "sparse": sparse_cases,
    "iterative": iterative_cases,
    "stream": stream_cases,
}


def work(request):
    """Measure one case in this process and print the result as JSON."""
    request = json.loads(request)
    # An array too large is a MemoryError here, not the end of other processes.
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    memory = memory if hard == resource.RLIM_INFINITY else min(memory, hard)
    resource.setrlimit(resource.RLIMIT_AS, (memory, hard))
    try:
        import peer_workers

        run = getattr(peer_workers, request["worker"])(**request["arguments"])
        next(run)
    except ModuleNotFoundError as error:
        print(json.dumps({"skipped": str(error)}))
        return
    with contextlib.suppress(OSError):  # Linux only
        # Forget the peak of the set-up, which may hide that of what is measured.
        Path("/proc/self/clear_refs").write_text("5")
    before = peak_memory()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        start = time.perf_counter()
        next(run)
        seconds = time.perf_counter() - start
    memory = peak_memory() - before
    answer, notes = next(run)
    if caught:
        kinds = sorted({warning.category.__name__ for warning in caught})
        notes["warned"] = f"{', '.join(kinds)} ({len(caught)})"
    if answer is not None and request["answer"]:
        np.save(request["answer"], answer)
    seconds *= notes.pop("times", 1)
    print(json.dumps({"seconds": seconds, "memory": memory, "notes": notes}))


def peak_memory():
    """Return the largest memory that the process has had, in bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def measure(case, time_limit):
    """Run one case in a process of its own; note the result, or why there is none."""
    with tempfile.TemporaryDirectory() as folder:
        answer = None if case.runs else str(Path(folder, "answer.npy"))
        request = {"worker": case.worker, "arguments": case.arguments, "answer": answer}
        command = [sys.executable, __file__, "--worker", json.dumps(request)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=time_limit
            )
        except subprocess.TimeoutExpired:
            case.stopped = f"more than {time_limit:.0f} s"
            return
        if done.returncode != 0:
            lines = done.stderr.strip().splitlines() or [f"exit {done.returncode}"]
            case.stopped = "failed: " + lines[-1].replace("|", "/")[:150]
            return
        result = json.loads(done.stdout.strip().splitlines()[-1])
        if "skipped" in result:
            case.stopped = f"skipped: {result['skipped']}"
            return
        case.runs.append(result)
        if answer and Path(answer).exists():
            case.answer = np.load(answer)


def run_all(cases, repeats, time_limit):
    for repeat in range(repeats):
        for case in cases:
            if case.stopped or (repeat and case.once):
                continue
            measure(case, time_limit)
            shown = case.stopped or f"{case.seconds[-1]:.3g} s"
            size = "" if case.size is None else f" {case.size:,}"
            row = f"{case.table} / {case.peer}{size}"
            print(f"[{repeat + 1}/{repeats}] {row}: {shown}", file=sys.stderr)


def table(cases):
    """Lay out the rows of one table, leaving out columns that are empty throughout."""
    rows = []
    for case in cases:
        peers = [other for other in cases if other.size == case.size]
        first = peers[0]
        limit = next((other for other in peers if "limit" in other.peer), None)
        row = {"size": "" if case.size is None else f"{case.size:,}", "peer": case.peer}
        notes = dict(case.runs[0]["notes"]) if case.runs else {}
        if case.runs:
            memory = np.median([run["memory"] for run in case.runs])
            row |= {
                "seconds": spread(case.seconds),
                "to the first": ratio(case, first) if len(peers) > 1 else "",
                "to the limit": ratio(case, limit),
                "MB": f"{memory / 1e6:,.0f}",
                "M x M": f"{memory / 8 / case.matrix**2:.2f}" if case.matrix else "",
                "difference": "" if case is first else difference(case, first),
            }
            best = first.runs[0]["notes"].get("winner") if first.runs else None
            if case is not first and best and "winner" in notes:
                notes["the same"] = "yes" if notes["winner"] == best else "NO"
        shown = [f"{key} {value}" for key, value in notes.items()]
        row["notes"] = "; ".join(shown + [case.stopped] * bool(case.stopped))
        rows.append(row)
    columns = [
        *("size", "peer", "seconds", "to the first", "to the limit"),
        *("MB", "M x M", "difference", "notes"),
    ]
    columns = [name for name in columns if any(row.get(name) for row in rows)]
    left = ("peer", "notes")
    yield "| " + " | ".join(columns) + " |"
    yield "|" + "|".join(" --- " if c in left else " ---: " for c in columns) + "|"
    for row in rows:
        yield "| " + " | ".join(row.get(name, "") for name in columns) + " |"
    for peer in dict.fromkeys(case.peer for case in cases):
        points = [
            (case.size, np.median(case.seconds))
            for case in cases
            if case.peer == peer and case.size and case.runs
        ]
        if len(points) > 1:
            slope = np.polyfit(*np.log(points).T, 1)[0]
            yield f"\nGrowth of {peer}: size^{slope:.2f} over {len(points)} sizes."


def spread(seconds):
    median = f"{np.median(seconds):.3g}"
    if len(seconds) == 1:
        return median
    return f"{median} ({min(seconds):.3g} to {max(seconds):.3g})"


def ratio(case, other):
    if other is None or not other.runs:
        return ""
    return f"{np.median(case.seconds) / np.median(other.seconds):.2f}"


def difference(case, first):
    a, b = case.answer, first.answer
    if a is None or b is None:
        return ""
    if a.shape != b.shape:
        return f"shape {a.shape}, not {b.shape}"
    if np.array_equal(a, b):
        return "identical"
    return f"{np.nanmax(np.abs(a - b)) / np.nanmax(np.abs(b)):.1e}"


def versions():
    names = "numpy", "scipy", "scikit-learn", "deeptime", "sklearn-koopman"
    yield f"Python {platform.python_version()}"
    for name in names:
        try:
            yield f"{name} {importlib.metadata.version(name)}"
        except importlib.metadata.PackageNotFoundError:
            yield f"{name} not installed"
    yield f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=list(TASKS))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="at reduced sizes")
    parser.add_argument("--data", type=Path, help="recorded walking, for the search")
    parser.add_argument(
        "--time-limit", type=float, default=900.0, help="of a process, in seconds"
    )
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.worker:
        work(options.worker)
        return
    print(", ".join(versions()))
    for task in options.tasks:
        cases = list(TASKS[task](options.quick, options.data))
        run_all(cases, options.repeats, options.time_limit)
        for name in dict.fromkeys(case.table for case in cases):
            print(f"\n**{name}**\n")
            shown = [case for case in cases if case.table == name]
            print("\n".join(table(shown)), flush=True)


if __name__ == "__main__":
    main()
