"""The machine check reports what this machine offers designlab, what is missing, and how to get it."""

import contextlib
import os
import platform
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from designlab.core import backend, llvm
from designlab.core.backend import installed_version
from designlab.core.progress import silent
from designlab.core.types import Progress

PACKAGES = (
    "mitsuba",
    "drjit",
    "cadquery",
    "trimesh",
    "numpy",
    "scipy",
    "scikit-image",
    "scikit-learn",
    "pandas",
    "optuna",
    "pydantic",
    "pyvista",
    "matplotlib",
    "plotly",
    "OpenEXR",
    "pymeshlab",
    "rawpy",
)
"""Distributions whose versions are reported; only the last two are optional."""

_OPTIONAL = {"pymeshlab": "repairs and thins meshes; its licence is GPL-3", "rawpy": "reads raw camera files"}

_OFFSCREEN_PROGRAM = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(32, 32))
plotter.add_mesh(pyvista.Sphere(), color="red")
image = plotter.screenshot(return_img=True)
assert image.std() > 0, "the picture is empty"
"""

_OFFSCREEN_TIMEOUT_S = 30


def doctor(*, progress: Progress = silent) -> dict[str, Any]:
    """Examine the machine: nothing here raises, and nothing that may crash runs in this process.

    Parameters
    ----------
    progress : callable, optional
        Called with what is examined, how much of it is done, and of how much.

    Returns
    -------
    dict
        Ready for JSON. ``missing`` lists ``{what, how}``: what limits designlab here, and how to get it;
        ``ok`` is false when something designlab cannot do without is absent.
    """
    with ThreadPoolExecutor() as pool:
        offscreen = pool.submit(_offscreen_problem)
        libraries = pool.submit(lambda: [llvm.examine(path) for path in llvm.candidate_paths()])
        progress("packages and back end", 0, 3)
        versions = {name: installed_version(name) for name in PACKAGES}
        chosen, backend_problem = _chosen_backend()
        progress("off-screen pictures", 1, 3)
        offscreen_problem = offscreen.result()
        progress("libraries of LLVM", 2, 3)
        found = libraries.result()
        progress("machine", 3, 3)
    devices = backend.cuda_devices()
    cache_problem = _unwritable(backend.cache_folder())
    absent = [name for name, version in versions.items() if version is None]
    report: dict[str, Any] = {
        "ok": backend_problem is None and set(absent) <= set(_OPTIONAL),
        "designlab": installed_version("designlab"),
        "python": {"version": platform.python_version(), "executable": sys.executable},
        "platform": platform.platform(),
        "packages": versions,
        "backend": None,
        "llvm_libraries": [
            {"path": library.path, "version": library.version_text, "problem": library.problem}
            for library in found
        ],
        "gpus": list(devices[1:]),
        "threads": backend.usable_cores(),
        "memory_gib": _memory_gib(),
        "offscreen": {"works": offscreen_problem is None, "problem": offscreen_problem},
        "cache": {
            "folder": str(backend.cache_folder()),
            "writable": cache_problem is None,
            "problem": cache_problem,
        },
    }
    missing = []
    if chosen:
        report["backend"] = {
            "variant": chosen.variant,
            "jit": chosen.is_jit,
            "reason": chosen.reason,
            "llvm_path": chosen.llvm_path,
            "llvm_version": chosen.llvm_version,
        }
        if not chosen.is_jit and not os.environ.get(backend.VARIANT_VARIABLE):
            missing.append({"what": "a just-in-time back end (slower, no gradients)", "how": _llvm_advice()})
    if backend_problem:
        missing.append({"what": f"a back end: {backend_problem}", "how": f"unset {backend.VARIANT_VARIABLE}"})
    missing += [{"what": f"package {name}", "how": _package_advice(name)} for name in absent]
    if offscreen_problem:
        missing.append({"what": f"off-screen 3D pictures: {offscreen_problem}", "how": _offscreen_advice()})
    if cache_problem:
        missing.append(
            {"what": f"a cache: {cache_problem}", "how": "set XDG_CACHE_HOME to a writable folder"}
        )
    report["missing"] = missing
    return report


def render_text(report: dict[str, Any]) -> str:
    """Write the report of `doctor` for people.

    Parameters
    ----------
    report : dict
        What `doctor` returned.

    Returns
    -------
    str
        Several lines without a trailing newline.
    """
    chosen = report["backend"]
    memory, cache = report["memory_gib"], report["cache"]
    rows = [
        ("designlab", report["designlab"] or "not installed, used from its source folder"),
        ("python", f"{report['python']['version']} ({report['python']['executable']})"),
        ("platform", report["platform"]),
        ("back end", f"{chosen['variant']} ({chosen['reason']})" if chosen else "none"),
    ]
    for library in report["llvm_libraries"]:
        rows.append(("LLVM", f"{library['path']} ({library['problem'] or library['version']})"))
    rows += [
        ("GPU", ", ".join(report["gpus"]) or "none"),
        ("cores", str(report["threads"])),
        ("memory", f"{memory:.1f} GiB" if memory is not None else "unknown"),
        ("3D pictures", "work" if report["offscreen"]["works"] else "do not work"),
        ("cache", cache["folder"] + ("" if cache["writable"] else " (not writable)")),
        ("packages", ", ".join(f"{name} {version or '-'}" for name, version in report["packages"].items())),
    ]
    lines = [f"{name:<12} {text}" for name, text in rows]
    for entry in report["missing"]:
        lines += [f"missing: {entry['what']}", f"     get it: {entry['how']}"]
    if not report["missing"]:
        lines.append("nothing is missing")
    return "\n".join(lines)


def _chosen_backend() -> tuple[backend.Backend | None, str | None]:
    """Return the back end, or why there is none."""
    if installed_version("mitsuba") is None:
        return None, "Mitsuba is not installed"
    try:
        return backend.choose(), None
    except ValueError as error:
        return None, str(error)


def _offscreen_problem() -> str | None:
    """Draw a sphere with PyVista in a process of its own; return what went wrong, or nothing."""
    try:
        answer = backend.run_apart(_OFFSCREEN_PROGRAM, timeout_s=_OFFSCREEN_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return f"no picture within {_OFFSCREEN_TIMEOUT_S} s"
    except OSError as error:
        return str(error)
    if answer.returncode == 0:
        return None
    return (answer.stderr.strip().splitlines() or [f"exit status {answer.returncode}"])[-1][:200]


def _unwritable(folder: Path) -> str | None:
    """Try to write into a folder; return what went wrong, or nothing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return str(error)


def _memory_gib() -> float | None:
    """Return the memory this process may use in GiB: the machine's, or less in a container."""
    try:
        limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    except (AttributeError, OSError, ValueError):
        return None
    with contextlib.suppress(OSError, ValueError):  # no control group, or one whose limit is "max"
        limits.append(int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return min(limits) / 2**30


def _llvm_advice() -> str:
    """Say how to get LLVM on this system."""
    oldest = llvm.OLDEST_USABLE
    if sys.platform == "darwin":
        return "brew install llvm"
    if Path("/usr/bin/apt-get").exists():
        return f"sudo apt-get install libllvm19 (any libllvm{oldest} or newer)"
    if Path("/usr/bin/dnf").exists():
        return f"sudo dnf install llvm-libs (LLVM {oldest} or newer)"
    return f"install LLVM {oldest} or newer, and set {llvm.LIBRARY_VARIABLE} to its shared library"


def _package_advice(name: str) -> str:
    """Say how to install a missing distribution."""
    note = f" (optional: {_OPTIONAL[name]})" if name in _OPTIONAL else ""
    return f"{sys.executable} -m pip install {name}{note}"


def _offscreen_advice() -> str:
    """Say how to get off-screen OpenGL on this system."""
    if Path("/usr/bin/apt-get").exists():
        return "sudo apt-get install libgl1 libegl1 libosmesa6 libxrender1"
    return "install Mesa's software OpenGL (EGL or OSMesa)"
