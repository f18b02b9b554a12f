"""From where a browser looks: the page fits the view to its picture until its user takes the camera."""

from __future__ import annotations

import asyncio
import time
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser
from viser import _messages as messages
from viser._viser import CameraHandle

from gelbot.live.gaze import Gaze
from gelbot.live.moment import Stage
from gelbot.live.view import ABOVE, ALL, BODY, FIELD_OF_VIEW, view
from toy import Toy

BROAD, NARROW, OTHER = (1000, 700), (402, 700), (600, 700)
"""Pictures [px]: a page before its panels stand beside it, and after."""
DEFAULT = np.array([3.0, 3.0, 3.0])
"""Where viser's browser looks from before it has been told anything."""


class Browser:
    """A browser at the other end of viser's own record of its camera: told what is written there, one message after
    the other, and telling where it looks from."""

    def __init__(self, gaze: Gaze, stage: Stage) -> None:
        self.inbox: list[Any] = []
        connection = SimpleNamespace(queue_message=self.inbox.append)
        self.client: Any = SimpleNamespace(client_id=0, atomic=nullcontext, _websock_connection=connection)
        self.client.camera = CameraHandle(self.client)
        self.position, self.look_at, self.size = DEFAULT, np.zeros(3), BROAD
        self._come = lambda: gaze.follow(self.client, stage)
        self._told: object = None

    def tell(self) -> None:
        """Where it looks from, now. With its first words it has come; who follows it then hears them too."""
        self._told = self._now()
        handle: CameraHandle = self.client.camera
        state = handle._state
        state.position, state.look_at = self.position, self.look_at
        state.up_direction, state.fov = np.array([0.0, 0.0, 1.0]), float(FIELD_OF_VIEW)
        (state.image_width, state.image_height), state.update_timestamp = self.size, time.time()
        if self._come is not None:
            come, self._come = self._come, None
            come()
        for callback in handle._state.camera_cb:
            asyncio.run(callback(handle))  # pyright: ignore[reportArgumentType]

    def hear(self, number: int | None = None) -> None:
        """Do the first `number` of the things that it was told, all without."""
        for message in self.inbox[:number]:
            if isinstance(message, messages.SetCameraPositionMessage):
                self.position = np.array(message.position)
            elif isinstance(message, messages.SetCameraLookAtMessage):
                self.look_at = np.array(message.look_at)
        del self.inbox[:number]

    def settle(self) -> None:
        """Hear and tell until there is nothing more to be told: what has not changed is not told."""
        for _ in range(20):
            if self._told != self._now():
                self.tell()
            if not self.inbox:
                return
            self.hear()
        pytest.fail("the page and the browser go on and on")

    def drag(self) -> None:
        """What its user does."""
        self.position = self.position + np.array([10.0, 0.0, -5.0])

    def _now(self) -> object:
        return tuple(self.position), tuple(self.look_at), self.size


@pytest.fixture(scope="module")
def stage() -> Stage:
    return Toy(camera=False).stage()


@pytest.fixture
def gaze() -> Gaze:
    return Gaze()


@pytest.fixture
def browser(gaze: Gaze, stage: Stage) -> Browser:
    return Browser(gaze, stage)


def looks(browser: Browser, stage: Stage, name: str = ALL) -> bool:
    """Whether a browser looks from this view, fitted to its picture."""
    wanted = view(stage, name, browser.size[0] / browser.size[1])
    return np.allclose(browser.position, wanted.position) and np.allclose(browser.look_at, wanted.target)


def stays(browser: Browser, size: tuple[int, int]) -> None:
    """Where it is, it stays, also when its picture gets another `size` [px]."""
    mine = browser.position
    browser.settle()
    browser.size = size
    browser.settle()
    np.testing.assert_array_equal(browser.position, mine)


def go_to_the_first_view(browser: Browser, stage: Stage) -> None:
    """What viser's browser does by itself, some time after it has come."""
    first = view(stage, ALL)
    browser.position, browser.look_at = first.position, first.target


def test_viser_still_keeps_its_record_in_the_way_this_file_has_it():
    for name in ("position", "look_at", "up_direction", "fov", "image_width", "camera_cb", "update_timestamp"):
        assert name in viser._viser._CameraHandleState.__dataclass_fields__


def test_the_first_view_fits(browser, stage):
    browser.tell()
    browser.hear()
    browser.tell()
    assert looks(browser, stage)
    browser.size = NARROW
    browser.settle()
    assert looks(browser, stage)


@pytest.mark.parametrize("heard", [0, 1, 2, None])
def test_a_slow_browser_tells_its_default_place_again(browser, stage, heard):
    """And goes to the first view late, which is not its user's doing."""
    browser.tell()
    browser.tell()
    browser.hear(heard)
    go_to_the_first_view(browser, stage)
    browser.size = NARROW
    browser.settle()
    assert looks(browser, stage)


@pytest.mark.parametrize("is_moved", [False, True])
@pytest.mark.parametrize("name", [ALL, BODY])
def test_a_browser_that_goes_to_the_first_view_when_all_was_fitted(browser, gaze, stage, name, is_moved):
    """By itself at first, or by viser's "Reset View"."""
    for width in range(400, 1000, 50):
        browser.size = width, 700
        browser.settle()
    browser.size = NARROW
    gaze.look(browser.client, stage, name)
    browser.settle()
    if is_moved:
        browser.drag()
        browser.settle()
    go_to_the_first_view(browser, stage)
    browser.settle()
    assert looks(browser, stage)


def test_a_picture_that_changes_its_shape_to_and_fro(browser, stage):
    """While the view for the shape in between is on its way: viser would not send the last one, for it believes that
    the browser looks from there."""
    browser.settle()
    browser.size = NARROW
    browser.tell()
    browser.size = BROAD
    browser.tell()
    browser.settle()
    assert looks(browser, stage)
    browser.size = NARROW
    browser.settle()
    assert looks(browser, stage)


def test_a_view_chosen_while_another_one_is_on_its_way(browser, gaze, stage):
    browser.settle()
    gaze.look(browser.client, stage, BODY)
    browser.tell()
    gaze.look(browser.client, stage, ALL)
    browser.settle()
    assert looks(browser, stage)


@pytest.mark.parametrize("name", [ALL, BODY, ABOVE])
def test_a_view_that_is_not_sent_since_the_browser_is_there(browser, gaze, stage, name):
    """Its user may move it all the same."""
    browser.settle()
    for size in (BROAD, (1050, 700)):
        browser.size = size
        gaze.look(browser.client, stage, name)
        browser.settle()
    gaze.look(browser.client, stage, name)
    browser.drag()
    stays(browser, NARROW)


def test_a_user_s_hand_while_a_view_is_on_its_way(browser, stage):
    browser.settle()
    browser.size = NARROW
    browser.tell()
    browser.drag()
    browser.tell()
    browser.hear()
    # The view and the next bit of the way in one picture.
    browser.drag()
    stays(browser, OTHER)


def test_many_shapes_while_a_view_is_on_its_way(browser, stage):
    browser.settle()
    for width in (*range(400, 1000, 100), BROAD[0], BROAD[0]):
        browser.size = width, 700
        browser.tell()
    browser.hear(1)
    browser.settle()
    assert looks(browser, stage)


def test_a_browser_that_says_the_same_over_and_over_while_views_are_on_their_way(browser, stage):
    browser.settle()
    for width in (OTHER[0], *[NARROW[0]] * 12):
        browser.size = width, 700
        browser.tell()
    browser.hear(3)
    assert looks(browser, stage) is False
    browser.settle()
    browser.size = BROAD
    browser.settle()
    assert looks(browser, stage)


def test_what_was_built_anew_is_fitted(browser, gaze, stage):
    """While its user leaves the camera there."""
    browser.settle()
    wide = replace(stage, outlines=tuple(2.0 * outline for outline in stage.outlines))
    gaze.refit(browser.client, wide)
    browser.settle()
    assert looks(browser, wide)
    browser.drag()
    mine = browser.position
    browser.settle()
    gaze.refit(browser.client, stage)
    browser.settle()
    np.testing.assert_array_equal(browser.position, mine)
    go_to_the_first_view(browser, stage)
    browser.settle()
    assert looks(browser, stage)


def test_a_browser_that_has_gone_is_forgotten(browser, gaze, stage):
    browser.settle()
    gaze.forget(0)
    gaze.refit(browser.client, stage)
    browser.size = NARROW
    browser.settle()
    assert not browser.inbox
    assert not gaze.is_settled(0)


@pytest.mark.parametrize("name", [ALL, BODY, ABOVE])
def test_what_its_user_has_moved_stays(browser, gaze, stage, name):
    browser.settle()
    gaze.look(browser.client, stage, name)
    browser.settle()
    assert looks(browser, stage, name)
    assert gaze.is_settled(0)
    browser.drag()
    stays(browser, OTHER)
    assert gaze.is_settled(0)
    # Until a view is chosen again.
    gaze.look(browser.client, stage, name)
    browser.settle()
    browser.size = NARROW
    browser.settle()
    assert looks(browser, stage, name)
