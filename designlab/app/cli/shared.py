"""What several commands need: names of sources in what is said, tables for people."""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from designlab.sensor.design import Design
    from geometries.mesh_files import Understood
    from geometries.probes import Probe


@contextmanager
def source_named(source: str) -> Iterator[None]:
    """Put the name of the file or preset in front of what is said about an infeasible design."""
    from designlab.sensor.design import InfeasibleDesign

    try:
        yield
    except InfeasibleDesign as error:
        raise InfeasibleDesign(f"{source}: {error}", error.broken) from None


def light_files(design: "Design") -> list[dict[str, Any]]:
    """What the files that a design's LEDs take their angular profiles from were taken for."""
    profiles = [design.leds.profile, *(group.profile for group in design.leds.groups)]
    found = {str(said): said for profile in profiles if profile and (said := profile.understood)}
    return list(found.values())


def understood_lines(files: Sequence[dict[str, Any]]) -> list[str]:
    """Say the same to people."""
    return [f"{file['file']}: understood as {file['as']}" for file in files]


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out columns for people: the first to the left, the others to the right."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    lines = []
    for row in (header, *rows):
        cells = [f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True)]
        lines.append("  ".join([f"{row[0]:<{widths[0]}}", *cells[1:]]).rstrip())
    return "\n".join(lines)


def probes_named(args: Namespace, texts: Sequence[str]) -> "list[Probe]":
    """Read probes, the meshes among them with the unit and the side that the arguments state."""
    from geometries.probes import is_mesh, parse

    meshes = [text for text in texts if is_mesh(text)]
    for option in ("unit", "side"):
        if getattr(args, f"probe_{option}") is not None and not meshes:
            raise ValueError(f"--probe-{option}: is for mesh files, no --probe names one; leave it out")
    return [
        parse(text, unit=args.probe_unit, side=args.probe_side) if text in meshes else parse(text)
        for text in texts
    ]


def as_understood(meshes: "Sequence[Understood]") -> dict[str, Any]:
    """What mesh files were taken for as ``understood`` of the JSON; nothing where there are none."""
    return {"understood": [mesh.to_json() for mesh in meshes]} if meshes else {}
