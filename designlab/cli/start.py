"""Commands for the first hour: doctor, init, demo."""

import shutil
from argparse import Namespace
from importlib import resources
from pathlib import Path

from designlab.cli.console import DONE, FAILED, Result


def doctor(args: Namespace) -> Result:
    """Examine the machine."""
    from designlab.doctor import doctor as examine
    from designlab.doctor import render_text

    report = examine()
    return Result(report, render_text(report), DONE if report["ok"] else FAILED)


def init(args: Namespace) -> Result:
    """Write a starter folder."""
    from designlab.store import atomic_folder

    target = Path(args.folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise ValueError(f"{target}: exists already; choose a folder that does not, nothing is overwritten")
    with (
        resources.as_file(resources.files("designlab").joinpath("templates")) as templates,
        atomic_folder(target) as folder,
    ):
        shutil.copytree(templates, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    files = sorted(path.relative_to(target).as_posix() for path in target.rglob("*") if path.is_file())
    lines = [f"{target}:", *(f"  {file}" for file in files), f"next: read {target / 'README.md'}"]
    return Result({"folder": str(target), "files": files}, "\n".join(lines))


def demo(args: Namespace) -> Result:
    """Run the main job end to end."""
    from designlab.demo import demo as run

    found = run(args.out, seed=args.seed)
    return Result(found.to_json(), found.text)
