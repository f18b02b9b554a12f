"""Where each browser looks from: the view that was chosen for it, as long as its user leaves the camera there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from gelbot.live.moment import Stage
from gelbot.live.view import ALL, View, view

SAME = 1e-3
"""Camera places that differ by less, as a share of the distance that is looked over, are one."""

ASPECTS = 0.2, 5.0
"""Breadth by height of the narrowest and the broadest picture that is filled."""
KEPT = 8
"""Views that a browser may still tell of."""
NONE_YET = 0.0
"""The shape of the picture of a browser that has just come."""


@dataclass
class _Chosen:
    name: str
    stage: Stage
    aspect: float
    seen: View
    before: tuple[View, ...] = ()
    """The last ones sent before, the newest first: the browser may still tell of them."""
    is_there: bool = False
    """Whether the browser has told that it looks from there."""
    is_known: bool = False
    """Whether it has told of any view that it was given. Before, it tells of where it stood by itself."""
    is_free: bool = False
    """Whether its user has moved the camera since."""


class Gaze:
    """The views of all browsers. A picture that changes its shape, as at first, when the panels come to stand beside
    it, is filled again.

    Everything here happens in the server's own thread, where a browser's words come in: what viser says of its camera
    is then what the browser has told last, until a view is written there.
    """

    def __init__(self) -> None:
        self._chosen: dict[int, _Chosen] = {}

    def look(self, client: viser.ClientHandle, stage: Stage, name: str) -> None:
        """From the view `name` of `stage`."""
        self._send(client, stage, name, is_known=False)

    def refit(self, client: viser.ClientHandle, stage: Stage) -> None:
        """From the view that was chosen, now of `stage`, as long as its user has not moved the camera."""
        chosen = self._chosen.get(client.client_id)
        if chosen is None:
            return
        chosen.stage = stage
        if not chosen.is_free:
            self._send(client, stage, chosen.name, chosen.is_known)

    def follow(self, client: viser.ClientHandle, stage: Stage) -> None:
        """From now on, from the first view of `stage`."""
        # No view is written here, before the callback: it is called with the words that brought the browser here, and
        # would find the view there as if the browser had told it.
        self._chosen[client.client_id] = _Chosen(ALL, stage, NONE_YET, view(stage, ALL))

        async def changed(camera: viser.CameraHandle) -> None:
            chosen = self._chosen.get(client.client_id)
            if chosen is not None:
                self._hear(client, chosen, camera)

        client.camera.on_update(changed)

    def is_settled(self, client: int) -> bool:
        """Whether a browser looks from where it was told to, or from where its user wants."""
        chosen = self._chosen.get(client)
        return chosen is not None and (chosen.is_there or chosen.is_free)

    def forget(self, client: int) -> None:
        """A browser has gone."""
        self._chosen.pop(client, None)

    def _hear(self, client: viser.ClientHandle, chosen: _Chosen, camera: viser.CameraHandle) -> None:
        chosen.is_there = _is_at(camera.position, chosen.seen)
        if not chosen.is_there and _is_at(camera.position, view(chosen.stage, ALL)):
            # It goes there by itself, a little after it has come, and by its own "Reset View".
            self._send(client, chosen.stage, ALL, is_known=True)
        elif chosen.is_free:
            return
        elif not chosen.is_there and any(_is_at(camera.position, other) for other in chosen.before):
            # Viser sends no view from which it believes that the browser looks, though another one may be on its way
            # there.
            self._send(client, chosen.stage, chosen.name, is_known=True)
        elif not chosen.is_there and chosen.is_known:
            chosen.is_free = True
        elif _aspect(camera) != chosen.aspect:
            self._send(client, chosen.stage, chosen.name, chosen.is_known or chosen.is_there)
        else:
            chosen.is_known = chosen.is_there

    def _send(self, client: viser.ClientHandle, stage: Stage, name: str, is_known: bool) -> None:
        aspect = _aspect(client.camera)
        seen = view(stage, name, aspect)
        last, before, stays = self._chosen.get(client.client_id), (), False
        if last is not None:
            before = (last.seen, *(other for other in last.before if not _is_at(other.position, last.seen)))[:KEPT]
            # Nothing is sent then, and nothing told.
            stays = last.is_there and _is_at(last.seen.position, seen)
        self._chosen[client.client_id] = _Chosen(name, stage, aspect, seen, before, stays, is_known or stays)
        with client.atomic():
            client.camera.position, client.camera.look_at = seen.position, seen.target
            client.camera.up_direction = (0.0, 0.0, 1.0)


def _aspect(camera: viser.CameraHandle) -> float:
    """Breadth by height of a picture, which may just have none."""
    return float(np.clip(camera.image_width / max(camera.image_height, 1), *ASPECTS))


def _is_at(place: NDArray[np.float64], seen: View) -> bool:
    away = np.linalg.norm(place - seen.position)
    return bool(away < SAME * np.linalg.norm(seen.position - seen.target))
