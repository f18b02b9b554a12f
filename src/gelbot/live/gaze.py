"""Where each browser looks from: the view that was chosen for it, as long as its user leaves the camera there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import viser

from gelbot.live.moment import Stage
from gelbot.live.view import ALL, View, view

SAME = 1e-3
"""Camera places that differ by less, as a share of the distance that is looked over, are one."""

ASPECTS = 0.2, 5.0
"""Breadth by height of the narrowest and the broadest picture that is filled."""
KEPT = 4
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
    has_come: bool = False
    """Whether the browser has told that it looks from there. What it tells before is what it did before."""


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
        aspect = _aspect(client.camera)
        seen = view(stage, name, aspect)
        last = self._chosen.get(client.client_id)
        before = () if last is None else (last.seen, *last.before)[:KEPT]
        self._chosen[client.client_id] = _Chosen(name, stage, aspect, seen, before)
        with client.atomic():
            client.camera.position, client.camera.look_at = seen.position, seen.target
            client.camera.up_direction = (0.0, 0.0, 1.0)

    def follow(self, client: viser.ClientHandle, stage: Stage) -> None:
        """From now on, from the first view of `stage`."""
        # No view is written here, before the callback: it is called with the words that brought the browser here, and
        # would find the view there as if the browser had told it.
        self._chosen[client.client_id] = _Chosen(ALL, stage, NONE_YET, view(stage, ALL))

        async def changed(camera: viser.CameraHandle) -> None:
            chosen = self._chosen.get(client.client_id)
            if chosen is None:
                return
            is_there = _is_at(camera, chosen.seen)
            # The browser puts its camera at the first view by itself, a little after it has come. And viser sends no
            # view from which it believes that the browser looks, though another one may be on its way there.
            if not is_there and any(_is_at(camera, other) for other in (view(chosen.stage, ALL), *chosen.before)):
                self.look(client, chosen.stage, chosen.name)
            elif not is_there and chosen.has_come:
                # Its user has moved it.
                self.forget(client.client_id)
            elif _aspect(camera) != chosen.aspect:
                self.look(client, chosen.stage, chosen.name)
            else:
                chosen.has_come = is_there

        client.camera.on_update(changed)

    def forget(self, client: int) -> None:
        """A browser has gone."""
        self._chosen.pop(client, None)


def _aspect(camera: viser.CameraHandle) -> float:
    """Breadth by height of a picture, which may just have none."""
    return float(np.clip(camera.image_width / max(camera.image_height, 1), *ASPECTS))


def _is_at(camera: viser.CameraHandle, seen: View) -> bool:
    away = np.linalg.norm(camera.position - seen.position)
    return bool(away < SAME * np.linalg.norm(seen.position - seen.target))
