"""Measurement sets of a sensor that hides an effect; the answer is kept apart and sealed."""

import hashlib
import json
import secrets
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.camera import View
from designlab.design import Design, dumps, preset, preset_names
from designlab.images import write_image
from designlab.plant.effects import apply
from designlab.plant.raycast import Caster
from designlab.plant.rig import Rig
from designlab.plant.surface import Indenter
from designlab.store import atomic_folder, write_atomic
from geometries import elastomer, probes

Array = NDArray[np.float64]

SIGMA = {
    "depth_mm": 0.02,
    "centre_mm": 0.05,
    "yaw_deg": 0.5,
}  # between the metadata and what was really pressed
GAIN_ERROR = 0.1  # largest departure of a group's flux from its design
BRIGHT = 0.7  # share of full scale that the bright parts of the untouched gel reach
PLACES = {
    "hour": ((-32, -28), (5, -30), (33, -22), (-33, 6), (2, 3), (31, 10), (-25, 31), (12, 30)),
    "small": ((-28, -20), (30, -5), (-2, 26)),
}  # of ball presses, in percent of the sensing area's width and height


class _Shot(NamedTuple):
    """One frame to take: the metadata written, the true indentation, and which groups are on."""

    metadata: dict[str, Any]
    indenter: Indenter | None
    lit: Array


def plant(
    design: Design,
    *,
    effects: Mapping[str, Mapping[str, float]],
    out: str | Path,
    seed: int,
    presses: Sequence[Mapping[str, Any]] | None = None,
    columns: int = 96,
    noise: bool = True,
    kit: Literal["hour", "small"] = "hour",
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Generate a measurement folder of a sensor that differs from its design by hidden effects.

    The set also carries errors that every bench has: poses and depths differ from the metadata by the `sigma`
    written with them, the flux of each LED group is off by up to 10 %, and the camera adds its noise. The
    answer is written beside the folder as ``<out>.answer.json``, and its SHA-256 as ``<out>.seal``; a random
    salt within the answer keeps it from being guessed.

    Parameters
    ----------
    design : Design
        The sensor as its owner believes it to be; light must travel in air.
    effects : mapping
        Effect name to parameter values, see `designlab.plant.effects.apply`; empty for a null set.
    out : str or Path
        Folder to make; must not exist, or be empty.
    seed : int
        Seed of positions, errors and noise.
    presses : sequence of mappings, optional
        Presses instead of the kit's: ``probe`` (text), ``depth_mm``, ``centre_mm``, ``yaw_deg`` each.
    columns : int
        Width of the images in pixels; the camera's pixels are binned by a whole number.
    noise : bool
        Without it there are neither noise nor quantisation; the errors of pose and flux stay.
    kit : {"hour", "small"}
        hour: 3 backgrounds, dark frame, one background a group, a ball at 8 places and 2 depths, 2 triangles;
        small: a ball at 3 places and 2 depths, no triangle.
    progress : callable, optional
        Called with the number of frames done and their total.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ValueError
        If the design, an effect or a press cannot be used.
    OSError
        If the folder exists and is not empty, or cannot be written.
    """
    out = Path(out)
    if columns < 8:
        raise ValueError(f"columns: at least 8, got {columns}")
    if kit not in PLACES:
        raise ValueError(f"kit: one of {', '.join(PLACES)}, got {kit!r}")
    if design.camera.defocus is not None:
        raise ValueError(
            "camera.focus_mm: measurements are generated for a lens that is sharp everywhere, "
            f"got {design.camera.focus_mm:g} mm"
        )
    rig, truth = apply(Rig.of(design), effects)
    crop, view = _crop(design, columns)
    streams = np.random.SeedSequence(seed).spawn(4)
    random_place, random_pose, random_gain, random_noise = (np.random.default_rng(s) for s in streams)
    nominal = _kit(design, kit, random_place) if presses is None else [dict(press) for press in presses]
    pressed = [_pressed(design, press, random_pose) for press in nominal]
    gain = 1 + GAIN_ERROR * random_gain.uniform(-1, 1, len(rig.flux_mw))
    caster = Caster(rig, view)
    cached: dict[Indenter | None, Array] = {None: caster.radiance(None)}
    mixed_background = _mixed(rig, cached[None], gain)
    exposure = design.camera.exposure or BRIGHT / float(np.percentile(mixed_background, 99.5))
    shots = _shots(rig, nominal, pressed)
    binned = view.width_px / view.columns * view.height_px / view.rows
    frames, images = [], {}
    for number, shot in enumerate(shots):
        if shot.indenter not in cached:
            cached[shot.indenter] = caster.radiance(shot.indenter)
        images[shot.metadata["file"]] = design.camera.expose(
            _mixed(rig, cached[shot.indenter], gain * shot.lit),
            exposure=exposure,
            seed=int(random_noise.integers(2**63)),
            noise=noise,
            binned=binned,
        )
        frames.append(shot.metadata | {"exposure": 1.0, "crop_px": crop})
        if progress is not None:
            progress(number + 1, len(shots))
    answer = {
        "effects": truth,
        "design": design.digest,
        "seed": seed,
        "gain": dict(zip(rig.group_names, gain.tolist(), strict=True)),
        "exposure": exposure,
        "presses": [
            {"depth_mm": p.depth_mm, "centre_mm": list(p.centre_mm), "yaw_deg": p.yaw_deg} for p in pressed
        ],
        "salt": secrets.token_hex(16),
    }
    _write(out, design, frames, images, json.dumps(answer, indent=1) + "\n")
    return out


def answer_path(out: str | Path) -> Path:
    """File that holds the answer of a generated set."""
    return Path(out).with_name(Path(out).name + ".answer.json")


def seal_path(out: str | Path) -> Path:
    """File that holds the SHA-256 of the answer of a generated set."""
    return Path(out).with_name(Path(out).name + ".seal")


def unseal(out: str | Path) -> dict[str, Any]:
    """Read the answer of a generated set.

    Raises
    ------
    ValueError
        If the answer is not the one that was sealed.
    """
    text = answer_path(out).read_bytes()
    if hashlib.sha256(text).hexdigest() != seal_path(out).read_text().strip():
        raise ValueError(f"{answer_path(out)}: is not the answer that was sealed in {seal_path(out)}")
    content: dict[str, Any] = json.loads(text)
    return content


def _crop(design: Design, columns: int) -> tuple[list[int], View]:
    """Rectangle of whole sensor pixels in the sensing area, and its view, binned by a whole number."""
    wanted, camera = design.view(columns), design.camera
    factor = max(1, int(wanted.width_px / columns))
    columns = min(columns, int(wanted.width_px) // factor, camera.width_px // factor)
    rows = max(1, min(int(wanted.height_px) // factor, camera.height_px // factor))
    width, height = columns * factor, rows * factor
    x = round(wanted.x_px + wanted.width_px / 2 - width / 2)
    y = round(wanted.y_px + wanted.height_px / 2 - height / 2)
    x, y = min(max(x, 0), camera.width_px - width), min(max(y, 0), camera.height_px - height)
    return [x, y, width, height], View(float(x), float(y), float(width), float(height), columns, rows)


def _kit(design: Design, kit: str, random: np.random.Generator) -> list[dict[str, Any]]:
    """Presses of a kit, scaled to the sensor; places move by up to 4 % of the sensing area with the seed."""
    width, height = design.sensing_area_mm
    thickness = design.elastomer.thickness_mm
    shallow, deep = (round(min(limit, share * thickness), 3) for limit, share in ((0.4, 0.2), (0.8, 0.4)))
    ball, side = round(min(4.0, height / 3), 2), round(min(5.0, 0.42 * height), 2)

    def place(percent_x: float, percent_y: float) -> list[float]:
        shift = random.uniform(-4, 4, 2)
        return [
            round((percent_x + shift[0]) / 100 * width, 2),
            round((percent_y + shift[1]) / 100 * height, 2),
        ]

    found = []
    for percent in PLACES[kit]:
        centre = place(*percent)
        found += [
            {"probe": f"sphere:{ball:g}", "depth_mm": depth, "centre_mm": centre, "yaw_deg": 0.0}
            for depth in (shallow, deep)
        ]
    if kit == "hour":
        for percent, yaw_deg, depth in (((12, -10), -28.0, deep), ((-15, 12), 40.0, shallow)):
            found.append(
                {
                    "probe": f"triangle:{side:g}",
                    "depth_mm": depth,
                    "centre_mm": place(*percent),
                    "yaw_deg": yaw_deg,
                }
            )
    return found


def _pressed(design: Design, press: Mapping[str, Any], random: np.random.Generator) -> Indenter:
    """Indentation that is really there when the metadata say `press`."""
    missing = [field for field in ("probe", "depth_mm", "centre_mm") if field not in press]
    if missing:
        raise ValueError(f"presses: {missing[0]} is needed, got {dict(press)}")
    x, y = press["centre_mm"]
    if not elastomer.inside(design.elastomer, x, y):
        raise ValueError(f"presses: centre_mm ({x:g}, {y:g}) lies on the gel")
    error = random.standard_normal(4)
    return Indenter(
        probes.parse(press["probe"]),
        max(float(press["depth_mm"]) + SIGMA["depth_mm"] * error[0], 0.01),
        (x + SIGMA["centre_mm"] * error[1], y + SIGMA["centre_mm"] * error[2]),
        float(press.get("yaw_deg", 0.0)) + SIGMA["yaw_deg"] * error[3],
    )


def _shots(rig: Rig, nominal: list[dict[str, Any]], pressed: list[Indenter]) -> list[_Shot]:
    """Frames in the order in which they are taken: backgrounds lie between the presses."""
    groups = len(rig.flux_mw)
    everything, nothing = np.ones(groups), np.zeros(groups)
    presses = [
        _Shot(
            {"file": f"press-{number:02d}.exr", "kind": "press", **press, "sigma": SIGMA},
            indenter,
            everything,
        )
        for number, (press, indenter) in enumerate(zip(nominal, pressed, strict=True), start=1)
    ]
    backgrounds = [
        _Shot({"file": f"background-{repeat}.exr", "kind": "background", "repeat": repeat}, None, everything)
        for repeat in range(3)
    ]
    single = [
        _Shot({"file": f"background-{name}.exr", "kind": "background", "leds": [name]}, None, lit)
        for name, lit in zip(rig.group_names, np.eye(groups), strict=True)
    ]
    dark = _Shot({"file": "dark.exr", "kind": "dark", "leds": []}, None, nothing)
    half = len(presses) // 2
    return [dark, *single, backgrounds[0], *presses[:half], backgrounds[1], *presses[half:], backgrounds[2]]


def _mixed(rig: Rig, radiance: Array, gain: Array) -> Array:
    """Mixed linear radiance, shape (rows, columns, channels)."""
    return np.asarray(np.einsum("cg,grk->rkc", rig.mixing * (rig.flux_mw * gain), radiance))


def _write(
    out: Path,
    design: Design,
    frames: list[dict[str, Any]],
    images: dict[str, NDArray[np.float32]],
    answer: str,
) -> None:
    import tomli_w

    known = design.name in preset_names() and preset(design.name).digest == design.digest
    content = {
        "name": f"{design.name}, generated",
        "sensor": design.name if known else "design.toml",
        "response": design.camera.response.label,
        "source": "generated by ray casting; whether and how the sensor departs from its design is sealed",
        "frame": frames,
    }
    with atomic_folder(out) as folder:
        for file, image in images.items():
            write_image(folder / file, image)
        if not known:
            (folder / "design.toml").write_text(dumps(design), encoding="utf-8")
        (folder / "measurement.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
        write_atomic(answer_path(out), answer)
        write_atomic(seal_path(out), hashlib.sha256(answer.encode()).hexdigest() + "\n")
