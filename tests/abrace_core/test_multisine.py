# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.multisine import LINES, multisine, repeated_multisine
from abrace_core.safety.command_guard import CommandGuard

PERIOD = 16384
TABLE, COMMAND = (0.3, 10.0), (0.3, 30.0)


def amplitudes(signal):
    """Of its lines 0, 1, 2, ... times one over the period."""
    return np.abs(np.fft.rfft(signal)) * 2 / len(signal)


def excited(signal):
    return np.flatnonzero(amplitudes(signal) > 1e-6 * amplitudes(signal).max())


@pytest.mark.parametrize("lines", LINES)
def test_amplitudes_are_exact_whatever_the_clipping_did(lines):
    signal = multisine(PERIOD, 500.0, TABLE, 0.25, 1, lines)
    assert np.sqrt(np.mean(signal**2)) == pytest.approx(0.25, rel=1e-12)
    found = excited(signal)
    assert found[0] >= 0.3 * PERIOD / 500
    assert found[-1] <= 10 * PERIOD / 500
    np.testing.assert_allclose(amplitudes(signal)[found], amplitudes(signal)[found[0]], rtol=1e-9)


@pytest.mark.parametrize(("lines", "remainder"), [("odd", 1), ("even", 0)])
def test_of_every_four_odd_or_even_lines_one_is_left_out(lines, remainder):
    found = excited(multisine(PERIOD, 500.0, COMMAND, 1.0, 3, lines))
    possible = np.arange(10, 984)
    possible = possible[possible % 2 == remainder]
    assert set(found) < set(possible)
    fours = possible[: len(possible) // 4 * 4].reshape(-1, 4)
    assert (np.isin(fours, found).sum(axis=1) == 3).all()
    assert len(excited(multisine(PERIOD, 500.0, COMMAND, 1.0, 3, "all"))) == 974


@pytest.mark.parametrize("lines", LINES)
@pytest.mark.parametrize("band", [TABLE, COMMAND])
def test_crest_factor_is_half_that_of_random_phases(lines, band):
    crest = max(np.abs(multisine(2048, 500.0, band, 1.0, seed, lines)).max() for seed in range(3))
    assert crest < 1.7, "random phases give 3 to 4"


def test_groups_with_one_seed_share_its_lines():
    alone = excited(multisine(PERIOD, 500.0, COMMAND, 1800.0, 2))
    shares = [excited(multisine(PERIOD, 500.0, COMMAND, 1800.0, 2, share=(number, 3))) for number in range(3)]
    assert sorted(np.concatenate(shares)) == alone.tolist()


def test_repeated_whole_periods_pass_the_guard_bit_for_bit():
    commands = repeated_multisine(100.0, 32.768, 500.0, COMMAND, 1800.0, 2)
    assert len(commands) == 3 * PERIOD
    assert (commands.reshape(3, PERIOD) == commands[:PERIOD]).all()
    guard = CommandGuard([24500.0], [5.0e6], 0.002, 0.5)
    passed = []
    for force in commands[: PERIOD + 100]:
        guard.follow([force])
        passed.append(guard.value[0])
    assert (np.array(passed) == commands[: PERIOD + 100]).all()
    assert guard.rate_limits == guard.saturations == 0


def test_it_begins_and_ends_at_rest():
    for seed in range(2):
        table, command = multisine(PERIOD, 500.0, TABLE, 1.0, seed), multisine(PERIOD, 500.0, COMMAND, 1.0, seed)
        assert max(abs(table[0]), abs(table[-1]), abs(command[0]), abs(command[-1])) < 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"band": (-1.0, 10.0)}, "band -1.0 to 10.0 Hz: expected 0 <= lowest < highest < 250 Hz"),
        ({"band": (1.01, 1.02)}, r"multisine of 4 s: no line \(odd\) between 1.01 and 1.02 Hz"),
        ({"rms": 0.0}, "rms 0.0: expected more than 0"),
        ({"sample_rate": 0.0}, "sample_rate"),
        ({"seed": -1}, "seed -1: expected 0 or more"),
        ({"lines": "prime"}, "lines 'prime': expected one of all, odd, even"),
        ({"share": (2, 2)}, "share 2 of 2: expected 0 <= number < count"),
    ],
)
def test_bad_argument_is_refused_with_what_was_expected(change, message):
    arguments = {"samples": 2000, "sample_rate": 500.0, "band": (0.3, 10.0), "rms": 1.0, "seed": 0} | change
    with pytest.raises(AbraceError, match=message):
        multisine(**arguments)


@pytest.mark.parametrize(("duration", "period"), [(60.0, 32.768), (60.0, 0.0), (0.0, 10.0)])
def test_less_than_two_periods_are_refused(duration, period):
    with pytest.raises(AbraceError, match="expected at least two periods"):
        repeated_multisine(duration, period, 500.0, TABLE, 1.0, 0)
