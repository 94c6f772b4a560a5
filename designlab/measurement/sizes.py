"""Whether the size of a picture fits the camera's sensor: whole, a stated part of it, or binned."""

from designlab.measurement.frames import MeasuredFrame, Measurement
from designlab.sensor.design import Design


def check_leds(measurement: Measurement, frame: MeasuredFrame, design: Design, of: str = "the model") -> None:
    """Check that the LED groups that were on are those of a design, which errors call as `of` says.

    Raises
    ------
    MeasurementError
        Naming file, frame, field, rule and value.
    """
    if frame.leds is not None and not set(frame.leds) <= set(design.group_names):
        rule = f"leds: groups of {of} are {', '.join(design.group_names)}"
        raise measurement.error(frame, rule, list(frame.leds))


def check_size(measurement: Measurement, frame: MeasuredFrame, design: Design | None) -> None:
    """Check that the crop lies on the sensor, and that the file is it, or it binned.

    Raises
    ------
    MeasurementError
        Naming file, frame, field, rule and value, with suspected cause and remedy.
    """
    full = None if design is None else (design.camera.width_px, design.camera.height_px)
    if frame.crop_px is None and full is None:
        return
    x, y, width, height = frame.crop_px or (0, 0, *(full or (0, 0)))
    if full is not None and (x + width > full[0] or y + height > full[1]):
        rule = f"crop_px: lies on the sensor of {full[0]} x {full[1]} px"
        raise measurement.error(frame, rule, [x, y, width, height])
    shape = measurement.image(frame).shape
    rows, columns = shape[:2]
    shown = (
        f"crop_px: {width} x {height} px" if frame.crop_px else f"file: the sensor of {width} x {height} px"
    )
    if columns > width or rows > height:
        rule = f"{shown} cannot be smaller than the image without crop or enlargement, got {size(shape)}"
        raise measurement.error(frame, f"{rule}; {_reason(width, height, columns, rows)}", None)
    if not _binned(width, height, columns, rows):
        rule = f"{shown} and the image must have one binning in both directions, got {size(shape)}"
        raise measurement.error(frame, f"{rule}; {_reason(width, height, columns, rows)}", None)


def size(shape: tuple[int, ...]) -> str:
    """Write the size of an image for people."""
    return f"{shape[1]} x {shape[0]} px of {shape[2]} channels"


def _binned(width: int, height: int, columns: int, rows: int) -> bool:
    """Binning both directions alike leaves less than one output pixel of either over."""
    factor = width / columns
    return abs(rows * factor - height) <= max(factor, 1.0) * 1.001


def _reason(width: int, height: int, columns: int, rows: int) -> str:
    if rows <= width and columns <= height and _binned(width, height, rows, columns):
        return (
            "suspected cause: the picture is turned by 90 deg; remedy: turn it back, by the camera's or the "
            "program's setting"
        )
    if columns > width or rows > height:
        return (
            "suspected cause: the picture was enlarged, or comes from another camera or mode than the design "
            "states; remedy: save it as the camera gives it, or correct camera.width_px and height_px"
        )
    return (
        "suspected cause: a part of the sensor was saved, or the picture was resized without keeping its "
        "proportion; remedy: state that part as crop_px = [x, y, width, height], or save the whole picture"
    )
