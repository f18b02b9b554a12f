"""Every error a user can cause or meet: one base class, children that carry the data of the case."""

from __future__ import annotations

from typing import Any


class GelbotError(Exception):
    """Base of all errors that gelbot raises on purpose. Its text is meant for the user."""

    def __reduce__(self) -> tuple[Any, ...]:
        # Out of another process it comes as it was: the children are not made from their text.
        return _restored, (type(self), self.args, self.__dict__)


def _restored(kind: type[GelbotError], texts: tuple[str, ...], data: dict[str, Any]) -> GelbotError:
    error = kind.__new__(kind, *texts)
    error.__dict__.update(data)
    return error


class Nothing:
    """Stands for a value that was not given, where `None` could be one that was."""

    def __repr__(self) -> str:
        return "nothing"


NOTHING = Nothing()


def shortened(text: str, most: int = 200) -> str:
    """`text`, cut after `most` characters: a message shows what was given, not all of it."""
    return text if len(text) <= most else text[:most] + "..."


class BadInput(GelbotError):
    """Something the user gave is not usable.

    Parameters say where it was found (`where`: a file, a key, an option), what was given (`given`), what is allowed
    (`allowed`) and, where it helps, what to try (`advice`); `more` errors were found beside this one.
    """

    def __init__(self, where: str, given: object, allowed: str, advice: str = "", more: int = 0) -> None:
        self.where, self.given, self.allowed, self.advice, self.more = where, given, allowed, advice, more
        text = f"{where}: got {shortened(repr(given))}; allowed: {allowed}"
        text = f"{text}. Try: {advice}" if advice else text
        super().__init__(f"{text} (and {more} more {'error' if more == 1 else 'errors'})" if more else text)

    def inside(self, place: str) -> BadInput:
        """The same error seen from further out: `place` is put before `where`."""
        return self.at(f"{place}: {self.where}")

    def at(self, where: str) -> BadInput:
        """The same error, found at another place."""
        return BadInput(where, self.given, self.allowed, self.advice, self.more)


class SimulationFailed(GelbotError):
    """The implicit step did not reach its tolerance, the state is no longer finite, or contacts were `missed`."""

    def __init__(self, time: float, residual: float, tolerance: float, finite: bool, missed: int = 0) -> None:
        self.time, self.residual, self.tolerance, self.finite, self.missed = time, residual, tolerance, finite, missed
        if missed and finite:
            text = (
                f"the simulation met more contacts of the body with itself than there is room for at t = {time:.3f} s: "
                f"{missed} were left out. Try: a coarser body.mesh_size, or material.self_contact = false"
            )
        else:
            what = "did not converge" if finite else "became non-finite"
            text = (
                f"the simulation {what} at t = {time:.3f} s: residual {residual:.3g}, tolerance {tolerance:.3g} "
                "(both relative to the body's net weight). Try: a smaller simulation.time_step, "
                "more simulation.max_iterations, a stiffer material.young_modulus, or a finer body.mesh_size"
            )
        super().__init__(text)


class SupplyFailed(GelbotError):
    """A supply did not do what it was told: what it is (`supply`), what went wrong (`what`), what to look at
    (`advice`)."""

    def __init__(self, supply: str, what: str, advice: str) -> None:
        self.supply, self.what, self.advice = supply, what, advice
        super().__init__(f"{supply}: {what}. Try: {advice}")


class CameraFailed(GelbotError):
    """A camera gives no pictures: which one (`camera`), what went wrong (`what`), what to look at (`advice`)."""

    def __init__(self, camera: str, what: str, advice: str) -> None:
        self.camera, self.what, self.advice = camera, what, advice
        super().__init__(f"{camera}: {what}. Try: {advice}")


class BenchStopped(GelbotError):
    """The electrodes are at zero volts and stay there, for the `reason` given."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"stopped, all electrodes at zero volts: {reason}")
