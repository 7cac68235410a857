"""Checks of the stream of samples that a node answers: lost samples, a restarted rig, a wrong sample rate."""

from __future__ import annotations

from abrace_core.sequence import SequenceCounter

LONGEST_GAP = 5
"""Lost samples in a row that a node bridges by default; more are a fault."""


class SampleWatch(SequenceCounter):
    """Checks each sample's number and stamp.

    Parameters
    ----------
    sample_period
        Expected [s].
    longest_gap
        Lost samples in a row that the node bridges.
    """

    def __init__(self, sample_period: float, longest_gap: int = LONGEST_GAP) -> None:
        super().__init__()
        self._longest_gap = longest_gap
        self._period = sample_period * 1e9
        self._stamp = 0
        self.problem: str | None = None
        """Why the last sample is a fault; None: it is not."""

    def update(self, sequence: int, stamp: int) -> int:
        """Check the next sample.

        Parameters
        ----------
        sequence
            Its number.
        stamp
            Its sampling instant [ns].

        Returns
        -------
        int
            Samples lost just before it; -1 if it is the first one, or the first after a restart of the rig.
        """
        lost = self.add(sequence)
        elapsed, self._stamp = stamp - self._stamp, stamp
        if lost < 0:
            self.problem = None
            return -1
        steps = lost + 1
        if lost > self._longest_gap:
            self.problem = f"{lost} samples lost before sample {sequence}, at most {self._longest_gap} can be bridged"
        elif abs(elapsed - steps * self._period) > 0.5 * self._period:
            self.problem = (
                f"sample {sequence} comes {elapsed / steps * 1e-6:g} ms after the one before, "
                f"expected {self._period * 1e-6:g} ms (sample rate)"
            )
        else:
            self.problem = None
        return lost
