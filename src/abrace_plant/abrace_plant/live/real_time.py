# SPDX-License-Identifier: Apache-2.0
"""A run of a rig in real time: a thread sends commands to the device, waits for its sample, and publishes it.

Samples are never more than `LONGEST_BURST` ahead of the clock, whatever the device does: ramps count samples. Before
the target is armed they may be: so no old ones wait in the device, and one that is too quick is found.
"""

from __future__ import annotations

import math
import threading
import time
from typing import TYPE_CHECKING

from abrace_plant.devices.device import DeviceError

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_plant.devices.device import Device
    from abrace_plant.live.loop import RigLoop, Sample

ANSWER_SHARE = 0.8
"""Share of the sample period after its tick within which answers to a sample must arrive; later ones act a sample
later."""
SLOW_SHARE = 0.4
"""The same for a sender that has been slow: its answers act a sample later anyway, and if it were waited for until
ANSWER_SHARE all commands, also those to the table, would often reach the hardware after its next tick."""
SENDING_SHARE = 0.1
"""Share of the sample period that a command may take until the device has it."""
LONGEST_BURST = 0.01
"""Seconds by which a device's samples may be ahead of the clock, after it was delayed."""
FASTEST = 1.008
"""Share of the rig's sample rate at which a device makes up for a delay; one that goes on so is too quick (`Ticks`),
and by stamps of its arrival no sample is."""


class RealTimeRun(threading.Thread):
    """Runs a rig until its end is requested and all is at rest.

    Parameters
    ----------
    loop, device
        Of the run; the device is open.
    sample_period
        [s].
    lock
        Held by whoever uses the loop; released while the device is waited for.
    publish
        Called with each sample, and with None where the device has failed instead, with the lock.
    over
        Called, without the lock, when the run is over; what broke it off, and why the device could not be made safe or
        closed, is in `errors`.
    prepare
        Called first in the thread.
    """

    def __init__(
        self,
        loop: RigLoop,
        device: Device,
        sample_period: float,
        lock: threading.RLock,
        publish: Callable[[Sample | None], None],
        over: Callable[[], None],
        prepare: Callable[[], None],
    ) -> None:
        super().__init__(name="rig", daemon=True)
        self._loop, self._device = loop, device
        self._period, self._publish, self._over, self._prepare = sample_period, publish, over, prepare
        self._input_arrived = threading.Condition(lock)
        self.errors: list[BaseException] = []

    def on_input(self) -> None:
        """An answer has come; called with the lock."""
        if self._loop.has_quick_answers():
            self._input_arrived.notify()

    def run(self) -> None:
        """The thread."""
        self._note_error(self._run)
        # at rest already, but with this message a target need not wait for its time-out
        self._note_error(self._device.make_safe)
        self._note_error(self._device.close)
        self._over()

    def _note_error(self, act: Callable[[], None]) -> None:
        """Do it, and note the error: a device may fail at the end, too."""
        try:
            act()
        except BaseException as error:
            self.errors.append(error)

    def _run(self) -> None:
        self._prepare()
        loop, period, monotonic = self._loop, self._period, time.monotonic
        tick, samples, acted, applied = monotonic(), 1, -math.inf, True
        accounted = -math.inf  # the instant until which the samples so far last
        while not loop.ended:
            with self._input_arrived:
                # where nobody is slow it would only wake this thread while the loop's thread needs the interpreter
                if loop.slow_sender():
                    self._input_arrived.wait_for(loop.has_all_answers, tick + SLOW_SHARE * period - monotonic())
                self._input_arrived.wait_for(loop.has_quick_answers, tick + ANSWER_SHARE * period - monotonic())
                # the last command may have come after this tick: with another one there would be two steps at the next
                if applied and tick > acted + SENDING_SHARE * period:
                    command = loop.act(samples)
                    samples, acted = 0, monotonic()
                else:
                    loop.repeat()
            try:
                reading = loop.exchange(*command)
            except DeviceError as error:
                # a device that fails at once would be asked thousands of times a second, and ramps would be as fast
                time.sleep(max(0.0, tick + period - monotonic()))
                now = monotonic()
                tick, applied, failed = now, True, max(1, round((now - tick) / period))
                samples += failed
                with self._input_arrived:
                    loop.fail(str(error), failed)
                    self._publish(None)
                continue
            tick, applied = monotonic() - max(0.0, reading.age), reading.command_applied
            samples += 1 + reading.missed
            # a device that makes up for a delay without saying so would also make ramps so much faster
            accounted = tick if loop.settles else max(accounted + (1 + reading.missed) * period / FASTEST, tick)
            if (ahead := accounted - LONGEST_BURST - monotonic()) > 0:
                time.sleep(ahead)
            clocks = time.monotonic_ns(), time.time_ns()
            with self._input_arrived:
                self._publish(loop.take(reading, clocks))
