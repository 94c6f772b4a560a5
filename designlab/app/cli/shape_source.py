"""What `reconstruct` turns pictures into shapes by: a calibration file, or a model of the sensor."""

from abc import ABC, abstractmethod
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from designlab.app.cli.arguments.options import UsageError
from designlab.core.images import read_picture
from designlab.core.progress import bar
from designlab.core.store import digest
from designlab.measurement.importing.conversion import decoded
from designlab.reconstruction.calibration_file import Kept, load_calibration, save_calibration
from designlab.reconstruction.contact_pressure import Mode
from designlab.reconstruction.reconstructor import Reconstructor

if TYPE_CHECKING:
    from designlab.inference.calibration.from_model import Crop

MAP = "calibration.npz"
LINEAR = (".exr",)  # files whose values are light


@dataclass(frozen=True, eq=False)
class Used:
    """What pictures of one command are reconstructed by.

    Attributes
    ----------
    reconstructor : Reconstructor
        Of linear pictures.
    notes, warnings : sequence of str
        What is said once for all pictures.
    background_drift : mapping or None
        What has changed since the calibration.
    """

    reconstructor: Reconstructor
    notes: Sequence[str] = ()
    warnings: Sequence[str] = ()
    background_drift: dict[str, object] | None = None

    @property
    def modulus_mpa(self) -> float | None:
        """Young's modulus of the model's gel; None without a model."""
        return self.reconstructor.kept.about.get("modulus_mpa")

    def linear(self, picture: NDArray[Any]) -> NDArray[Any]:
        """A picture as the calibration's pictures are."""
        return decoded(picture, self.reconstructor.kept.about.get("response"))


class Source(ABC):
    """Where a map comes from; `content` identifies it."""

    content: str | bytes

    @abstractmethod
    def prepared(self, out: Path) -> Used:
        """Make the map ready, and keep what took long in the folder of the shapes."""


class CalibrationFile(Source):
    """A calibration file, with today's background where one is given."""

    def __init__(
        self, path: str, background: str | None, mode: Mode, *, markers: bool, camera_mm: float | None
    ) -> None:
        self.content = Path(path).read_bytes() if Path(path).is_file() else b""
        made = Reconstructor.load(path, mode=mode)
        about = dict(made.kept.about)
        if not markers:
            about.pop("markers", None)
        if camera_mm is not None:
            about["sight"] = {"slope_per_mm": [-1 / camera_mm] * 2, "slope": [0.0, 0.0]}
        self._used = _used(replace(made, kept=made.kept._replace(about=about)))
        if background is not None:
            today = np.asarray(self._used.linear(read_picture(background)), dtype=float)
            before = self._used.reconstructor
            warnings = [*self._used.warnings, *before.drift(today)]
            self._used = replace(
                self._used,
                reconstructor=before.on(today),
                warnings=warnings,
                background_drift=before.drift_of(today).plain(),
            )

    def prepared(self, out: Path) -> Used:
        """Return the map."""
        return self._used


class Model(Source):
    """A model of the sensor, on which a map is taught; the map is kept as a calibration file."""

    def __init__(
        self,
        name: str,
        background: str,
        crop_px: "Crop | None",
        response: dict[str, Any],
        mode: Mode,
        *,
        markers: bool,
    ) -> None:
        from designlab.inference.calibration.from_model import views_that_fit
        from designlab.simulation.effects.model import load_model

        self._model, self._response, self._mode = load_model(name), response, mode
        self._crop_px, self._markers = crop_px, markers
        self._background = np.asarray(decoded(read_picture(background), response), dtype=float)
        try:
            views_that_fit(self._model.effective_design(), self._background.shape, crop_px)
        except ValueError as error:
            field, _, rule = str(error).partition(": ")
            where = "--crop-px" if field == "crop_px" else f"--background: {background}"
            raise ValueError(f"{where}: {rule}") from None
        self.content = digest(
            self._model.digest, Path(background).read_bytes(), str((response, crop_px, markers))
        )

    def prepared(self, out: Path) -> Used:
        """Teach the map, or read what an earlier run of the same command taught."""
        from designlab.inference.calibration.from_model import teach_on_model

        path = out / MAP
        kept = load_calibration(path) if path.is_file() else None
        if kept is None or kept.about.get("made_from") != self.content:
            with bar("picture", keep=True) as progress:
                kept = teach_on_model(
                    self._model,
                    self._background,
                    crop_px=self._crop_px,
                    markers=self._markers,
                    progress=progress,
                ).kept
            about = {**kept.about, "response": self._response, "made_from": self.content}
            kept = Kept(kept.calibration, kept.taught, about)
            save_calibration(path, kept)
        made = Reconstructor(load_calibration(path), self._mode)
        if self._mode == "video":
            made.video.warm_up()
        return _used(made)


def _used(reconstructor: Reconstructor) -> Used:
    """Say once what the calibration says of itself."""
    about, notes = reconstructor.kept.about, []
    if about.get("markers") and not about.get("sight"):
        notes.append(
            "markers are followed; shear needs the camera's distance from the gel, since markers that are "
            "lifted seem to move: give it with --camera-mm"
        )
    return Used(reconstructor, [*about.get("notes", ()), *notes], list(about.get("warnings", ())))


def source_of(args: Namespace, files: Sequence[Path]) -> Source:
    """Where the map of a command comes from.

    Raises
    ------
    UsageError, ValueError
        If neither or both are given, or something that belongs to one of them is missing.
    """
    if (args.calibration is None) == (args.design is None):
        raise UsageError("reconstruct: needs one of --calibration FILE and --design MODEL")
    if args.calibration is not None:
        for name in ("response", "crop_px"):
            if getattr(args, name) is not None:
                option = f"--{name.replace('_', '-')}"
                raise UsageError(f"{option}: is for --design; a calibration knows what its pictures are")
        if args.camera_mm is not None and not args.camera_mm > 0:
            raise UsageError(f"--camera-mm: must be above 0 mm, got {args.camera_mm:g}")
        return CalibrationFile(
            args.calibration,
            args.background,
            args.mode,
            markers=args.markers == "auto",
            camera_mm=args.camera_mm,
        )
    if args.camera_mm is not None:
        raise UsageError("--camera-mm: is for --calibration; the design states its camera")
    if args.background is None:
        raise UsageError("--design: needs --background FILE, a picture of your sensor's untouched gel")
    return Model(
        args.design,
        args.background,
        args.crop_px,
        _response(args, files),
        args.mode,
        markers=args.markers == "auto",
    )


def _response(args: Namespace, files: Sequence[Path]) -> dict[str, Any]:
    """The curve of the pictures as plain data."""
    from designlab.measurement.importing.conversion import response_named
    from designlab.sensor.response_curve import Response

    if args.response is None:
        unsure = [path for path in (*files, Path(args.background)) if path.suffix.lower() not in LINEAR]
        if unsure or args.watch is not None:
            of = str(unsure[0]) if unsure else "what a camera writes"
            raise UsageError(
                f"--response: required for {of}; srgb for pictures that a camera or a program made for eyes, "
                "linear for values in proportion to light"
            )
        return Response().model_dump(mode="json")
    curve = response_named(args.response)
    if isinstance(curve, Response):
        return curve.model_dump(mode="json")
    return {"encoded": curve.encoded.tolist(), "linear": curve.linear.tolist()}
