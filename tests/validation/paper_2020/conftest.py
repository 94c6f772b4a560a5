"""What experiments would give, made up."""

import pytest

FLAT, DOME = "gelsight-2020-flat", "gelsight-2020-dome"
MODELS = {"light transport": 0.0, "directional, diffuse": 12.0, "directional, Phong": 10.5}


def figures(loss_db, channels=True):
    found = {
        "mse": 1e-5 * 10 ** (loss_db / 10),
        "snr_db": 30.25 - loss_db,
        "smape": 0.04 + 0.01 * loss_db,
        "ssim": 0.95 - 0.02 * loss_db,
        "structure_corr": 0.99 - 0.02 * loss_db,
        "structure_snr_db": 18.0 - loss_db,
    }
    if channels:
        found["channels"] = {name: figures(loss_db + n, False) for n, name in enumerate("RGB")}
    return found


def shares(smooth):
    return {"smooth": smooth, "edges": 0.75 * (1 - smooth), "rest": 0.25 * (1 - smooth)}


def sensor(datasets):
    return {
        "models": {
            name: {
                "frames": [],
                "held_out": {
                    **figures(loss),
                    "error_shares": shares(0.6 if loss else 0.1),
                    "datasets": {
                        number: {**figures(loss + int(number)), "error_shares": shares(0.5)}
                        for number in datasets
                    },
                },
            }
            for name, loss in MODELS.items()
        },
        "pictures": {},
        "interreflected_share": {"R": 0.11, "G": 0.07, "B": 0.09},
        "fit_frames": 2,
        "held_out_frames": 38,
    }


def error(median, largest, count=12):
    return {"median": median, "largest": largest, "count": count}


@pytest.fixture
def result():
    """Of the shape that experiments give; every number is made up."""
    strips = [
        {
            "channel": group,
            "lobe": f"{group} 1",
            "polar_deg": 60.0,
            "azimuth_deg": 90.0,
            "apart_deg": apart_deg,
            "solid_angle_ratio": 1.004,
            "seen_ratio": 1.003,
        }
        for group, apart_deg in (("red", 0.0125), ("green", 0.0375))
    ]
    covered = {"share": 0.95, "count": 300, "by_kind": {"product": {"share": 0.8, "count": 36}}}
    errors = {
        "product": error(0.002, 0.0123, 36),
        "reflectance": error(0.01, 0.05),
        "x_mm": error(0.001, 0.002),
        "y_mm": error(0.001, 0.031),
        "depth_mm": error(0.001, 0.002),
        "yaw_deg": error(0.05, 0.15, 6),
    }
    path = [
        {"px": 600, "samples": 8, "ms": 1234.5, "paper_ms": 95.0, "snr_db": 26.0, "ssim": 0.75},
        {"px": 64, "samples": 8, "ms": 99.0, "paper_ms": None, "snr_db": 26.0, "ssim": 0.75},
    ]
    fast = [{"px": 600, "first_ms": 900.0, "next_ms": 90.0, "snr_db": 40.0, "ssim": 0.99}]
    frame = {"file": "one.exr", "use": "train"}
    frame |= {"before": figures(25.0), "after": figures(8.0), "constant": figures(20.25)}
    transfer = [{"name": "transfer.R.green", "value": 0.3}, {"name": "transfer.G.green", "value": 10.0}]
    return {
        "designlab": "0.0",
        "size": "full",
        "seed": 1,
        "stages": {
            "probe": {"sensor": FLAT, "strips": strips, "unmatched": 0, "picture": "light-map.png"},
            "recovery": {"repeats": 12, "errors": errors, "covered": covered},
            "accuracy": {"sensors": {FLAT: sensor("12"), DOME: sensor("1")}},
            "timing": {
                "device": "a processor <fast>",
                "backend": "llvm_ad_rgb",
                "reference_samples": 256,
                "repeats": 3,
                "path": path,
                "fast": fast,
            },
            "real": {
                "columns": 160,
                "frames": [frame],
                "parameters": transfer,
                "notes": ["one | note"],
                "picture": "residual.png",
            },
        },
    }
