# SPDX-License-Identifier: Apache-2.0
"""Detection of changes of a building: the modes of two ambient tests compared by a significance test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from abrace_core import AbraceError
from abrace_core.model.modes import match_modes, modal_assurance
from abrace_core.model.verdict import judged
from abrace_sysid.ambient.modes import ambient_test

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_sysid.ambient.modes import AmbientMode, AmbientOptions, AmbientTest
    from abrace_sysid.recorded.test import Test


SAME_FREQUENCY, SAME_SHAPE = 0.2, 0.6
"""Modes of two tests are matched if their frequencies differ by less than SAME_FREQUENCY (relative) and their modal
assurance criterion is above SAME_SHAPE."""
SIGNIFICANCE = 0.01
"""Probability of a false alarm over all modes of an unchanged building."""


@dataclass(frozen=True)
class ModeChange:
    """One mode found in both tests.

    Parameters
    ----------
    assurance
        Modal assurance criterion of the two shapes.
    probability
        Probability that frequency and damping ratio differ at least as much in an unchanged building.
    """

    before: AmbientMode
    after: AmbientMode
    assurance: float
    probability: float

    @property
    def frequency_change(self) -> float:
        """Relative change of the frequency."""
        return self.after.frequency / self.before.frequency - 1

    @property
    def damping_change(self) -> float:
        """Relative change of the damping ratio."""
        return self.after.damping / self.before.damping - 1


@dataclass(frozen=True)
class BuildingChange:
    """The comparison of two ambient tests of one building.

    Parameters
    ----------
    modes
        Modes found in both tests, lowest frequency first.
    gone, new
        Modes found only in the first test, and only in the second.
    """

    modes: tuple[ModeChange, ...]
    gone: tuple[AmbientMode, ...]
    new: tuple[AmbientMode, ...]

    @property
    def changed(self) -> tuple[ModeChange, ...]:
        """The modes that have changed significantly (Bonferroni correction for their number), or may have: NaN."""
        return tuple(mode for mode in self.modes if judged(-mode.probability, -SIGNIFICANCE / len(self.modes)))

    @property
    def words(self) -> str:
        """What the comparison says of the building."""
        if not self.modes:
            return "no mode is in both tests: nothing can be said of the building"
        return "the building has changed" if self.changed else "no change beyond chance"


def compare_tests(before: AmbientTest, after: AmbientTest) -> BuildingChange:
    """Compare two ambient tests by Hotelling's T squared of each mode's frequency and damping ratio.

    Parameters
    ----------
    before, after
        The two tests, with the same channels.

    Raises
    ------
    AbraceError
        If the channels differ.
    """
    if before.channels != after.channels:
        raise AbraceError(
            f"{after.source}: channels {', '.join(after.channels)}, expected those of {before.source}: "
            f"{', '.join(before.channels)}"
        )
    pairs = _matched(before, after)
    freedom = before.pieces + after.pieces - 2
    changes = tuple(_change(before.modes[i], after.modes[j], freedom) for i, j in pairs)
    known, found = {i for i, _ in pairs}, {j for _, j in pairs}
    return BuildingChange(
        changes,
        tuple(mode for i, mode in enumerate(before.modes) if i not in known),
        tuple(mode for j, mode in enumerate(after.modes) if j not in found),
    )


def _matched(before: AmbientTest, after: AmbientTest) -> list[tuple[int, int]]:
    if not before.modes or not after.modes:
        return []
    alike = modal_assurance(*(np.array([mode.shape for mode in test.modes]) for test in (before, after)))
    first, second = ([mode.frequency for mode in test.modes] for test in (before, after))
    return match_modes(first, second, alike, SAME_SHAPE, SAME_FREQUENCY)


def _change(before: AmbientMode, after: AmbientMode, freedom: int) -> ModeChange:
    difference = np.array([after.frequency - before.frequency, after.damping - before.damping])
    squared = float(difference @ np.linalg.solve(before.covariance + after.covariance, difference))
    probability = float(stats.f.sf(squared * (freedom - 1) / (2 * freedom), 2, freedom - 1))
    assurance = float(modal_assurance(before.shape[None], after.shape[None])[0, 0])
    return ModeChange(before, after, assurance, probability)


def compared_tests(
    tests: Sequence[Test], before: Sequence[Test], options: AmbientOptions
) -> tuple[AmbientTest, AmbientTest, BuildingChange]:
    """A later and an earlier test, both in the band of the earlier one, and what has changed between them.

    Parameters
    ----------
    tests, before
        The later and the earlier tests, as for `ambient_test`.
    options
        Channels, band and highest order.
    """
    earlier = ambient_test(before, options)
    # in one band, or a difference could be that of the bands
    later = ambient_test(tests, options.model_copy(update={"band": earlier.band}))
    return later, earlier, compare_tests(earlier, later)
