"""How alike a picture and a model are on some blocks, in full resolution."""

from collections.abc import Mapping

import numpy as np

from designlab.core.types import Array, Mask
from designlab.sensor.camera import View
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import SensorModel
from designlab.simulation.imaging import Capture, expected, mixed
from designlab.simulation.simulator import Simulator


def structure(simulated: Array, real: Array, mask: Mask) -> Mapping[str, float]:
    """Figures of `metrics.compare` over part of a picture: a quadratic field is taken from that part alone.

    Parameters
    ----------
    simulated, real : array, shape (rows, columns, 3)
        Linear pictures.
    mask : bool array, shape (rows, columns)
        Where they are compared.

    Returns
    -------
    mapping of str to float
        ``structure_corr``, ``structure_snr_db`` (means of the channels) and ``snr_db``.
    """
    rows, columns = mask.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)[mask]
    s, r = simulated[mask], real[mask]
    detail_s, detail_r = (v - terms @ np.linalg.lstsq(terms, v, rcond=None)[0] for v in (s, r))
    power_s, power_r = (detail_s**2).sum(axis=0), (detail_r**2).sum(axis=0)
    corr = (detail_s * detail_r).sum(axis=0) / np.sqrt(power_s * power_r)
    ratio = power_r / ((detail_r - detail_s) ** 2).sum(axis=0)
    return {
        "structure_corr": float(corr.mean()),
        "structure_snr_db": float(10 * np.log10(ratio).mean()),
        "snr_db": float(10 * np.log10((r**2).sum() / ((r - s) ** 2).sum())),
    }


def rendered(model: SensorModel, press: Press, gains: Array, *, view: View, samples: int, seed: int) -> Array:
    """Signal of a model under a press, LED groups brighter by gains, (rows, columns, 3)."""
    frame = Simulator(model, view=view, samples=samples, seed=seed).frame(press)
    capture = Capture(model.effective_design().camera, model)
    return expected(mixed(frame.basis.astype(float), frame.weights * gains), capture)
