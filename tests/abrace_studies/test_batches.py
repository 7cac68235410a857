# SPDX-License-Identifier: Apache-2.0
"""Batches: the same files whichever way they are computed, and what is told when a process is lost."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pyarrow
import pytest

from abrace_core import AbraceError, RunFailed
from abrace_studies.batches import compute as module
from abrace_studies.batches.compute import compute_missing
from abrace_studies.batches.parts import read_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

BATCHES = [(seed, 200) for seed in range(7)]


def products(size: int, batch: tuple[int, int]) -> pyarrow.Table:
    """Sums long enough for more than one thread of linear algebra, and the process that found them."""
    seed, columns = batch
    values = np.random.default_rng(seed).standard_normal((size, columns))
    return pyarrow.table({"sum": (values.T @ values).sum(axis=1), "process": [os.getpid()] * columns})


def killed_once(folder: Path, batch: int) -> pyarrow.Table:
    try:
        (folder / str(batch)).touch(exist_ok=False)
    except FileExistsError:
        return pyarrow.table({"batch": [batch]})
    return os.kill(os.getpid(), signal.SIGKILL)


def divided(_shared: None, batch: int) -> pyarrow.Table:
    return pyarrow.table({"value": [1 // batch]})


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A Dask scheduler with a worker, which can import this module."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=None
    ) as running:
        yield running.scheduler_address


def computed(folder: Path, **how: object) -> tuple[list[float], set[int]]:
    """The sums, and the processes that found them."""
    progress: list[tuple[int, int]] = []
    compute_missing(products, 3000, BATCHES, folder, progress=lambda *done: progress.append(done), **how)
    assert progress == [(done, 7) for done in range(8)]
    table = read_parts(folder)
    return table["sum"].to_pylist(), set(table["process"].to_pylist())


def test_process_pool_and_scheduler_give_the_same_numbers(tmp_path, scheduler):
    here, processes = computed(tmp_path / "process", workers=1)
    assert processes == {os.getpid()}
    pool, processes = computed(tmp_path / "pool", workers=2)
    assert os.getpid() not in processes
    assert len(processes) == 2
    assert computed(tmp_path / "dask", scheduler=scheduler)[0] == here == pool
    assert not multiprocessing.active_children()


def test_a_few_batches_are_computed_in_this_process_and_many_by_a_process_for_each_core(tmp_path, monkeypatch):
    monkeypatch.setattr(module.os, "sched_getaffinity", lambda _process: {0, 1, 2})
    compute_missing(products, 10, BATCHES[: module.FEW], tmp_path / "few")
    assert set(read_parts(tmp_path / "few")["process"].to_pylist()) == {os.getpid()}
    compute_missing(products, 10, BATCHES[: module.FEW + 1], tmp_path / "many")
    assert os.getpid() not in set(read_parts(tmp_path / "many")["process"].to_pylist())


def test_the_script_that_runs_is_left_as_it_is(tmp_path):
    before = dict(vars(sys.modules["__main__"]))
    computed(tmp_path, workers=2)
    assert vars(sys.modules["__main__"]) == before


def test_after_a_killed_process_the_same_call_goes_on(tmp_path):
    (tmp_path / "killed").mkdir()
    with pytest.raises(RunFailed, match="a process that computed was killed"):
        compute_missing(killed_once, tmp_path / "killed", [1, 2, 3], tmp_path / "found", workers=2)
    for _ in range(10):
        with contextlib.suppress(RunFailed):
            compute_missing(killed_once, tmp_path / "killed", [1, 2, 3], tmp_path / "found", workers=2)
    assert read_parts(tmp_path / "found")["batch"].to_pylist() == [1, 2, 3]


@pytest.mark.parametrize("how", [{"workers": 1}, {"workers": 2}])
def test_what_fails_is_named_and_what_is_done_stays(tmp_path, how):
    with pytest.raises(RunFailed, match="the work failed: ZeroDivisionError"):
        compute_missing(divided, None, [1, 0, 1], tmp_path, **how)
    assert (tmp_path / "part-000000.parquet").exists() or how["workers"] == 2


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", "nothing"])
def test_a_scheduler_that_does_not_answer_is_named(address, tmp_path):
    with pytest.raises(AbraceError, match=f"Dask scheduler {address}: does not answer"):
        compute_missing(divided, None, [1], tmp_path / "none", scheduler=address)
    assert not (tmp_path / "none").exists()


LOOPS = """
import sys
import numpy as np
from abrace_core.model.linear_model import LinearModel
from abrace_studies.batches.loop_extremes import Motions
from abrace_studies.fragility.loops import compute_batch
from abrace_studies.fragility.study import FragilityStudy
model = LinearModel([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], ("w", "U"), ("x1",))
study = FragilityStudy((model,), (), (), Motions.of([np.ones(100)]), ("one",), (1.0,), 0.002)
assert len(compute_batch(study, study.cases())) == 1
print(sorted({"control", "matplotlib"} & set(sys.modules)))
"""


def test_loops_that_are_counted_in_millions_import_neither_python_control_nor_figures():
    ended = subprocess.run([sys.executable, "-c", LOOPS], capture_output=True, text=True, timeout=120, check=False)
    assert (ended.stdout, ended.returncode) == ("[]\n", 0), ended.stderr
