"""Accuracy compares light transport and directional light on the paper's two sets of presses."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.images import read_image, write_image
from designlab.core.metrics import remove_quadratic_field
from designlab.core.progress import named, silent
from designlab.core.run_folder import resumed
from designlab.core.store import read_json, write_atomic, write_json
from designlab.core.types import Progress
from designlab.inference.calibration import Calibration, calibrate
from designlab.inference.calibration.imaging import ALBEDO, KERNEL
from designlab.measurement import MeasuredFrame, Measurement, PoseSigma, load_measurement, write_measurement
from designlab.measurement.compare import FIGURES, Pair, compare_model
from designlab.report.figures import write_figure
from designlab.sensor.design import CHANNELS, Design, preset
from designlab.simulation.directional_light import DirectionalLight, load_any_model
from designlab.simulation.effects.model import SensorModel
from designlab.simulation.simulator import Simulator
from designlab.validation.paper_2020.datasets import around, dataset_1, dataset_2, stated
from designlab.validation.paper_2020.hidden import hidden
from designlab.validation.paper_2020.photograph import photograph
from designlab.validation.paper_2020.pictures import models_plot
from designlab.validation.paper_2020.sizes import SENSORS, Size

TRANSPORT, DIFFUSE, PHONG = MODELS = ("light transport", "directional, diffuse", "directional, Phong")
SAMPLES = 48
AVERAGED = 4  # exposures of each picture, as a lab takes them that wants to see the press and not the noise
PLACED = PoseSigma(depth_mm=0.01, centre_mm=0.01, yaw_deg=0.1)  # of presses for baselines
PARTS = ("smooth", "edges", "rest")  # of an error
STEEP = 0.15  # slope of the membrane above which a pixel belongs to the edges of a contact
SHOWN = ("triangle", "star", "sphere")  # which press is drawn, the first of these


def accuracy(folder: str | Path, size: Size, seed: int = 1, progress: Progress = silent) -> dict[str, Any]:
    """Photograph hidden sensors, calibrate each model on two presses, and compare on all others.

    Every picture, calibration and comparison is kept in the folder and not made again.

    Parameters
    ----------
    folder : path
        Where to keep them.
    size : Size
        Presses, pixels and samples.
    seed : int
        Seed of sensors, poses, noise and light.
    progress : callable, optional
        Called with what is done, how many parts are done and how many there are.

    Returns
    -------
    dict
        For each sensor and model the figures of every frame, and their means over frames not fitted to.
    """
    found = {}
    for number, (shape, sensor) in enumerate(SENSORS.items()):
        if shape not in size.shapes_of_gel:
            continue
        place = Path(folder) / shape
        hidden_sensor = _HiddenSensor(place, preset(sensor), size, seed + number, progress)
        found[sensor] = resumed(place / "accuracy.json", hidden_sensor.compared)
        pictures = found[sensor]["pictures"]  # named relative to the folder, which may be moved
        found[sensor]["pictures"] = {name: os.path.relpath(path, folder) for name, path in pictures.items()}
    return {"sensors": found}


@dataclass(frozen=True)
class _HiddenSensor:
    """A sensor built after a nominal design, its pictures, and the models fitted to them, in one folder."""

    place: Path
    nominal: Design
    size: Size
    seed: int
    progress: Progress

    def compared(self) -> dict[str, Any]:
        """Figures of every model, and what is told of the sensor beside them."""
        nominal, place, seed = self.nominal, self.place, self.seed
        # The second set of presses is on the flat gel; of the dome it gives the two that are fitted to.
        balls, triangles = 1, 1
        if nominal.name == SENSORS["flat"]:
            balls, triangles = self.size.balls, self.size.triangles
        sets = {
            1: dataset_1(nominal, seed=seed, shapes=self.size.shapes, places=self.size.places),
            2: dataset_2(nominal, seed=seed, balls=balls, triangles=triangles),
        }
        measurement = self._photographed([*around(nominal, light_probe=True), *sets[1], *sets[2]])
        dataset = {frame.file: number for number, own in sets.items() for frame in own}
        models: dict[str, Any] = {}
        pairs: dict[str, Sequence[Pair]] = {}
        edges: dict[str, NDArray[np.bool_]] = {}
        posed = measurement
        for name in MODELS:
            # Directional light would bend poses to stand for light that falls off; it is given those found.
            model, poses = self._calibrated(name, posed)
            posed = at_poses(measurement, poses) if name == TRANSPORT else posed
            tell = named(self.progress, f"{nominal.name}: {name}, comparing: ")
            comparison = compare_model(model, posed, samples=SAMPLES, seed=seed, progress=tell)
            pairs[name] = comparison.pairs
            if name == TRANSPORT:
                edges = {
                    frame.file: _edges(nominal, posed, frame)
                    for frame in posed.frames
                    if frame.kind == "press"
                }
            models[name] = _figures(comparison.pairs, measurement, dataset, edges)
        shown = next(
            k
            for kind in SHOWN
            for k, pair in enumerate(pairs[TRANSPORT])
            if pair.file.startswith(kind) and dataset[pair.file] == 1
        )
        plot = models_plot({name: own[shown] for name, own in pairs.items()})
        picture = write_figure(plot, place / "comparison.png")
        return {
            "models": models,
            "pictures": {"comparison": str(picture)},
            "interreflected_share": self._interreflected(),
            "fit_frames": sum(frame.split == "train" for frame in measurement.frames),
            "held_out_frames": sum(frame.split == "final" for frame in measurement.frames),
        }

    def _photographed(self, frames: Sequence[MeasuredFrame]) -> Measurement:
        """Take every picture that is not there yet, then write the measurement."""
        folder, sensor = self.place / "measurement", self.nominal.name
        if (folder / "measurement.toml").is_file():
            return load_measurement(folder)
        true = hidden(self.nominal, seed=self.seed)
        pictures, taken = self.place / "pictures", []
        pictures.mkdir(parents=True, exist_ok=True)
        for number, frame in enumerate(frames):
            self.progress(f"{sensor}: photographing", number, len(frames))
            image, about = pictures / frame.file, pictures / f"{frame.file}.json"
            if not about.is_file():
                binned = 1 if frame.kind == "light_probe" else self.size.binned
                seed = 1000 * self.seed + number
                done, found = photograph(
                    true, [frame], samples=self.size.samples, seed=seed, binned=binned, averaged=AVERAGED
                )
                write_image(image, found[frame.file].astype(np.float16))
                write_json(about, done[0].model_dump(mode="json", exclude_none=True))
            taken.append(MeasuredFrame.model_validate(read_json(about)))
        measurement = Measurement(
            name=f"made {sensor}",
            sensor=sensor,
            response="linear",
            source="simulated: unbiased estimator, fine mesh, camera noise, poses off by their stated doubt",
            frames=tuple(stated(taken, seed=self.seed)),
        )
        images = {frame.file: read_image(pictures / frame.file).astype(np.float16) for frame in frames}
        return load_measurement(write_measurement(measurement, images, folder))

    def _calibrated(
        self, name: str, measurement: Measurement
    ) -> tuple[SensorModel | DirectionalLight, dict[str, Any]]:
        """Model fitted to two presses, and the pose that it finds for every press."""
        stem = name.replace(", ", "-").replace(" ", "-")
        model, kept = self.place / f"{stem}.toml", self.place / f"{stem}.json"
        if not kept.is_file():
            groups = range(len(self.nominal.leds.groups))
            start: Design | DirectionalLight = self.nominal
            free = [KERNEL, *(f"{ALBEDO}.{group}" for group in groups)]
            if name != TRANSPORT:
                # At poses that are known nothing of the other presses is left to be found.
                fitted = tuple(frame for frame in measurement.frames if frame.split != "final")
                measurement = measurement.model_copy(update={"frames": fitted})
                start = DirectionalLight.of(self.nominal, "diffuse" if name == DIFFUSE else "phong")
                # Free azimuths turn to where they stand for fall-off, and shade presses from the wrong side.
                free = [f"lights.{group}.elevation_deg" for group in groups]
                free += ["exponent"] if name == PHONG else []
            found = calibrate(
                measurement,
                start,
                columns=self.size.columns,
                samples=SAMPLES,
                seed=self.seed,
                free=free,
                progress=named(self.progress, f"{self.nominal.name}: {name}: "),
            )
            write_atomic(model, found.model.dumps())
            write_json(kept, {"poses": poses_of(found), "calibration": found.to_json()})
        return load_any_model(model), read_json(kept)["poses"]

    def _interreflected(self) -> dict[str, float]:
        """Share of the untouched gel's light that met the membrane or the parts around it more than once."""
        model = load_any_model(self.place / "light-transport.toml")
        assert isinstance(model, SensorModel)
        lengths = model.design.optics.path_length, 2
        designs = [model.design.replace({"optics.path_length": length}) for length in lengths]
        whole, once = (
            Simulator(design, columns=80, samples=SAMPLES, seed=self.seed).frame(None).mixed.mean(axis=(0, 1))
            for design in designs
        )
        return {channel: float(1 - b / a) for channel, a, b in zip(CHANNELS, whole, once, strict=True)}


def poses_of(found: Calibration) -> dict[str, Any]:
    """Pose of every press after a calibration, by its file."""
    return {frame.file: dict(frame.pose) for frame in found.frames if frame.pose is not None}


def at_poses(measurement: Measurement, poses: dict[str, Any]) -> Measurement:
    """Return the measurement with the poses that were found; a press without one keeps what is stated."""
    frames = []
    for frame in measurement.frames:
        if frame.kind == "press" and frame.file in poses:
            pose = poses[frame.file]
            frame = frame.model_copy(
                update={
                    "centre_mm": (pose["x_mm"], pose["y_mm"]),
                    "depth_mm": pose["depth_mm"],
                    "yaw_deg": pose["yaw_deg"],
                    "sigma": PLACED,
                }
            )
        frames.append(frame)
    return measurement.model_copy(update={"frames": tuple(frames)})


def _edges(design: Design, posed: Measurement, frame: MeasuredFrame) -> NDArray[np.bool_]:
    """Pixels that see a steep part of the membrane."""
    simulator = Simulator(design, view=posed.view(frame, design), seed=0)
    surface = simulator.surface(posed.press(frame))
    x, y = simulator.rays.hit(surface)
    p, q = (surface.sample(slope, x, y) for slope in surface.indentation_gradient)
    return np.hypot(p, q) > STEEP


def _figures(
    pairs: Sequence[Pair],
    measurement: Measurement,
    dataset: dict[str, int],
    edges: dict[str, NDArray[np.bool_]],
) -> dict[str, Any]:
    use = {frame.file: frame.split for frame in measurement.frames}
    frames = [
        {
            "file": pair.file,
            "dataset": dataset[pair.file],
            "use": use[pair.file],
            **pair.figures,
            "error_shares": error_shares(pair.simulated, pair.real, edges[pair.file]),
        }
        for pair in pairs
    ]
    held_out = [frame for frame in frames if frame["use"] == "final"]
    own = {
        str(number): [frame for frame in held_out if frame["dataset"] == number]
        for number in sorted({frame["dataset"] for frame in held_out})
    }
    return {
        "frames": frames,
        "held_out": {**_means(held_out), "datasets": {number: _means(part) for number, part in own.items()}},
    }


def _means(frames: Sequence[dict[str, Any]]) -> dict[str, Any]:
    return {
        **_mean(frames, FIGURES),
        "channels": {
            channel: _mean([frame["channels"][channel] for frame in frames], FIGURES) for channel in CHANNELS
        },
        "error_shares": _mean([frame["error_shares"] for frame in frames], PARTS),
    }


def _mean(entries: Sequence[dict[str, Any]], names: Sequence[str]) -> dict[str, float]:
    return {name: float(np.mean([entry[name] for entry in entries])) for name in names}


def error_shares(
    simulated: NDArray[np.floating], real: NDArray[np.floating], edges: NDArray[np.bool_]
) -> dict[str, float]:
    """Shares of the squared error: a smooth field of each channel, steep parts of the membrane, the rest.

    The smooth field is quadratic in place: light that falls off from the LEDs. What is left of the error on
    steep parts is colour of edges; the rest is cast shadows, and light from wall to wall.
    """
    error = np.asarray(simulated, dtype=float) - np.asarray(real, dtype=float)
    left = np.stack([remove_quadratic_field(error[..., c]) for c in range(3)], axis=-1)
    parts = (((error - left) ** 2).sum(), (left[edges] ** 2).sum(), (left[~edges] ** 2).sum())
    total = float(sum(parts))
    return {name: float(part) / total if total else 0.0 for name, part in zip(PARTS, parts, strict=True)}
