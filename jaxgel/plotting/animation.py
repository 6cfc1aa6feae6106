"""A path as an animation."""

from pathlib import Path as File
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .._deprecated import old_arguments
from ..continuation import Path
from ..observables import obstacle_displacement
from .filled import Gel
from .patterns import add_colorbar, colour_range, draw_frame, pictured_states
from .style import state_text, styled

FRAMES_MAX = 60  # of an animation
DPI = 110


class _Frames(Figure):
    """A figure that a writer of films saves frame by frame.

    Only what moves is drawn for a frame, over all that does not, which is drawn once.
    """

    background: Any = None
    moving: list[Artist]

    def savefig(self, fname: Any, **_: Any) -> None:
        """Write the pixels of the frame, RGBA."""
        canvas = self.canvas
        if self.background is None:
            # not invisible: an invisible title is placed anew, off the figure (Matplotlib 3.11.2)
            for artist in self.moving:
                artist.set_animated(True)
            canvas.draw()
            self.background = canvas.copy_from_bbox(self.bbox)
        canvas.restore_region(self.background)
        for artist in sorted(self.moving, key=Artist.get_zorder):
            self.draw_artist(artist)
        fname.write(canvas.buffer_rgba())


@styled
@old_arguments
def animate_pattern(
    path: Path, file: str | File, *, field: str | None = "stretch", seconds: float = 6.0
) -> None:
    """Write a GIF of a path's states (at most ``FRAMES_MAX``), ``seconds`` long.

    The states are evenly chosen. A ``file`` whose name ends in .mp4 becomes a film (H.264) by the
    program ffmpeg, that on the PATH or, else, that of the package imageio-ffmpeg (extra
    ``[view]``); ValueError if there is neither.
    """
    kind, settings = _writer_of(file)
    states = np.unique(
        np.linspace(0, len(path.mu) - 1, min(FRAMES_MAX, len(path.mu))).round().astype(int)
    )
    vertices, values = pictured_states(path, states, field)
    figure = _Frames(figsize=(4.4, 3.8), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    gel = Gel(ax, path.model.cloud, vertices[0], values[0], colour_range(values, path, field))
    moved = obstacle_displacement(path[states])
    obstacles = draw_frame(
        ax, path.model.cloud, vertices, state_text(path.value[states[0]], path.control), moved[0]
    )
    if field is not None:
        add_colorbar(gel, [ax], values, field)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # every frame as the first one is laid out
    writer = kind(fps=max(1.0, len(states) / seconds))
    with mpl.rc_context(settings), writer.saving(figure, str(file), dpi=DPI):
        for k, v, colours, by in zip(states, vertices, values, moved, strict=True):
            gel.move(v, colours)
            obstacles.move(by)
            ax.set_title(state_text(path.value[k], path.control))
            figure.moving = [*gel.artists, *obstacles.artists, ax.title]
            writer.grab_frame()


def _writer_of(file: str | File) -> tuple[type, dict[str, Any]]:
    """Matplotlib's writer for a file's name, and the settings it needs."""
    if not str(file).lower().endswith(".mp4"):
        return PillowWriter, {}
    if FFMpegWriter.isAvailable():
        return FFMpegWriter, {}
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return FFMpegWriter, {"animation.ffmpeg_path": get_ffmpeg_exe()}
    except (ImportError, RuntimeError):
        raise ValueError(
            f"file: {str(file)!r} needs the program ffmpeg; install it, or pip install "
            "'jaxgel[view]', or write a GIF"
        ) from None
