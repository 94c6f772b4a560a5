"""One generated sensor measured in the forms that labs have, and what each form costs.

    python benchmarks/lab_forms.py [--out FOLDER]

The lens of the sensor takes a quarter of the light at the corner. Its set of the hour kit is diagnosed
as it is, without repeats, as 8-bit sRGB pictures, with balls of which the circle alone is known that is
read off the picture (places to half a pixel, radii to 5 %), and as one press with a background; and that
of the same sensor with an elastic gel with presses known by their force (to 5 %). Printed are verdict,
names with confidence and values, and what the report says the form costs. Sets kept in the folder are
used again.
"""

import argparse
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from designlab.core.images import to_srgb
from designlab.inference.diagnosis import diagnose
from designlab.measurement import Measurement, load_measurement, write_measurement
from designlab.measurement.frames import MeasuredFrame, PoseSigma
from designlab.sensor.design import Design, preset
from designlab.simulation.contact.indentation import indent
from designlab.validation.synthetic import plant
from geometries.probes import parse

DESIGN, ELASTIC = preset("gelsight-2020-flat"), preset("gelsight-2020-flat-elastic")
HIDDEN = {"vignetting": {"corner_loss": 0.25}}
SEED = 4242
Images = dict[str, np.ndarray]
Form = tuple[Measurement, Images]


def main() -> None:
    """Print a block for every form."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help="folder for sets and pictures (default: a temporary one)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.out or Path(temporary)
        for design, forms in ((DESIGN, FORMS), (ELASTIC, {"presses by force": by_force})):
            source = folder / design.name
            if not source.exists():
                plant(design, effects=HIDDEN, out=source, seed=SEED, kit_seed=1)
            whole = load_measurement(source)
            for name, form in forms.items():
                measurement, images = form(whole)
                place = folder / f"{design.name}, {name}"
                shutil.rmtree(place, ignore_errors=True)
                write_measurement(measurement, images, place)
                _report(name, place, design, folder / "renders" / design.name)


def _report(name: str, place: Path, design: Design, renders: Path) -> None:
    out = place.with_name(f"{place.name}, diagnosis")
    shutil.rmtree(out, ignore_errors=True)
    report = diagnose(load_measurement(place), design, out=out, seed=0, renders=renders)
    named = []
    for found in report.effects:
        values = ", ".join(f"{parameter} {value.value:.3f}" for parameter, value in found.parameters.items())
        named.append(f"{found.name} {found.confidence:.2f} ({values})")
    print(f"{name}: {report.verdict}; {', '.join(named) or 'no name'}")
    for reserve in report.reserves:
        print(f"  {reserve}", flush=True)


def _images(measurement: Measurement) -> Images:
    return {frame.file: np.asarray(measurement.image(frame)) for frame in measurement.frames}


def _of(measurement: Measurement, frames: list[MeasuredFrame], **fields: object) -> Form:
    images = _images(measurement)
    kept = {frame.file: images[frame.file] for frame in frames}
    return measurement.model_copy(update={"frames": tuple(frames), **fields}), kept


def as_it_is(whole: Measurement) -> Form:
    """Keep all."""
    return _of(whole, list(whole.frames))


def without_repeats(whole: Measurement) -> Form:
    """Keep the first of frames that share all fields."""
    first: dict[str, MeasuredFrame] = {}
    for frame in whole.frames:
        alone = frame.model_copy(update={"repeat": None})
        first.setdefault(str(alone.model_copy(update={"file": "x"})), alone)
    return _of(whole, list(first.values()))


def in_8_bits(whole: Measurement) -> Form:
    """Write PNG as cameras do."""
    frames = [f.model_copy(update={"file": f.file.replace(".exr", ".png")}) for f in whole.frames]
    images = {
        new.file: np.clip(to_srgb(np.clip(whole.image(old), 0.0, 1.0)), 0.0, 1.0)
        for new, old in zip(frames, whole.frames, strict=True)
    }
    return whole.model_copy(update={"frames": tuple(frames), "response": "srgb"}), images


def by_circle(whole: Measurement) -> Form:
    """Keep balls, and of these the circles that they touch."""
    random, frames = np.random.default_rng(SEED), []
    mm_per_px = DESIGN.sensing_area_mm[0] / whole.image(whole.frames[0]).shape[1]
    for frame in whole.frames:
        if frame.kind != "press":
            frames.append(frame)
        elif frame.probe is not None and frame.probe.startswith("sphere"):
            rows, columns = whole.image(frame).shape[:2]
            ball, (x, y) = parse(frame.probe).size_mm / 2, frame.centre_mm or (0.0, 0.0)
            radius = np.sqrt(ball**2 - (ball - (frame.depth_mm or 0.0)) ** 2)
            centre = np.array([columns / 2 + x / mm_per_px, rows / 2 - y / mm_per_px])
            changes = {
                "centre_px": tuple((centre + random.normal(0.0, 0.5, 2)).tolist()),
                "contact_radius_px": float(radius / mm_per_px * (1 + 0.05 * random.normal())),
            }
            unknown = dict.fromkeys(("depth_mm", "centre_mm", "sigma"))
            frames.append(frame.model_copy(update=changes | unknown))
    return _of(whole, frames, mm_per_px=mm_per_px)


def one_press(whole: Measurement) -> Form:
    """Keep the first press and the first background with all LEDs."""
    background = next(f for f in whole.frames if f.kind == "background" and f.leds is None)
    return _of(whole, [background, next(f for f in whole.frames if f.kind == "press")])


def by_force(whole: Measurement) -> Form:
    """State the force of every press in place of its depth."""
    random = np.random.default_rng(SEED)

    def forced() -> Iterator[MeasuredFrame]:
        for frame in whole.frames:
            press = whole.press(frame) if frame.kind == "press" else None
            if press is None:
                yield frame
                continue
            area_mm = ELASTIC.sensing_area_mm
            surface = indent(ELASTIC.elastomer, ELASTIC.contact, press, area_mm=area_mm, pitch_mm=0.1)
            assert surface.mechanics is not None
            force = surface.mechanics.force_n
            sigma = (frame.sigma or PoseSigma()).model_copy(
                update={"depth_mm": None, "force_n": 0.05 * force}
            )
            measured = {"depth_mm": None, "force_n": force * (1 + 0.05 * random.normal()), "sigma": sigma}
            yield frame.model_copy(update=measured)

    return _of(whole, list(forced()))


FORMS: dict[str, Callable[[Measurement], Form]] = {
    "as it is": as_it_is,
    "without repeats": without_repeats,
    "8-bit sRGB": in_8_bits,
    "balls by their circle": by_circle,
    "one press and a background": one_press,
}


if __name__ == "__main__":
    main()
