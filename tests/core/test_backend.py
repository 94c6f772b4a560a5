"""Choice of the back end, with the LLVM libraries of this machine and with files that are none.

Each choice is made in a process of its own: the environment is read once per process, and a wrong choice
would end the process.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from designlab.core import llvm
from designlab.core.backend import VARIANTS, Backend
from tests import ROOT

pytestmark = pytest.mark.renders

# Chooses with the libraries found in sys.argv[1] only, renders, and tells the result.
PROGRAM = """
import dataclasses, json, sys
from designlab.core import backend, llvm
if len(sys.argv) > 1:
    llvm.FOLDERS = (sys.argv[1],)
    llvm._paths_known_to_loader = lambda: []
backend.cuda_devices = lambda: ()
chosen = backend.choose()
loaded_early = "mitsuba" in sys.modules
backend.activate()
import mitsuba as mi
ball = mi.load_dict({"type": "scene", "light": {"type": "constant"}, "ball": {"type": "sphere"}})
image = mi.render(ball, integrator=mi.load_dict({"type": "direct"}), sensor=mi.load_dict({
    "type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4},
    "to_world": mi.ScalarTransform4f().look_at([0, 0, 9], [0, 0, 0], [0, 1, 0])}), spp=4)
print(json.dumps({**dataclasses.asdict(chosen), "loaded_early": loaded_early,
                  "set": mi.variant(), "shape": list(image.shape)}))
"""


def run_choice(cache: Path, *folders: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    inherited = {k: v for k, v in os.environ.items() if k not in ("DESIGNLAB_VARIANT", llvm.LIBRARY_VARIABLE)}
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, *map(str, folders)],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=ROOT,
        env={**inherited, "XDG_CACHE_HOME": str(cache), **environment},
        check=False,
    )


def choice(cache: Path, *folders: Path, **environment: str) -> dict[str, object]:
    answer = run_choice(cache, *folders, **environment)
    assert answer.returncode == 0, answer.stderr
    result = json.loads(answer.stdout)
    assert not result["loaded_early"]
    assert result["set"] == result["variant"]
    assert result["shape"] == [4, 4, 3]
    return result


def installed(*, usable: bool) -> list[str]:
    return [path for path in llvm.candidate_paths() if (llvm.examine(path).problem is None) == usable]


@pytest.fixture
def usable_library() -> str:
    found = installed(usable=True)
    if not found:
        pytest.skip("no LLVM 17 or newer on this machine")
    return found[0]


@pytest.fixture
def old_library() -> str:
    found = installed(usable=False)
    if not found:
        pytest.skip("no LLVM older than 17 on this machine")
    return found[0]


@pytest.fixture
def fake_library(tmp_path: Path) -> Path:
    folder = tmp_path / "fake"
    folder.mkdir()
    path = folder / "libLLVM.so"
    path.write_text("this is a text file\n")
    return path


def compile_library(path: Path, source: str) -> None:
    compiler = shutil.which("cc")
    if not compiler:
        pytest.skip("no C compiler")
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-x", "c", "-", "-o", str(path)], input=source, text=True, check=True
    )


def test_scalar_without_any_library(tmp_path: Path) -> None:
    result = choice(tmp_path, tmp_path)
    assert result["variant"] == "scalar_rgb"
    assert "no usable LLVM 17 or newer" in str(result["reason"])


def test_text_file_named_like_a_library_is_refused(tmp_path: Path, fake_library: Path) -> None:
    result = choice(tmp_path, fake_library.parent)
    assert result["variant"] == "scalar_rgb"
    assert f"{fake_library}: not a loadable LLVM library" in str(result["reason"])


def test_old_library_named_by_the_user_is_refused(tmp_path: Path, old_library: str) -> None:
    result = choice(tmp_path, tmp_path, DRJIT_LIBLLVM_PATH=old_library)
    assert result["variant"] == "scalar_rgb"
    assert f"DRJIT_LIBLLVM_PATH = {old_library}: LLVM" in str(result["reason"])
    assert "needs 17 or newer" in str(result["reason"])


def test_old_library_named_by_the_user_gives_way_to_a_usable_one(
    tmp_path: Path, old_library: str, usable_library: str
) -> None:
    result = choice(tmp_path, Path(usable_library).parent, DRJIT_LIBLLVM_PATH=old_library)
    assert result["variant"] == "llvm_ad_rgb"
    assert result["llvm_path"] == usable_library
    assert f"DRJIT_LIBLLVM_PATH = {old_library}" in str(result["reason"])


def test_missing_file_named_by_the_user_is_said(tmp_path: Path) -> None:
    result = choice(tmp_path, tmp_path, DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so")
    assert result["variant"] == "scalar_rgb"
    assert "DRJIT_LIBLLVM_PATH = /nowhere/libLLVM.so: no such file" in str(result["reason"])


def test_usable_library_named_by_the_user_is_taken(tmp_path: Path, usable_library: str) -> None:
    result = choice(tmp_path, tmp_path, DRJIT_LIBLLVM_PATH=usable_library)
    assert result["variant"] == "llvm_ad_rgb"
    assert result["llvm_path"] == usable_library
    version = llvm.examine(usable_library).version_text
    assert result["llvm_version"] == version


def test_library_that_lies_about_its_version_fails_the_proof(tmp_path: Path) -> None:
    folder = tmp_path / "lying"
    folder.mkdir()
    path = folder / "libLLVM.so.19.1"
    compile_library(
        path,
        "void LLVMContextCreate(void) {}\n"
        "void LLVMGetVersion(unsigned *a, unsigned *b, unsigned *c) { *a = 19; *b = 1; *c = 0; }\n",
    )
    result = choice(tmp_path / "cache", folder)
    assert result["variant"] == "scalar_rgb"
    assert f"{path}: fails to render a test scene" in str(result["reason"])
    assert not list((tmp_path / "cache").rglob("*.txt"))


def test_proof_is_remembered_until_the_library_changes(tmp_path: Path, usable_library: str) -> None:
    library = tmp_path / "lib" / "libLLVM.so.99"
    library.parent.mkdir()
    shutil.copy(usable_library, library)
    first = choice(tmp_path / "cache", library.parent)
    assert first["llvm_path"] == str(library)
    records = list((tmp_path / "cache").rglob("*.txt"))
    assert len(records) == 1
    assert records[0].read_text() == first["llvm_version"]
    os.utime(library, (1, 1))
    choice(tmp_path / "cache", library.parent)
    assert len(list((tmp_path / "cache").rglob("*.txt"))) == 2


def test_unwritable_cache_is_survived(tmp_path: Path, usable_library: str) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert choice(blocked, Path(usable_library).parent)["variant"] == "llvm_ad_rgb"


def test_variant_can_be_demanded(tmp_path: Path) -> None:
    result = choice(tmp_path, DESIGNLAB_VARIANT="scalar_rgb")
    assert result["variant"] == "scalar_rgb"
    assert result["reason"] == "DESIGNLAB_VARIANT demands scalar_rgb"


@pytest.mark.parametrize(
    ("demanded", "message"),
    [
        ("llvm", f"DESIGNLAB_VARIANT must be one of {', '.join(VARIANTS)}, got 'llvm'"),
        ("cuda_ad_rgb", "DESIGNLAB_VARIANT demands cuda_ad_rgb, which cannot run here: no CUDA device"),
        ("llvm_ad_rgb", "DESIGNLAB_VARIANT demands llvm_ad_rgb, which cannot run here: no usable LLVM 17"),
    ],
)
def test_impossible_demand_is_an_error(tmp_path: Path, demanded: str, message: str) -> None:
    answer = run_choice(tmp_path, tmp_path, DESIGNLAB_VARIANT=demanded)
    assert answer.returncode == 1
    assert f"ValueError: {message}" in answer.stderr


def test_newest_library_is_tried_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (
        "libLLVM-15.so.1",
        "libLLVM.so.22.1",
        "libLLVM.so.9",
        "libLLVMSPIRVLib.so.19.1",
        "libLLVM-9.a",
    ):
        (tmp_path / name).write_text("")
    monkeypatch.setattr(llvm, "FOLDERS", (str(tmp_path),))
    monkeypatch.setattr(llvm, "_paths_known_to_loader", list)
    names = [Path(path).name for path in llvm.candidate_paths()]
    assert names == ["libLLVM.so.22.1", "libLLVM-15.so.1", "libLLVM.so.9"]


def test_fixture_has_set_the_variant(backend: Backend) -> None:
    import mitsuba

    assert mitsuba.variant() == backend.variant
    assert backend.is_jit == (backend.variant != "scalar_rgb")
    assert backend.threads >= 1
