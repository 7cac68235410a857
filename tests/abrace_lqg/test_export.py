# SPDX-License-Identifier: Apache-2.0
"""A controller exported as C99 and as a co-simulation unit commands what the node commands."""

import math
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from exported import InC, compiled, unit_answers

from abrace_core import AbraceError
from abrace_core.model.controller_file import Controller
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.signals import response_names
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_lqg.active_controller import ActiveController
from abrace_lqg.export.c_sources import c_sources, write_c
from abrace_lqg.export.fmu import write_fmu

PERIOD = 0.002
NAMES = response_names(3, 2)
RATE_LIMIT = 1e5
RAMP = 0.1
SAMPLES = 1000


def controller(measured: tuple[str, ...] = ("a1", "a2", "a3"), held: int = 1) -> Controller:
    """Six states, two commands, gains with which forces reach both limits; it answers one of `held` samples."""
    random = np.random.default_rng(3)
    a = random.normal(size=(6, 6))
    a *= 0.95 / np.abs(np.linalg.eigvals(a)).max()
    law = LinearModel(
        a,
        random.normal(size=(6, len(measured))),
        300 * random.normal(size=(2, 6)),
        100 * random.normal(size=(2, len(measured))),
        inputs=measured,
        outputs=("U1", "U2"),
        sample_period=held * PERIOD,
    )
    correction, prediction = 1e-4 * random.normal(size=(6, 2)), random.normal(size=(len(measured), 8))
    limit = np.array([2000.0, 3000.0])
    return Controller("lqg*/3", law, correction, prediction, limit, "of a test */", "-", "-", PERIOD)


def measured() -> np.ndarray:
    """Noise in bursts: forces within the limits and beyond both."""
    random = np.random.default_rng(4)
    return random.normal(size=(SAMPLES, len(NAMES))) * np.repeat([0.3, 3.0, 0.1, 10.0], SAMPLES // 4)[:, np.newaxis]


def node_answers(of: Controller, samples: np.ndarray, acting: list[float]) -> tuple[np.ndarray, CommandGuard]:
    """What the node `controller` commands: its law, faded in, its limits, and the estimate with what was applied."""
    law = ActiveController(of, RAMP)
    guard = CommandGuard(of.force_limit, [RATE_LIMIT] * 2, PERIOD, RAMP_TIME)
    guard.value = list(acting)
    law.reset(NAMES, of.law.outputs, np.array(acting))
    found = []
    for values in samples:
        guard.follow(law.force(values.tolist(), 0).tolist())
        law.advance(guard.value)
        found.append(guard.value)
    return np.array(found), guard


def picked(samples: np.ndarray) -> np.ndarray:
    return samples[:, [NAMES.index(name) for name in ("a1", "a2", "a3")]]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported") / "lqg3_c"
    write_c(controller(), folder, RATE_LIMIT, RAMP)
    return compiled(folder)


@pytest.mark.parametrize("acting", [[0.0, 0.0], [500.0, -900.0]])
def test_the_c_controller_commands_what_the_node_commands(library: Path, acting: list[float]):
    expected, guard = node_answers(controller(), measured(), acting)
    assert guard.saturations > 10
    assert guard.rate_limits > 10
    in_c = InC(library, 6, 2)
    in_c.start(acting)
    found = np.array([in_c.step(values)[0] for values in picked(measured())])
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("held", [2, 5])
def test_a_slower_controller_answers_the_same_samples_in_c(tmp_path: Path, held: int):
    slower = controller(held=held)
    write_c(slower, tmp_path, RATE_LIMIT, RAMP)
    expected, guard = node_answers(slower, measured(), [500.0, -900.0])
    assert guard.saturations > 10
    assert guard.rate_limits > 10
    in_c = InC(compiled(tmp_path), 6, 2)
    for _ in range(2):
        in_c.start([500.0, -900.0])
        found = np.array([in_c.step(values)[0] for values in picked(measured())[: SAMPLES - 1]])
        assert np.abs(found - expected[:-1]).max() <= 1e-12 * np.abs(expected).max()
    assert "#define ABRACE_SAMPLE_PERIOD 0.002 " in (tmp_path / "constants.h").read_text()


@pytest.mark.parametrize("held", [1, 5])
def test_the_co_simulation_unit_commands_what_the_node_commands(tmp_path: Path, held: int):
    pytest.importorskip("fmpy", reason="fmpy is not installed")
    write_fmu(controller(held=held), tmp_path / "lqg3.fmu", RATE_LIMIT, RAMP)
    expected, _ = node_answers(controller(held=held), measured(), [0.0, 0.0])
    found = unit_answers(tmp_path / "lqg3.fmu", ("a1", "a2", "a3"), ("U1", "U2"), picked(measured()), PERIOD)
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()
    with zipfile.ZipFile(tmp_path / "lqg3.fmu") as unit:
        assert {"sources/controller.c", "sources/constants.c", "sources/fmu.c"} < set(unit.namelist())
        assert b'stepSize="0.002"' in unit.read("modelDescription.xml")


def test_a_unit_of_fmi_keeps_to_its_schema_and_refuses_other_steps(tmp_path: Path):
    pytest.importorskip("fmpy", reason="fmpy is not installed")
    from fmpy.fmi1 import FMICallException
    from fmpy.validation import validate_fmu

    write_fmu(controller(), tmp_path / "lqg3.fmu", RATE_LIMIT, RAMP)
    assert validate_fmu(str(tmp_path / "lqg3.fmu")) == []
    with pytest.raises(FMICallException, match="fmi2DoStep failed"):
        unit_answers(tmp_path / "lqg3.fmu", ("a1", "a2", "a3"), ("U1", "U2"), picked(measured()), 2 * PERIOD)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e308])
def test_a_value_that_is_not_finite_ramps_the_force_to_zero_for_good(library: Path, bad: float):
    in_c = InC(library, 6, 2)
    samples = picked(measured())
    before = in_c.answers(samples[:400])[-1]
    assert np.abs(before).max() > 100
    guard = CommandGuard(controller().force_limit, [RATE_LIMIT] * 2, PERIOD, RAMP_TIME)
    guard.value = before.tolist()
    guard.begin_to_rest()
    wrong = samples[400].copy()
    wrong[1] = bad
    for values in (wrong, *samples[:300]):
        guard.come_to_rest()
        force, stopped = in_c.step(values)
        assert stopped
        assert np.allclose(force, guard.value, rtol=0, atol=1e-9)
    assert force == [0.0, 0.0]
    in_c.start([0.0, 0.0])
    assert not in_c.step(samples[0])[1]


def test_a_step_needs_no_heap_and_no_library_but_cos(library: Path):
    listed = subprocess.run(["nm", "-D", "--undefined-only", str(library)], capture_output=True, text=True, check=True)
    needed = {line.split()[-1].partition("@")[0] for line in listed.stdout.splitlines() if " U " in line}
    assert needed <= {"cos", "__stack_chk_fail"}


def test_a_limit_that_cannot_be_used_is_refused():
    with pytest.raises(AbraceError, match=r"^rate_limit: 100 N/s, expected at least \d+ N/s to bring 2000 N to zero"):
        c_sources(controller(), 100.0, RAMP)
    for ramp in (-1.0, math.nan, math.inf):
        with pytest.raises(AbraceError, match=r"^ramp_time .* s, expected 0 or more$"):
            c_sources(controller(), RATE_LIMIT, ramp)


def test_a_unit_without_a_compiler_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CC", "no_such_compiler -O1")
    with pytest.raises(AbraceError, match=r"^no C compiler 'no_such_compiler -O1', expected one to compile the unit"):
        write_fmu(controller(), tmp_path / "lqg3.fmu", RATE_LIMIT, RAMP)
    assert not list(tmp_path.iterdir())


def test_names_of_another_rig_are_exported_without_a_unit(tmp_path: Path):
    sources = c_sources(controller(("disp/3", "vel", "a*/1")), RATE_LIMIT, RAMP)
    assert "measured[0]  disp/3 [-]" in sources["constants.h"]
    for name, text in sources.items():
        (tmp_path / name).write_text(text)
    assert compiled(tmp_path).is_file()
