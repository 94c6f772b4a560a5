"""A real press of the flat sensor of 2020: how well contact by a kernel and by an elastic layer explain it.

    python benchmarks/real_press.py --measured FOLDER [--columns 160] [--quick] [--more]

FOLDER is the measurement folder of the released picture: a triangle of 5 mm pressed 0.5 mm deep.

- Darkening: the mean of the three colours, each over its own background, inside the triangle and around it.
  Slopes cancel in it, since the lights stand 120 deg apart.
- As published: nothing is fitted (`designlab compare`).
- Fitted: light, floor, pose and the same free fields for both models are fitted on half of the blocks of a
  chessboard, and judged on the other half in full resolution; then the other way round.
  Coatings of both models are tight, or leak as that of the elastic preset does and so turn darker where the
  probe touches. With `--more` the leak is free as well, then also where the LEDs stand.
- Ridge: the elastic model fitted on all blocks; how depth, thickness, size and field of view go together, and
  whether the published depth and field of view lie in their common 95 % region: by the errors of the fit, and
  by what a fit with both held loses (likelihood ratio, errors of each channel of unknown size).
"""

import argparse
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.metrics import compare_within
from designlab.inference.calibration import Calibration, calibrate
from designlab.measurement import Measurement, load_measurement
from designlab.measurement.blocks import TRAIN, block_uses
from designlab.measurement.compare import compare_model, rendered
from designlab.measurement.frames import PoseSigma
from designlab.measurement.residuals import BLOCKS_PX, block_sums
from designlab.measurement.shots import DEFAULT_SIGMA, POSE
from designlab.sensor.design import Design, preset
from designlab.simulation.effects.model import SensorModel

KERNEL, ELASTIC = "gelsight-2020-flat", "gelsight-2020-flat-elastic"
FREE = {
    KERNEL: ("contact.kernel_length_mm",),
    ELASTIC: ("contact.skin_length_mm", "elastomer.thickness_mm=4+-1.5"),
}
BOTH = ("camera.horizontal_fov_deg", "probe.size_mm=5..5.8", "probe.edge_radius_mm=0..0.3")
LEAKS = ("optics.coating_transmittance", "optics.backing_reflectance")
LEAK = ("optics.coating_transmittance=0.2+-0.1",)
PLACE = ("leds.height_mm=8.79+-1", "leds.radius_mm=12.59+-1")
PUBLISHED = {"depth_mm": 0.50, "camera.horizontal_fov_deg": 53.3}
HELD_MM = 1e-5
REGION_95 = 5.991  # of chi squared with 2 degrees of freedom


CORNERS_PX = (
    (303, 100),
    (132, 408),
    (490, 405),
)  # row, column of the triangle's corners, read off the picture
BESIDE_PX = 15  # left out on both sides of the outline
UNDISTURBED = 0.75  # of half the picture's width from its middle, beyond which it is background
DEGREE = 3  # of the polynomial that the logarithm of the background is


class Half(NamedTuple):
    """A fit to half of the blocks, and its figures on the other half."""

    found: Calibration
    judged: Mapping[str, float]


class Variant(NamedTuple):
    """What both models have alike beside contact: a coating that leaks or not, and what more is free."""

    title: str
    leaks: bool
    free: tuple[str, ...] = ()

    def design(self, name: str) -> Design:
        """Preset with the coating of the elastic one, or a tight one."""
        coat = preset(ELASTIC).optics
        stated = {path: getattr(coat, path.rpartition(".")[2]) if self.leaks else 0.0 for path in LEAKS}
        return preset(name).replace(stated)


VARIANTS = (
    Variant("coating as in the elastic preset", leaks=True),
    Variant("coating tight", leaks=False),
    Variant("leak of the coating free", leaks=True, free=LEAK),
    Variant("leak of the coating and place of the LEDs free", leaks=True, free=(*LEAK, *PLACE)),
)


def fitted(
    measurement: Measurement,
    name: str,
    variant: Variant,
    *,
    columns: int,
    mask: NDArray[np.bool_] | None = None,
) -> Calibration:
    """Calibrate a preset on part of the picture, or all of it."""
    free = (*BOTH, *FREE[name], *variant.free)
    return calibrate(measurement, variant.design(name), columns=columns, free=free, mask=mask)


def half(measurement: Measurement, name: str, variant: Variant, *, parity: int, columns: int) -> Half:
    """Fit to the blocks of one colour of the chessboard and judge on the other."""
    (frame,) = measurement.frames
    real = measurement.linear(frame).astype(float)
    mask = block_uses(*real.shape[:2], parity=parity) == TRAIN
    found = fitted(measurement, name, variant, columns=columns, mask=mask)
    assert isinstance(found.model, SensorModel)
    design = found.model.effective_design()
    stated, pose = measurement.press(frame), found.frames[0].pose
    assert stated is not None
    assert pose is not None
    values = {p.name: p.value for p in found.parameters}
    lengths = {name: values[f"probe.{name}"] for name in ("size_mm", "edge_radius_mm")}
    press = stated.model_copy(
        update={
            "probe": stated.probe.model_copy(update=lengths),
            "depth_mm": pose["depth_mm"],
            "centre_mm": (pose["x_mm"], pose["y_mm"]),
            "yaw_deg": pose["yaw_deg"],
        }
    )
    gains = np.full(len(design.group_names), design.camera.exposure or 1.0)
    view = measurement.view(frame, design)
    image = rendered(found.model, press, gains, view=view, samples=64, seed=0)
    return Half(found, compare_within(image, real, ~mask))


def darkening(picture: NDArray[np.float64]) -> tuple[float, float]:
    """Mean of the colours over their backgrounds, inside the triangle and in a ring around it."""
    rows, columns = picture.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    terms = np.stack([x**i * y**j for i, j in powers], axis=-1)
    background = np.hypot(x, y) > UNDISTURBED
    colours = np.log(np.maximum(picture, 1e-4))
    known = np.linalg.lstsq(terms[background], colours[background], rcond=None)[0]
    even = np.exp(colours - terms @ known).mean(axis=-1)
    away = signed_distance_px(rows, columns)
    inside, around = away < -BESIDE_PX, (away > 3 * BESIDE_PX) & (away < 6 * BESIDE_PX)
    return float(even[inside].mean()), float(even[around].mean())


def signed_distance_px(rows: int, columns: int) -> NDArray[np.float64]:
    """Distance of each pixel from the sides of the triangle, negative inside."""
    at = np.stack(np.indices((rows, columns)), axis=-1).astype(float)
    corners = np.array(CORNERS_PX, dtype=float)
    sides = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([sides[:, 1], -sides[:, 0]], axis=-1) / np.linalg.norm(sides, axis=1)[:, None]
    outward *= np.sign(((corners - corners.mean(axis=0)) * outward).sum(axis=1))[:, None]
    return np.asarray(np.max([(at - c) @ n for c, n in zip(corners, outward, strict=True)], axis=0))


def show_values(found: Calibration) -> None:
    """Print what was fitted, but for the light."""
    for parameter in found.parameters:
        if not parameter.name.startswith(("transfer", "floor")):
            error = "-" if parameter.se is None else f"{parameter.se:.3f}"
            print(f"    {parameter.name:28} {parameter.value:8.3f} +- {error} {parameter.unit}", flush=True)


def show_ridge(found: Calibration) -> None:
    """Print how errors go together, and where the published pair lies."""
    names = [p.name for p in found.parameters]
    depth = next(name for name in names if name.endswith(".depth_mm"))
    ridge = [depth, "elastomer.thickness_mm", "probe.size_mm", "camera.horizontal_fov_deg"]
    places = [names.index(name) for name in ridge]
    errors = np.array([found.parameters[place].se or np.nan for place in places])
    correlation = found.correlation[np.ix_(places, places)]
    print(f"    {'correlation':28}", *(f"{name.rpartition('.')[2]:>20}" for name in ridge))
    for name, row in zip(ridge, correlation, strict=True):
        print(f"    {name:28}", *(f"{value:20.2f}" for value in row))
    pair = [0, 3]
    away = np.array([found.parameters[places[k]].value for k in pair]) - list(PUBLISHED.values())
    spread = (correlation * np.outer(errors, errors))[np.ix_(pair, pair)]
    distance = float(away @ np.linalg.solve(spread, away))
    inside = "inside" if distance < REGION_95 else "outside"
    print(f"    published pair (0.50 mm, 53.3 deg): {distance:.2f} of {REGION_95}, {inside} the 95 % region")


def held(measurement: Measurement, variant: Variant, *, columns: int) -> Calibration:
    """Calibrate the elastic preset with the published depth and field of view held."""
    (frame,) = measurement.frames
    place_mm, _, _, yaw_deg = DEFAULT_SIGMA
    sigma = PoseSigma(depth_mm=HELD_MM, centre_mm=place_mm, yaw_deg=yaw_deg)
    stated = measurement.model_copy(update={"frames": (frame.model_copy(update={"sigma": sigma}),)})
    free = [text for text in (*BOTH, *FREE[ELASTIC], *variant.free) if not text.startswith("camera.")]
    return calibrate(stated, variant.design(ELASTIC), columns=columns, free=free)


def loss(found: Calibration, other: Calibration, measurement: Measurement) -> float:
    """Twice the fall of the log likelihood from one fit to another, with what is known of pose and thickness.

    Errors of a channel are of unknown size, and as many values as sums over blocks make them are independent.
    """
    left, more = (each.frames[0].measured - each.frames[0].simulated for each in (found, other))
    total = misplaced(other, measurement) - misplaced(found, measurement)
    for channel in range(3):
        own = left[..., channel]
        spread = max(float((block_sums(own, size) ** 2).sum()) for size in BLOCKS_PX)
        independent = own.size * float((own**2).sum()) / spread
        total += independent * float(np.log((more[..., channel] ** 2).sum() / (own**2).sum()))
    return total


def misplaced(found: Calibration, measurement: Measurement) -> float:
    """Squared departures of pose and thickness from what is known of them, in standard deviations."""
    stated, pose = measurement.press(measurement.frames[0]), found.frames[0].pose
    assert stated is not None
    assert pose is not None
    thickness_mm = next(p.value for p in found.parameters if p.name == "elastomer.thickness_mm")
    placed = (*stated.centre_mm, stated.stated_depth_mm, stated.yaw_deg)
    away = np.array([pose[name] for name in POSE]) - placed
    return float(np.square(away / DEFAULT_SIGMA).sum() + ((thickness_mm - 4.0) / 1.5) ** 2)


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--measured", required=True, help="measurement folder of the released press")
    parser.add_argument("--columns", type=int, default=160, help="width of the pictures that are fitted to")
    parser.add_argument("--quick", action="store_true", help="nothing fitted")
    parser.add_argument("--more", action="store_true", help="free the coating and the LEDs' place too")
    args = parser.parse_args()
    measurement = load_measurement(args.measured)
    (frame,) = measurement.frames
    inside, around = darkening(measurement.linear(frame).astype(float))
    print(f"mean of the colours over their backgrounds: inside {inside:.3f}, around {around:.3f}")
    print("as published, nothing fitted: structure correlation, SNR (dB)")
    for name in (KERNEL, ELASTIC):
        figures = compare_model(preset(name), measurement).pairs[0].figures
        print(f"  {name:28} {figures['structure_corr']:.4f} {figures['structure_snr_db']:6.3f}", flush=True)
    if args.quick:
        return
    for variant in VARIANTS if args.more else VARIANTS[:2]:
        print(f"fitted on half of the blocks, judged on the other; {variant.title}")
        for name in (KERNEL, ELASTIC):
            halves = [half(measurement, name, variant, parity=p, columns=args.columns) for p in (0, 1)]
            corr, snr = (
                np.mean([each.judged[figure] for each in halves])
                for figure in ("structure_corr", "structure_snr_db")
            )
            print(f"  {name} {corr:.4f} {snr:.2f}")
            for each in halves:
                print(f"   {each.judged['structure_corr']:.4f} {each.judged['structure_snr_db']:.2f}")
                show_values(each.found)
        print(f"ridge of the elastic model, fitted on all blocks; {variant.title}")
        whole = fitted(measurement, ELASTIC, variant, columns=args.columns)
        show_values(whole)
        show_ridge(whole)
        lost = loss(whole, held(measurement, variant, columns=args.columns), measurement)
        inside = "inside" if lost < REGION_95 else "outside"
        print(f"    ... by a fit with both held: {lost:.2f} of {REGION_95}, {inside}", flush=True)


if __name__ == "__main__":
    main()
