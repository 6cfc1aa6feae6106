"""Fields of the gel as design parameters: pixels or cosine modes, smoothed by a filter.

The filter keeps bounds.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from .._types import Array, Float
from ..materials import PixelField, WithHoles

PIXELS = 40  # along the plate's shorter side, if modes are varied
REACH = 6.0  # of the coefficients of modes: the field reaches its bounds to 1/400 of their range


@dataclasses.dataclass(frozen=True, eq=False)
class DesignField:
    """A parameter of the gel over the plate as a function of a design's pixels or modes."""

    pixels: tuple[int, int]
    """Rows and columns of the picture, whose pixels are square but for rounding."""
    size: tuple[float, float]
    """Width and height of the plate, mm."""
    lower: float = 0.0
    """Least value, which only modes need: bounds of pixels are those of the parameters."""
    upper: float = 1.0
    """Largest value, likewise."""
    filter: float = 0.0
    """Radius of the filter, mm, see `filtered`; 0 for none."""
    modes: tuple[int, int] | None = None
    """Numbers (m, n) of cosines along y and x, the constant among them.

    None if each pixel is a parameter.
    """
    with_holes: bool = False
    """Whether the field moves with the material around holes, see `WithHoles`."""

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the parameters: (r, c) pixels, or (m, n) coefficients."""
        return self.modes or self.pixels

    def values(self, parameters: Float[Array, "m n"]) -> Float[Array, "r c"]:
        """Value of each pixel of the picture; within the bounds, as the filter takes means.

        Pixels are the parameters, filtered. Of coefficients a the field is lower + (upper -
        lower) / (1 + exp(-s)), where s is the sum of a_kl cos(k pi y / height) cos(l pi x / width),
        with y from the plate's upper edge down and x from the left one.
        """
        if self.modes is None:
            return filtered(parameters, self.size, self.filter)
        along_y, along_x = (
            np.cos(np.outer(np.arange(number), (np.arange(count) + 0.5) * np.pi / count))
            for count, number in zip(self.pixels, self.modes, strict=True)
        )
        share = jax.nn.sigmoid(along_y.T @ parameters @ along_x)
        return filtered(self.lower + (self.upper - self.lower) * share, self.size, self.filter)

    def field(self, parameters: Float[Array, "m n"]) -> PixelField | WithHoles:
        """The field of the gel, a smooth `PixelField`, without kinks as holes move under it."""
        width, height = self.size
        field = PixelField(
            self.values(parameters), (-width / 2, width / 2, -height / 2, height / 2), smooth=True
        )
        return WithHoles(field) if self.with_holes else field

    def constant(self, value: float) -> Float[np.ndarray, "m n"]:
        """The parameters of a constant field: its value for pixels.

        For modes the nearest one that the coefficients reach.
        """
        if self.modes is None:
            return np.full(self.pixels, float(value))
        share = (value - self.lower) / (self.upper - self.lower)
        first = math.inf * (share - 0.5) if share in (0, 1) else math.log(share / (1 - share))
        coefficients = np.zeros(self.modes)
        coefficients[0, 0] = np.clip(first, -REACH, REACH)
        return coefficients


def filtered(
    pixels: Float[Array, "r c"], size: tuple[float, float], radius: float
) -> Float[Array, "r c"]:
    """The picture (r, c) by the Helmholtz filter of a ``radius``, mm, on a plate of ``size``, mm.

    The size is width and height. It solves f - l^2 (f_xx + f_yy) = pixels with no slope across the
    plate's edges, l = radius / (2 sqrt 3), by second-order differences between pixels, whose
    eigenvectors are cosines. Every pixel becomes a mean of all with positive weights, so bounds and
    the mean over the plate stay. Lazarov & Sigmund (2011), https://doi.org/10.1002/nme.3072
    """
    if radius == 0:
        return jnp.asarray(pixels)
    counts, lengths = np.shape(pixels), (size[1], size[0])
    # (count, count), orthonormal, a row each
    cosines = [scipy.fft.dct(np.eye(count), axis=0, norm="ortho") for count in counts]
    curvature = [
        (2 * count / length * np.sin(np.pi * np.arange(count) / (2 * count))) ** 2
        for count, length in zip(counts, lengths, strict=True)
    ]
    damping = 1 / (1 + radius**2 / 12 * (curvature[0][:, None] + curvature[1]))
    return cosines[0].T @ (damping * (cosines[0] @ pixels @ cosines[1].T)) @ cosines[1]
