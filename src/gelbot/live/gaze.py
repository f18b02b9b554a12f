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


@dataclass
class _Chosen:
    name: str
    stage: Stage
    aspect: float
    seen: View
    has_come: bool = False
    """Whether the browser has told that it looks from there. What it tells before is what it did before."""


class Gaze:
    """The views of all browsers. A picture that changes its shape, as at first, when the panels come to stand beside
    it, is filled again."""

    def __init__(self) -> None:
        self._chosen: dict[int, _Chosen] = {}

    def look(self, client: viser.ClientHandle, stage: Stage, name: str) -> None:
        """From the view `name` of `stage`."""
        aspect = _aspect(client.camera)
        seen = view(stage, name, aspect)
        self._chosen[client.client_id] = _Chosen(name, stage, aspect, seen)
        with client.atomic():
            client.camera.position, client.camera.look_at = seen.position, seen.target
            client.camera.up_direction = (0.0, 0.0, 1.0)

    def follow(self, client: viser.ClientHandle, stage: Stage) -> None:
        """From now on, from the first view of `stage`."""
        self.look(client, stage, ALL)

        async def changed(camera: viser.CameraHandle) -> None:
            chosen = self._chosen.get(client.client_id)
            if chosen is None:
                return
            if _is_at(camera, chosen.seen):
                chosen.has_come = True
            elif _is_at(camera, view(chosen.stage, ALL)):
                # The browser puts its camera there by itself, a little after it has come.
                self.look(client, chosen.stage, chosen.name)
            elif chosen.has_come:
                # Its user has moved it.
                self.forget(client.client_id)
                return
            if _aspect(camera) != chosen.aspect:
                self.look(client, chosen.stage, chosen.name)

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
