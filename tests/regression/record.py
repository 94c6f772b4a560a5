"""Record the figures that `test_recorded.py` compares with, or files that `test_written_before.py` reads.

    python -m tests.regression.record                 all cases, into recorded/
    python -m tests.regression.record study plant     these alone
    python -m tests.regression.record --files         planted/ and written_before/ instead

What lies there now was written by the code at commit 3016e41. Record again only where figures are meant to
change, and say in the commit which and why. Files written before are never replaced by those of later code:
that it reads them is what they are for.
"""

import argparse
import gzip
import json
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

from tests.regression import cases

WRITTEN = cases.HERE / "written_before"


def rounded(content: object) -> object:
    """Leave out what is not compared, and digits that are not either."""
    if isinstance(content, dict):
        return {k: rounded(v) for k, v in content.items() if not cases.NOT_COMPARED.fullmatch(k)}
    if isinstance(content, list):
        return [rounded(value) for value in content]
    return float(f"{content:.12g}") if isinstance(content, float) else content


def record(names: list[str]) -> None:
    """Run cases and write what they give."""
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            found = cases.run(name, Path(folder))
        target = cases.RECORDED / f"{name}.json"
        target.parent.mkdir(exist_ok=True)
        target.write_text(json.dumps(rounded(found), indent=0) + "\n", encoding="utf-8")
        print(target.relative_to(cases.HERE), flush=True)


def write_files() -> None:
    """Make the measurement that cases use, and one of each file that commands read again."""
    if WRITTEN.exists():
        raise SystemExit(f"{WRITTEN}: exists; files written before are not replaced")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if not cases.PLANTED.exists():
            cases.plant(folder, cases.FLAT)
            shutil.copytree(folder / "planted", cases.PLANTED)
        cases.command("init", folder / "mine")
        for part in ("one", "three", "study"):
            (folder / part).mkdir()
        cases.phong(folder / "one", cases.FLAT)
        cases.diagnosis(folder / "three", cases.FLAT)
        cases.study(folder / "study", cases.FLAT)
        for name in ("design.toml", "study.toml"):
            _keep(folder / "mine" / name, WRITTEN / name)
        _keep(folder / "one" / "out" / "calibrated.toml", WRITTEN / "phong.toml")
        for name in ("run.json", "report.json", "model.toml"):
            _keep(folder / "three" / "out" / name, WRITTEN / "diagnosis" / name)
        results = folder / "study" / "out"
        for path in results.rglob("*"):
            if path.suffix in (".toml", ".json"):
                _keep(path, WRITTEN / "finished_study" / path.relative_to(results))
        packed = gzip.compress((results / "study.db").read_bytes(), mtime=0)
        (WRITTEN / "finished_study" / "study.db.gz").write_bytes(packed)


def _keep(path: Path, target: Path) -> None:
    """Copy a text file, without the place where it was written."""
    target.parent.mkdir(parents=True, exist_ok=True)
    text = path.read_text(encoding="utf-8")
    target.write_text(re.sub(r'(?<=")/[^"]*/(?=[^/"]+")', "", text), encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(cases.CASES))
    parser.add_argument("--files", action="store_true", help="write files, not figures")
    asked = parser.parse_args()
    if unknown := set(asked.cases) - set(cases.CASES):
        parser.error(f"no such case: {', '.join(unknown)}")
    with tempfile.TemporaryDirectory() as empty:
        os.environ["DESIGNLAB_CACHE"] = empty  # nothing is taken from an earlier run
        sys.exit(write_files() if asked.files else record(asked.cases or list(cases.CASES)))
