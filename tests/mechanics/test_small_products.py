"""Sums over the components of small matrices stay in loops of their own in compiled kernels.

From jaxlib 0.12 on XLA may hand a sum to a library, which is slow for one over 2 x 2 components at
every point. Earlier releases have no such library, and nothing is found.
"""

import math
import re

import jax
import jax.numpy as jnp
import pytest

import jaxgel
from jaxgel.mechanics import linearise, tangent_blocks

GEL = jaxgel.Gel(Nv=1e-3, chi=0.2)
LIBRARY = "__ynn_fusion"
SUM = r" (?:reduce|dot)\(([^)]*)\), (?:.*lhs_contracting_)?dim\w*={([\d,]*)}"


def summed_by_the_library(text):
    """Entries that each sum of a compiled program has which XLA hands to its library."""
    bodies, shapes, body = {}, {}, None
    for line in text.splitlines():
        if begins := re.match(r"(?:ENTRY )?%?([\w.-]+) .*\{$", line):
            body = bodies.setdefault(begins[1], [])
        elif defined := re.match(r"\s+(?:ROOT )?%?([\w.-]+) = \w+\[([\d,]*)\]", line):
            shapes[defined[1]] = [int(size) for size in defined[2].split(",") if size]
            body.append(line)
    called = {
        re.search(r"calls=%?([\w.-]+)", line)[1]
        for lines in bodies.values()
        for line in lines
        if LIBRARY in line
    }
    counts = []
    for line in (line for name in called for line in bodies[name]):
        if sums := re.search(SUM, line):
            size = shapes[re.search(r"%([\w.-]+)", sums[1])[1]]
            counts.append(math.prod(size[int(axis)] for axis in sums[2].split(",")))
    return counts


@pytest.fixture(scope="module")
def kernels(tiny_model):
    """Compiled text of the linearisation and of the blocks of the tangent."""
    problem = jaxgel.Problem(tiny_model, GEL, contact=False).prepared.shared.inside
    x, p = jnp.asarray(problem.model.nodes), jnp.zeros(problem.lengths["g"])
    now = linearise(problem, x, p, -2.0)
    return [
        jax.jit(function.__wrapped__).lower(problem, x, p, last).compile().as_text()
        for function, last in ((linearise, -2.0), (tangent_blocks, now))
    ]


@pytest.mark.smoke
def test_no_sum_over_components_at_points_is_left_to_a_library(kernels):
    for text in kernels:
        # the rows of a 2 x 2 matrix have 2 entries; 3 are the groups of a patch, in whole blocks
        assert min(summed_by_the_library(text), default=math.inf) > 2


def test_such_a_sum_is_seen():
    """A broadcast product and its sum, by the library where jaxlib has it, and not by `einsum`."""
    F = jax.ShapeDtypeStruct((1000, 2, 2), float)
    text = jax.jit(lambda F, G: (F[..., None] * G[:, None]).sum(axis=2)).lower(F, F)
    found = summed_by_the_library(text.compile().as_text())
    assert found == ([2] if LIBRARY in text.compile().as_text() else [])
