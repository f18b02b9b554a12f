"""What a user can do on the page. The session does it; the page only knows these words."""

from __future__ import annotations

from typing import Protocol

from gelbot.live.moment import Moment, Stage


class Actions(Protocol):
    """The session as the page sees it. Every method returns at once; what it did is seen in the next `moment`.

    Raises `BadInput` with one line for the user when something cannot be done.
    """

    def stage(self) -> Stage:
        """What stands; another object after a scenario was chosen or changed."""
        ...

    def moment(self) -> Moment:
        """The newest moment."""
        ...

    def scenarios(self) -> list[str]:
        """The names of the scenarios that can be chosen."""
        ...

    def choose(self, scenario: str) -> None:
        """Another scenario, by name or file, at its beginning, paused."""
        ...

    def change(self, changes: dict[str, str]) -> None:
        """Values of the scenario, by key, as a scenario file writes them; begins again."""
        ...

    def start(self) -> None:
        """Go, or go on."""
        ...

    def pause(self) -> None:
        """Stand still with zero volts; a simulated gel stands still too."""
        ...

    def step(self) -> None:
        """One control period, then stand still again."""
        ...

    def reset(self) -> None:
        """Back to the beginning; also what sets free after an emergency stop."""
        ...

    def emergency_stop(self, who: str) -> None:
        """Zero volts now. `who` pressed it, for the log: "the browser", "the keyboard"."""
        ...

    def drive_with(self, controller: str) -> None:
        """Who drives: "by hand", "servo" (the scenario's programme), "planned", "predictive", as in `Stage`."""
        ...

    def set_voltage(self, electrode: int, volts: float) -> None:
        """By hand from now on: this electrode at `volts` [V], the others as they are."""
        ...

    def set_pattern(self, pattern: str, amplitude: float) -> None:
        """By hand from now on: a named pattern with this amplitude [V]."""
        ...

    def set_reference(self, height: float | None) -> None:
        """The servo follows this height [m] instead of the programme's; None gives it back."""
        ...

    def set_pace(self, pace: float | None) -> None:
        """Simulated seconds to a second of the wall clock; None: as fast as it goes."""
        ...

    def record(self, wanted: bool) -> None:
        """Keep, or no longer keep, the gel's shape in a run folder."""
        ...
