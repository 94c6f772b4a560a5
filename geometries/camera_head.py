"""The head of a housing with seats: camera board, its seat and screws, and the lid over it."""

from typing import TYPE_CHECKING, NamedTuple

from geometries.blocks import Rectangle, disc, grown, slab
from geometries.housing import Housing, Seats
from geometries.mesh import solids

if TYPE_CHECKING:
    import cadquery

Box = tuple[float, float, float, float, float]

BESIDE_LENS_MM = 0.3
LID_WALL_MM, LID_TOP_MM, LID_AIR_MM = 2.0, 1.6, 0.8
TONGUE_MM, TONGUE_HEIGHT_MM, GROOVE_MM = 0.8, 1.0, 1.2
POST_MM = 4.4  # width of the lid's posts, which press the camera board down
CHAMFER_MM = 0.5


class CameraBoard(NamedTuple):
    """A camera board about its lens axis (mm), see ``designlab/sensor/data/camera_modules.toml``.

    The board's lens side is the plane 0; `base_mm` is the width of the lens's square base, `barrel_mm` the
    diameter of what reaches beyond it, `lens_height_mm` where that ends, `pupil_mm` the height of the
    entrance pupil. Boxes are (x from, x to, y from, y to, height). `ribbon_mm` is width, thickness and height
    of the cable behind the board; it leaves towards -y. `raw_bits` are those of a pixel of raw pictures.
    """

    name: str
    title: str
    number: str
    sources: tuple[str, ...]
    board_mm: Rectangle
    thickness_mm: float
    holes_mm: tuple[tuple[float, float], ...]
    hole_diameter_mm: float
    base_mm: float
    base_height_mm: float
    barrel_mm: float
    lens_height_mm: float
    pupil_mm: float
    front: tuple[Box, ...]
    back: tuple[Box, ...]
    ribbon_mm: tuple[float, float, float]
    raw_bits: int
    assumed: tuple[str, ...]


class Fastener(NamedTuple):
    """A screw and what it goes into (mm), see ``designlab/sensor/data/fasteners.toml``."""

    title: str
    insert_title: str
    thread_mm: float
    clearance_mm: float
    tap_mm: float
    head_mm: float
    head_height_mm: float
    insert_hole_mm: float
    insert_length_mm: float
    lengths_mm: tuple[float, ...]
    assumed: tuple[str, ...]


class Mount(NamedTuple):
    """A camera board in its place: the lens axis and the height of the board's lens side (mm)."""

    x_mm: float
    y_mm: float
    seat_mm: float
    board: CameraBoard
    fastener: Fastener


def camera_seat(
    block: "cadquery.Workplane", housing: Housing, mount: Mount, gap: float
) -> "cadquery.Workplane":
    """Cut room for lens, parts, screws and the lid's tongue into the head."""
    board, seat = mount.board, mount.seat_mm
    half = board.base_mm / 2 + BESIDE_LENS_MM
    floor = seat - board.base_height_mm - BESIDE_LENS_MM
    block = block.cut(slab(_placed((-half, half, -half, half), mount), floor, seat + 1))
    barrel = disc(board.barrel_mm / 2 + BESIDE_LENS_MM, seat - board.lens_height_mm - BESIDE_LENS_MM, seat)
    block = block.cut(barrel.translate((mount.x_mm, mount.y_mm, 0)))
    block = block.cut(disc(housing.camera_hole_mm / 2, housing.top_mm - 1, floor))
    for x0, x1, y0, y1, height in board.front:
        room = grown(_placed((x0, x1, y0, y1), mount), BESIDE_LENS_MM)
        block = block.cut(slab(room, seat - height - BESIDE_LENS_MM, seat + 1))
    assert housing.seats is not None
    diameter, depth = screw_hole_mm(housing.seats, mount)
    for x, y in screw_places(mount):
        block = block.cut(disc(diameter / 2, seat - depth, seat + 1).translate((x, y, 0)))
    middle = grown(lid_outline(mount, gap), -LID_WALL_MM / 2)
    groove = slab(grown(middle, TONGUE_MM / 2 + gap), seat - GROOVE_MM, seat + 1)
    groove = groove.cut(slab(grown(middle, -TONGUE_MM / 2 - gap), seat - GROOVE_MM - 1, seat + 2))
    return block.cut(groove)


def screw_places(mount: Mount) -> list[tuple[float, float]]:
    """Axes of the screws through lid and camera board (mm)."""
    return [(mount.x_mm + x, mount.y_mm + y) for x, y in mount.board.holes_mm]


def screw_hole_mm(seats: Seats, mount: Mount) -> tuple[float, float]:
    """Diameter and depth of a hole that a screw goes into."""
    fastener = mount.fastener
    if seats.fastening == "insert":
        return fastener.insert_hole_mm, fastener.insert_length_mm + 0.5
    return fastener.tap_mm, fastener.insert_length_mm + 0.5


def lid_top_mm(mount: Mount) -> float:
    """Height of the lid's outer face."""
    tallest = max((height for *_, height in mount.board.back), default=0.0)
    return mount.seat_mm + mount.board.thickness_mm + tallest + LID_AIR_MM + LID_TOP_MM


def lid(housing: Housing, mount: Mount) -> "cadquery.Workplane":
    """Lid over the camera board: a cap with a tongue, posts around its screws and a slot for the ribbon."""
    assert housing.seats is not None
    gap, seat, board = housing.seats.gap_mm, mount.seat_mm, mount.board
    top, outline = lid_top_mm(mount), lid_outline(mount, gap)
    cap = slab(outline, seat, top).edges("|Z").fillet(1.5).faces(">Z").chamfer(CHAMFER_MM)
    cap = cap.cut(slab(grown(outline, -LID_WALL_MM), seat - 1, top - LID_TOP_MM))
    middle = grown(outline, -LID_WALL_MM / 2)
    tongue = slab(grown(middle, TONGUE_MM / 2), seat - TONGUE_HEIGHT_MM, seat + 0.2)
    tongue = tongue.cut(slab(grown(middle, -TONGUE_MM / 2), seat - TONGUE_HEIGHT_MM - 1, seat + 1))
    cap = cap.union(tongue)
    bottom = seat + board.thickness_mm
    for x, y in screw_places(mount):
        # A post reaches into the wall beside it.
        half = POST_MM / 2
        from_x, to_x = (x - half, outline[1] - LID_WALL_MM / 2)
        if x < mount.x_mm:
            from_x, to_x = outline[0] + LID_WALL_MM / 2, x + half
        cap = cap.union(slab((from_x, to_x, y - half, y + half), bottom, top - LID_TOP_MM / 2))
    for x, y in screw_places(mount):
        cap = cap.cut(disc(mount.fastener.clearance_mm / 2, seat - 1, top + 1).translate((x, y, 0)))
    width, thickness, height = board.ribbon_mm
    high = bottom + height + thickness / 2 + gap
    slot = (
        mount.x_mm - width / 2 - gap,
        mount.x_mm + width / 2 + gap,
        outline[2] - 1,
        outline[2] + LID_WALL_MM + 0.5,
    )
    # Open at the joint: the ribbon is laid in before the lid comes down.
    return cap.cut(slab(slot, seat - TONGUE_HEIGHT_MM - 1, high)).solids()


def camera_solid(mount: Mount) -> "cadquery.Workplane":
    """Camera board at its place: board with holes, lens, and the boxes on both sides."""
    board, seat = mount.board, mount.seat_mm
    back = seat + board.thickness_mm
    work = slab(_placed(board.board_mm, mount), seat, back)
    half = board.base_mm / 2
    work = work.union(slab(_placed((-half, half, -half, half), mount), seat - board.base_height_mm, seat))
    barrel = disc(board.barrel_mm / 2, seat - board.lens_height_mm, seat)
    work = work.union(barrel.translate((mount.x_mm, mount.y_mm, 0)))
    for x0, x1, y0, y1, height in board.front:
        work = work.union(slab(_placed((x0, x1, y0, y1), mount), seat - height, seat))
    for x0, x1, y0, y1, height in board.back:
        work = work.union(slab(_placed((x0, x1, y0, y1), mount), back, back + height))
    for x, y in screw_places(mount):
        work = work.cut(disc(board.hole_diameter_mm / 2, seat - 1, back + 1).translate((x, y, 0)))
    return work.solids()


def screw_solids(seats: Seats, mount: Mount, length_mm: float) -> "list[cadquery.Solid]":
    """Screws at their places: cap heads on the lid, shanks as thick as what they go into is drawn."""
    fastener, top = mount.fastener, lid_top_mm(mount)
    shank = fastener.thread_mm if seats.fastening == "insert" else fastener.tap_mm
    found: list[cadquery.Solid] = []
    for x, y in screw_places(mount):
        screw = disc(fastener.head_mm / 2, top, top + fastener.head_height_mm)
        screw = screw.union(disc(shank / 2, top - length_mm, top))
        found += solids(screw.translate((x, y, 0)))
    return found


def insert_solids(mount: Mount) -> "list[cadquery.Solid]":
    """Threaded inserts at their places, as wide as their holes: they are melted in."""
    fastener, seat = mount.fastener, mount.seat_mm
    found: list[cadquery.Solid] = []
    for x, y in screw_places(mount):
        insert = disc(fastener.insert_hole_mm / 2, seat - fastener.insert_length_mm, seat)
        insert = insert.cut(disc(fastener.thread_mm / 2, seat - fastener.insert_length_mm - 1, seat + 1))
        found += solids(insert.translate((x, y, 0)))
    return found


def lid_outline(mount: Mount, gap: float) -> Rectangle:
    """Outside of the lid: around the camera board, with room for its gap and the lid's wall."""
    return grown(_placed(mount.board.board_mm, mount), gap + LID_WALL_MM)


def _placed(box: Rectangle, mount: Mount) -> Rectangle:
    """A rectangle (x from, x to, y from, y to) about the lens axis in the sensor frame."""
    return box[0] + mount.x_mm, box[1] + mount.x_mm, box[2] + mount.y_mm, box[3] + mount.y_mm
