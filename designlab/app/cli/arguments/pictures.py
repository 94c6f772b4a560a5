"""Arguments of the commands on a lab's own pictures: import, lens, calibrate, reconstruct."""

from typing import Any

from designlab.app.cli.arguments.options import (
    DESIGN_HELP,
    mesh,
    noted,
    option,
    out,
    part,
    seed,
    size,
    trust,
    whole,
)

LENS_HELP = "calibration by OpenCV, ROS, Kalibr, COLMAP or a script (YAML, XML, JSON, .npz, cameras.txt)"
OF_DESIGN = "with --design, part of the camera's full picture that the pictures show, where not the whole"


def add_calibration(add: Any) -> None:
    """Add calibrate, which fits a model or a map to pictures."""
    calibrate = add(
        "calibrate",
        "designlab.app.cli.calibrate:calibrate",
        "the design under which the simulator gives a sensor's pictures",
    )
    option(
        calibrate,
        "measurement MEASUREMENT",
        "folder with a measurement.toml; with --model, or --balls FOLDER in its place",
        nargs="?",
    )
    option(calibrate, "--model MODEL", DESIGN_HELP + ", or what calibrate wrote", default=None)
    balls = calibrate.add_argument_group("calibration on balls, for reconstruct")
    option(
        balls,
        "--balls FOLDER",
        "ball presses and a background: a measurement folder, or pictures, the background's name "
        "beginning with background; circles from balls.csv, else found",
        default=None,
    )
    option(balls, "--ball-mm D", "diameter of the ball (mm)", type=float, default=None)
    option(balls, "--mm-per-px S", "size of a pixel at the gel (mm)", type=float, default=None)
    option(
        balls,
        "--thickness-mm T",
        "thickness of the gel (mm); that of --design, or fitted, when absent",
        type=float,
        default=None,
    )
    option(
        balls,
        "--design MODEL",
        "preset or design file that says what the gel is; of a dome, or behind a lens that bends, also where "
        "pixels see it, and how steep it is there; its light does not matter",
        default=None,
    )
    part(balls, OF_DESIGN)
    option(
        calibrate,
        "--baseline",
        "fit, in place of light transport, one distant light for each LED group on a surface of this "
        "reflection, starting from where the LEDs stand; calibrated.toml is then for compare and calibrate",
        choices=("diffuse", "phong"),
        default=None,
    )
    option(
        calibrate,
        "--free FIELD",
        "numbers of the design, or of the probe such as probe.size_mm, to fit beside light and poses; after "
        "one may stand what is known of it, =4+-1.5 (value and standard deviation), =5..5.8 (bounds) or "
        "=4+-1.5,2..6 (default: contact.kernel_length_mm or contact.skin_length_mm, "
        "camera.horizontal_fov_deg, and contact.modulus_mpa where a press states depth_mm and force_n; of a "
        "baseline, which names these with design. in front, lights.N.azimuth_deg, lights.N.elevation_deg and "
        "exponent)",
        nargs="*",
    )
    option(
        calibrate,
        "--layout",
        "find first where each LED group shines from, then fit azimuth, height and tilt of each",
    )
    option(calibrate, "--columns N", "wider frames are binned to this", type=whole(8, 2048), default=160)
    out(calibrate, "folder for the calibrated model, the result and a picture of what is left")
    trust(calibrate)
    seed(calibrate)


def add_reconstruct(add: Any) -> None:
    """Add reconstruct, which finds shapes in pictures."""
    shapes = add(
        "reconstruct",
        "designlab.app.cli.reconstruct:reconstruct",
        "heights, normals and contact from pictures of one's own sensor",
    )
    option(shapes, "pictures PICTURE", "files, folders, patterns or videos", nargs="*")
    option(
        shapes,
        "--watch FOLDER",
        "reconstruct what a camera writes into a folder as it comes, until Ctrl-C",
        default=None,
    )
    option(shapes, "--every N", "of a video, every Nth frame", type=whole(1, 10**6), default=1)
    option(
        shapes,
        "--mode",
        "accurate, or video: some hundredths of a second a picture",
        choices=("accurate", "video"),
        default="accurate",
    )
    option(
        shapes,
        "--files",
        "kinds of files to write of each picture (default: all; height and contact in mode video; picture "
        "only of those that matter where there are many)",
        choices=("height", "tiff", "exr", "normals", "contact", "mesh", "picture"),
        default=None,
        nargs="+",
    )
    option(
        shapes,
        "--calibration FILE",
        "calibration.npz of `calibrate --balls`, or of an earlier --design",
        default=None,
    )
    option(
        shapes,
        "--design MODEL",
        "instead of a calibration: preset, design or model file that the pictures are taken to come from; "
        "needs --background",
        default=None,
    )
    option(
        shapes,
        "--response CURVE",
        "with --design, the curve of the pictures: linear, srgb, gamma:G, or a file of lines "
        "'encoded,linear'; linear for EXR when absent",
        default=None,
    )
    part(shapes, OF_DESIGN)
    option(
        shapes,
        "--markers",
        "printed markers: looked for in the background, filled in and followed; none ignores them",
        choices=("auto", "none"),
        default="auto",
    )
    option(
        shapes,
        "--camera-mm Z",
        "with markers and --calibration, distance of the camera from the gel, for the shear (mm)",
        type=float,
        default=None,
    )
    option(shapes, "--background FILE", "today's picture of the untouched gel", default=None)
    option(
        shapes, "--gel NAME", "material of the gel, for forces; see docs/reference/catalogue.md", default=None
    )
    option(shapes, "--modulus-mpa E", "Young's modulus of the gel instead (MPa)", type=float, default=None)
    option(
        shapes,
        "--modulus-sd-mpa S",
        "its standard deviation (MPa); 10 %% when absent",
        type=float,
        default=None,
    )
    option(shapes, "--mesh", "kind of the mesh", choices=("ply", "stl", "glb", "none"), default="ply")
    out(shapes, "folder of the shapes; the same command again goes on there")


def add_import(add: Any) -> None:
    """Add import and lens, which read files of cameras."""
    command = add(
        "import",
        "designlab.app.cli.importing:import_pictures",
        "a camera's own files as linear images of a measurement folder",
    )
    option(
        command,
        "sources SOURCE",
        "JPEG, PNG, TIFF, EXR, WebP, BMP, PGM, NPY or raw files, or folders of them; or one folder with a "
        "measurement.toml that says what each of its files shows",
        nargs="*",
    )
    out(command, "measurement folder; frames are added to one that exists", required=False)
    shown = command.add_argument_group("what the pictures show (all of this call; several are repeats)")
    kinds = ("background", "press", "light_probe", "dark", "flat_field")
    option(shown, "--kind", "what they show", choices=kinds, default=None)
    option(shown, "--leds NAMES", "LED groups on, with commas; all when absent")
    option(shown, "--exposure E", "relative exposure", type=float)
    option(shown, "--probe SPEC", "kind:size_mm such as sphere:4, or a mesh file, which is copied")
    mesh(shown)
    noted(shown)
    text = "the same, read off the picture (px)"
    option(shown, "--contact-diameter-px D", text, type=float)
    part(shown)
    undone = command.add_argument_group("what is undone")
    curves = "linear, srgb, gamma:G, or a file of lines 'encoded,linear'; linear for raw files when absent"
    option(undone, "--response CURVE", curves)
    option(undone, "--ladder FILE=E", "estimate the response from one scene at exposures E", nargs="+")
    option(undone, "--save-response FILE", "write the estimated response, for --response")
    option(undone, "--dark FILE", "pictures with all LEDs off, imported too", nargs="+")
    option(undone, "--black V", "value without light, as the files store it", type=float)
    option(undone, "--white V", "value at full scale, as the files store it", type=float)
    patterns = ("RGGB", "BGGR", "GRBG", "GBRG")
    option(undone, "--bayer", "pattern of files with one channel", choices=patterns, default=None)
    matrix = "matrix that the camera applied to linear R, G, B: nine numbers, row by row, or a file"
    option(undone, "--colour-matrix M", matrix)
    sensor = command.add_argument_group("the sensor")
    option(sensor, "--sensor DESIGN", DESIGN_HELP)
    option(sensor, "--lens FILE", f"{LENS_HELP}, to put into a copy of the design")
    _lens(sensor)

    lens = add(
        "lens",
        "designlab.app.cli.importing:lens",
        "what a lens calibration says, and a design with this lens",
    )
    option(lens, "file FILE", LENS_HELP)
    option(lens, "--design DESIGN", f"whose camera has this lens: {DESIGN_HELP}")
    option(lens, "--out FILE", "design file to write, a copy of DESIGN with this lens")
    _lens(lens)


def _lens(to: Any) -> None:
    text = "size of the calibrated pictures, such as 640x480, where the lens file states none"
    option(to, "--lens-size WxH", text, type=size)
    option(to, "--fisheye", "cv2.fisheye made the lens file, where it does not say so")
