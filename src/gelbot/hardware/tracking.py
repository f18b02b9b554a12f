"""The essential points of the body from one camera, picture by picture: state in, state out.

    silhouette -> what resembles it -> fit from the last pose (and from what resembles it) -> believed, or lost

A silhouette alone cannot tell a body from its mirror image, nor a dome from a bowl: the last pose can, from which the
search begins. A picture is not believed, and the body is `lost`, when nothing is seen, when what is seen reaches the
border of the picture (a hand does) or is much too small or too large, when the sheet cannot be laid over it, or when
the body would have jumped. Then the last pose is kept, and allowed to have moved further the longer that lasts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelbot.errors import BadInput
from gelbot.hardware.belief import Kin, Thought, begun, doubt, kin_of, marks_of, thought
from gelbot.hardware.calibration import Calibration
from gelbot.hardware.fitting import Expected, Fit, draw, fit, supposed
from gelbot.hardware.habits import Habits, Likely, cells_of, differing, likely_of, mirrored, together
from gelbot.hardware.open_cv import cv2_of
from gelbot.hardware.segment import Box, Pixels, Silhouette, background_of, silhouette
from gelbot.hardware.umbrella import Pose, Umbrella

Floats = NDArray[np.float64]

MARGIN = 48
"""Pixels around the last silhouette in which the next one is sought first."""
BELIEVED, REGAINED = 0.75, 0.85
"""Least intersection over union of the sheet with what is seen, while it is followed and when it is found again."""
WORST_MISFIT = 5.0
"""Root mean square distance [px] of the outlines from which on the sheet does not lie over what is seen."""
JUMP, SPEED = 2e-3, 40e-3
"""How far [m] the centre may move in no time, and how fast [m/s] beyond that: a falling body reaches 20 mm/s."""
LEAST_AREA, MOST_AREA = 0.12, 1.5
"""Areas of a silhouette, as shares of the flat sheet's."""
GROWTH = 1.6
"""By how much the area may change from one picture to the next."""
ITERATIONS, LOST_ITERATIONS = 4, 8
"""Steps of the search that begins from what resembles the body; when it was lost."""
DOUBT, FAR = 1.2, 0.6e-3
"""At a misfit [px] above this, and where examples have the body's points so far [m] from the last, the search begins
once more, from the last pose."""
GAIN = 1.0
"""How much less such a pose must cost to be taken."""
SURE = 0.3e-3
"""The standard deviation of a tip [m] at which its confidence is half of the body's."""
USUAL_MISFIT = 0.6
"""Misfit [px] of a fit that is right; one that misses by more is trusted as much less."""
SURE_TURN = 0.12
"""The standard deviation of the normal [rad], of all that the body may be, at which its confidence is halved."""
BARE = 0.35e-3
"""How far off a tip is, of an umbrella without examples of what it cannot do [m]: a standard deviation."""
FROM_ABOVE = Expected(seen_turn=0.3, hidden_turn=1.2, hidden_move=5e-3)
"""From above, the body turns over about axes that lie in the picture, and rises along the line of sight."""


class Tracked(NamedTuple):
    """What the camera says at `time` [s]: as `gelbot.points.Observation`, with how sure it is.

    `centre` [m] (3,), `normal` (3,), `tips` [m] (3, a), `tip_angles` [rad] (a,); `tip_confidence` (a,) and `confidence`
    0 to 1; `lost`: the picture was not believed, the points are the last ones. For a page: `outline_pixels` (2, m) of
    what is seen, `fit_pixels` (2, k) of the sheet laid over it, both [px], empty when there are none. `why`: what is
    wrong with a picture that was not believed.
    """

    time: float
    centre: Floats
    normal: Floats
    tips: Floats
    tip_angles: Floats
    tip_confidence: Floats
    confidence: float
    lost: bool
    outline_pixels: Floats
    fit_pixels: Floats
    why: str = ""


class State(NamedTuple):
    """Where the tracker stands: the last believed `pose`, `time` [s] and silhouette's `area` [px^2] and `box`; how many
    `pictures` there were; whether the body is `lost`; `belief` (s,) in the examples, if there are any."""

    pose: Pose
    time: float
    area: float
    box: Box | None
    pictures: int
    lost: bool
    belief: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class Scene:
    """What does not change while a body is followed: the `sheet`, the `calibration`, the empty tank's `background`
    (h, w), what is `expected` of the body, and `habits`, examples of how it usually looks, if there are any."""

    sheet: Umbrella
    calibration: Calibration
    background: NDArray[np.float32]
    expected: Expected
    habits: Habits | None = None

    @cached_property
    def cells(self) -> NDArray[np.float32]:
        """The silhouettes of the examples, (s, cells): drawn once, a millisecond each."""
        assert self.habits is not None
        drawn = [draw(self.sheet, self.calibration, self.habits.pose(k)) for k in range(self.habits.numbers.shape[1])]
        blank = np.zeros((1, 1), np.uint8)
        return np.stack([cells_of(blank if d is None else d.mask, self.calibration.scale) for d in drawn])

    @cached_property
    def flat_area(self) -> float:
        """Area [px^2] of the flat sheet, seen face on."""
        a, b, c = (
            self.sheet.surface(np.zeros(self.sheet.number_count), self.sheet.no_rest)[:, t]
            for t in self.sheet.triangles
        )
        z = np.cross(b - a, c - a, axis=0)[2] / 2.0
        return float(z[z > 0.0].sum()) * self.calibration.scale**2

    @cached_property
    def kin(self) -> Kin:
        """Which examples are near each other."""
        assert self.habits is not None
        return kin_of(self.sheet, self.habits)

    def prepare(self) -> None:
        """Draw and compare the examples now: that takes longer than a picture may."""
        if self.habits is not None:
            _ = self.cells, self.kin

    def likely(self, seen: Silhouette, state: State, elapsed: float) -> tuple[Likely | None, Thought | None]:
        """What the examples say of what is `seen`, and what is believed of them then."""
        if self.habits is None:
            return None, None
        belief = begun(self.kin, self.sheet, state.pose) if state.belief is None else state.belief
        differs = differing(self.cells, cells_of(seen.mask, self.calibration.scale))
        last = marks_of(self.sheet, state.pose)
        thinks = thought(self.kin, belief, differs, last, elapsed)
        return likely_of(self.habits, thinks.weight, state.pose, self.calibration.axes), thinks


def flat_pose(sheet: Umbrella, place: tuple[float, float], heading: float) -> Pose:
    """A sheet that lies flat on the floor, its middle at `place` [m], turned by `heading` [rad]."""
    c, s = np.cos(heading), np.sin(heading)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Pose(np.zeros(sheet.number_count), rotation, np.array([*place, sheet.thickness / 2.0]), sheet.no_rest)


def look(scene: Scene, state: State, pixels: Pixels, time: float) -> tuple[State, Tracked]:
    """The next state and what is seen in a grey picture `pixels` (h, w) taken at `time` [s]."""
    elapsed = max(time - state.time, 1e-3)
    seen = _silhouette(scene, state, pixels)
    why = _unlike(scene, state, seen, elapsed)
    found, thinks = None, None
    if seen is not None and not why:
        known, thinks = scene.likely(seen, state, elapsed)
        found = _found(scene, state, seen, elapsed, known)
        why = _unbelievable(state, found, elapsed)
    state = state._replace(pictures=state.pictures + 1)
    outline = np.zeros((2, 0)) if seen is None else seen.edge[:, ::3]
    if why or found is None or seen is None:
        drawn = draw(scene.sheet, scene.calibration, state.pose)
        shown = np.zeros((2, 0)) if drawn is None else drawn.edge
        points, no = scene.sheet.essential(state.pose), np.zeros(scene.sheet.tip_count)
        return state._replace(lost=True), Tracked(time, *points, no, 0.0, True, outline, shown, why)
    points = scene.sheet.essential(found.pose)
    confidence = float(np.clip((found.overlap - 0.7) / 0.25, 0.0, 1.0) * np.exp(-((found.misfit / 4.0) ** 2)))
    doubtful, turned = (BARE, 0.0) if thinks is None else doubt(scene.kin, thinks, scene.sheet.tip_count)
    tips = confidence / (1.0 + (_tip_deviation(scene, found) ** 2 + doubtful**2) / SURE**2)
    confidence /= 1.0 + (turned / SURE_TURN) ** 2
    belief = None if thinks is None else thinks.belief
    state = State(found.pose, time, seen.area, seen.box, state.pictures, False, belief)
    return state, Tracked(time, *points, tips, confidence, False, outline, found.drawn.edge)


def _silhouette(scene: Scene, state: State, pixels: Pixels) -> Silhouette | None:
    """What is seen near the last silhouette; in the whole picture if it is lost, or reaches out of that."""
    h, w = pixels.shape
    if not state.lost and state.box is not None:
        x0, y0, x1, y1 = state.box
        near = (max(0, x0 - MARGIN), max(0, y0 - MARGIN), min(w, x1 + MARGIN), min(h, y1 + MARGIN))
        seen = silhouette(pixels, scene.background, near)
        if seen is not None:
            x0, y0, x1, y1 = seen.box
            if near[0] < x0 and near[1] < y0 and x1 < near[2] and y1 < near[3]:
                return seen
    return silhouette(pixels, scene.background)


def _unlike(scene: Scene, state: State, seen: Silhouette | None, elapsed: float) -> str:
    """Why what is seen cannot be the body, or nothing."""
    if seen is None:
        return "nothing stands out from the empty tank"
    if seen.is_cut:
        return "what is seen reaches the border of the picture"
    share = seen.area / scene.flat_area
    if not LEAST_AREA < share < MOST_AREA:
        return f"what is seen is {share:.2g} times as large as the flat sheet"
    change = seen.area / max(state.area, 1.0)
    if state.area > 0.0 and elapsed < 0.3 and not 1.0 / GROWTH < change < GROWTH:
        return f"what is seen became {change:.2g} times as large at once"
    return ""


def _found(scene: Scene, state: State, seen: Silhouette, elapsed: float, known: Likely | None) -> Fit | None:
    """The sheet laid over what is seen: from where examples have it, or from the last pose if there are none or that is
    better."""
    arguments = (scene.sheet, scene.calibration, seen)
    guess = supposed(*arguments, state.pose, known) if known is not None else None
    if guess is None and state.lost:
        guess = _moved_there(scene, state, seen)
    steps = LOST_ITERATIONS if state.lost else ITERATIONS
    found = None if guess is None else fit(*arguments, guess, guess, elapsed, scene.expected, known, steps)
    if found is None or guess is None or found.misfit > DOUBT or _far(scene.sheet, guess, state.pose):
        other = fit(*arguments, state.pose, state.pose, elapsed, scene.expected, known)
        if found is None or (other is not None and other.cost < found.cost - GAIN):
            found = other
    return found


def _far(sheet: Umbrella, guess: Pose, last: Pose) -> bool:
    """Whether the body would have moved so fast that it may be anywhere between examples."""
    return float(np.sqrt(3.0 * np.mean((marks_of(sheet, guess) - marks_of(sheet, last)) ** 2))) > FAR


def _moved_there(scene: Scene, state: State, seen: Silhouette) -> Pose | None:
    """The last pose, moved to the middle of what is seen."""
    drawn = draw(scene.sheet, scene.calibration, state.pose)
    if drawn is None:
        return None
    x0, y0, x1, y1 = seen.box
    away = (
        np.array([(x0 + x1 - 1) / 2.0, (y0 + y1 - 1) / 2.0]) - (drawn.edge.min(axis=1) + drawn.edge.max(axis=1)) / 2.0
    )
    right, up = scene.calibration.axes[:2]
    moved = (right * away[0] - up * away[1]) / scene.calibration.scale
    return state.pose._replace(centre=state.pose.centre + moved)


def _unbelievable(state: State, found: Fit | None, elapsed: float) -> str:
    if found is None:
        return "the sheet leaves the picture"
    least = REGAINED if state.lost else BELIEVED
    if found.overlap < least or found.misfit > WORST_MISFIT:
        return f"the sheet covers {found.overlap:.0%} of what is seen, {found.misfit:.1f} px apart"
    jumped = float(np.linalg.norm(found.pose.centre - state.pose.centre))
    if jumped > JUMP + SPEED * elapsed:
        return f"the body would have jumped by {jumped * 1e3:.1f} mm"
    return ""


def _tip_deviation(scene: Scene, found: Fit) -> Floats:
    """Standard deviation of the tips [m] (a,) that the fit leaves them, larger where it misses what is seen."""
    sheet, pose, a = scene.sheet, found.pose, scene.sheet.tip_count
    at = sheet.mid_count + 1 + np.arange(a)
    slopes = np.einsum("ij,jad->iad", pose.rotation, sheet.bent(pose.numbers, at).slopes()[0])
    arm = pose.rotation @ sheet.marks(pose.numbers, pose.rest)[:, 1 : 1 + a]
    axes = scene.calibration.axes
    turn = np.cross(axes[:, :, None], arm[None], axisa=1, axisb=1, axisc=1)
    by = np.concatenate(
        [np.concatenate([turn, np.broadcast_to(axes[:, :, None], turn.shape)]).transpose(1, 2, 0), slopes], axis=2
    )
    deviation = np.sqrt(np.maximum(np.einsum("iad,de,iae->a", by, found.covariance, by), 0.0))
    return deviation * max(1.0, found.misfit / USUAL_MISFIT)


class Tracker:
    """Follows one body: holds what is constant and the last state, and calls `look`."""

    def __init__(
        self,
        sheet: Umbrella,
        calibration: Calibration,
        start: Pose | None = None,
        background: NDArray[np.float32] | None = None,
        habits: Habits | None = None,
        expected: Expected | None = None,
    ) -> None:
        """`sheet` from `umbrella_of`; `start`: where it lies first (`flat_pose`), or it is looked for in the first
        picture, flat; `background` (h, w): the empty tank, or it is guessed from the first picture; `habits`: how such
        a body moves, from `habits_of` simulated runs."""
        if expected is None:
            expected = Expected() if calibration.view == "side" else FROM_ABOVE
        # From above a dome and a bowl look alike, but gravity tells them apart.
        if habits is not None and calibration.view == "side":
            habits = together(habits, mirrored(sheet, habits, calibration.axes[2]))
        blank = np.zeros((0, 0), np.float32)
        self.scene = Scene(sheet, calibration, blank if background is None else background, expected, habits)
        self.state: State | None = None if start is None else State(start, 0.0, 0.0, None, 0, False)
        if background is not None:
            self._check(background.shape)

    def look(self, pixels: Pixels, time: float) -> Tracked:
        """What is seen in the picture `pixels`, (h, w) grey or (h, w, 3) BGR, taken at `time` [s].

        Raises `BadInput` for a picture that has not the size of the calibration's, or, without a start pose, when the
        first one shows no flat sheet.
        """
        grey = pixels if pixels.ndim == 2 else cv2_of("a camera").cvtColor(pixels, cv2_of("a camera").COLOR_BGR2GRAY)
        self._check(grey.shape)
        if self.scene.background.size == 0:
            self.scene = replace(self.scene, background=background_of(grey))
        if self.state is None:
            self.state = _first(self.scene, grey, time)
        if self.state.pictures == 0:
            self.state = self.state._replace(time=time - 1.0 / 30.0)
        self.state, tracked = look(self.scene, self.state, grey, time)
        return tracked

    def _check(self, shape: tuple[int, ...]) -> None:
        calibration = self.scene.calibration
        if shape != (calibration.height, calibration.width):
            allowed = f"{calibration.width} x {calibration.height}, for which the camera is calibrated"
            raise BadInput("tracker: picture", f"{shape[1]} x {shape[0]} px", allowed, "calibrate the camera again")


def _first(scene: Scene, pixels: Pixels, time: float) -> State:
    """A flat sheet where the first picture shows one, in the heading in which it covers most of what is seen."""
    seen = silhouette(pixels, scene.background)
    if seen is None or seen.is_cut:
        raise BadInput("tracker: first picture", "no gel in it", "a flat sheet on the floor", "give the start pose")
    x0, y0, x1, y1 = seen.box
    middle = scene.calibration.back(np.array([[(x0 + x1 - 1) / 2.0], [(y0 + y1 - 1) / 2.0]]))[:, 0]
    best: Fit | None = None
    for heading in np.arange(0.0, 2.0 * np.pi, np.pi / 18.0):
        pose = flat_pose(scene.sheet, (middle[0], middle[1]), float(heading))
        state = State(pose, time, 0.0, None, 0, True)
        guess = _moved_there(scene, state, seen)
        found = None if guess is None else fit(scene.sheet, scene.calibration, seen, guess, guess, 0.01, scene.expected)
        if found is not None and (best is None or found.overlap > best.overlap + 1e-3):
            best = found
    if best is None or best.overlap < BELIEVED:
        raise BadInput(
            "tracker: first picture", "no flat sheet in it", "a flat sheet on the floor", "give the start pose"
        )
    return State(best.pose, time, seen.area, seen.box, 0, False)
