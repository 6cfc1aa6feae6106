"""Recipes of docs/architecture.md, "Where to add", followed in a copy of the package."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HOLE = '''
@pytree()
@dataclasses.dataclass(frozen=True, eq=False)
class Egg(Hole):
    """An oval with a blunt side."""

    centre: Float[Array, "2"] | Sequence[Scalar]
    """Centre, mm."""
    radius: Scalar
    """Mean radius, mm."""
    bluntness: Scalar
    """Of the right side, dimensionless."""

    shapes: ClassVar[dict[str, tuple]] = {"centre": (2,), "radius": (), "bluntness": ()}
    positive: ClassVar[tuple[str, ...]] = ("radius",)

    def point(self, t: Scalar) -> Float[Array, "2"]:
        phi = 2 * jnp.pi * t
        return self.centre + self.radius * (1 + self.bluntness * jnp.cos(phi)) * _direction(phi)

    def excess(self, x: Float[Array, "2"]) -> Float[Array, ""]:
        d = x - self.centre
        rho = jnp.linalg.norm(d)
        return rho - self.radius * (1 + self.bluntness * d[0] / rho)

    def area(self) -> Float[Array, ""]:
        return jnp.pi * self.radius**2 * (1 + self.bluntness**2 / 2)


KINDS: Mapping'''
ENERGY = '''
@dataclasses.dataclass(frozen=True)
class Quadratic:
    """Network energy Nv/2 (I - 3 + c (I - 3)^2)."""

    c: float

    def __call__(self, F: Float[Array, "2 2"], gel: Any, axial: Scalar = 1.0) -> Float[Array, ""]:
        excess = jnp.sum(F**2) + (axial**2 - 3)
        return gel.Nv / 2 * (excess + self.c * excess**2)


def network_at('''
OBSERVABLE = '''

@of_path
def top_edge(states: States) -> Float[Array, " k"]:
    """Mean displacement (k,) of the top edge along y, mm."""
    nodes = states.model.lists.topology.edge_nodes["top"]
    return jnp.mean(states.x[:, nodes, 1], axis=1) - states.model.cloud.plate.height / 2
'''
CONTROL = '''
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Shear:
    """The control that is the shear which the edges follow."""

    mu: Scalar = 0.0
    name: str = dataclasses.field(default="shear", kw_only=True, metadata={"static": True})
    unit: str = dataclasses.field(default="", kw_only=True, metadata={"static": True})
    scale: float = dataclasses.field(default=0.1, kw_only=True, metadata={"static": True})

    def __call__(self, value: Scalar, gel: Any) -> Setting:
        return Setting(self.mu, gel, deformation=jnp.eye(2).at[0, 1].set(value))
'''
KINDS_OF_CONTROLS = '''    "shear": Kind(
        lambda own: edges.Shear(own["mu"]), "", "shear", "shear of the edges", ".4f"
    ),
    "Nv": Kind(_driven("Nv"), "", "Nv", "density of chains", ".4g", 1e-3),
}
"""Name -> what'''
COMMAND = '''

def kinds(args: Namespace) -> int:
    """``jaxgel kinds``: list the kinds of holes."""
    from ..geometry import KINDS

    print(*KINDS)
    return DONE
'''
QUANTITY = """    Quantity(
        "top_edge",
        top_edge,
        "mm",
        "top edge",
        "mean displacement of the top edge",
        column="top_edge",
        **_STUDIED,
    ),
    *(_macroscopic"""
# recipe -> file below jaxgel/, what is replaced (the end of the file for None) and by what
RECIPES = {
    "hole": [
        ("geometry/holes.py", "\nKINDS: Mapping", HOLE),
        ("geometry/holes.py", "Fourier, Polygon)\n}", "Fourier, Polygon, Egg)\n}"),
        ("geometry/__init__.py", "KINDS, Circle, Ellipse,", "KINDS, Circle, Egg, Ellipse,"),
        ("geometry/__init__.py", '    "Ellipse",', '    "Egg",\n    "Ellipse",'),
        (
            "__init__.pyi",
            "from .geometry import Ellipse",
            "from .geometry import Egg as Egg\nfrom .geometry import Ellipse",
        ),
    ],
    "network energy": [
        ("materials/gel.py", "\ndef network_at(", ENERGY),
        ("materials/__init__.py", "    Gent,", "    Gent,\n    Quadratic,"),
        ("materials/__init__.py", '    "Gent",', '    "Gent",\n    "Quadratic",'),
        (
            "__init__.pyi",
            "from .materials import Gent as",
            "from .materials import Quadratic as Quadratic\nfrom .materials import Gent as",
        ),
    ],
    "observable": [
        ("observables/rotation.py", None, OBSERVABLE),
        (
            "observables/quantities.py",
            "import core_rotation, rotation_angle",
            "import core_rotation, rotation_angle, top_edge",
        ),
        ("observables/quantities.py", "    *(_macroscopic", QUANTITY),
    ],
    "control": [
        ("controls/edges.py", None, CONTROL),
        ("controls/registry.py", '}\n"""Name -> what', KINDS_OF_CONTROLS),
    ],
    "command": [
        ("cli/starting.py", None, COMMAND),
        (
            "cli/parser.py",
            "    case_commands(add)\n",
            '    add("starting.kinds", "kinds", "kinds of holes")\n    case_commands(add)\n',
        ),
    ],
}
CASE = """
[plate]
width = 4.0
height = 4.0
spacing = 1.0
nodes_per_hole = 8
[[holes]]
kind = "egg"
centre = [0.1, 0.0]
radius = 1.0
bluntness = 0.1
[gel]
energy = "mine:gel"
c = 1e-3
[sweep]
contact = "off"
control = "{control}"
values = {values}
at_mu = -2.0
"""
RUN = """
import json, sys
import jaxgel, jaxgel.cli
from jaxgel.cases import load_case, load_path
from jaxgel.observables import history
codes, rows = [jaxgel.cli.main(["kinds"])], {}
for control in sys.argv[1:]:
    options = ["--no-plots", "--quiet", "--out", control]
    codes.append(jaxgel.cli.main(["run", f"{control}.toml", *options]))
    path = load_path(control)
    table = history(path)
    columns = {"controls": table[control], "top_edge": table["top_edge"]}
    rows[control] = {name: list(map(float, values)) for name, values in columns.items()}
    rows[control]["gel"] = repr(path.gel)
    rows[control]["hole"] = repr(type(path.model.cloud.plate.holes[0]) is jaxgel.Egg)
print(json.dumps([codes, rows, jaxgel.Quadratic.__name__, load_case("Nv.toml").sweep.control]))
"""
VALUES = {"shear": [0.0, 0.1], "Nv": [1e-3, 2e-3]}


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """Folder with a copy of the package after all recipes, and a case for either control."""
    folder = tmp_path_factory.mktemp("recipes")
    shutil.copytree(
        ROOT / "jaxgel", folder / "jaxgel", ignore=shutil.ignore_patterns("__pycache__")
    )
    for name, old, new in (edit for edits in RECIPES.values() for edit in edits):
        file = folder / "jaxgel" / name
        text = file.read_text(encoding="utf-8")
        assert old is None or text.count(old) == 1, f"{name} does not have {old!r} once"
        file.write_text(text + new if old is None else text.replace(old, new), encoding="utf-8")
    (folder / "mine.py").write_text(
        "import jaxgel\ndef gel(Nv, chi, c):\n"
        "    return jaxgel.Gel(Nv, chi, network=jaxgel.Quadratic(c))\n"
    )
    for control, values in VALUES.items():
        (folder / f"{control}.toml").write_text(CASE.format(control=control, values=values))
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("control", ["shear", pytest.param("Nv", marks=pytest.mark.slow)])
def test_the_recipes_make_a_hole_an_energy_an_observable_two_controls_and_a_command(copy, control):
    variables = os.environ | {"PYTHONPATH": str(copy)}
    done = subprocess.run(
        [sys.executable, "-c", RUN, control],
        cwd=copy,
        env=variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    kinds, *_, answer = done.stdout.splitlines()
    codes, rows, energy, other = json.loads(answer)
    assert codes == [0, 0] and "egg" in kinds.split() and (energy, other) == ("Quadratic", "Nv")
    row = rows[control]
    assert row["controls"] == VALUES[control]
    assert "Quadratic(c=0.001)" in row["gel"] and row["hole"] == "True"
    # the edges of the plate do not move along y
    assert row["top_edge"] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_the_recipes_name_every_file_that_is_changed():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    for recipe, edits in RECIPES.items():
        section = re.search(rf"\n### An? (?:kind of )?{recipe}\n(.*?)\n##", text, re.DOTALL)[1]
        missing = [name for name, *_ in edits if f"jaxgel/{name}" not in section]
        assert not missing, f"{recipe}: {missing}"
