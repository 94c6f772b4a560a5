"""Spectra of LEDs and cameras: overlaps in closed form, and the mixing matrix that follows."""

import numpy as np
import pytest
from scipy.stats import norm

from designlab.sensor.design import DesignError, dumps, loads, preset
from designlab.sensor.spectra import (
    SENSITIVITIES,
    Sensitivity,
    luminous_efficacy_lm_w,
    response,
    typical_width_nm,
)

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
