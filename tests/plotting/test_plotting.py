"""Figures carry what they say they carry; axes come in and go out."""

import dataclasses
import itertools
import sys

import imageio_ffmpeg
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image, ImageSequence

import jaxgel
from jaxgel.observables import BY_COLUMN, QUANTITIES, field_values, history, triangles
from jaxgel.plotting import (
    CURVES,
    animate_pattern,
    draw_optima,
    plot_curve,
    plot_curves,
    plot_pattern,
    plot_patterns,
)

DARK = 100  # of 255: grey of lines and letters


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def lines(ax, style):
    """The drawn lines of a style that hold at least one point."""
    return [
        line
        for line in ax.lines
        if line.get_linestyle() == style
        and np.isfinite(line.get_ydata()).any()
        and len(line.get_xdata()) > 2
    ]


@pytest.mark.parametrize("field", ["J", "stretch", None])
def test_a_pattern_is_drawn_on_the_axes_given(path, field):
    ax = plt.figure().add_subplot()
    assert plot_pattern(path, 2, ax=ax, field=field) is ax
    assert ax.get_aspect() == 1.0
    assert ax.get_title() == rf"$\mu = {path.mu[2]:.4f}\,kT$"
    assert "mm" in ax.get_xlabel()
    assert "mm" in ax.get_ylabel()
    assert len(ax.figure.axes) == (1 if field is None else 2)


def test_a_pattern_shows_all_four_walls_and_leaves_out_free_edges(path):
    ax = plot_pattern(path)
    assert sum(patch.get_hatch() is not None for patch in ax.patches) == 4


def area_mean(path, values):
    """Mean over the dry gel (k,) of values (k, t) on the triangles."""
    corners = np.asarray(path.model.cloud.vertices)[np.asarray(path.model.cloud.triangles)]
    area = np.linalg.det(triangles._edges(corners)) / 2
    return values @ area / area.sum()


def test_field_j_is_the_volume_ratio_of_the_cells(path):
    np.testing.assert_allclose(
        area_mean(path, field_values(path, "J")),
        jaxgel.observables.mean_volume_ratio(path),
        rtol=1e-9,
    )  # of moments of J over patches, and of points


def test_the_largest_stretch_is_at_least_the_root_of_the_volume_ratio(path):
    """Between vertices lines stay straight: J differs by the bulge of edges, 2e-3 here."""
    assert np.all(field_values(path, "stretch") >= np.sqrt(field_values(path, "J")) * (1 - 2e-3))


def test_a_row_of_patterns_takes_the_nearest_states(path):
    axes = plot_patterns(path, at=[path.mu[0] + 1e-3, path.mu[-1] - 1e-3])
    assert [ax.get_title() for ax in axes] == [
        rf"$\mu = {mu:.4f}\,kT$" for mu in (path.mu[0], path.mu[-1])
    ]
    assert len(axes[0].figure.axes) == 3  # one colour bar for all
    with pytest.raises(
        ValueError,
        match=r"^mu: 1 is beyond the path, which runs from -\S+ to -0.9178; give a value within$",
    ):
        plot_patterns(path, at=[path.mu[0], 1.0])


@pytest.fixture(scope="module")
def table(path):
    """Its table."""
    return history(path)


@pytest.mark.parametrize("against", ["mu", "free_stretch"])
@pytest.mark.parametrize("quantity", CURVES)
def test_a_curve_holds_the_values_of_the_history(path, table, quantity, against):
    ax = plot_curve(path, quantity, against=against)
    curve = lines(ax, "-")[0]
    first = QUANTITIES[next(iter(CURVES[quantity]))]
    np.testing.assert_allclose(curve.get_xdata(), table[against])
    np.testing.assert_allclose(
        curve.get_ydata(), table[first.column] * (100 if quantity == "area_reduction" else 1)
    )
    assert ax.get_ylabel() == first.axis_label("mm")


def test_unstable_states_are_dashed(path):
    unstable = dataclasses.replace(path, negative_pivots=np.array([0, 0, 2, 2]))
    ax = plot_curve(unstable, "area_reduction")
    (dashed,) = lines(ax, "--")
    (solid,) = lines(ax, "-")
    np.testing.assert_array_equal(np.isfinite(dashed.get_ydata()), [False, True, True, True])
    np.testing.assert_array_equal(np.isfinite(solid.get_ydata()), [True, True, False, False])


def test_events_are_marked_and_what_is_invalid_is_shaded(path, table, monkeypatch):
    gap = dataclasses.replace(
        BY_COLUMN["min_gap"], function=lambda _: np.array([1.0, 1.0, -0.1, -0.2])
    )
    monkeypatch.setitem(BY_COLUMN, "min_gap", gap)
    monkeypatch.setattr("jaxgel.observables.gaps.min_gap_once", gap.function)
    axes = plot_curves(path)
    assert axes.shape == (6, 2)
    for ax, against in zip(axes[0], ("mu", "free_stretch"), strict=True):
        left = table[against][2]
        (shade,) = ax.patches
        np.testing.assert_allclose(shade.get_x(), left)
    labels = [
        text.get_text() for legend in axes[0, 0].figure.legends for text in legend.get_texts()
    ]
    assert "self-contact" in labels
    assert "invalid after self-contact" in labels


@pytest.mark.slow
@pytest.mark.parametrize("scale", ["linear", "log", "sqrt", None])
def test_a_curve_in_time_has_the_scale_that_is_asked_for(in_time, scale):
    ax = plot_curve(in_time, "uptake", scale=scale)
    (curve,) = lines(ax, "-")
    np.testing.assert_allclose(
        curve.get_xdata(), np.sqrt(in_time.t) if scale == "sqrt" else in_time.t
    )
    np.testing.assert_allclose(curve.get_ydata(), jaxgel.uptake(in_time))
    assert ax.get_xscale() == ("log" if scale in ("log", None) else "linear")
    assert (ax.get_xlabel(), ax.get_ylabel()) == (
        r"$\sqrt{t}$" if scale == "sqrt" else "time $t$",
        "solvent taken up (mm²)",
    )


@pytest.mark.slow
def test_curves_in_time_have_a_row_for_the_uptake_and_the_unit_of_time(in_time):
    control = dataclasses.replace(in_time.control, unit="h")
    timed = dataclasses.replace(in_time, problem=in_time.problem.replace(control=control))
    axes = plot_curves(timed, scale="sqrt")
    assert axes.shape == (7, 1) and axes[-1, 0].get_xlabel() == r"$\sqrt{t}$ ($\mathrm{h}^{1/2}$)"
    assert plot_curve(timed, "J").get_xlabel() == "time $t$ (h)"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("time", "text"),
    [
        (0.0, "0"),
        (0.0316228, "0.0316"),
        (1234.5, "1230"),
        (2.5e-5, r"2.5 \times 10^{-5}"),
        (10.0, "10"),
    ],
)
def test_times_are_written_with_three_digits(in_time, time, text):
    ax = plot_pattern(dataclasses.replace(in_time[:1], value=np.array([time])), field=None)
    assert ax.get_title() == f"$t = {text}$"


@pytest.mark.slow
def test_patterns_at_times_have_the_colours_of_the_potential_between_start_and_bath(in_time):
    axes = plot_patterns(in_time, [0.001, 0.1, 10.0], field="mu")
    (bar,) = axes[0].figure.axes[3:]
    assert (
        bar.get_ylim() == pytest.approx((-3.0, -1.5), abs=1e-9)
        and "chemical potential" in bar.get_ylabel()
    )
    # by default evenly spaced in the uptake
    titles = [ax.get_title() for ax in plot_patterns(in_time)]
    assert titles[0] == "$t = 0$" and len(titles) == 4


@pytest.mark.slow
def test_a_scale_that_an_axis_does_not_have_is_refused(path, in_time):
    with pytest.raises(ValueError, match=r"^scale: 'log' is not one of linear$"):
        plot_curve(path, "J", scale="log")
    with pytest.raises(ValueError, match=r"^scale: 'root' is not one of linear, log, sqrt$"):
        plot_curve(in_time, "J", scale="root")
    with pytest.raises(ValueError, match=r"^quantity: 'uptake' is not one of J, area_reduction"):
        plot_curve(path, "uptake")


def test_names_that_do_not_exist_are_refused(path):
    with pytest.raises(ValueError, match="field: 'pressure' is not one of J, stretch"):
        plot_pattern(path, field="pressure")
    with pytest.raises(
        ValueError, match="quantity: 'turn' is not one of J, area_reduction, rotation"
    ):
        plot_curve(path, "turn")


def test_the_animation_has_a_frame_per_state(path, tmp_path):
    """Each has its title above the axes, and each gel is another one."""
    animate_pattern(path, tmp_path / "pattern.gif")
    with Image.open(tmp_path / "pattern.gif") as image:
        assert image.n_frames == len(path.mu)
        frames = [np.asarray(frame.convert("L")) for frame in ImageSequence.Iterator(image)]
    top = min(int(np.argmax((frame < DARK).sum(axis=1) > len(frame) / 2)) for frame in frames)
    titles, gels = [frame[:top] for frame in frames], [frame[top:] for frame in frames]
    assert min(int((title < DARK).sum()) for title in titles) > 50
    for parts in (titles, gels):
        assert all(np.any(one != other) for one, other in itertools.pairwise(parts))


def test_an_mp4_has_a_frame_per_state_and_lasts_as_long_as_asked(path, tmp_path):
    animate_pattern(path, tmp_path / "pattern.mp4", seconds=2.0)
    assert (tmp_path / "pattern.mp4").read_bytes()[4:8] == b"ftyp"
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(tmp_path / "pattern.mp4")
    assert frames == len(path.mu) and seconds == pytest.approx(2.0)


def test_a_film_without_ffmpeg_is_refused_in_one_line(path, tmp_path, monkeypatch):
    monkeypatch.setattr("jaxgel.plotting.animation.FFMpegWriter.isAvailable", lambda: False)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(
        ValueError, match=r"^file: '.*pattern.mp4' needs the program ffmpeg; install it, [^\n]*$"
    ):
        animate_pattern(path, tmp_path / "pattern.mp4")
    assert not list(tmp_path.iterdir())


def test_the_callers_settings_stay(path):
    before = dict(mpl.rcParams)
    plot_curves(path)
    assert dict(mpl.rcParams) == before


def test_lengths_carry_the_unit_of_the_plate(path):
    plate = dataclasses.replace(path.model.cloud.topology.plate, unit="1e-3 mm")
    cloud = dataclasses.replace(
        path.model.cloud, topology=dataclasses.replace(path.model.cloud.topology, plate=plate)
    )
    small = dataclasses.replace(
        path, problem=path.problem.replace(model=dataclasses.replace(path.model, cloud=cloud))
    )
    assert plot_pattern(small).get_xlabel() == "$x$ ($10^{-3}$ mm)"
    assert plot_curve(small, "min_gap").get_ylabel() == "smallest gap ($10^{-3}$ mm)"


def test_optima_of_several_searches_are_lines_across_their_parameters():
    """Of three designs one is infeasible, the objective of one start is unknown."""
    shares = np.array([[0.1, 0.9], [0.5, 0.5], [0.2, 0.3]])
    figure = draw_optima(
        ["Nv", "chi"],
        shares,
        np.array([3.0, 1.0, 2.0]),
        np.array([4.0, 1.5, np.nan]),
        np.array([True, False, True]),
    )
    map_of, ranks = figure.axes[:2]
    np.testing.assert_array_equal([line.get_ydata() for line in map_of.lines], shares)
    assert [line.get_linestyle() for line in map_of.lines] == ["-", "--", "-"]
    colours = {line.get_color() for line in map_of.lines}
    assert len(colours) == 3
    assert [label.get_text() for label in map_of.get_xticklabels()] == ["Nv", "chi"]
    at_start, best, infeasible = ranks.lines
    np.testing.assert_array_equal(at_start.get_ydata(), [1.5, np.nan, 4.0])
    np.testing.assert_array_equal(best.get_xydata(), [[2, 2.0], [3, 3.0]])
    np.testing.assert_array_equal(infeasible.get_xydata(), [[1, 1.0]])
