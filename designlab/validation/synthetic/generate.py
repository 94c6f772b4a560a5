"""`plant` generates measurement sets of a sensor that hides an effect; the answer is sealed apart."""

import hashlib
import json
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from designlab.core.images import write_image
from designlab.core.progress import silent
from designlab.core.store import atomic_folder, write_atomic
from designlab.core.types import Progress
from designlab.sensor.camera import View
from designlab.sensor.design import Design, dumps, preset, preset_names
from designlab.validation.synthetic.capture import CaptureSession
from designlab.validation.synthetic.capture_plan import (
    PLACES,
    SIGMA,
    further_shot,
    shots,
    stated_presses,
    true_press,
)
from designlab.validation.synthetic.dirt import READ_OFF, add_dirt
from designlab.validation.synthetic.effects import apply
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.noted import Noted, noted_as
from designlab.validation.synthetic.unmodelled import add_outside, add_unlisted

NOTED_STREAM = 1  # of random numbers beside those of `streams`, which stay what they were
GAIN_ERROR = 0.1  # largest departure of a group's flux from its design


def plant(
    design: Design,
    *,
    effects: Mapping[str, Mapping[str, float]],
    out: str | Path,
    seed: int,
    presses: Sequence[Mapping[str, Any]] | None = None,
    columns: int = 96,
    noise: bool = True,
    correlated_noise: bool = True,
    kit: Literal["hour", "small"] = "hour",
    kit_seed: int | None = None,
    flat_field: bool = False,
    further: Sequence[Mapping[str, Any]] = (),
    outside: Mapping[str, float] | None = None,
    unlisted: bool | Mapping[str, float] = True,
    dirt: bool = False,
    noted: Noted = "depth",
    placed: bool = True,
    progress: Progress = silent,
) -> Path:
    """Generate a measurement folder of a sensor that differs from its design by hidden effects.

    The set also carries errors that every bench has: poses and depths differ from the metadata by the `sigma`
    written with them, the flux of each LED group is off by up to 10 %, one or two small departures are there
    that no catalogue lists, and the camera adds its noise. The answer is written beside the folder as
    ``<out>.answer.json``, and its SHA-256 as ``<out>.seal``; a random salt within the answer keeps it from
    being guessed.

    Parameters
    ----------
    design : Design
        The sensor as its owner believes it to be.
    effects : mapping
        Effect name to parameter values, see `effects.apply`; empty for a null set.
    out : str or Path
        Folder to make; must not exist, or be empty.
    seed : int
        Seed of all that is hidden: errors, noise, and what an effect changes from frame to frame.
    presses : sequence of mappings, optional
        Presses instead of the kit's: ``probe`` (text), ``depth_mm``, ``centre_mm``, ``yaw_deg`` each.
    columns : int
        Width of the images in pixels; the camera's pixels are binned by a whole number.
    noise : bool
        Without it there are neither noise nor quantisation; the errors of pose and flux stay.
    correlated_noise : bool
        Whether neighbouring pixels share noise (correlation 0.3), as behind a demosaicing filter.
    kit : {"hour", "small"}
        hour: dark frame, one background a group, 5 backgrounds in between, 2 of shorter exposure, one with
        the gel turned by 180 deg, a ball at 8 places and 2 depths, 2 triangles, one press once more;
        small: 3 backgrounds, no ladder, turn or repeat, a ball at 3 places and 2 depths, no triangle.
    kit_seed : int, optional
        Seed of the stated places, that of `seed` when absent; sets that share it share their places.
    flat_field : bool
        Whether to add a frame of uniform light straight into the camera, which shows lens and sensor only.
    further : sequence of mappings
        Frames taken after those of the kit, in the fields of a measurement file: ``kind``, ``leds``,
        ``exposure``, ``gel_rotation_deg``, and those of a press.
    outside : mapping, optional
        Departures that no catalogue lists, kind to strength, see `unmodelled.outside_kinds`.
    unlisted : bool or mapping
        Whether to add small departures (or which, kind to strength).
    dirt : bool
        Whether the sensor has a lab's dirt too, see `dirt.add_dirt`, and its poses are read off the picture.
    noted : {"depth", "force", "circle", "nothing"}
        What the metadata state of a press's depth, see `noted.noted_as`.
    placed : bool
        Whether they state its place and yaw.
    progress : callable, optional
        Called with what is being done, the number of frames done and their total.

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
    _require_usable(design, columns, kit)
    _, random_pose, random_gain, random_noise, random_frames, *departing = streams(seed)
    random_outside, random_unlisted, random_dirt = departing
    rig, truth = apply(Rig.of(design), effects)
    rig, beyond = add_outside(rig, outside or {}, random=random_outside)
    small: dict[str, Any] = {}
    if unlisted is not False:
        asked = None if unlisted is True else unlisted
        rig, small = add_unlisted(rig, asked, random=random_unlisted)
    found_dirt: dict[str, Any] = {}
    if dirt:
        rig, found_dirt = add_dirt(rig, random=random_dirt)
    sigma = READ_OFF if dirt else SIGMA
    crop, view = cropped_view(design, columns)
    gain = 1 + GAIN_ERROR * random_gain.uniform(-1, 1, len(rig.flux_mw))
    random_place = streams(seed if kit_seed is None else kit_seed)[0]
    stated = stated_presses(design, kit, random_place) if presses is None else [dict(p) for p in presses]
    true = [true_press(rig, press, random_pose, sigma=sigma) for press in stated]
    planned = shots(rig, kit, stated, true, flat_field=flat_field, sigma=sigma)
    later = [
        further_shot(rig, frame, number, random_pose, sigma=sigma)
        for number, frame in enumerate(further, start=1)
    ]
    planned += later
    if noted != "depth" or not placed:
        random_noted = np.random.default_rng([seed, NOTED_STREAM])
        planned = [
            shot
            if shot.indenter is None
            else shot._replace(
                metadata=noted_as(
                    shot.metadata, shot.indenter, design, noted, placed=placed, random=random_noted
                )
            )
            for shot in planned
        ]
    session = CaptureSession(rig, view, gain=gain, random=random_frames, grain_seed=seed)
    frames, images = [], {}
    for number, shot in enumerate(planned):
        frame_noise = np.random.default_rng(int(random_noise.integers(2**63)))
        values = session.take(shot, frame_noise if noise else None, correlated=correlated_noise)
        images[shot.file] = values.astype(np.float32)
        frames.append(shot.metadata | {"exposure": shot.exposure, "crop_px": crop})
        progress("planting", number + 1, len(planned))
    pressed = [*true, *(shot.indenter for shot in later if shot.indenter is not None)]
    answer = {
        "effects": truth,
        "outside": beyond,
        "unlisted": small,
        "dirt": found_dirt,
        "design": design.digest,
        "seed": seed,
        "kit_seed": kit_seed,
        "gain": dict(zip(rig.group_names, gain.tolist(), strict=True)),
        "exposure": session.exposure,
        "presses": [
            {"depth_mm": p.depth_mm, "centre_mm": list(p.centre_mm), "yaw_deg": p.yaw_deg} for p in pressed
        ],
        **session.hidden(),
        "salt": secrets.token_hex(16),
    }
    _write(out, design, frames, images, json.dumps(answer, indent=1) + "\n")
    return out


def _require_usable(design: Design, columns: int, kit: str) -> None:
    """Refuse what no measurement can be generated of."""
    if not isinstance(design, Design):
        raise TypeError(
            f"design: must be a Design, got {type(design).__name__}: effects to plant are given by `effects`"
        )
    if columns < 8:
        raise ValueError(f"columns: at least 8, got {columns}")
    if kit not in PLACES:
        raise ValueError(f"kit: one of {', '.join(PLACES)}, got {kit!r}")
    if design.camera.defocus is not None:
        raise ValueError(
            "camera.focus_mm: measurements are generated for a lens that is sharp everywhere, "
            f"got {design.camera.focus_mm:g} mm"
        )


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


def streams(seed: int) -> list[np.random.Generator]:
    """Sources of stated places, poses, gains, noise, what varies by frame, and outside, unlisted, dirt."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(8)]


def cropped_view(design: Design, columns: int) -> tuple[list[int], View]:
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
