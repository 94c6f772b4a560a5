"""Commands for the first hour: doctor, init, demo."""

import json
import re
from argparse import Namespace
from importlib import resources
from pathlib import Path

from designlab.app.cli.console import DONE, FAILED, Result
from designlab.core.progress import IN_PERCENT, bar


def doctor(args: Namespace) -> Result:
    """Examine the machine."""
    from designlab.app.doctor import doctor as examine
    from designlab.app.doctor import render_text

    with bar() as progress:
        report = examine(progress=progress)
    return Result(report, render_text(report), DONE if report["ok"] else FAILED)


def init(args: Namespace) -> Result:
    """Write a starter folder."""
    from designlab.core.store import atomic_folder, write_atomic
    from designlab.sensor.design import preset_text

    target = Path(args.folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise ValueError(f"{target}: already exists; choose a new folder. Nothing was overwritten")
    contents = {Path("design.toml"): _named(preset_text(args.preset), target.resolve().name, args.preset)}
    with resources.as_file(resources.files("designlab.app").joinpath("templates")) as templates:
        for path in templates.rglob("*"):
            if path.is_file():
                contents[path.relative_to(templates)] = path.read_bytes()
    with atomic_folder(target) as folder:
        for name, content in contents.items():
            write_atomic(folder / name, content)
    files = sorted(name.as_posix() for name in contents)
    lines = [f"{target}:", *(f"  {file}" for file in files), f"next: read {target / 'README.md'}"]
    return Result({"folder": str(target), "files": files}, "\n".join(lines))


def _named(text: str, name: str, parent: str) -> bytes:
    """TOML of a preset under a name of its own."""
    own = f'name = {json.dumps(name, ensure_ascii=False)}\nparent = "{parent}"  # the preset it was made from'
    return re.sub(r"^name = .*$", lambda _: own, text, count=1, flags=re.MULTILINE).encode()


def demo(args: Namespace) -> Result:
    """Run the main job end to end."""
    from designlab.app.demo import demo as run

    with bar(form=IN_PERCENT) as progress:
        done = run(args.out, seed=args.seed, progress=progress)
    return Result(done.to_json(), done.text)
