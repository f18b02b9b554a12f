"""The controls on the right: go and pause, who drives, volts by hand, the reference, what is shown, the scenario."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

import viser

from gelbot.live.actions import Actions
from gelbot.live.hand import Hand
from gelbot.live.moment import Moment
from gelbot.live.plates import FRAMES, SOLID
from gelbot.live.scene import BESIDE, HIDDEN, OVERLAID
from gelbot.live.shared import Permit, Rest, Shared, on_press
from gelbot.live.view import MM, VIEWS

PACES: dict[str, float | None] = {"1x": 1.0, "2x": 2.0, "4x": 4.0, "fastest": None}
STATES = {"running": "#009E73", "paused": "#E69F00", "stopped": "#c92a2a", "ready": "#0072B2", "building": "#7a5195"}
RUN = ("start", "pause", "step", "reset")


class Panel:
    """The controls of one stage. What they do is done by `actions`, and `rest` knows of it.

    `look` is told a browser and a view's name. `is_built`: whether the stage is what these controls have built.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        permit: Permit,
        actions: Actions,
        hand: Hand,
        rest: Rest,
        look: Callable[[viser.ClientHandle, str], None],
        is_built: bool = False,
    ) -> None:
        self._gui, self._permit, self._actions, self._hand, self._look = gui, permit, actions, hand, look
        self._rest = rest
        self.stage = actions.stage()
        self._parts: list[Any] = []
        self._error: viser.GuiHtmlHandle | None = None
        self._run()
        self._by_hand()
        self._reference()
        self._show()
        self._scenario()
        self._settings(is_built)

    def update(self, moment: Moment) -> None:
        """Show what the session says of things that the page did not ask for."""
        if moment.controller in self.stage.controllers:
            self.controller.put(moment.controller)
        self.record.put(moment.recording)
        name = next((name for name, pace in PACES.items() if pace == moment.pace), None)
        if name is not None:
            self.pace.put(name)

    def remove(self) -> None:
        """Take the controls away."""
        for part in self._parts:
            part.remove()

    def _keep(self, part: Any) -> Any:
        self._parts.append(part)
        return part

    def _run(self) -> None:
        gui, actions = self._gui, self._actions
        buttons = self._keep(gui.add_button_group("", RUN))

        async def pressed(event: Any) -> None:
            # A browser may send any text as the button that was pressed.
            name = event.target.value
            if event.client is not None and name in RUN:
                self._permit.do(event.client, lambda: self._rest.ask(name, getattr(actions, name)))

        buttons.on_click(pressed)
        controllers = self.stage.controllers
        chosen = actions.moment().controller
        drive = self._keep(
            gui.add_dropdown(
                "driven by", controllers, initial_value=chosen if chosen in controllers else controllers[0]
            )
        )
        self.controller: Shared[str] = Shared(self._permit, drive, actions.drive_with)
        # A real gel takes its time.
        paces = tuple(name for name, pace in PACES.items() if pace == 1.0 or not self.stage.is_real)
        pace = self._keep(gui.add_dropdown("pace", paces, initial_value="1x", hint="Of the gel's time to yours"))
        self.pace: Shared[str] = Shared(self._permit, pace, lambda name: actions.set_pace(PACES[name]))
        record = self._keep(
            gui.add_checkbox("record", actions.moment().recording, hint="Keep the motion in a run folder")
        )
        self.record: Shared[bool] = Shared(self._permit, record, actions.record)

    def _by_hand(self) -> None:
        gui, hand, limit = self._gui, self._hand, self.stage.limit
        with self._keep(gui.add_folder("volts by hand")):
            words = "Click a plate: the brush; again: zero. Ctrl and drag: all it passes. Shift and drag: all inside."
            gui.add_html(f'<div class="gelbot-hint">{words}</div>')
            brush = gui.add_slider("brush, V", -limit, limit, limit / 40.0, limit / 2.0)
            self.brush: Shared[float] = Shared(self._permit, brush)
            if self.stage.patterns:
                pattern = gui.add_dropdown("pattern", self.stage.patterns)
                self.pattern: Shared[str] = Shared(self._permit, pattern)
                put = gui.add_button("set pattern at the brush's volts", color="gray")
                on_press(self._permit, put, lambda: partial(hand.pattern, self.pattern.value, self.brush.value))
            on_press(self._permit, gui.add_button("all zero", color="gray"), lambda: self._all_zero)

    def _all_zero(self) -> None:
        self._hand.put(range(len(self.stage.outlines)), 0.0)

    def _reference(self) -> None:
        gui, actions = self._gui, self._actions
        with self._keep(gui.add_folder("height wanted")):
            hint = "Or drag the arrow beside the gel"
            height = gui.add_number("height, mm", 0.0, min=0.0, step=0.1, hint=hint)
            self.reference: Shared[float] = Shared(self._permit, height, lambda h: actions.set_reference(h / MM))
            programme = gui.add_button("as in the programme", color="gray")
            on_press(self._permit, programme, lambda: partial(actions.set_reference, None))

    def _show(self) -> None:
        gui = self._gui
        with self._keep(gui.add_folder("show", expand_by_default=False)):
            views = gui.add_button_group("view", VIEWS)

            async def look(event: Any) -> None:
                # Where one looks from is everybody's own.
                if event.client is not None and event.target.value in VIEWS:
                    self._look(event.client, event.target.value)

            views.on_click(look)
            side = gui.add_dropdown("gel seen", (OVERLAID, BESIDE, HIDDEN), hint=f"From {self.stage.plant}")
            self.side: Shared[str] = Shared(self._permit, side)
            plates = gui.add_dropdown("plates", (FRAMES, SOLID), hint="Frames let the gel below them be seen")
            self.plates: Shared[str] = Shared(self._permit, plates)
            self.arrows: Shared[bool] = Shared(self._permit, gui.add_checkbox("current density", True))
            self.labels: Shared[bool] = Shared(self._permit, gui.add_checkbox("numbers and volts", True))

    def _scenario(self) -> None:
        gui, actions = self._gui, self._actions
        names = list(actions.scenarios())
        if self.stage.name not in names:
            names.insert(0, self.stage.name)
        with self._keep(gui.add_folder("scenario", expand_by_default=False)):
            scenario = gui.add_dropdown("scenario", names, initial_value=self.stage.name)
            self.scenario: Shared[str] = Shared(
                self._permit, scenario, lambda name: self._rest.ask("choose", partial(actions.choose, name))
            )
            gui.add_html(f'<div class="gelbot-hint">{escape(" ".join(self.stage.description.split()))}</div>')

    def _settings(self, is_open: bool) -> None:
        gui = self._gui
        if not self.stage.settings:
            return
        with self._keep(gui.add_folder("body and electrodes", expand_by_default=is_open)):
            self._texts: dict[str, Shared[str]] = {
                key: Shared(self._permit, gui.add_text(key, text)) for key, text in self.stage.settings.items()
            }
            self._error = gui.add_html("", visible=False)
            build = gui.add_button("build", color="gray", hint="Nothing changes before. Begins anew")
            on_press(self._permit, build, self._written)

    def _written(self) -> Callable[[], None] | None:
        """What asks for that which was written, None: nothing was."""
        written = {key: text.value.strip() for key, text in self._texts.items()}
        changes = {key: text for key, text in written.items() if text != self.stage.settings[key]}
        return partial(self._build, changes) if changes else None

    def _build(self, changes: dict[str, str]) -> None:
        """Ask for these changes: one line says what is wrong with them, if something is."""
        assert self._error is not None
        try:
            self._rest.ask("change", partial(self._actions.change, changes))
        except Exception as error:
            self._error.content = f'<div class="gelbot-error">{escape(str(error))}</div>'
            self._error.visible = True
            raise
        self._error.visible = False


def status(moment: Moment) -> str:
    """The lines that say how things stand, as HTML."""
    ticks = moment.ticks
    state = escape(moment.state)
    badge = f'<span class="gelbot-state" style="background:{STATES.get(moment.state, "#666")}">{state}</span>'
    record = '<span class="gelbot-record">&#9679; recording</span>' if moment.recording else ""
    where = f"{badge} <b>{moment.time:.1f} s</b> {escape(moment.phase)}{record}"
    took = f"tick {1e3 * ticks.median:.1f} ms, 99 % {1e3 * ticks.p99:.1f}, {ticks.late} of {ticks.count} late"
    loop = f"{escape(moment.controller)} &middot; {took if ticks.count else 'no ticks yet'}"
    message = f'<div class="gelbot-message">{escape(moment.message)}</div>' if moment.message else ""
    return f'<div class="gelbot-status"><div>{where}</div><div class="gelbot-small">{loop}</div>{message}</div>'
