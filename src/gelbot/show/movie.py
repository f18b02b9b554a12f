"""The movie of a run: the body under the electrodes, the array from above, and the height's curve growing below.

Only what moves is drawn for each picture, on top of a stored picture of the rest; matplotlib's software renderer draws
it, so that no display and no graphics card are needed. The H.264 encoder comes with imageio-ffmpeg.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, cast

import imageio_ffmpeg
import matplotlib
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from gelbot.show.gel_view import GelView, Scene
from gelbot.show.plan_view import PlanView
from gelbot.show.style import BLUE, SETTINGS, add_colour_bars, drawable, new_figure, phase_name
from gelbot.show.trajectory import draw_height, shade_phases

WIDTH, HEIGHT, DPI = 960, 540, 100
ENCODER = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-preset", "veryfast", "-crf", "20", "-movflags", "+faststart"]


def make_movie(
    run: xr.Dataset,
    path: Path,
    frames_per_second: float = 10.0,
    speed: float = 4.0,
    on_picture: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the H.264 movie of `run` to `path` (.mp4), `speed` simulated seconds to a second of film.

    `on_picture(done, of)` is called after each picture. Nothing is left behind when it fails half way. Raises
    `ValueError` when the run has no frames.
    """
    run = drawable(run)
    chosen = film_frames(run["time"].values, frames_per_second, speed)
    draft = path.with_name(f".{path.stem}.part.mp4")
    try:
        with _encoder(draft, frames_per_second) as pipe:
            for done, picture in enumerate(_pictures(run, chosen), start=1):
                pipe.write(picture.tobytes())
                if on_picture is not None:
                    on_picture(done, len(chosen))
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path


@contextmanager
def _encoder(path: Path, frames_per_second: float) -> Iterator[IO[bytes]]:
    """A pipe that takes pictures, RGBA row by row, and writes them to `path`. Raises `OSError` when that fails."""
    # Started directly: imageio-ffmpeg's own writer forks in a way of which JAX, where it runs, warns.
    source = ["-f", "rawvideo", "-pix_fmt", "rgba", "-s", f"{WIDTH}x{HEIGHT}", "-r", f"{frames_per_second:g}"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *source, "-i", "-", *ENCODER, str(path)]
    with TemporaryFile() as log, subprocess.Popen(command, stdin=subprocess.PIPE, stderr=log) as process:
        try:
            assert process.stdin is not None
            with suppress(BrokenPipeError), process.stdin as pipe:
                yield pipe
        except BaseException:
            process.kill()
            raise
        if process.wait() != 0:
            log.seek(0)
            raise OSError(f"the movie's encoder failed: {log.read().decode(errors='replace').strip()}")


def film_frames(time: NDArray[np.float64], frames_per_second: float, speed: float) -> NDArray[np.int64]:
    """Numbers of the frames, recorded at `time` [s], nearest to the film's pictures; the last is the run's last."""
    step = speed / frames_per_second
    wanted = time[0] + step * np.arange(int(np.floor((time[-1] - time[0]) / step + 1e-9)) + 1)
    nearest = np.abs(time[:, None] - wanted).argmin(axis=0)
    return nearest if nearest[-1] == len(time) - 1 else np.append(nearest, len(time) - 1)


def _pictures(run: xr.Dataset, chosen: NDArray[np.int64]) -> Iterator[NDArray[np.uint8]]:
    """The film's pictures, shape (HEIGHT, WIDTH, 4) each."""
    with matplotlib.rc_context(SETTINGS):
        board = _Board(run)
    for k in chosen:
        yield board.picture(int(k))


class _Board:
    """The page that is photographed: everything at rest is drawn once and kept."""

    def __init__(self, run: xr.Dataset) -> None:
        figure = new_figure(WIDTH / DPI, HEIGHT / DPI, DPI)
        self.canvas = cast(FigureCanvasAgg, figure.canvas)
        scene = Scene.of(run)
        self.gel = GelView(figure, (0.0, 0.235, 0.68, 0.665), scene)
        self.plan = PlanView(figure.add_axes((0.76, 0.555, 0.225, 0.4)), scene)
        bars = [(0.76, 0.4, 0.225, 0.02), (0.76, 0.295, 0.225, 0.02)]
        add_colour_bars(figure, scene.limit, scene.most_adsorption, bars, size=8.0)
        figure.text(0.03, 0.907, "arrow: normal of the body's upper side", fontsize=8)

        self.time = run["time"].values
        self.height = scene.centre[:, 2]
        self.phases = [phase_name(run, int(p)) for p in run["phase"].values]
        self.curve_axes: Axes = figure.add_axes((0.065, 0.092, 0.915, 0.13))
        shade_phases(self.curve_axes, run, names=False)
        draw_height(self.curve_axes, run, faint=True)
        (self.curve,) = self.curve_axes.plot([], [], color=BLUE, lw=2.0)
        (self.dot,) = self.curve_axes.plot([], [], "o", color=BLUE, ms=5)
        self.caption = figure.text(0.03, 0.955, "", fontsize=13, va="center", family="DejaVu Sans Mono")
        self.moving = [self.curve, self.dot, self.caption]
        for artist in self.moving:
            artist.set_animated(True)
        for artist in (*self.gel.moving, *self.plan.moving):
            artist.set_animated(True)
        self.canvas.draw()
        self.at_rest: Any = self.canvas.copy_from_bbox(Bbox.from_bounds(0, 0, WIDTH, HEIGHT))

    def picture(self, k: int) -> NDArray[np.uint8]:
        """The page at frame `k` of the run, shape (HEIGHT, WIDTH, 4)."""
        self.gel.show(k)
        self.plan.show(k)
        self.curve.set_data(self.time[: k + 1], self.height[: k + 1])
        self.dot.set_data(self.time[k : k + 1], self.height[k : k + 1])
        self.caption.set_text(f"t = {self.time[k]:5.1f} s   height {self.height[k]:4.1f} mm   {self.phases[k]}")
        renderer = self.canvas.get_renderer()
        self.canvas.restore_region(self.at_rest)
        self.gel.draw_moving(renderer)
        self.plan.draw_moving(renderer)
        for artist in self.moving:
            artist.draw(renderer)
        return np.array(self.canvas.buffer_rgba())
