"""What each browser is told of the driver's seat, and its button to take or leave it."""

from __future__ import annotations

import viser

from gelbot.live.seat import Seat


class Seats:
    """A line and a button in each browser's panel. Its methods are called by the server's own thread alone."""

    def __init__(self, seat: Seat) -> None:
        self._seat = seat
        self._signs: dict[int, tuple[viser.GuiHtmlHandle, viser.GuiButtonHandle]] = {}

    def seat_at(self, client: viser.ClientHandle) -> None:
        """A browser has come."""
        sign = client.gui.add_html("", order=0.3)
        button = client.gui.add_button("take over", color="gray", order=0.4)
        number = client.client_id

        async def pressed(_: object) -> None:
            if not self._seat.hand_over(number) and not self._seat.take_over(number):
                driver = self._seat.driver
                who = "Somebody else" if driver is None else f"Browser {driver + 1}"
                client.add_notification(
                    "The seat is taken", f"{who} drives, and can hand over.", auto_close_seconds=4.0, color="blue"
                )
            self._refresh()

        button.on_click(pressed)
        self._signs[number] = (sign, button)
        self._refresh()

    def take_from(self, client: viser.ClientHandle) -> None:
        """A browser has gone."""
        self._signs.pop(client.client_id, None)
        self._refresh()

    def _refresh(self) -> None:
        driver = self._seat.driver
        for number, (sign, button) in self._signs.items():
            if number == driver:
                text, label = f"You drive (browser {number + 1}).", "hand over"
            elif driver is None:
                text, label = "Watching; nobody drives.", "take over"
            else:
                text, label = f"Watching; browser {driver + 1} drives.", "take over"
            sign.content, button.label = f'<div class="gelbot-seat">{text}</div>', label
