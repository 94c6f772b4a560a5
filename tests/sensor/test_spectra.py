"""Spectra of LEDs and cameras: overlaps in closed form, and the mixing matrix that follows."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import norm

from designlab.sensor.design import DesignError, dumps, loads, preset
from designlab.sensor.spectra import (
    EMISSION,
    FILTERS,
    SENSITIVITIES,
    Sensitivity,
    luminous_efficacy_lm_w,
    response,
    typical_width_nm,
)
from geometries.spectrum import Filter, Spectrum

CORE = preset("default")
EDGES = (500.0, 500.001, 600.0, 600.001)


def steps(**fields):
    """Camera whose channels are ideal: R above 600 nm, G between 500 and 600 nm, B below."""
    return Sensitivity(
        wavelength_nm=(300.0, *EDGES, 900.0),
        red=(0, 0, 0, 0, 1, 1),
        green=(0, 0, 1, 1, 0, 0),
        blue=(1, 1, 0, 0, 0, 0),
        **fields,
    )


def test_the_overlap_of_a_gaussian_with_ideal_filters_is_the_error_function():
    peaks, widths = [625.0, 505.0, 480.0], [40.0, 30.0, 25.0]
    found = response(steps(), wavelength_nm=peaks, width_nm=widths)
    sigma = np.array(widths) / 2.354820
    below_500, below_600 = (norm.cdf((edge - np.array(peaks)) / sigma) for edge in (500.0, 600.0))
    exact = np.array([1 - below_600, below_600 - below_500, below_500])
    # the narrow steps of the table cost a few 1e-5 here
    np.testing.assert_allclose(found, exact / exact.max(), atol=1e-3)


def test_a_quantum_efficiency_counts_photons():
    # a flat one answers in proportion to the wavelength, whatever the spectral width
    flat = Sensitivity(wavelength_nm=(300, 900), red=(1, 1), green=(1, 1), blue=(1, 1), per="photon")
    found = response(flat, wavelength_nm=[465.0, 620.0], width_nm=[20.0, 40.0])
    np.testing.assert_allclose(found, [[0.75, 1.0]] * 3, rtol=1e-9)


def test_a_narrow_line_reads_the_published_table():
    found = response(Sensitivity(name="imx219"), wavelength_nm=[600.0, 450.0], width_nm=[0.2, 0.2])
    rows = {row[0]: np.array(row[1:]) for row in SENSITIVITIES["imx219"].rows}
    exact = np.column_stack([rows[600.0] * 600, rows[450.0] * 450])
    np.testing.assert_allclose(found, exact / exact.max(), rtol=2e-3)


def test_every_published_set_has_a_source_and_rises():
    for name, curves in SENSITIVITIES.items():
        assert curves.source, name
        table = np.array(curves.rows)
        assert (np.diff(table[:, 0]) > 0).all()
        # each channel is highest for its own colour
        assert (
            table[table[:, 1].argmax(), 0] > table[table[:, 2].argmax(), 0] > table[table[:, 3].argmax(), 0]
        )


def test_typical_widths_are_those_of_the_data_sheet():
    assert [typical_width_nm(peak) for peak in (460.0, 515.0, 640.0)] == [25.0, 35.0, 20.0]


def test_the_mixing_of_a_design_follows_from_its_spectra():
    assert np.array_equal(CORE.mixing_matrix, np.eye(3))
    real = CORE.replace({"camera.sensitivity": "imx219"})
    matrix = real.mixing_matrix
    assert matrix.max() == 1.0
    assert (matrix.argmax(axis=0) == (0, 1, 2)).all()  # each group is seen best by its own channel
    assert (matrix > 0.01).all()  # but by all of them
    again = loads(dumps(real))
    assert again == real
    np.testing.assert_array_equal(again.mixing_matrix, matrix)
    # what is given wins
    given = real.replace({"mixing": ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 0.5))})
    assert given.mixing_matrix[2, 2] == 0.5
    # a wider spectrum spreads over more channels
    wide = real.replace({"leds.groups.1.width_nm": 80.0}).mixing_matrix[:, 1]
    narrow = real.replace({"leds.groups.1.width_nm": 5.0}).mixing_matrix[:, 1]
    assert wide[0] / wide[1] > narrow[0] / narrow[1]


def test_with_a_sensitivity_any_number_of_groups_will_do():
    white = """
    [camera]
    sensitivity = { wavelength_nm = [400, 500, 600, 700], red = [0, 0, 1, 1], green = [0, 1, 1, 0], blue = [1, 1, 0, 0] }
    [leds]
    [[leds.groups]]
    name = "amber"
    azimuth_deg = [90.0]
    wavelength_nm = 590.0
    """  # noqa: E501
    assert loads(white).mixing_matrix.shape == (3, 1)


def test_lumen_per_watt_are_those_of_a_data_sheet():
    # Broadcom ASMT-QTB4-0AA02, table 3: peaks at 629 and 521 nm, 210 and 535 lm/W; its spectra are skewed.
    # Blue is not compared: there the skew, which a Gaussian has not, weighs more than the rest.
    found = [luminous_efficacy_lm_w(peak) for peak in (629.0, 521.0)]
    np.testing.assert_allclose(found, [210.0, 535.0], rtol=0.13)
    assert luminous_efficacy_lm_w(555.0, 0.2) == pytest.approx(683.0, rel=1e-3)
    # linear between two entries of the table
    assert luminous_efficacy_lm_w(605.0, 0.2) == pytest.approx(683 * (0.631 + 0.503) / 2, rel=1e-3)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("imx477", ["camera.sensitivity: name", "imx477", "imx219"]),
        ({}, ["camera.sensitivity", "wavelength_nm", "at least two"]),
        ({"name": "imx219", "wavelength_nm": [1, 2]}, ["name", "not both"]),
        ({"wavelength_nm": [500, 400], "red": [1, 1], "green": [1, 1], "blue": [1, 1]}, ["must rise, 400"]),
        ({"wavelength_nm": [400, 500], "red": [1], "green": [1, 1], "blue": [1, 1]}, ["red", "has 1"]),
        ({"wavelength_nm": [400, 500], "red": [1, -1], "green": [1, 1], "blue": [1, 1]}, ["red", "negative"]),
        (
            {"wavelength_nm": [400, 500], "red": [1, 1], "green": [1, 1], "blue": [1, 1]},
            ["camera.sensitivity", "LED group 1 at 625 nm", "400 to 500 nm"],
        ),
    ],
)
def test_a_sensitivity_that_is_refused_says_why(value, words):
    with pytest.raises(DesignError) as caught:
        CORE.replace({"camera.sensitivity": value})
    for word in words:
        assert word in str(caught.value)


def exact_integral(spectrum, sensitivity, *filters):
    """Integral of piecewise linear curves by photons, exact between all their kinks."""
    curves = [spectrum, sensitivity, *filters]
    kinks = np.unique(np.concatenate([np.asarray(curve)[:, 0] for curve in curves]))
    kinks = kinks[(kinks >= spectrum[0][0]) & (kinks <= spectrum[-1][0])]
    nodes, weights = np.polynomial.legendre.leggauss(4)  # exact up to degree 7
    total = 0.0
    for low, high in pairwise(kinks):
        at = (low + high) / 2 + (high - low) / 2 * nodes
        value = np.ones(4) * at / 550.0
        for curve in curves:
            x, y = np.asarray(curve, dtype=float).T
            value *= np.interp(at, x, y, left=0.0, right=0.0)
        total += (high - low) / 2 * float(weights @ value)
    return total


@pytest.mark.physics
@pytest.mark.parametrize("white", sorted(EMISSION))
@pytest.mark.parametrize("through", [(), ("hoya-cm500",), ("wratten-58",), ("wratten-25", "hoya-cm500")])
def test_the_mixing_of_white_leds_behind_filters_is_the_exact_integral(white, through):
    camera = Sensitivity(name="imx219")
    found = response(
        camera,
        wavelength_nm=[530.0, 530.0],
        width_nm=[None, None],
        spectra=[Spectrum(name=white), Spectrum(name="cie-led-b3")],
        filters=[[Filter(name=name) for name in through], []],
    )
    table = np.asarray(SENSITIVITIES["imx219"].rows)
    emission, other = np.asarray(EMISSION[white].rows), np.asarray(EMISSION["cie-led-b3"].rows)
    passing = [np.asarray(FILTERS[name].rows) for name in through]
    bare, exact = np.zeros((3, 2)), np.zeros((3, 2))
    for column, (light, filters) in enumerate([(emission, passing), (other, [])]):
        flux = np.trapezoid(light[:, 1], light[:, 0])
        for row in range(3):
            curve = table[:, [0, row + 1]]
            bare[row, column] = exact_integral(light, curve) / flux
            exact[row, column] = exact_integral(light, curve, *filters) / flux
    np.testing.assert_allclose(found, exact / bare.max(), atol=1e-3)


@pytest.mark.physics
@pytest.mark.parametrize(
    ("peak", "width", "centre"), [(530.0, 30.0, 530.0), (465.0, 25.0, 480.0), (625.0, 20.0, 610.0)]
)
def test_a_gaussian_filter_takes_the_closed_form_share_of_a_gaussian_led(peak, width, centre):
    flat = Sensitivity(wavelength_nm=(200, 1000), red=(1, 1), green=(1, 1), blue=(1, 1))
    grid = np.linspace(300.0, 800.0, 2001)
    band = 40.0 / 2.354820
    passing = Filter(
        wavelength_nm=tuple(grid), transmittance=tuple(np.exp(-0.5 * ((grid - centre) / band) ** 2))
    )
    found = response(flat, wavelength_nm=[peak], width_nm=[width], filters=[[passing]])
    sigma = width / 2.354820
    both = np.hypot(sigma, band)
    exact = band / both * np.exp(-0.5 * ((peak - centre) / both) ** 2)
    np.testing.assert_allclose(found, exact, atol=1e-3)


def test_a_filter_before_the_camera_dims_and_one_before_a_group_dims_only_that():
    plain = CORE.replace({"camera.sensitivity": "imx219"})
    before_camera = plain.replace({"camera.filter": "hoya-cm500"}).mixing_matrix
    assert (before_camera <= plain.mixing_matrix + 1e-12).all()
    assert before_camera[1, 1] > 0.8 * plain.mixing_matrix[1, 1]  # green passes
    assert before_camera[0, 0] < 0.35 * plain.mixing_matrix[0, 0]  # red less
    one = plain.replace({"leds.groups.1.filter": "wratten-58"}).mixing_matrix
    np.testing.assert_array_equal(one[:, [0, 2]], plain.mixing_matrix[:, [0, 2]])
    assert (one[:, 1] < plain.mixing_matrix[:, 1]).all()


def test_designs_with_spectra_and_filters_are_written_and_read_and_others_keep_their_digest():
    plain = CORE.replace({"camera.sensitivity": "imx219"})
    white = plain.replace(
        {
            "leds.groups.0.spectrum": "cie-led-b5",
            "camera.filter": {"name": "mine", "wavelength_nm": [300, 800], "transmittance": [0.5, 0.5]},
        }
    )
    assert loads(dumps(white)) == white
    assert white.digest != plain.digest
    half = plain.replace({"camera.filter": {"wavelength_nm": [300, 800], "transmittance": [0.5, 0.5]}})
    np.testing.assert_allclose(half.mixing_matrix, plain.mixing_matrix / 2, rtol=1e-12)
    assert "filter" not in repr(plain.camera)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"camera.filter": "hoya-cm500", "camera.sensitivity": None},
            ["camera.filter", "camera.sensitivity"],
        ),
        ({"camera.filter": "hoya"}, ["camera.filter", "'hoya'", "hoya-cm500"]),
        ({"leds.groups.1.spectrum": "white"}, ["leds.groups.1.spectrum", "'white'", "cie-led-b1"]),
        (
            {"camera.filter": {"wavelength_nm": [400, 700], "transmittance": [90, 90]}},
            ["camera.filter", "transmittance", "90", "divide percent by 100"],
        ),
        ({"camera.filter": {"wavelength_nm": [0.4, 0.7], "transmittance": [1, 1]}}, ["wavelength_nm", "nm"]),
        ({"leds.groups.0.spectrum": {"wavelength_nm": [500, 400], "power": [1, 1]}}, ["must rise"]),
        ({"leds.groups.0.spectrum": {"wavelength_nm": [400, 500], "power": [1]}}, ["power", "each of the 2"]),
        ({"leds.groups.0.spectrum": "cie-led-b1", "leds.groups.0.width_nm": 20.0}, ["width_nm", "spectrum"]),
        (
            {"camera.filter": {"wavelength_nm": [500, 700], "transmittance": [1, 1]}},
            ["camera.filter", "known from 500 to 700 nm", "LED group 2", "extend"],
        ),
        (
            {"camera.filter": {"wavelength_nm": [300, 590, 595, 800], "transmittance": [0, 0, 1, 1]}},
            ["camera.filter", "LED group 3", "filters pass less"],
        ),
        ({"camera.filter": {}}, ["camera.filter", "name", "needed"]),
    ],
)
def test_spectra_and_filters_that_are_refused_say_why(changes, words):
    with pytest.raises(DesignError) as refused:
        CORE.replace({"camera.sensitivity": "imx219"} | changes)
    for word in words:
        assert word in str(refused.value)
