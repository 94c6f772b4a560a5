"""The state of a tab as the query of its address, so that a reload loses nothing."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple
from urllib.parse import parse_qsl, urlencode

from designlab.simulation.contact.press import Press

VIEWS = ("design", "study", "gap", "reconstruct")
LONGEST = 16_000  # characters of a query


class Address(NamedTuple):
    """What an address states.

    Attributes
    ----------
    design : str
        Preset or file.
    edits, pin : mapping of str to Any
        Changed fields of the design and of the pinned one; `pin` is None where nothing is pinned.
    press : mapping of str to str
        Texts of the press by field.
    view, folder : str
        View that is shown, and the folder of its study or diagnosis.
    """

    design: str = ""
    edits: Mapping[str, Any] = {}
    press: Mapping[str, str] = {}
    pin: Mapping[str, Any] | None = None
    view: str = "design"
    folder: str = ""


def query_of(address: Address) -> str:
    """Query of an address, without the question mark."""
    pairs: list[tuple[str, str]] = []
    if address.view != "design":
        pairs.append(("view", address.view))
    if address.folder:
        pairs.append(("folder", address.folder))
    if address.design:
        pairs.append(("design", address.design))
    pairs += [("set", _pair(path, value)) for path, value in address.edits.items()]
    pairs += list(address.press.items())
    if address.pin is not None:
        pairs.append(("pin", ""))
        pairs += [("pin", _pair(path, value)) for path, value in address.pin.items()]
    return urlencode(pairs, safe=":,./[]\"'{}")


def address_of(query: str) -> Address:
    """What a query states; what cannot be read is left out."""
    edits: dict[str, Any] = {}
    pin: dict[str, Any] | None = None
    press: dict[str, str] = {}
    found: dict[str, str] = {}
    for name, text in parse_qsl(query[:LONGEST], keep_blank_values=True):
        if name == "set":
            edits |= _read(text)
        elif name == "pin":
            pin = (pin or {}) | _read(text)
        elif name in ("probe", "depth_mm", "force_n", "at", "yaw_deg"):
            press[name] = text
        elif name in ("design", "view", "folder"):
            found[name] = text
    view = found.get("view", "design")
    return Address(
        design=found.get("design", ""),
        edits=edits,
        press=press,
        pin=pin,
        view=view if view in VIEWS else "design",
        folder=found.get("folder", ""),
    )


def press_texts(press: Press) -> dict[str, str]:
    """Texts of a press by field, as the command line and the address write them."""
    found = {"probe": press.probe.text}
    for name in ("depth_mm", "force_n"):
        if (value := getattr(press, name)) is not None:
            found[name] = f"{value:.6g}"
    found["at"] = ",".join(f"{value:.6g}" for value in press.centre_mm)
    if press.yaw_deg:
        found["yaw_deg"] = f"{press.yaw_deg:.6g}"
    return found


def _pair(path: str, value: Any) -> str:
    return f"{path}={json.dumps(value, separators=(',', ':'))}"


def _read(text: str) -> dict[str, Any]:
    path, equals, value = text.partition("=")
    if not equals:
        return {}
    try:
        return {path: json.loads(value)}
    except (ValueError, RecursionError):
        return {}
