"""Watching the stream of samples that a node answers: lost ones, a restarted rig, a wrong sample rate."""

from __future__ import annotations

from abrace_core.sequence import SequenceCounter

LONGEST_GAP = 5
"""Lost samples in a row that a node may bridge if it is not told otherwise; more are a fault."""


class SampleWatch(SequenceCounter):
    """Looks at each sample's number and stamp.

    Parameters
    ----------
    sample_period
        That the node is made for [s].
    longest_gap
        Lost samples in a row that it may bridge.
    """

    def __init__(self, sample_period: float, longest_gap: int = LONGEST_GAP) -> None:
        super().__init__()
        self._longest_gap = longest_gap
        self._period = sample_period * 1e9
        self._stamp = 0
        self.problem: str | None = None
        """Why the last sample may not be answered as usual; None: all is well."""

    def take(self, sequence: int, stamp: int) -> int:
        """Look at a sample.

        Parameters
        ----------
        sequence
            Its number.
        stamp
            Its instant [ns].

        Returns
        -------
        int
            Samples lost just before it; -1 if the rig has started anew (so for the first sample that is seen).
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
