"""Matrix of a stage's Newton step: its factorised symmetric part, and the flow's part.

About the positions and the unknowns of mu it is

    [ K            -B^T            ]
    [ -B - tau X   -tau (A + A_M)  ]

see `stage`. X and A are never made: products with them go through the quadrature points, as the
flow itself does, see ``mechanics.FlowRates``. NumPy.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from .._types import Array, Float, Int
from ..linalg import Factor, factor
from ..mechanics import (
    FlowRates,
    Linearisation,
    Problem,
    axial_stretch,
    tangent,
)
from .problem import PatchLists, Transport

MAX_ITERATIONS = 40  # of GMRES


class Rates(NamedTuple):
    """How the flow changes with the state, in the sizes of the ``shared`` form."""

    slopes: tuple
    """Of `Carried`."""
    points: FlowRates
    """At the quadrature points."""
    layer: Float[Array, " e"]
    """Of thin layers by the mu of their groups."""
    layer_by_square: Float[Array, " e"]
    """By the square of the stretch along the surface."""
    share: Float[Array, " g"]
    """That of the flow which works on the unknowns of mu."""


@dataclasses.dataclass(frozen=True, eq=False)
class PatchChange:
    """How the solvent that leaves in a stage changes on the patches of a block; NumPy."""

    lists: PatchLists
    """What the patches know of."""
    slopes: Float[np.ndarray, "c b"]
    """Derivative of what mu moves by mu at places."""
    rates: Float[np.ndarray, "c q 2 6"]
    """Of the flow by the gradient of that, and by the deformation gradient; times tau."""
    pressures: Float[np.ndarray, "c a 2"]
    """Of the patch's mean pressure by nodal positions."""
    thin: Float[np.ndarray, " e"]
    """Of what thin layers take from wetted groups, by their mu; times tau."""
    thin_by_position: Float[np.ndarray, "e a 2"]
    """The same by nodal positions."""
    sides: tuple[Int[np.ndarray, " e"], Int[np.ndarray, " e"]]
    """Patches of these groups, and their places in the lists."""

    def change(
        self,
        mu: Float[np.ndarray, " v"],
        field: Float[np.ndarray, "n 2"],
        v: Float[np.ndarray, " u"],
    ) -> Float[np.ndarray, "c b"]:
        """What leaves each place if ``mu`` at places, unknowns ``v`` and nodes change so."""
        moved, (patch, place), mu = field[self.lists.nodes], self.sides, mu[self.lists.places]
        raised = np.einsum("cai,cai->c", self.pressures, moved) - v[self.lists.means]
        # column by column: in half the time of both together (NumPy 2.4.6, a thread)
        parts = [self.lists.gradients @ (self.slopes * (mu + raised[:, None]))[:, :, None]]
        parts += [self.lists.stretches @ moved[:, :, k, None] for k in range(2)]
        c, q = self.rates.shape[:2]
        given = np.concatenate([part.reshape(c, q, 2) for part in parts], axis=2)
        flux = np.einsum("cqij,cqj->cqi", self.rates, given)
        leaving = (flux.reshape(c, 1, 2 * q) @ self.lists.gradients)[:, 0]
        leaving[patch, place] -= self.thin * mu[patch, place] + np.einsum(
            "eai,eai->e", self.thin_by_position, moved[patch]
        )
        return leaving

    def transposed(
        self, own: Float[np.ndarray, "c b"]
    ) -> tuple[Float[np.ndarray, "c b"], Float[np.ndarray, "c a 2"], Float[np.ndarray, " c"]]:
        """The transpose of `change` on the block's own places, nodes, and means."""
        (c, q), (patch, place) = self.rates.shape[:2], self.sides
        flux = (self.lists.gradients @ own[:, :, None]).reshape(c, q, 2)
        given = np.einsum("cqij,cqi->cqj", self.rates, flux)
        by_gradient, *by_stretch = (
            np.ascontiguousarray(given[:, :, 2 * k : 2 * k + 2]).reshape(c, 1, 2 * q)
            for k in range(3)
        )
        mu = self.slopes * (by_gradient @ self.lists.gradients)[:, 0]
        raised = mu.sum(axis=1)
        nodes = np.stack([(part @ self.lists.stretches)[:, 0] for part in by_stretch], axis=2)
        nodes += self.pressures * raised[:, None, None]
        mu[patch, place] -= self.thin * own[patch, place]
        np.subtract.at(nodes, patch, self.thin_by_position * own[patch, place][:, None, None])
        return mu, nodes, -raised

    @property
    def entries(self) -> Float[np.ndarray, "c t"]:
        """Entries a <= b of a symmetric matrix near the derivative of `change` by mu."""
        c, q, b = *self.rates.shape[:2], self.lists.places.shape[1]
        scaled = (self.lists.gradients * np.sqrt(self.slopes)[:, None]).reshape(c, q, 2, b)
        flux = np.stack(
            [
                self.rates[:, :, i, 0, None] * scaled[:, :, 0]
                + self.rates[:, :, i, 1, None] * scaled[:, :, 1]
                for i in range(2)
            ],
            axis=2,
        )
        both = scaled.reshape(c, 2 * q, b).swapaxes(1, 2) @ flux.reshape(c, 2 * q, b)
        row, column = np.triu_indices(b)
        return both.reshape(c, b * b).take(b * row + column, axis=1)


@dataclasses.dataclass(frozen=True, eq=False)
class FlowChange:
    """How the solvent that leaves in a stage changes, mm^2."""

    transport: Transport
    """Of which problem."""
    blocks: list[PatchChange]
    """Per block, at its places."""
    share: Float[np.ndarray, " u"]
    """What of it works on the unknowns of mu."""
    entries: Float[np.ndarray, " s"]
    """Entries of a symmetric matrix near the derivative by mu, for ``Saddle.pairs``."""

    @classmethod
    def of(cls, transport: Transport, tau: float, now: Linearisation, rates: Rates) -> "FlowChange":
        """Of a stage of length ``tau`` at the state of the linearisation ``now`` and `Rates`."""
        saddle, wet = transport.saddle, transport.solvent.wetting
        layer, by_square = (tau * np.asarray(rate) for rate in (rates.layer, rates.layer_by_square))
        stiffness = np.asarray(now.stiffness)
        entries, blocks = np.zeros(len(saddle.pairs) + 1), []
        for by_gradient, by_stretch, F, slopes, G, block, lists, slots, sides in zip(
            *rates.points,
            rates.slopes,
            now.gradients,
            transport.model.blocks,
            transport.lists,
            saddle.slots,
            saddle.sides,
            strict=True,
        ):
            (c, b), a, q = lists.places.shape, lists.nodes.shape[1], lists.gradients.shape[1] // 2
            by_gradient, by_stretch, F = (
                np.asarray(part)[:c, :q] for part in (by_gradient, by_stretch, F)
            )
            number, patch, place = sides
            weight, groups = np.asarray(block.weight), np.asarray(block.groups)[:, : block.carrying]
            volume = weight.sum(axis=1, keepdims=True)
            square = np.einsum(
                "eq,eqia,eqkj,eij->eak",
                (weight / volume)[patch],
                lists.stretches[patch].reshape(-1, q, 2, a),
                F[patch],
                np.asarray(wet.directions)[number],
                optimize=True,
            )
            change = PatchChange(
                lists,
                np.asarray(slopes)[:c, :b],
                tau * np.concatenate([by_gradient, by_stretch.reshape(c, q, 2, 4)], axis=3),
                np.einsum(
                    "cg,cgia->cai",
                    stiffness[groups] / volume,
                    np.asarray(G)[:c, : block.carrying, :, :a],
                )
                / float(axial_stretch(transport.model)),
                layer[number],
                2 * by_square[number, None, None] * square,
                (patch, place),
            )
            entries += np.bincount(slots.ravel(), change.entries.ravel(), minlength=len(entries))
            blocks.append(change)
        same = saddle.pairs[:, 0] == saddle.pairs[:, 1]
        thin, groups = np.zeros(len(transport.model.carries)), np.asarray(wet.groups)
        thin[groups] = np.maximum(-layer[: len(groups)], 0.0)
        entries[:-1][same] += thin[saddle.pairs[same, 0]]
        share = np.asarray(rates.share)[saddle.groups]
        return cls(transport, blocks, share, entries[:-1])

    def change(
        self, field: Float[np.ndarray, "n 2"], v: Float[np.ndarray, " u"]
    ) -> Float[np.ndarray, " u"]:
        """Residual of mu by the flow if nodes move by ``field`` and the unknowns by ``v``."""
        values, out = self.transport.saddle.values, np.zeros(self._count)
        mu = np.concatenate([values @ v, np.zeros(self._count - values.shape[0])])
        for block in self.blocks:
            leaving = block.change(mu, field, v)
            out += np.bincount(block.lists.places.ravel(), leaving.ravel(), minlength=self._count)
        return self.share * (values.T @ out[: values.shape[0]])

    def transposed(
        self, w: Float[np.ndarray, " u"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " u"]]:
        """The transpose of `change`, of values ``w`` of the unknowns of mu."""
        values, n = self.transport.saddle.values, self.transport.model.n_nodes
        mu, field, v = np.zeros(self._count), np.zeros(2 * n), np.zeros(len(w))
        of_places = np.concatenate(
            [values @ (self.share * w), np.zeros(self._count - values.shape[0])]
        )
        for block in self.blocks:
            by_mu, by_node, by_mean = block.transposed(of_places[block.lists.places])
            mu += np.bincount(block.lists.places.ravel(), by_mu.ravel(), minlength=self._count)
            numbers = 2 * block.lists.nodes[:, :, None] + np.arange(2)
            field += np.bincount(numbers.ravel(), by_node.ravel(), minlength=2 * n)
            v += np.bincount(block.lists.means, by_mean, minlength=len(w))
        return field.reshape(n, 2), v + values.T @ mu[: values.shape[0]]

    @property
    def _count(self):
        """Number of places."""
        return len(self.transport.model.carries) + len(self.transport.solvent.wetting.node_parts)


def factorised(
    transport: Transport,
    acting: Problem,
    now: Linearisation,
    x: Float[Array, "n 2"],
    p: Float[Array, " g"],
    flow: FlowChange,
) -> Factor:
    """Factor of the symmetric part about an iterate of the problem that is ``acting``.

    Raises ``SingularTangent``.
    """
    saddle = transport.saddle
    K, A, B = tangent(acting, x, p, now), flow.entries, []
    for G, real, block in zip(now.gradients, saddle.real, transport.model.blocks, strict=True):
        c, a = real.shape
        part = np.asarray(G)[:c, : block.carrying, :, :a]  # (c, g, 2, a)
        B.append(part.swapaxes(2, 3)[np.broadcast_to(real[:, None], (c, block.carrying, a))])
    B = float(axial_stretch(transport.model)) * np.concatenate(B)
    pairs = np.zeros((len(K) + len(B) + len(A), 2, 2))
    pairs[: len(K)] = K
    pairs[len(K) : len(K) + len(B), :, 0] = -B
    pairs[len(K) + len(B) :, 0, 0] = -A
    return factor(saddle.pattern, pairs)


@dataclasses.dataclass(frozen=True, eq=False)
class Tangent:
    """The matrix of a Newton step."""

    made: Factor
    """Factor of its symmetric part."""
    flow: FlowChange
    """Derivatives of the flow."""

    def product(self, v: Float[np.ndarray, " r"]) -> Float[np.ndarray, " r"]:
        """Product with ``v``: changes of the position unknowns, then of those of mu."""
        fields, f = self._fields, self._fields.shape[1]
        leaving = self.flow.change((fields @ v[:f]).reshape(-1, 2), v[f:])
        return np.concatenate([self.made.product(v)[:f], -self.taken_up(v[:f]) - leaving])

    def transposed(self, v: Float[np.ndarray, " r"]) -> Float[np.ndarray, " r"]:
        """The product of the transposed matrix with ``v``."""
        fields, f = self._fields, self._fields.shape[1]
        forces, leaving = self.flow.transposed(v[f:])
        return np.concatenate(
            [self.made.product(v)[:f] - fields.T @ forces.ravel(), -self.taken_up(v[:f]) - leaving]
        )

    def taken_up(self, v: Float[np.ndarray, " f"]) -> Float[np.ndarray, " u"]:
        """Solvent taken up, on the unknowns of mu, if positions change by ``v``: B v."""
        return -self.made.product(
            np.concatenate([v, np.zeros(len(self.flow.transport.saddle.groups))])
        )[len(v) :]

    def forces(self, w: Float[np.ndarray, " u"]) -> Float[np.ndarray, " f"]:
        """The transpose of `taken_up`, of values ``w`` of the unknowns of mu: B^T w."""
        f = self._fields.shape[1]
        return -self.made.product(np.concatenate([np.zeros(f), w]))[:f]

    @property
    def _fields(self):
        return self.flow.transport.saddle.fields

    def solve(
        self, rhs: Float[np.ndarray, " r"], tolerance: float, *, transposed: bool = False
    ) -> Float[np.ndarray, " r"]:
        """Solution by GMRES, which leaves ``tolerance`` of the right-hand side."""
        size = (len(rhs), len(rhs))
        operator = LinearOperator(
            size, matvec=self.transposed if transposed else self.product, dtype=float
        )
        precond = LinearOperator(size, matvec=self.made.apply, dtype=float)
        return gmres(
            operator, rhs, M=precond, rtol=tolerance, atol=0.0, restart=MAX_ITERATIONS, maxiter=1
        )[0]
