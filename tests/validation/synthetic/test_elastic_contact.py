"""The exact contact of round probes, against published tables, formulas and limits."""

import numpy as np
import pytest

from designlab.validation.synthetic.elastic_contact import (
    ElasticBase,
    layer_share,
    press_ball,
    press_flat_punch,
    press_paraboloid,
)

pytestmark = pytest.mark.physics


def half_space_force(base, radius, depth):
    """Hertz's force of a paraboloid."""
    return 4 / 3 * base.plane_modulus_mpa * np.sqrt(radius) * depth**1.5


@pytest.mark.parametrize(
    ("poisson", "expected"),
    [
        (0.5, [1.2806, 1.6837, 2.2129, 2.8602, 3.6187, 6.003, 9.1495]),
        (0.45, [1.2523, 1.5993, 2.0328, 2.5354, 3.0914, 4.6576, 6.4206]),
        (0.3, [1.2066, 1.4726, 1.7848, 2.1260, 2.4835, 3.409, 4.3532]),
    ],
)
def test_stiffness_of_flat_punch_by_table(poisson, expected):
    base = ElasticBase(0.4, poisson, 2.0)
    radii = 2.0 * np.array([0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0])
    found = [
        press_flat_punch(base, punch_radius_mm=radius, depth_mm=0.1).force_n
        / (2 * base.plane_modulus_mpa * radius * 0.1)
        for radius in radii
    ]
    np.testing.assert_allclose(found, expected, rtol=5e-5)


def test_stiffness_of_flat_punch_as_hayes_found():
    """Hayes et al. 1972, whose quadrature was coarser: nearer where the layer is thick."""
    base = ElasticBase(1.0, 0.5, 1.0)
    published = [1.281, 1.683, 2.211, 2.855, 3.609, 5.970, 9.069]
    for ratio, factor in zip([0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0], published, strict=True):
        contact = press_flat_punch(base, punch_radius_mm=ratio, depth_mm=0.1)
        assert contact.force_n / (2 * base.plane_modulus_mpa * ratio * 0.1) == pytest.approx(
            factor, rel=5e-4 + 0.0045 * ratio
        )


@pytest.mark.parametrize(
    ("contact_ratio", "geometric_ratio", "force_ratio", "widening", "bulge", "peak"),
    [
        (0.1, 0.0962, 1.1235, 1.0393, None, None),
        (0.25, 0.2270, 1.3518, 1.1014, 0.017, 0.90),
        (0.5, 0.4172, 1.8571, 1.1984, 0.038, 0.73),
        (0.75, 0.5874, 2.5292, 1.2768, 0.062, 0.61),
        (1.0, 0.7479, 3.3711, 1.3370, 0.088, 0.52),
        (1.5, 1.0544, 5.5632, 1.4226, 0.139, 0.40),
        (2.0, 1.3489, 8.4680, 1.4827, None, None),
    ],
)
def test_paraboloid_by_table(contact_ratio, geometric_ratio, force_ratio, widening, bulge, peak):
    base = ElasticBase(0.43, 0.5, 2.0)
    tip_radius = 15.0
    depth = (2.0 * geometric_ratio) ** 2 / tip_radius
    contact = press_paraboloid(base, tip_radius_mm=tip_radius, depth_mm=depth)
    # the table's depths are rounded to 5e-5 of the thickness
    rounding = 5e-5 / geometric_ratio
    assert contact.contact_radius_mm / 2.0 == pytest.approx(contact_ratio, rel=1.2 * rounding)
    assert contact.contact_radius_mm / np.sqrt(tip_radius * depth) == pytest.approx(widening, abs=1e-4)
    assert contact.force_n / half_space_force(base, tip_radius, depth) == pytest.approx(
        force_ratio, rel=2 * rounding
    )
    if bulge is not None:
        height, place = contact.bulge_mm
        assert height / depth == pytest.approx(bulge, abs=6e-4)
        assert (place - contact.contact_radius_mm) / 2.0 == pytest.approx(peak, abs=6e-3)


@pytest.mark.parametrize(
    ("thickness", "radius", "bulge_um"), [(2.0, 1.692, 61), (3.0, 1.585, 34), (4.0, 1.522, 23)]
)
def test_ball_by_figures(thickness, radius, bulge_um):
    contact = press_ball(ElasticBase(0.43, 0.5, thickness), ball_radius_mm=2.5, depth_mm=0.8)
    assert contact.contact_radius_mm == pytest.approx(radius, abs=5e-4)
    assert contact.bulge_mm[0] * 1e3 == pytest.approx(bulge_um, abs=0.5)


@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.5])
def test_solution_keeps_what_it_was_found_from(poisson):
    """The surface repeats the probe, no pressure is left at the edge, and pressure adds up to the force."""
    base = ElasticBase(0.43, poisson, 2.0)
    for contact, profile in (
        (press_ball(base, ball_radius_mm=4.0, depth_mm=0.9), lambda r: 4.0 - np.sqrt(16.0 - r**2)),
        (press_paraboloid(base, tip_radius_mm=4.0, depth_mm=0.9), lambda r: r**2 / 8.0),
        (press_flat_punch(base, punch_radius_mm=2.0, depth_mm=0.9), np.zeros_like),
    ):
        radius = contact.contact_radius_mm
        r = radius * np.array([0.0, 0.2, 0.5, 0.8, 0.95, 1.0 - 1e-9])
        np.testing.assert_allclose(contact.surface_mm(r), 0.9 - profile(r), atol=1e-7)
        node, weight = np.polynomial.legendre.leggauss(60)
        across = 0.5 * (node + 1.0)
        pressure = contact.pressure_mpa(radius * np.sqrt(1.0 - across**2))
        assert (pressure > 0).all()
        assert np.pi * radius**2 * (weight * across) @ pressure == pytest.approx(contact.force_n, rel=1e-8)
        assert (contact.pressure_mpa(radius * np.array([1.0, 1.5])) == 0).all()
        # no point of the free surface lies within the probe
        outside = radius * np.linspace(1.0, 1.2, 30)
        if profile is not np.zeros_like:
            assert abs(contact.edge_density) < 1e-9
            assert (contact.surface_mm(outside) >= 0.9 - profile(np.minimum(outside, 4.0)) - 1e-9).all()


def test_no_volume_is_lost_where_gel_keeps_it():
    """At nu = 1/2 what sinks under the probe rises around it."""
    contact = press_ball(ElasticBase(0.43, 0.5, 2.0), ball_radius_mm=4.0, depth_mm=0.9)
    radius, end = contact.contact_radius_mm, 60.0
    node, weight = np.polynomial.legendre.leggauss(200)
    parts = []
    for low, high in ((0.0, radius), (radius, end)):
        r = low + (high - low) * (0.5 * (node + 1.0)) ** 2
        step = (high - low) * 0.5 * (node + 1.0) * weight
        parts.append(2 * np.pi * (step * r) @ contact.surface_mm(r))
    assert parts[0] > 5.0
    assert sum(parts) == pytest.approx(0.0, abs=1e-6 * parts[0])


def test_on_thick_layer_hertz_and_sneddon_hold():
    base = ElasticBase(0.43, 0.4, 2000.0)
    contact = press_paraboloid(base, tip_radius_mm=4.0, depth_mm=0.1)
    assert contact.contact_radius_mm == pytest.approx(np.sqrt(0.4), rel=1e-3)
    assert contact.force_n == pytest.approx(half_space_force(base, 4.0, 0.1), rel=1e-3)
    hertz = 2 * base.plane_modulus_mpa / (np.pi * 4.0) * np.sqrt(0.4 - 0.3**2)
    assert contact.pressure_mpa(np.array(0.3)) == pytest.approx(hertz, rel=1e-3)
    sneddon = 0.1 * 2 / np.pi * np.arcsin(1.5 / np.array([1.6, 2.0, 6.0]))
    punch = press_flat_punch(base, punch_radius_mm=1.5, depth_mm=0.1)
    np.testing.assert_allclose(punch.surface_mm(np.array([1.6, 2.0, 6.0])), sneddon, atol=2e-4)


@pytest.mark.parametrize(
    ("poisson", "widening", "force", "errors"),
    [
        # force of the thin layer by its confined modulus; at nu = 1/2 by lubrication theory (Jaffar 1989)
        (0.3, np.sqrt(2), lambda r, d: np.pi * 0.7 / (1.3 * 0.4) * r * d**2, (0.04, 0.02, 0.01)),
        (0.5, 2.0, lambda r, d: 2 * np.pi / 3 * r**2 * d**3, (0.30, 0.17, 0.09)),
    ],
)
def test_thin_layer_comes_near_its_limit(poisson, widening, force, errors):
    """Contact radii of some 7, 14, 28 thicknesses: the distance from the limit halves."""
    base = ElasticBase(1.0, poisson, 1.0)
    off = []
    for depth, most in zip((0.125, 0.5, 2.0), errors, strict=True):
        contact = press_paraboloid(base, tip_radius_mm=100.0, depth_mm=depth)
        off.append(1.0 - contact.contact_radius_mm / np.sqrt(100.0 * depth) / widening)
        assert 0 < off[-1] < most
        assert contact.force_n == pytest.approx(force(100.0, depth), rel=1.3 * most)
    assert off[0] / off[1] == pytest.approx(2.0, rel=0.15)
    assert off[1] / off[2] == pytest.approx(2.0, rel=0.1)


def test_response_has_its_limits():
    """Half space at short waves; at long ones the confined column, or at nu = 1/2 a thin film's flow."""
    np.testing.assert_allclose(layer_share(np.array([20.0, 800.0]), 0.4), 1.0, atol=1e-12)
    x = np.array([1e-3])
    nu = 0.3
    confined = x * (1 - 2 * nu) / (2 * (1 - nu) ** 2)
    np.testing.assert_allclose(layer_share(x, nu), confined, rtol=1e-5)
    np.testing.assert_allclose(layer_share(np.array([1e-2]), 0.5), 2 / 3 * 1e-6, rtol=1e-3)


def test_approximations_of_others_are_met_where_they_hold():
    """Dimitriadis et al. 2002 expand for thick layers; Long et al. 2011 fitted balls on neo-Hookean gels."""
    base = ElasticBase(1.0, 0.5, 1.0)
    for ratio in (1.0, 2.0, 4.0, 10.0):
        for depth in (0.001, 0.01, 0.1, 0.3):
            x = np.sqrt(ratio * depth)
            force = press_paraboloid(base, tip_radius_mm=ratio, depth_mm=depth).force_n
            series = 1 + 1.133 * x + 1.283 * x**2 + 0.769 * x**3 + 0.0975 * x**4
            lack = 1 - half_space_force(base, ratio, depth) * series / force
            if x < 0.15:
                assert abs(lack) < 0.005
            elif 0.5 < x < 1.5:
                assert 0.06 < lack < 0.17
    for ratio, depth in ((2.0, 0.01), (2.0, 0.1), (4.0, 0.05), (4.0, 0.1), (10.0, 0.01), (10.0, 0.05)):
        w = (ratio * depth) ** 1.5
        alpha = 10.05 - 0.63 / np.sqrt(ratio) * (3.1 + ratio**-2)
        beta = 4.8 - 4.23 / ratio**2
        long = (1 + 1.15 * w ** (1 / 3) + alpha * w + beta * w**2) / (1 + 2.3 * w)
        force = press_ball(base, ball_radius_mm=ratio, depth_mm=depth).force_n
        assert force == pytest.approx(half_space_force(base, ratio, depth) * long, rel=0.025)


def test_ball_pressed_deeper_than_its_equator_touches_within_it():
    contact = press_ball(ElasticBase(1.0, 0.5, 8.0), ball_radius_mm=1.0, depth_mm=2.0)
    assert 0.9 < contact.contact_radius_mm < 1.0


@pytest.mark.parametrize(
    ("name", "arguments"),
    [("poisson", (1.0, 0.51, 1.0)), ("poisson", (1.0, 0.0, 1.0)), ("thickness_mm", (1.0, 0.5, 0.0))],
)
def test_impossible_layers_are_refused(name, arguments):
    with pytest.raises(ValueError, match=name):
        ElasticBase(*arguments)


def test_lengths_that_are_none_are_refused():
    with pytest.raises(ValueError, match="depth_mm = 0"):
        press_ball(ElasticBase(1.0, 0.5, 1.0), ball_radius_mm=1.0, depth_mm=0.0)
