"""The keys of a scenario that say what an electrode is: its shape, its sizes, and on which side it conducts."""

from __future__ import annotations

from typing import Any, Literal

from gelbot.errors import NOTHING, BadInput
from gelbot.field.electrodes import THIN, Block, Disc, Electrode, Rectangle, Ring, Rod, Shape
from gelbot.scenario.fields import Length, Sizes, Table, written
from gelbot.units import allowed_quantity, shown

BACKING = 1e-3
"""Thickness of the insulated back of a plate that conducts in front only [m], if the scenario gives none."""

SIZE_KEYS: dict[str, tuple[str, ...]] = {
    "square": ("side",),
    "rectangle": ("size",),
    "disc": ("diameter",),
    "ring": ("diameter", "inner_diameter"),
    "rod": ("diameter", "length"),
    "block": ("size",),
}
"""The keys of each shape."""
SHAPE_KEYS = ("shape", "side", "size", "diameter", "inner_diameter", "length", "conducts", "backing")
COUNTS = {"rectangle": 2, "block": 3}


class ShapeKeys(Table):
    """What an electrode is, lengths in m. A thin plate that conducts in "front" has an insulated back of `backing`."""

    shape: Literal["square", "rectangle", "disc", "ring", "rod", "block"] | None = None
    side: Length | None = None
    size: Sizes | None = None
    diameter: Length | None = None
    inner_diameter: Length | None = None
    length: Length | None = None
    conducts: Literal["both", "front"] | None = None
    backing: Length | None = None


def shape_of(own: ShapeKeys, common: ShapeKeys | None = None) -> tuple[Shape, float, set[str]]:
    """Shape and backing [m] of an electrode with keys of its `own`, the rest from `common`; the keys used of those.

    Raises `BadInput` for a key of its own that its shape does not have, and for one that is missing.
    """
    used: set[str] = set()

    def get(key: str) -> Any:
        value = getattr(own, key)
        if value is None and common is not None and getattr(common, key) is not None:
            used.add(key)
            value = getattr(common, key)
        return value

    kind = get("shape") or "square"
    needed = SIZE_KEYS[kind]
    for key in ("side", "size", "diameter", "inner_diameter", "length"):
        if getattr(own, key) is not None and key not in needed:
            given = displayed(getattr(own, key))
            raise BadInput(key, given, f'nothing: the shape "{kind}" has no {key}, but {" and ".join(needed)}')
    values = {key: get(key) for key in needed}
    for key, value in values.items():
        if value is None or (key == "size" and len(value) != COUNTS[kind]):
            meaning = f"{COUNTS.get(kind)} lengths" if key == "size" else allowed_quantity("m")
            raise BadInput(
                key, NOTHING if value is None else displayed(value), f'{meaning}: the shape "{kind}" needs it'
            )
    shape = _shape(kind, values)
    return shape, _backing(own, get, shape, kind), used


def _shape(kind: str, values: dict[str, Any]) -> Shape:
    match kind:
        case "square":
            return Rectangle((values["side"], values["side"]))
        case "rectangle":
            return Rectangle(values["size"])
        case "disc":
            return Disc(**values)
        case "ring":
            if values["inner_diameter"] >= values["diameter"]:
                allowed = f"less than diameter = {displayed(values['diameter'])}"
                raise BadInput("inner_diameter", displayed(values["inner_diameter"]), allowed)
            return Ring(**values)
        case "rod":
            return Rod(**values)
        case _:
            return Block(values["size"])


def _backing(own: ShapeKeys, get: Any, shape: Shape, kind: str) -> float:
    """Thickness of the insulated back [m], 0 of an electrode that conducts all over."""
    if not isinstance(shape, THIN):
        for key in ("conducts", "backing"):
            if getattr(own, key) not in (None, "both"):
                allowed = f'nothing: the shape "{kind}" conducts all over, only thin plates can have a back'
                raise BadInput(key, displayed(getattr(own, key)), allowed)
        return 0.0
    if get("conducts") != "front":
        if own.backing is not None:
            raise BadInput("backing", displayed(own.backing), 'nothing without conducts = "front"')
        return 0.0
    return get("backing") or BACKING


def shape_keys(electrode: Electrode) -> dict[str, Any]:
    """The keys of an electrode as a scenario writes them: what `shape_of` reads."""
    match electrode.shape:
        case Rectangle(size=size):
            sizes = {"shape": "rectangle", "size": size}
        case Block(size=size):
            sizes = {"shape": "block", "size": size}
        case Disc(diameter=d):
            sizes = {"shape": "disc", "diameter": d}
        case Ring(diameter=d, inner_diameter=inner):
            sizes = {"shape": "ring", "diameter": d, "inner_diameter": inner}
        case Rod(diameter=d, length=length):
            sizes = {"shape": "rod", "diameter": d, "length": length}
    backing = {"conducts": "front", "backing": electrode.backing} if electrode.backing else {}
    return {key: written(value) for key, value in (sizes | backing).items()}


def displayed(value: Any) -> Any:
    """A value of a key as a message shows it: lengths in millimetres."""
    if isinstance(value, float):
        return shown(value, "m")
    if isinstance(value, tuple):
        numbers = all(isinstance(part, float) for part in value)
        return ", ".join(shown(part, "m") for part in value) if numbers else f"{len(value)} tables"
    return value
