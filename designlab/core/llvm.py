"""LLVM libraries on this machine, and whether Dr.Jit can use them.

Dr.Jit loads LLVM at run time, and versions below 17 end the whole Python process at the first kernel
(``LLVM ERROR: Cannot select: ... fminimum``). So every library is examined in a process of its own, and
nothing here loads one into the calling process.
"""

import glob
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

OLDEST_USABLE = 17
"""First major version of LLVM that knows the instructions Dr.Jit emits."""

LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Environment variable by which Dr.Jit is told which library to load."""

FOLDERS = (
    "/usr/lib/llvm-*/lib",
    "/usr/lib/*-linux-gnu",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
    f"{sys.prefix}/lib",
)
"""Folders (as glob patterns) where Linux distributions, Homebrew and Conda put the library."""

_FILE_NAME = re.compile(r"libLLVM(-\d+(\.\d+)*)?\.(so(\.\d+)*|dylib)")

# LLVMGetVersion appeared in LLVM 16; any LLVM has LLVMContextCreate.
_VERSION_PROGRAM = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
library.LLVMContextCreate
if hasattr(library, "LLVMGetVersion"):
    numbers = [ctypes.c_uint() for _ in range(3)]
    library.LLVMGetVersion(*map(ctypes.byref, numbers))
    print(*(number.value for number in numbers))
else:
    print("old")
"""


@dataclass(frozen=True)
class Library:
    """An LLVM shared library and what is known of it.

    Parameters
    ----------
    path : str
        File, or a bare name for the dynamic loader to find.
    version : tuple of int, optional
        Major, minor and patch number; absent below LLVM 16, which cannot tell, and where loading failed.
    problem : str, optional
        Why Dr.Jit cannot use the library; absent when its version is recent enough.
    """

    path: str
    version: tuple[int, int, int] | None
    problem: str | None

    @property
    def version_text(self) -> str | None:
        """Version as ``major.minor.patch``."""
        return ".".join(map(str, self.version)) if self.version else None


def candidate_paths() -> list[str]:
    """Return the files that are named like an LLVM library, in the usual places.

    Returns
    -------
    list of str
        Resolved, each once; the one with the highest version in its name first.
    """
    found = _paths_known_to_loader()
    for folder in FOLDERS:
        found += glob.glob(f"{folder}/libLLVM*")
    named = (path for path in found if _FILE_NAME.fullmatch(Path(path).name))
    resolved = {os.path.realpath(path) for path in named if os.path.isfile(path)}
    return sorted(resolved, key=lambda path: (_version_in_name(path), path), reverse=True)


def examine(path: str) -> Library:
    """Read the version of one LLVM library, in a process of its own.

    Parameters
    ----------
    path : str
        File, or a bare name for the dynamic loader to find.

    Returns
    -------
    Library
        With its ``problem`` named where the file is missing, is no LLVM library, or is too old.
    """
    if os.sep in path and not os.path.isfile(path):
        return Library(path, None, "no such file")
    try:
        answer = subprocess.run(
            [sys.executable, "-I", "-S", "-c", _VERSION_PROGRAM, path],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        return Library(path, None, f"could not be examined: {error}")
    if answer.returncode != 0:
        return Library(path, None, "not a loadable LLVM library")
    words = answer.stdout.split()
    if len(words) != 3:
        return Library(path, None, f"LLVM 15 or older, needs {OLDEST_USABLE} or newer")
    version = (int(words[0]), int(words[1]), int(words[2]))
    if version[0] < OLDEST_USABLE:
        return Library(path, version, f"LLVM {version[0]}, needs {OLDEST_USABLE} or newer")
    return Library(path, version, None)


def _version_in_name(path: str) -> tuple[int, ...]:
    """Return the numbers of a file name: (19, 1) for ``libLLVM.so.19.1``."""
    return tuple(map(int, re.findall(r"\d+", Path(path).name)))


def _paths_known_to_loader() -> list[str]:
    """Return the library paths in the dynamic loader's cache; none where there is no such cache."""
    command = [shutil.which("ldconfig") or "/sbin/ldconfig", "-p"]
    try:
        listing = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False).stdout
    except (OSError, subprocess.TimeoutExpired):
        return []
    return re.findall(r"=> (\S*/libLLVM\S*)$", listing, flags=re.MULTILINE)
