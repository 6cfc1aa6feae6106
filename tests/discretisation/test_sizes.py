"""Sizes of programs: padding is inert, and similar plates share programs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import monitoring

import jaxgel
from jaxgel._sizes import padded, room, rung, taken
from jaxgel.discretisation import consistency, layout
from jaxgel.discretisation.interpolation import size_of_groups
from jaxgel.discretisation.ladder import patches_of_blocks

GEL = jaxgel.Gel(Nv=1e-3, chi=0.2)


def plate(axes):
    return jaxgel.Plate(
        8,
        8,
        [jaxgel.Ellipse((0.3, -0.2), axes, 0.4)],
        regions=[jaxgel.Circle((2.9, 2.9), 0.7)],
        spacing=0.9,
    )


def of_patches(cloud, axes):
    """Blocks and outline of a model as a function of the semi-axes of the plate's hole."""
    return jaxgel.discretise(cloud.at(cloud.plate.at([{"semi_axes": axes}])))


@pytest.mark.thorough
def test_a_program_holds_the_shape_functions_once_for_all_points():
    """Inside the patches and on their contours; XLA compiles a function at every call of it."""
    cloud = jaxgel.make_cloud(plate((2.0, 1.6)))
    assert jaxgel.discretise(cloud).n_points > 1024

    def gradients(axes):
        return [block.dphi for block in of_patches(cloud, axes).blocks]

    text = jax.jit(gradients).lower(jnp.array([2.0, 1.6])).as_text()
    assert text.count("call @_evaluated") == 2


@pytest.mark.parametrize("steps", [1, 2, 4])
def test_sizes_of_the_ladder_hold_a_number_and_are_few(steps):
    numbers = np.arange(1, 5000)
    sizes = np.array([rung(int(n), steps) for n in numbers])
    assert np.all(sizes >= numbers) and np.all(sizes <= (1 + 1 / steps) * numbers)
    assert len(np.unique(sizes)) <= steps * 13 + 1  # 13 doublings to 8192
    # a size of the ladder is its own
    assert np.all(np.isin(sizes, [rung(int(n), steps) for n in np.unique(sizes)]))


@pytest.mark.parametrize("shape", [(3,), (3, 2)])
def test_no_rows_have_a_derivative_of_zeros(shape):
    """As those of the free edges of a plate without any.

    NumPy (2.4) gives whole numbers for ``bincount`` of nothing, weighted or not.
    """
    values = np.arange(float(np.prod(shape))).reshape(shape)
    found, pullback = jax.vjp(lambda v: taken(v, np.zeros(0, dtype=int)), jnp.asarray(values))
    (slope,) = pullback(found)
    assert found.shape == (0, *shape[1:]) and slope.dtype == np.float64
    np.testing.assert_array_equal(slope, np.zeros(shape))


@pytest.mark.slow
def test_padding_is_inert(monkeypatch):
    cloud = jaxgel.make_cloud(plate((2.4, 1.6)))

    def total(axes):
        """All numbers of the blocks with weights of their own, and the numbers."""
        leaves = jax.tree.leaves(of_patches(cloud, axes).blocks)
        return sum(
            jnp.vdot(np.sin(np.arange(leaf.size) + 7.0 * k), leaf) for k, leaf in enumerate(leaves)
        ), leaves

    def numbers():
        return jax.value_and_grad(total, has_aux=True)(jnp.array([2.3, 1.7]))

    once = numbers()
    monkeypatch.setattr(layout, "room", lambda count, least=None: room(2 * count, least))
    monkeypatch.setattr(consistency, "room", layout.room)
    monkeypatch.setattr(
        layout,
        "patches_of_blocks",
        lambda counts, *others: patches_of_blocks([2 * count for count in counts], *others),
    )
    monkeypatch.setattr(layout, "size_of_groups", lambda count: size_of_groups(2 * count))
    cloud = jaxgel.make_cloud(plate((2.4, 1.6)))  # a layout is made once for a cloud
    twice = numbers()
    for one, two in zip(jax.tree.leaves(once), jax.tree.leaves(twice), strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-12, atol=1e-12 * np.abs(one).max())


def test_padding_repeats_the_last_row_of_numbers_and_of_traces():
    values = np.arange(6.0).reshape(3, 2)
    np.testing.assert_array_equal(padded(values, 5), values[[0, 1, 2, 2, 2]])
    jacobian = jax.jacobian(lambda v: padded(v, 5).sum(axis=1))(jnp.asarray(values))
    np.testing.assert_array_equal(jacobian.sum(axis=(0, 2)), [2.0, 2.0, 6.0])


@pytest.mark.slow
def test_shape_functions_of_a_similar_plate_are_not_compiled_again():
    """Neither of a second plate nor their derivatives.

    What is left is to make its cloud and to cut what was padded.
    """
    names = []

    def hear(event, *_, fun_name="", **__):
        if event.endswith("backend_compile_duration"):
            names.append(fun_name)

    def value_and_slopes(axes):
        cloud = jaxgel.make_cloud(plate(axes))
        return jax.value_and_grad(
            lambda axes: jnp.sum(of_patches(cloud, axes).blocks[0].dphi ** 2)
        )(jnp.array(axes))

    value_and_slopes((2.4, 1.6))
    monitoring.register_event_duration_secs_listener(hear)
    try:
        value_and_slopes((2.39, 1.61))
    finally:
        monitoring.unregister_event_duration_listener(hear)
    dear = ("_evaluated", "_consistent", "_taken", "_concatenated", "_placed")
    assert [name for name in names if any(part in name for part in dear)] == []


@pytest.mark.thorough
def test_layout_pads_without_weight_and_length():
    cloud = jaxgel.make_cloud(plate((2.4, 1.6)))
    lists = jaxgel.discretise(cloud).lists
    given, wide = lists.topology.quadrature, layout.layout_of(lists)
    vertices = np.asarray(cloud.vertices)
    np.testing.assert_array_equal(wide.quadrature.weights(vertices)[len(given.owner) :], 0.0)
    np.testing.assert_array_equal(
        wide.quadrature.points(vertices)[: len(given.owner)], given.points(vertices)
    )
    ends = wide.contour.ends[len(lists.contour.ends) :]
    assert len(ends) and np.all(ends[:, 0] == ends[:, 1])
