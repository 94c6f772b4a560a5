"""How long the studio takes from an event to new pixels, measured in a browser.

python benchmarks/studio_latency.py [--design NAME] [--events N]

Each event is made in the page, and its time is that until the picture that belongs to it has been decoded.
What the machine's own load adds is in wall-clock times, not in the processor time of the worker beside them.
"""

import argparse
import base64
import io
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from designlab.core.images import from_srgb
from designlab.sensor.design import preset
from tests.helpers.studio import FULL, PICTURE_MS, Studio, pages

TARGETS = {
    "mixing": "median at most 60 ms",
    "press, first": "at most 400 ms",
    "press, full": "at most 1500 ms",
    "LED moved, first": "at most 2500 ms",
}
WATCH = """
() => {
  window.seen = [];
  window.addEventListener("studio-picture", async (event) => {
    const image = document.getElementById("picture-now");
    if (event.detail.slot !== "now") return;
    await image.decode().catch(() => null);
    window.seen.push([performance.now(), event.detail.step, image.src]);
  });
}
"""


def processor_s(pid: int) -> float:
    """Processor time of a process (s)."""
    import os

    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def timed(tab, worker: int, event: str, *, until: str) -> tuple[dict[str, float], list[list]]:
    """Milliseconds to the first picture and to the full one, and seconds of the worker's processor."""
    tab.evaluate("window.seen = []")
    before = processor_s(worker)
    start = tab.evaluate(f"() => {{ const now = performance.now(); {event}; return now; }}")
    tab.wait_for_function(f"window.seen.some((each) => {until})", timeout=PICTURE_MS)
    seen = tab.evaluate("window.seen")
    found = {"first": seen[0][0] - start, "cpu_s": processor_s(worker) - before}
    full = [each for each in seen if not each[1].startswith("coarse")]
    if full:
        found["full"] = full[0][0] - start
    return found, seen


def error(first: str, full: str) -> float:
    """Root mean square of the difference of two pictures in linear light, over the mean of the second."""
    from PIL import Image

    pictures = []
    for source in (first, full):
        image = Image.open(io.BytesIO(base64.b64decode(source.partition(",")[2]))).convert("RGB")
        pictures.append(image)
    size = pictures[1].size
    a, b = (from_srgb(np.asarray(each.resize(size, Image.BILINEAR)) / 255) for each in pictures)
    return float(np.sqrt(np.mean((a - b) ** 2)) / b.mean())


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--design", default="default")
    parser.add_argument("--events", type=int, default=100)
    args = parser.parse_args()
    design = preset(args.design)
    results: dict[str, list[float]] = {}
    errors: list[float] = []
    random = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "root"
        folder.mkdir()
        studio = Studio(folder, args.design, "--port", "0")
        with pages(studio) as opened:
            tab = opened()
            (worker,) = studio.children()
            tab.wait_for_function(FULL, timeout=PICTURE_MS)
            tab.evaluate(WATCH)
            time.sleep(2)

            def add(kind: str, found: dict[str, float], *parts: str) -> None:
                for part in parts:
                    if part in found:
                        results.setdefault(f"{kind}, {part}", []).append(found[part])
                results.setdefault(f"{kind}, cpu with what follows (s)", []).append(found["cpu_s"])

            emit = "emitEvent('studio_touch', {place: [%.3f, %.3f], going_on: true})"
            wide = "!each[1].startsWith('coarse')"
            for _ in range(args.events):
                x, y = random.uniform(0.3, 0.7, 2)
                found, seen = timed(tab, worker, emit % (x, y), until=wide)
                add("press", found, "first", "full")
                errors.append(error(seen[0][2], next(s for s in seen if not s[1].startswith("coarse"))[2]))
            tab.get_by_text(f"LED group {design.leds.groups[0].name}").click()
            entry = '[data-path="leds.groups.0.flux_mw"] input'
            tab.wait_for_selector(entry)
            tab.wait_for_timeout(3000)
            write = (
                f"const e = [...document.querySelectorAll('{entry}')].pop(); e.value = '%.3f';"
                "e.dispatchEvent(new Event('input', {bubbles: true}));"
                "e.dispatchEvent(new Event('change', {bubbles: true}))"
            )
            flux = design.leds.groups[0].flux_mw
            for factor in random.uniform(0.5, 1.5, args.events):
                found, _ = timed(tab, worker, write % (flux * factor), until="true")
                add("mixing", found, "first")
            entry = entry.replace("leds.groups.0.flux_mw", "leds.height_mm")
            for offset in random.uniform(-0.5, 0.5, max(3, args.events // 10)):
                told = write.replace("leds.groups.0.flux_mw", "leds.height_mm")
                found, _ = timed(tab, worker, told % (design.leds.height_mm + offset), until="true")
                add("LED moved", found, "first")
        studio.stop()
    rows = {
        kind: {"median": float(np.median(v)), "p95": float(np.percentile(v, 95)), "events": len(v)}
        for kind, v in results.items()
    }
    for kind, row in rows.items():
        unit = "s" if "cpu" in kind else "ms"
        print(
            f"{kind:36} median {row['median']:8.3g} {unit}  95 % {row['p95']:8.3g} {unit}  n={row['events']}"
        )
    print(f"press, first against full: {100 * np.median(errors):.2f} % RMS (target 3 %)")
    print("targets on two quiet cores: " + "; ".join(f"{k}: {v}" for k, v in TARGETS.items()))
    print(json.dumps({"design": args.design, "rows": rows, "press_error": float(np.median(errors))}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
