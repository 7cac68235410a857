# SPDX-License-Identifier: Apache-2.0
"""What a viewer is shown of a rig, 50 times a second: named channels, the floors' places, columns and braces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from abrace_bags.definitions import message_definition
from abrace_bringup.viewing.decimation import extremes
from abrace_bringup.viewing.named_channels import ResponseReader, message, names_of, schema
from abrace_bringup.viewing.scene import Scene, scene_update
from abrace_bringup.viewing.server import CHANNELS, DESCRIPTION, FRAMES, SCENE
from abrace_core.errors import AbraceError
from abrace_plant.rig.robot_description import urdf

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_bringup.viewing.named_channels import Samples
    from abrace_bringup.viewing.scene import Picture
    from abrace_bringup.viewing.server import ViewServer
    from abrace_plant.rig.model import Rig

PARTS = 2
"""Messages of named channels from one window: one of the smaller and one of the larger values, or the other way round.
A window is as many displays long, so that these come 50 times a second, too."""


class Pictures(Protocol):
    """Who draws pictures of the building besides the server's viewers."""

    @property
    def wanted(self) -> bool:
        """Whether anybody looks."""

    def take(self, picture: Picture, time: int) -> None:
        """Draw a picture of a `time` [ns]."""


class Display:
    """Sends messages made from the samples of a rig to a server.

    Parameters
    ----------
    server
        Where viewers are.
    rig
        Whose samples come.
    pictures
        Who else is given each picture of the columns and braces, with its time [ns], and whether they want it.
    """

    def __init__(self, server: ViewServer, rig: Rig, pictures: Pictures) -> None:
        self._server = server
        self._pictures = pictures
        self._rig = rig
        self._reader = ResponseReader(rig.capacity.tolist())
        self._scene = Scene(rig)
        self._new: tuple[list[int], list[bytes]] = [], []
        self._window: list[tuple[NDArray[np.int64], Samples]] = []
        self.samples = 0
        """Samples so far."""
        self.problem = ""
        """Why nothing, or not everything, can be shown; empty: nothing is wrong."""
        server.open_channels(schema(names_of(rig.floors, rig.braces_in_group)))
        server.offer(DESCRIPTION, message_definition("std_msgs/msg/String"))
        server.send(DESCRIPTION, _string(urdf(rig)), 0, latched=True)

    @property
    def wanted(self) -> bool:
        """Whether a client shows any of it."""
        return self._pictures.wanted or any(self._server.wanted(topic) for topic in (CHANNELS, FRAMES, SCENE))

    def add(self, payload: bytes, time: int) -> None:
        """Take a Response, given as its `payload`, of a `time` [ns]."""
        times, payloads = self._new
        times.append(time)
        payloads.append(payload)

    def finish(self, exaggeration: float) -> None:
        """Send all that has come, before time steps back; `exaggeration` as for `show`."""
        self.show(exaggeration)
        self._send_window()

    def show(self, exaggeration: float) -> None:
        """Send what has come since the last time.

        Parameters
        ----------
        exaggeration
            Times which displacements are drawn enlarged.
        """
        (times, payloads), self._new = self._new, ([], [])
        if not payloads:
            self._send_window()
            return
        try:
            samples = self._reader.read(payloads)
        except AbraceError as error:
            self.problem = f"response: {error}"
            return
        self.samples += len(payloads)
        last = samples.last
        floors = sum(name[0] == "x" and name[1:].isdigit() for name in samples.names)
        self.problem = (
            ""
            if floors == self._rig.floors
            else f"response has {floors} floors, {self._rig.name} has {self._rig.floors}: expected -p rig:= that rig"
        )
        if not self.problem and self._server.wanted(FRAMES):
            self._server.send(FRAMES, self._scene.frames(last, exaggeration, times[-1]).encode(), times[-1])
        scene, pictures = self._server.wanted(SCENE), self._pictures.wanted
        if not self.problem and (scene or pictures):
            picture = self._scene.picture(samples.loaded, exaggeration)
            if scene:
                self._server.send(SCENE, scene_update(picture, times[-1]).encode(), times[-1])
            if pictures:
                self._pictures.take(picture, times[-1])
        self._window.append((np.array(times[-len(samples.values) :], np.int64), samples))
        if len(self._window) == PARTS:
            self._send_window()

    def _send_window(self) -> None:
        window, self._window = self._window, []
        if not window:
            return
        samples = window[-1][1]
        same = [part for part in window if part[1].names == samples.names]
        times, values = extremes(
            np.concatenate([times for times, _ in same]), np.vstack([part.values for _, part in same])
        )
        self._server.open_channels(schema(samples.names))
        for time, row in zip(times.tolist(), values, strict=True):
            self._server.send_json(CHANNELS, message(samples, row), time)


def _string(text: str) -> bytes:
    """A std_msgs/String as it comes from the wire."""
    data = text.encode() + b"\0"
    return b"\x00\x01\x00\x00" + len(data).to_bytes(4, "little") + data
