"""A real picture by itself as a measurement, by what the arguments say that it shows."""

import tempfile
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from designlab.measurement import Measurement

STATED = ("depth_mm", "force_n", "contact_diameter_mm", "depth_range_mm", "at", "yaw_deg", "direction")
SHOWN = ("probe", "untouched", "background", "response", "crop_px", *STATED)
ALONE = ("--untouched", "--response", "--crop-px")  # that go with a picture of the untouched gel


def given(args: Namespace) -> list[str]:
    """Return options that say what a picture shows."""
    return [f"--{name.replace('_', '-')}" for name in SHOWN if getattr(args, name) not in (None, False)]


@contextmanager
def measured_picture(args: Namespace) -> Iterator["Measurement"]:
    """Make a measurement of a picture, and of the untouched gel beside it, for as long as it is needed.

    Raises
    ------
    ValueError
        In one line, what is missing and a command that says it.
    """
    from designlab.measurement import MeasurementError, load_measurement
    from designlab.measurement.importing.conversion import Conversion, response_named
    from designlab.measurement.importing.import_frames import import_frames, items, listed
    from designlab.sensor.response_curve import Response

    _require(args)
    response = Response() if args.response is None else response_named(args.response)
    stated = {"centre_mm" if name == "at" else name: getattr(args, name) for name in STATED}
    known: dict[str, Any] = {name: value for name, value in stated.items() if value is not None}
    shown = {"kind": "background"} if args.untouched else {"kind": "press", "probe": args.probe, **known}
    part = {} if args.crop_px is None else {"crop_px": args.crop_px}
    made = items([Path(args.real)], **shown, **part)
    if args.background:
        made += items(listed(args.background), kind="background", **part)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "set"
        try:
            import_frames(made, Conversion(response=response), out=folder)
            yield load_measurement(folder)
        except MeasurementError as error:
            raise MeasurementError(_named(str(error), folder, args.real)) from None


def _named(text: str, folder: Path, real: str) -> str:
    """An error about the file that was given, not about the folder that was made of it."""
    text = text.replace(str(folder / "measurement.toml"), real).replace(str(folder), real)
    return text.replace("crop_px = [x, y, width, height]", "--crop-px X,Y,WIDTH,HEIGHT")


def _require(args: Namespace) -> None:
    """Refuse what does not say what the picture shows, all that is missing in one line."""
    from designlab.measurement.importing.camera_files import is_linear_format

    if args.untouched and (wrong := [o for o in given(args) if o not in ALONE]):
        raise ValueError(f"{wrong[0]}: does not go with --untouched; leave one of them out")
    for option in STATED:
        if args.probe is None and getattr(args, option) is not None:
            raise ValueError(f"--{option.replace('_', '-')}: needs --probe, what was pressed?")
    missing, command = [], ["designlab", "compare", args.simulated, args.real]
    if not args.untouched:
        if args.probe is None:
            missing.append("what it shows: --untouched, or --probe with what was pressed, as sphere:4")
        if args.at is None and not args.background:
            missing.append("where: --at X,Y, or --background with the untouched gel, to read it off")
        if not any(getattr(args, name) is not None for name in STATED[:4]):
            depth = "how deep, if known: --depth-mm, --force-n, --contact-diameter-mm or --depth-range-mm"
            missing += [depth] if missing else []
        command += ["--probe", args.probe or "sphere:4", "--depth-mm", "0.5"]
        command += [] if args.background else ["--background", "gel.png"]
    if args.response is None and not is_linear_format(Path(args.real)):
        missing.append("its response: --response srgb for a picture made for eyes, linear for raw values")
        command += ["--response", "srgb"]
    if missing:
        raise ValueError(
            f"{args.real}: beside the design {args.simulated} it needs {'; '.join(missing)}; for example "
            f"`{' '.join(command)}`"
        )
