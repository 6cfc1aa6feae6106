"""Matrix of a stage's Newton step: its factorised symmetric part, and the flow's part.

About the positions and the unknowns of mu it is

    [ K          -B^T            ]
    [ -B - tau X -tau (A + A_M)  ]

see `stage`. The flow of each patch depends on mu at the patch's places and on the positions of its
nodes, so that its derivatives are a matrix for each patch. NumPy.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from .._programs import program
from .._types import Array, Float
from ..linalg import Factor, factor
from ..mechanics import (
    Carried,
    FlowRates,
    Linearisation,
    Problem,
    axial_stretch,
    flow_rates,
    tangent,
)
from .problem import Transport

MAX_ITERATIONS = 40  # of GMRES


class Rates(NamedTuple):
    """How the flow changes with the state, in the sizes of the ``shared`` form."""

    carried: Carried
    """By mu and pressures."""
    layer: Float[Array, " e"]
    """That of thin layers by the mu of their groups."""
    layer_by_square: Float[Array, " e"]
    """By the square of the stretch along the surface."""
    share: Float[Array, " g"]
    """That of the flow which works on the unknowns of mu."""


@program(x="n")
def _flow_rates(problem, x, now, rates):
    return flow_rates(x, now, rates.carried, problem.model, problem.solvent, problem.D)


@dataclasses.dataclass(frozen=True, eq=False)
class FlowMatrices:
    """Derivatives of the solvent that leaves in a stage, patch by patch, at its places, mm^2."""

    transport: Transport
    """Of which problem."""
    by_mu: list[Float[np.ndarray, "c b b"]]
    """Per block, by mu at its places."""
    by_position: list[Float[np.ndarray, "c b d"]]
    """By the positions of its nodes, d = 2 a."""
    by_mean: list[Float[np.ndarray, "c b"]]
    """By the mean mu of its own groups."""
    share: Float[np.ndarray, " u"]
    """What of it works on the unknowns of mu."""
    entries: Float[np.ndarray, " s"]
    """Entries of a symmetric matrix near the derivative by mu, for ``Saddle.pairs``."""

    @classmethod
    def of(
        cls,
        transport: Transport,
        x: Float[Array, "n 2"],
        tau: float,
        now: Linearisation,
        rates: Rates,
    ) -> "FlowMatrices":
        """Of a stage of length ``tau`` at ``x`` with the linearisation ``now`` and the `Rates`."""
        saddle, solvent = transport.saddle, transport.solvent
        found: FlowRates = _flow_rates(transport, x, now, rates)
        layer, by_square = (tau * np.asarray(rate) for rate in (rates.layer, rates.layer_by_square))
        directions = np.asarray(solvent.wetting.directions)
        entries, parts = np.zeros(len(saddle.pairs) + 1), []
        blocks = zip(
            *found,
            rates.carried.slopes,
            transport.model.blocks,
            solvent.blocks,
            saddle.slots,
            saddle.sides,
            strict=True,
        )
        for by_mu, by_position, by_mean, squares, slope, block, on_block, slots, (
            number,
            patch,
            place,
        ) in blocks:
            (c, b), a = on_block.places.shape, block.nodes.shape[1]
            mu, mean = (
                tau * np.asarray(part)[(slice(c), *(slice(b),) * (part.ndim - 1))]
                for part in (by_mu, by_mean)
            )
            root = np.sqrt(np.asarray(slope)[:c, :b])
            low, high = np.triu_indices(b)
            upper = mu[:, low, high] * (root[:, low] / np.where(root > 0, root, 1.0)[:, high])
            entries += np.bincount(slots.ravel(), upper.ravel(), minlength=len(entries))
            position = tau * np.asarray(by_position)[:c, :b, :a]
            position[patch, place] -= by_square[number, None, None] * np.einsum(
                "eakij,eij->eak", np.asarray(squares)[patch, :a], directions[number]
            )
            mu[patch, place, place] -= layer[number]
            parts.append((mu, position.reshape(c, b, 2 * a), mean))
        same = saddle.pairs[:, 0] == saddle.pairs[:, 1]
        thin = np.zeros(len(transport.model.carries))
        wet = np.asarray(solvent.wetting.groups)
        thin[wet] = np.maximum(-layer[: len(wet)], 0.0)
        entries[:-1][same] += thin[saddle.pairs[same, 0]]
        share = np.asarray(rates.share)[saddle.groups]
        return cls(transport, *map(list, zip(*parts, strict=True)), share, entries[:-1])

    def change(
        self, field: Float[np.ndarray, "n 2"], v: Float[np.ndarray, " u"]
    ) -> Float[np.ndarray, " u"]:
        """Residual of mu by the flow if nodes move by ``field`` and the unknowns by ``v``."""
        saddle, out = self.transport.saddle, np.zeros(self._count)
        mu = np.concatenate([saddle.values @ v, np.zeros(self._count - saddle.values.shape[0])])
        for places, nodes, by_mu, by_position, by_mean, mean in self._patches:
            at = by_mu @ mu[places][:, :, None] + by_position @ field[nodes].reshape(
                len(nodes), -1, 1
            )
            leaving = at[:, :, 0] + by_mean * v[mean][:, None]
            out += np.bincount(places.ravel(), leaving.ravel(), minlength=self._count)
        return self.share * (saddle.values.T @ out[: saddle.values.shape[0]])

    def transposed(
        self, w: Float[np.ndarray, " u"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " u"]]:
        """The transpose of `change`, of values ``w`` of the unknowns of mu."""
        saddle, n = self.transport.saddle, self.transport.model.n_nodes
        mu, field, v = np.zeros(self._count), np.zeros(2 * n), np.zeros(len(w))
        of_places = np.concatenate(
            [saddle.values @ (self.share * w), np.zeros(self._count - saddle.values.shape[0])]
        )
        for places, nodes, by_mu, by_position, by_mean, mean in self._patches:
            own = of_places[places][:, None]
            mu += np.bincount(places.ravel(), (own @ by_mu).ravel(), minlength=self._count)
            numbers = 2 * nodes[:, :, None] + np.arange(2)
            field += np.bincount(numbers.ravel(), (own @ by_position).ravel(), minlength=2 * n)
            v += np.bincount(mean, np.sum(own[:, 0] * by_mean, axis=1), minlength=len(w))
        return field.reshape(n, 2), v + saddle.values.T @ mu[: saddle.values.shape[0]]

    @property
    def _count(self):
        """Number of places."""
        return len(self.transport.model.carries) + len(self.transport.solvent.wetting.node_parts)

    @property
    def _patches(self):
        transport = self.transport
        lists = [
            (on.places, block.nodes)
            for on, block in zip(transport.solvent.blocks, transport.model.blocks, strict=True)
        ]
        parts = zip(
            lists, self.by_mu, self.by_position, self.by_mean, transport.saddle.means, strict=True
        )
        return [(np.asarray(at), np.asarray(nodes), *rest) for (at, nodes), *rest in parts]


def factorised(
    transport: Transport,
    acting: Problem,
    now: Linearisation,
    x: Float[Array, "n 2"],
    p: Float[Array, " g"],
    flow: FlowMatrices,
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
    flow: FlowMatrices
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
