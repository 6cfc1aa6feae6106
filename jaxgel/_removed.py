"""Names, arguments and options of version 0.2 that are gone, each with what a user writes instead.

Nothing replaces a name whose text is empty.
"""

LAW = "materials.VolumeLaw(gel, mu, axial, film)"
PROBLEM = "Problem(model, gel, loads=..., control=..., contact=...) as the first argument"
SCHEME = "jaxgel.paper.make_scheme, with its equilibria"


def _without(package: str, names: str) -> dict[str, str]:
    """Names of a package that nothing replaces."""
    return {f"{package}.{name}": "" for name in names.split()}


REMOVED = {
    "Dispersion": "lattice_onset, for the instability of a lattice",
    "dispersion": "lattice_onset, for the instability of a lattice",
    "bifurcation.imperfection_load": "imperfection(problem, point, size)",
    "bifurcation.points_by_options": "Case.critical_points",
    "bifurcation.solve_from": "equilibrium.solve(problem.prepared, value, x, pressure)",
    "continuation.is_traced": "",
    "controls.Values": "",
    "controls.adds_loads": "the attributes of the control",
    "controls.control_name": "control.name",
    "controls.drives_stiffness": "the attributes of the problem",
    "controls.edge_motion": "problem.at(value)",
    "controls.moves_edges": "the attributes of the problem",
    "controls.scale_of": "the attributes of the control",
    "controls.setting_of": "problem.at(value)",
    "controls.unit_of": "control.unit",
    "discretisation.METHODS": SCHEME,
    "discretisation.QUADRATURES": SCHEME,
    "equilibrium.CONSTRAINT_TOLERANCE": "Newton, the options of Newton's method",
    "equilibrium.MAX_ITERATIONS": "Newton, the options of Newton's method",
    "equilibrium.TOLERANCE": "Newton, the options of Newton's method",
    "equilibrium.assess_equilibrium": "Newton.assess",
    "equilibrium.negative_eigenvalues": "State.negative_pivots",
    "equilibrium.of_control": "equilibrium.control_force(problem, state)",
    "equilibrium.prepare_incremental": SCHEME,
    "equilibrium.prepare_weak": SCHEME,
    "equilibrium.solve_incremental": SCHEME,
    "equilibrium.solve_weak": SCHEME,
    "geometry.arc_point": "geometry.arc_points(plate, arc, [s])[0]",
    "linalg.Kept": "linalg.Factor",
    "linalg.remember": "linalg.RECENT_FACTORS.add",
    "linalg.solve_near": "mechanics.factorised_tangent(...).solve(b)",
    "linalg.solve_near_factor": "mechanics.factorised_tangent(...).solve(b)",
    "materials.Varying": "arrays, with which energies broadcast",
    "materials.by_material": LAW,
    "materials.elastic_energy": f"{LAW}.energy",
    "materials.elastic_film_energy": f"{LAW}.energy",
    "materials.elastic_film_pressure": f"{LAW}.pressure",
    "materials.elastic_film_stiffness": f"{LAW}.stiffness",
    "materials.elastic_film_stretch": f"{LAW}.areal_stretch",
    "materials.elastic_film_stretch_at": f"{LAW}.areal_stretch",
    "materials.elastic_pressure": f"{LAW}.pressure",
    "materials.elastic_stiffness": f"{LAW}.stiffness",
    "materials.elastic_volume_ratio": f"{LAW}.volume_ratio",
    "materials.film_energy": f"{LAW}.energy",
    "materials.film_pressure": f"{LAW}.pressure",
    "materials.film_stiffness": f"{LAW}.stiffness",
    "materials.film_stretch_at": f"{LAW}.areal_stretch",
    "materials.film_volume_ratio": f"{LAW}.volume_ratio",
    "materials.largest_mu": 'limits_of_stability(gel, swelling="plane strain").control[0]',
    "materials.largest_pressure": "materials.osmotic(materials.stiff_until(0.0, gel), mu, gel)",
    "materials.polyelectrolyte_energy": "Polyelectrolyte",
    "materials.split": "arrays, with which energies broadcast",
    "materials.stretch_near": LAW,
    "materials.value": "arrays, with which energies broadcast",
    "mechanics.Strained": "mechanics.Free",
    "mechanics.TangentOperator": "mechanics.factorised_tangent(...)",
    "mechanics.carries_volume": "model.carries",
    "mechanics.is_film": "model.film",
    "mechanics.is_generalised": "mechanics.volume_law",
    "mechanics.is_sparse": "mechanics.factorised_tangent(...)",
    "mechanics.mu_force": "equilibrium.control_force(problem, state)",
    "mechanics.outline_loops": "observables.outlines(path)",
    "mechanics.prepare": "Problem(model, gel, loads=loads).prepared",
    "mechanics.pressure_step_of_mu": "equilibrium.control_force(problem, state)",
    "mechanics.start_positions": "equilibrium.dry_state",
    "mechanics.tangent_product": "mechanics.factorised_tangent(...).product(v)",
    "observables.WRINKLE_RATIO": "surface_stability",
    "observables.axial_stretch": "a number for axial_stretch, by the root in docs/howto/printed.md",
    "observables.phases": "materials.phase_of(J, gel)",
    "observables.swollen_share": "materials.phase_of(J, gel)",
    "plotting.PathView": "plotting.plot_pattern(path)",
    "plotting.show_path": "plotting.plot_pattern(path)",
    "waves.Dispersion": "lattice_onset, for the instability of a lattice",
    "waves.dispersion": "lattice_onset, for the instability of a lattice",
    **_without("cloud", "contour_edges edge_points square_cells"),
    **_without("continuation", "CONTACT values_of"),
    **_without("discretisation", "in_plane"),
    **_without("equilibrium", "strain_matrices strain_operators with_derivatives_of"),
    **_without(
        "linalg", "Border SOLVERS View bordered_product extreme_eigenvalues host_border standing"
    ),
    **_without("materials", "balanced_stretch"),
    **_without("mechanics", "STATES_TOGETHER border contact_pairs held_stretch walls"),
    **_without("observables", "NO_GEL driven_column"),
    **_without(
        "paper", "CLOSING CONDITION CONFIRMED CONTRADICTED Claim Entry METHODS Number PRINTED Runs"
    ),
    **_without("paper", "TIMED at bow crossing stability table_1"),
    **_without("plotting", "plot_bands"),
    **_without("symmetry", "Orbits node_images orbits"),
    **_without("waves", "brillouin_path check_periodic"),
}

_OF_PROBLEM = dict.fromkeys(("model", "gel", "loads", "control", "contact"), PROBLEM)
_OBSERVED = {"on_step": "observer=Observer(accepted=f)"}
ARGUMENTS = {  # of functions: argument -> what a call has instead
    "sweep": {
        "mu": "sweep(Problem(model, gel), values), with Adaptive(first, last) for chosen steps",
        **_OF_PROBLEM,
        **_OBSERVED,
        "max_steps": "Adaptive(first, last, max_steps=...) as the values",
        "formulation": SCHEME,
    },
    "critical_points": {
        "mu": "critical_points(problem, ends)",
        **_OF_PROBLEM,
        "values": "critical_points(problem, ends)",
    },
    "loop": {
        "mu": "loop(problem, ends)",
        **_OF_PROBLEM,
        **_OBSERVED,
        "values": "loop(problem, ends)",
    },
    "barrier": {"mu": "barrier(problem, mu, between)", **_OF_PROBLEM},
    "find_states_by_deflation": {"mu": "find_states_by_deflation(problem, mu, ...)", **_OF_PROBLEM},
    "switch_branch": {
        "mu_end": "switch_branch(problem, point, end=...)",
        **_OF_PROBLEM,
        **dict.fromkeys(
            ("max_step", "max_states"), "continue_branch(path, ...) from the states that it returns"
        ),
    },
    "continue_branch": {"loads": "those of path.problem"},
    "folds": {"loads": "those of path.problem"},
    "imperfection": _OF_PROBLEM,
    "lattice_onset": {"mu": "lattice_onset(problem, ends)", **_OF_PROBLEM},
    "discretise": {
        **dict.fromkeys(("method", "quadrature", "kind", "conditions", "penalty", "cells"), SCHEME),
        "skin": "",
        "solver": "",
    },
    "make_cloud": {"follow_outlines": ""},
    "paper_stress": {"stretch": ""},
    "paper_tangent": {"stretch": ""},
    "animate_pattern": {"most_frames": ""},
    "plot_lattice": {"size": ""},
    "plot_modes": {"size": ""},
    "Case.path": _OBSERVED,
    "Case.loop": _OBSERVED,
    "Recorder": {
        **dict.fromkeys(("model", "gel"), "Recorder(folder, case, problem)"),
        **dict.fromkeys(("steps", "seconds"), "Recorder(...).begin(states)"),
        "durable": "",
    },
    "Workers": {"spent": "Workers(calls_each=...)"},
    "write_waves": {"bands": ""},
    "load_run": {"max_bytes": ""},
    "read_summary": {"max_bytes": ""},
    "write_atomically": {"durable": ""},
}
CALLS = {  # functions that take fewer arguments without a name -> how they are called
    "sweep": "sweep(problem, values)",
    "switch_branch": "switch_branch(problem, point)",
    "imperfection": "imperfection(problem, point, size)",
    "folds": "folds(path)",
}

_PAPER = "gone since 0.3, jaxgel has one discretisation; the paper's is jaxgel.paper.make_scheme"
_NUMERICAL = "gone since 0.3, nothing replaces it"
OPTIONS = {  # of the command line and entries of case files -> what their line says
    "--method": _PAPER,
    "--quadrature": _PAPER,
    "--solver": _NUMERICAL,
    "--bands": "gone since 0.3: no gel vibrates at constant chemical potential",
    "discretisation.method": _PAPER,
    "discretisation.quadrature": _PAPER,
    "discretisation.solver": _NUMERICAL,
    "discretisation.follow_outlines": "gone since 0.3, squares follow outlines always",
    "plate.cells": _PAPER,
}
