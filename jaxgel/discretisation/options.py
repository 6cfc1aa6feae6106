"""Options of the cloud and the discretisation."""

import dataclasses

from .._validation import POSITIVE, check_options, keywords_of, option, whole, word
from ..cloud import Cloud, make_cloud
from ..geometry import Plate
from .model import Model, discretise
from .moving_least_squares import BASES
from .placement import placed, quality, refreshed


@dataclasses.dataclass(frozen=True)
class DiscretisationOptions:
    """Choices of `make_cloud` and `discretise`, checked when they are made.

    None leaves the default of the plate or the discretisation. A field's ``stage`` says which of
    the two takes it as a keyword: `cloud` and `model` pass all of theirs on.
    """

    spacing: float | None = option(None, POSITIVE, "cloud")
    """Distance of the background nodes, mm."""
    nodes_per_hole: int | None = option(None, whole(3), "cloud")
    """Nodes on the outline of a whole hole."""
    across: int | None = option(None, whole(2), "cloud")
    """Least number of nodes across every ligament, by local refinement."""
    basis: str = option("quadratic", word(BASES), "model")
    """Basis of the shape functions"""
    dmax: float | None = option(None, POSITIVE | {"maximum": 10.0}, "model")
    """Support radius over spacing."""

    def __post_init__(self) -> None:
        check_options("discretisation", self)

    def cloud(self, plate: Plate) -> Cloud:
        """`make_cloud` of a plate with these options."""
        return make_cloud(plate, **keywords_of(self, "cloud"))

    def model(self, cloud: Cloud) -> Model:
        """`discretise` of a cloud with these options."""
        return discretise(cloud, **keywords_of(self, "model"))

    def refreshed(self, cloud: Cloud, plate: Plate) -> tuple[Cloud, str]:
        """`refreshed` with these options: cloud for a moved plate, and the reason for a new one.

        It is empty if the cloud is not new.
        """
        return refreshed(cloud, plate, basis=self.basis, dmax=self.dmax)

    def placed(self, cloud: Cloud, plate: Plate) -> Model:
        """`placed` with these options: the model of a moved plate."""
        return placed(cloud, plate, basis=self.basis, dmax=self.dmax)

    def carries(self, cloud: Cloud, plate: Plate) -> bool:
        """Whether `refreshed` keeps the ``cloud`` for a moved plate."""
        return not quality(cloud.at(plate), basis=self.basis, dmax=self.dmax).fault

    def at_spacing(self, spacing: float) -> "DiscretisationOptions":
        """These options with another spacing, mm: outline nodes in proportion, equal ``across``.

        At least as many nodes lie across ligaments.
        """
        return dataclasses.replace(self, spacing=float(spacing), nodes_per_hole=None)

    def scaled(self, cloud: Cloud, spacing: float) -> "DiscretisationOptions":
        """These options for a cloud scaled to another spacing, mm, with all its distances."""
        made, factor = cloud.topology, cloud.topology.spacing / spacing
        nodes = (
            None
            if self.nodes_per_hole is None
            else max(8, 4 * round(made.nodes_per_hole * factor / 4))
        )
        across = None if self.across is None else max(2, 1 + round((self.across - 1) * factor))
        return dataclasses.replace(
            self, spacing=float(spacing), nodes_per_hole=nodes, across=across
        )
