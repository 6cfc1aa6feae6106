"""Types of arguments and fields: arrays with their shapes, as in ``Float[Array, "n 2"]``.

Letters of shapes: ``n`` nodes, ``k`` states, ``f`` free degrees of freedom, ``c`` cells, ``q``
quadrature points of a cell, ``p`` points, ``a`` nodes of a cell, ``g`` volume groups, ``m`` modes,
``w`` modes that are followed, ``v`` vertices, ``t`` triangles.
"""

import jax
import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Int, Num, Shaped

Array = jax.Array | np.ndarray
"""An array of JAX (traced or not) or of NumPy."""
Scalar = float | int | np.number | Float[Array, ""] | Int[Array, ""]
"""A real number: of Python, NumPy or JAX."""
Chemical = Scalar | Float[Array, " g"]
"""Chemical potential, kT, of all volume groups or of each.

As the value of a control that is the chemical potential, too.
"""

__all__ = [
    "Array", "Bool", "Chemical", "Complex", "Float", "Inexact", "Int", "Num", "Scalar", "Shaped",
]  # fmt: skip
