# SPDX-License-Identifier: Apache-2.0
"""What a table goes through, and which motions it is not asked for."""

from pathlib import Path

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.table_signals import table_noise
from abrace_core.safety.table_stop import Table
from abrace_plant.records.files import KNOWN_RECORDS, read_record
from abrace_plant.records.options import Treatment
from abrace_plant.records.record import Record
from abrace_plant.records.table_motion import RECORD_REMEDIES, check_motion, table_demands
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.file import load_rig

ROOT = Path(__file__).parents[2]
RIGS = {path.stem: load_rig(path) for path in sorted((ROOT / "src/abrace_plant/config").glob("*.yaml"))}
NCREE = RIGS["ncree_three_storey"].table
G = 9.80665


def refusal(motion: np.ndarray, table: Table = NCREE, remedies: dict = RECORD_REMEDIES, **more: float) -> str:
    """What is said of a motion; empty: it is played."""
    try:
        check_motion(motion, 500.0, table, "any", remedies, **more)
    except AbraceError as error:
        return str(error)
    return ""


def test_the_motion_is_the_exact_one_of_a_sinusoid_and_nothing_is_corrected():
    time = np.arange(1, 1001) / 500
    demands = {demand.name: demand for demand in table_demands(np.sin(2 * np.pi * time), 500.0, NCREE, 0.1)}
    assert demands["acceleration"].value == pytest.approx(1.0, rel=1e-4)
    assert demands["jerk"].value == pytest.approx(2 * np.pi, rel=1e-3)
    assert demands["velocity"].value == pytest.approx(1 / np.pi, rel=1e-4)
    assert demands["displacement"].value == pytest.approx(0.1 + 2 / (2 * np.pi), rel=1e-3)
    assert demands["displacement"].exceeded


@pytest.mark.parametrize("name", KNOWN_RECORDS)
@pytest.mark.parametrize("duration", [0.0, 10.0, 100.0])
def test_the_papers_motions_are_played_untreated(name, duration):
    motion = prepare(read_record(name), 500.0, Treatment(band_limit=25.0, peak_acceleration=0.1 * G, duration=duration))
    assert refusal(motion) == ""


@pytest.mark.parametrize("rig", RIGS)
def test_the_default_white_noise_is_played_by_every_table_of_the_folder(rig):
    for seed in (1, 2):
        assert refusal(table_noise(120_000, 500.0, (0.1, 10.0), 0.25, seed), RIGS[rig].table) == ""


def test_what_is_beyond_each_limit_is_named_with_value_time_limit_and_what_to_do():
    record = prepare(read_record("el_centro"), 500.0, Treatment(peak_acceleration=30.0))
    told = refusal(record)
    assert told.startswith("ground motion any exceeds the table's limits: acceleration 30 m/s^2 at 2.17")
    assert "the table's limit is 10, expected a smaller peak_acceleration; velocity 3.3" in told
    assert "displacement 0.94" in told
    assert " m at 5.140 s, the table's limit is 0.25, expected a low_cut" in told
    share = float(told.rpartition("; scaled by ")[2].partition(" it would fit")[0])
    assert refusal(share * record) == ""
    assert refusal(1.01 * share * record)
    step = np.concatenate([np.full(10, 4.5), np.full(10, -4.5), [0.0]])
    assert (
        "jerk 4500 m/s^3 at 0.018 s, the table's limit is 2000, expected a smaller peak_acceleration, or a"
        in refusal(step)
    )
    pulse = 0.5 * np.sin(np.linspace(0, np.pi, 100))
    assert "velocity at the end 0.06" in refusal(pulse)


@pytest.mark.parametrize("treatment", [Treatment(baseline="constant"), Treatment(low_cut=0.1, taper=1.0)])
def test_a_record_that_drifts_is_refused_and_played_once_it_is_treated(treatment):
    whole = read_record("el_centro")
    drifting = Record("drifting", whole.sample_period, whole.acceleration + 0.02)
    told = refusal(prepare(drifting, 500.0))
    assert "displacement 28" in told
    assert "a low_cut (with a taper), a baseline" in told
    assert refusal(prepare(drifting, 500.0, treatment)) == ""


def test_a_motion_begins_where_the_table_stands():
    motion = prepare(read_record("el_centro"), 500.0)
    assert refusal(motion, displacement=0.1) == ""
    assert "displacement 0.28" in refusal(motion, displacement=-0.2)


def test_a_motion_that_is_not_finite_is_refused():
    assert "acceleration nan" in refusal(np.array([0.0, np.nan, 0.0]))
