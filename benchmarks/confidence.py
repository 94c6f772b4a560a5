"""Confidence of names with an opened pool added to what it was learnt from.

    python benchmarks/confidence.py RECORDS.jsonl [--write]

Printed is what each confidence becomes. The records must have been made with the confidence that is known
now, of whole kits. `--write` puts the result in its place; records that it holds already are refused.
"""

import argparse
import json
from pathlib import Path

import designlab
from designlab.core.store import read_json
from designlab.inference.diagnosis.likelihood.empirical_errors import FILE, known
from designlab.inference.diagnosis.verdict.confidence import share_right, sum_of
from designlab.validation.blind.learn import with_records

KEPT = Path(designlab.__file__).parent / "inference" / "diagnosis" / "likelihood" / FILE


def main() -> None:
    """Learn, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("records", type=Path)
    parser.add_argument("--write", action="store_true", help=f"to {KEPT.name}")
    args = parser.parse_args()
    held = known()["confidence"].get("records", [])
    if args.records.name in held:
        raise SystemExit(f"{args.records.name}: is part of what is known already")
    try:
        rows = [json.loads(line) for line in args.records.read_text().splitlines()]
        before, after = known()["confidence"], with_records(rows)
    except (OSError, ValueError, KeyError) as error:
        raise SystemExit(f"{args.records}: no records of sets: {error}") from None
    print(f"names: {before['names']} -> {after['names']}")
    for stated in (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, before["right"][-1]):
        total = sum_of(stated, before["scores"], before["right"])
        print(f"{stated:.2f} -> {share_right(total, after['scores'], after['right']):.2f}")
    after["records"] = [*held, args.records.name]
    if args.write:
        KEPT.write_text(json.dumps({**read_json(KEPT), "confidence": after}, indent=2) + "\n")


if __name__ == "__main__":
    main()
