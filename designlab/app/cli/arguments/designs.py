"""Arguments of the commands on designs: evaluate, render, compare, export."""

from typing import Any

from designlab.app.cli.arguments.options import (
    DESIGN_HELP,
    FIDELITIES,
    MODEL_HELP,
    direction,
    mesh,
    noted,
    option,
    out,
    part,
    point,
    presses,
    samples,
    seed,
    whole,
)

_DESIGNS = "designlab.app.cli.designs"


def add_designs(add: Any) -> None:
    """Add what a design is given to."""
    evaluate = add("evaluate", f"{_DESIGNS}:evaluate", "scores of a design, by simulation")
    option(evaluate, "design DESIGN", DESIGN_HELP)
    option(evaluate, "other OTHER", "second design, with --compare", nargs="?")
    option(evaluate, "--compare", "say in which scores two designs differ, and which is better")
    option(evaluate, "--fidelity", "effort", choices=FIDELITIES)
    option(evaluate, "--profile", "show how long each part took")
    presses(evaluate)
    text = "along the sensor's axis (default) or the membrane's normal at each place"
    option(evaluate, "--direction", text, choices=("axis", "normal"), default="axis")
    own = "of elastic gels: saturation depth and lateral resolution too, as fidelity standard"
    option(evaluate, "--all-scores", own)
    seed(evaluate)
    out(evaluate, "folder for the score and its pictures", required=False)

    render = add("render", f"{_DESIGNS}:render", "one picture of the sensing area")
    option(render, "design DESIGN", MODEL_HELP)
    press = render.add_argument_group("press (without: the untouched gel)")
    option(
        press,
        "--probe SPEC",
        "kind[:size_mm] such as sphere:4, triangle:5:r0.2 (edge radius in mm), or a mesh file",
    )
    mesh(press)
    option(press, "--depth-mm D", "how deep it is pressed (mm)", type=float)
    option(press, "--force-n F", "force (N) instead of a depth, on an elastic gel", type=float)
    option(press, "--at X,Y", "where its axis meets the gel (mm; default 0,0)", type=point)
    direction(press)
    option(press, "--yaw-deg A", "its rotation, counter-clockwise (deg)", type=float)
    option(press, "--shear-mm X,Y", "how far it is then moved sideways (mm)", type=point)
    option(press, "--twist-deg A", "how far it is then turned, counter-clockwise (deg)", type=float)
    png = "picture for eyes (sRGB, brightest 0.1 %% clipped)"
    option(render, "-o --output FILE", f".exr: linear radiance; .png: {png}", required=True)
    option(render, "--columns N", "width of the picture in pixels", type=whole(16, 4096), default=640)
    samples(render)
    seed(render)

    compare = add("compare", f"{_DESIGNS}:compare", "image metrics of a simulation against the real thing")
    option(compare, "simulated SIM", f"image file; or {MODEL_HELP} or `calibrate`")
    option(compare, "real REAL", "image file; or a measurement folder")
    real = compare.add_argument_group("what one picture of the real sensor shows, beside a design")
    option(real, "--untouched", "the gel without contact")
    option(real, "--probe SPEC", "kind:size_mm such as sphere:4, or a mesh file")
    noted(real)
    option(real, "--background FILE", "pictures of the untouched gel, by which places are found", nargs="+")
    option(real, "--response CURVE", "linear, srgb, gamma:G, or a file of lines 'encoded,linear'")
    part(real)
    out(compare, "folder for the simulated pictures, beside the real ones", required=False)
    samples(compare)
    seed(compare)

    export = add("export", f"{_DESIGNS}:export", "STL, STEP, 3MF, LED boards, bill of materials, checks")
    option(export, "design DESIGN", DESIGN_HELP)
    out(export, "folder to make; replaces an earlier export")
    option(export, "--probe SPEC", "indenter to add (repeatable)", action="append", default=[])
    mesh(export)
    option(export, "--supply-v V", "supply of the LED boards", type=float, default=5.0)
    option(export, "--no-boards", "leave the LED boards out")
    option(export, "--allow-infeasible", "export although rules are broken, with warnings")
