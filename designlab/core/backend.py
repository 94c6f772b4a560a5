"""Choice of the Mitsuba variant this machine can run.

The order of preference is CUDA, LLVM, scalar. A wrong choice would end the Python process, not raise an
exception, so a just-in-time back end is chosen only after a small scene was rendered with it in a process of
its own. That proof is remembered in the user's cache folder; later starts do not repeat it.

Environment variables: ``DESIGNLAB_VARIANT`` demands one of `VARIANTS`, ``DRJIT_LIBLLVM_PATH`` names the LLVM
library to try first.
"""

import contextlib
import hashlib
import importlib.metadata
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from designlab.core import llvm, store
from designlab.core.interrupts import held

VARIANTS = ("cuda_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
"""Mitsuba variants that designlab uses, best first."""

VARIANT_VARIABLE = "DESIGNLAB_VARIANT"
"""Environment variable that demands one of `VARIANTS`."""

_PROOF_TIMEOUT_S = 180

# A sphere in front of an emitter: geometry, sampling, a material and the film all take part.
_PROOF_PROGRAM = """
import sys
import mitsuba as mi
mi.set_variant(sys.argv[1])
import numpy as np
scene = mi.load_dict({
    "type": "scene",
    "integrator": {"type": "path"},
    "light": {"type": "constant"},
    "ball": {"type": "sphere", "bsdf": {"type": "roughplastic"}},
    "sensor": {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 4], target=[0, 0, 0], up=[0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
        "sampler": {"type": "ldsampler"},
    },
})
image = np.array(mi.render(scene, spp=4))
assert np.isfinite(image).all() and image.mean() > 0
"""

_CUDA_PROGRAM = """
import ctypes
cuda = ctypes.CDLL("libcuda.so.1")
count, driver = ctypes.c_int(), ctypes.c_int()
assert cuda.cuInit(0) == 0 and cuda.cuDeviceGetCount(ctypes.byref(count)) == 0
assert cuda.cuDriverGetVersion(ctypes.byref(driver)) == 0
print("driver", driver.value)
for index in range(count.value):
    device, name = ctypes.c_int(), ctypes.create_string_buffer(256)
    assert cuda.cuDeviceGet(ctypes.byref(device), index) == 0
    assert cuda.cuDeviceGetName(name, 256, device) == 0
    print(name.value.decode())
"""


@dataclass(frozen=True)
class Backend:
    """A Mitsuba variant and why it was chosen.

    Parameters
    ----------
    variant : str
        One of `VARIANTS`.
    llvm_path : str, optional
        The LLVM library Dr.Jit is to load; present with ``llvm_ad_rgb``.
    llvm_version : str, optional
        Its version, ``major.minor.patch``.
    reason : str
        One line for people: what was found and what was not.
    threads : int
        Number of processor cores this process may use.
    """

    variant: str
    llvm_path: str | None
    llvm_version: str | None
    reason: str
    threads: int

    @property
    def is_jit(self) -> bool:
        """Whether kernels are compiled: vectorised, and with gradients."""
        return self.variant != "scalar_rgb"


@cache
def choose() -> Backend:
    """Choose the fastest variant that is proven to work here, without loading Mitsuba.

    Returns
    -------
    Backend

    Raises
    ------
    ValueError
        When ``DESIGNLAB_VARIANT`` names an unknown variant, or one this machine cannot run.
    """
    demanded = os.environ.get(VARIANT_VARIABLE)
    if demanded and demanded not in VARIANTS:
        raise ValueError(f"{VARIANT_VARIABLE} must be one of {', '.join(VARIANTS)}, got {demanded!r}")
    reasons: list[str] = []
    if demanded:
        reasons.append(f"{VARIANT_VARIABLE} demands {demanded}")
    if demanded in (None, "", "cuda_ad_rgb"):
        usable, reason = _try_cuda()
        reasons.append(reason)
        if usable:
            return _backend("cuda_ad_rgb", None, reasons)
    if demanded in (None, "", "llvm_ad_rgb"):
        library, reason = _try_llvm()
        reasons.append(reason)
        if library:
            return _backend("llvm_ad_rgb", library, reasons)
    if demanded and demanded != "scalar_rgb":
        raise ValueError(f"{VARIANT_VARIABLE} demands {demanded}, which cannot run here: {reasons[-1]}")
    return _backend("scalar_rgb", None, reasons)


@cache
def activate() -> Backend:
    """Load Mitsuba and set the chosen variant, once.

    Returns
    -------
    Backend
        What `choose` returned.
    """
    backend = choose()
    if backend.llvm_path:
        os.environ[llvm.LIBRARY_VARIABLE] = backend.llvm_path
    with held():
        import mitsuba

        mitsuba.set_variant(backend.variant)
    return backend


@cache
def cuda_devices() -> tuple[str, ...]:
    """Return the driver version and then the name of each CUDA device; empty where CUDA cannot start."""
    # starting the driver takes up to a second: not tried where there is no device file (WSL has /dev/dxg)
    if not any(map(os.path.exists, ("/dev/nvidiactl", "/dev/nvidia0", "/dev/dxg"))):
        return ()
    try:
        answer = run_apart(_CUDA_PROGRAM, timeout_s=60)
    except (OSError, subprocess.TimeoutExpired):
        return ()
    return tuple(answer.stdout.splitlines()) if answer.returncode == 0 else ()


def run_apart(
    program: str, *arguments: str, timeout_s: float, setting: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a Python program in a process of its own, so that a crash stays there.

    Parameters
    ----------
    program : str
        Source text.
    *arguments : str
        Its ``sys.argv[1:]``.
    timeout_s : float
        Time limit in seconds.
    setting : mapping, optional
        Environment variables to add.

    Returns
    -------
    subprocess.CompletedProcess
        With exit status, standard output and standard error.

    Raises
    ------
    OSError
        When no process can be started.
    subprocess.TimeoutExpired
        When the limit is reached; the process is ended.
    """
    return subprocess.run(
        [sys.executable, "-P", "-c", program, *arguments],
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        env={**os.environ, **(setting or {})},
    )


def cache_folder() -> Path:
    """Return the folder where proofs are remembered; it may not exist yet."""
    return store.cache_dir() / "backend"


def _backend(variant: str, library: llvm.Library | None, reasons: list[str]) -> Backend:
    return Backend(
        variant=variant,
        llvm_path=library.path if library else None,
        llvm_version=library.version_text if library else None,
        reason="; ".join(reasons),
        threads=usable_cores(),
    )


def usable_cores() -> int:
    """Return the number of cores this process may run on, which a container can restrict."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _try_cuda() -> tuple[bool, str]:
    """Say whether CUDA works, and the reason."""
    found = cuda_devices()
    if len(found) < 2:
        return False, "no CUDA device"
    record = _proof_record("cuda_ad_rgb", *found)
    if not _recall(record):
        problem = _prove("cuda_ad_rgb")
        if problem:
            return False, f"{found[1]}: {problem}"
        _remember(record, found[1])
    return True, f"{found[1]} renders a test scene"


def _try_llvm() -> tuple[llvm.Library | None, str]:
    """Return the first LLVM library that works, and the reason."""
    complaints: list[str] = []
    for path, origin in _libraries_to_try():
        library = _proven_library(path)
        if library.problem is None:
            return library, "; ".join([*complaints, f"LLVM {library.version_text} renders a test scene"])
        complaints.append(f"{origin}{path}: {library.problem}")
    return None, "; ".join([f"no usable LLVM {llvm.OLDEST_USABLE} or newer", *complaints])


def _libraries_to_try() -> Iterator[tuple[str, str]]:
    """Yield library paths, the one the user names first, each with where its name comes from."""
    named = os.environ.get(llvm.LIBRARY_VARIABLE)
    if named:
        yield named, f"{llvm.LIBRARY_VARIABLE} = "
    for path in llvm.candidate_paths():
        if not named or path != os.path.realpath(named):
            yield path, ""


def _proven_library(path: str) -> llvm.Library:
    """Examine a library and render with it, or recall that both went well before."""
    record = None
    if os.path.isfile(path):
        stamp = os.stat(path)
        record = _proof_record("llvm_ad_rgb", path, stamp.st_mtime_ns, stamp.st_size)
        remembered = re.fullmatch(r"(\d+)\.(\d+)\.(\d+)", _recall(record))
        if remembered:
            major, minor, patch = map(int, remembered.groups())
            return llvm.Library(path, (major, minor, patch), None)
    library = llvm.examine(path)
    if library.problem is None:
        problem = _prove("llvm_ad_rgb", llvm_path=path)
        if problem:
            return replace(library, problem=problem)
        if record and library.version_text:
            _remember(record, library.version_text)
    return library


def _prove(variant: str, *, llvm_path: str | None = None) -> str | None:
    """Render a test scene in a process of its own; return what went wrong, or nothing."""
    setting = {llvm.LIBRARY_VARIABLE: llvm_path} if llvm_path else {}
    try:
        answer = run_apart(_PROOF_PROGRAM, variant, setting=setting, timeout_s=_PROOF_TIMEOUT_S)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the test scene could not be rendered: {error}"
    if answer.returncode == 0:
        return None
    lines = answer.stderr.strip().splitlines() or [f"exit status {answer.returncode}"]
    complaint = next((line for line in lines if "LLVM ERROR" in line), lines[-1])
    return f"fails to render a test scene ({complaint[:200]})"


def _proof_record(*key: object) -> Path:
    """Return the file that says that what `key` describes was proven with the engine installed now."""
    engine = tuple(importlib.metadata.version(name) for name in ("mitsuba", "drjit"))
    digest = hashlib.sha256(repr((key, engine, _PROOF_PROGRAM)).encode()).hexdigest()
    return cache_folder() / f"{digest[:32]}.txt"


def _recall(record: Path) -> str:
    """Return what a record says; nothing where there is none or it cannot be read."""
    try:
        return record.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""


def _remember(record: Path, text: str) -> None:
    """Write a record whole or not at all; without a writable cache the next start proves again."""
    with contextlib.suppress(OSError):
        store.write_atomic(record, text)


def installed_version(distribution: str) -> str | None:
    """Return the installed version of a distribution, if any."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None
