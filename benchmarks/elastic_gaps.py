"""Sensors whose gel is an elastic layer, diagnosed with a model whose contact is a kernel.

    python benchmarks/elastic_gaps.py [--out FOLDER]

Three sets of the hour kit, 150 pixels wide, come from the generator's own contact: gels of 4, 2.5 and 3.2 mm
with a tight coating. Printed are the truth, the effects that are named with their values, and the share of
the gap that is gone on the final presses. Sets and pictures kept in the folder are used again.
"""

import argparse
import tempfile
from pathlib import Path

from designlab.inference.diagnosis import diagnose
from designlab.measurement import load_measurement
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import preset
from designlab.simulation.effects import UNASKED
from designlab.validation.synthetic import plant

THICK_MM = (4.0, 2.5, 3.2)
TIGHT = {"optics.coating_transmittance": 0.0, "optics.backing_reflectance": None}
COLUMNS, SEED = 150, 11


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, help="folder for sets and pictures (default: a temporary one)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        for number, thickness_mm in enumerate(THICK_MM):
            folder = (args.out or Path(temporary)) / f"{thickness_mm:g}mm"
            elastic = preset("gelsight-2020-flat-elastic").replace(
                {"elastomer.thickness_mm": thickness_mm, **TIGHT}
            )
            if not (folder / "set").exists():
                plant(elastic, effects={}, out=folder / "set", seed=SEED + number, columns=COLUMNS)
            report = diagnose(
                load_measurement(folder / "set"),
                preset("gelsight-2020-flat"),
                out=folder / "diagnosis",
                seed=0,
                catalogue=[*UNASKED, "contact_layer"],
            )
            assert isinstance(elastic.contact, LayerContact)
            print(
                f"gel {thickness_mm:g} mm thick, skin {elastic.contact.skin_length_mm:g} mm: {report.verdict}"
            )
            for found in report.effects:
                values = (f"{name} {value.value:.4g}" for name, value in found.parameters.items())
                print(f"  {found.name}: {', '.join(values)}")
            print(f"  gap gone on final presses {report.gap['final'].removed or 0.0:.1%}", flush=True)


if __name__ == "__main__":
    main()
