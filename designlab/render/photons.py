"""Light traced from the LEDs to the membrane: finds small LEDs behind glass, which paths meet by chance."""

from collections.abc import Callable
from typing import Any

import numpy as np

from designlab.render import bridge, emitters
from designlab.scene import Light, Scene

BATCH = 5_000_000  # photons traced at once; bounds memory
DIMMEST = 1e-3  # photons that lost all but this share of their power are dropped
Record = Callable[[Any, Any, Any, Any, Any], None]


def trace(scene: Scene, *, group: int, photons: int, seed: int, record: Record) -> None:
    """Trace photons of one LED group that emits 1 mW and hand every arrival at the membrane to `record`.

    Parameters
    ----------
    scene : Scene
        Must be loaded on a just-in-time back end.
    group : int
        LED group.
    photons : int
        Number of photons, rounded up to whole batches.
    seed : int
        Seed of the random numbers.
    record : callable
        Called with Dr.Jit arrays: position, direction back towards the light, membrane normal, power (mW)
        and the mask of photons that arrive. It is called while a loop is recorded, so it may only scatter.
    """
    import drjit as dr

    loaded = bridge.load(scene, group=group, integrator={"type": "path"}, samples=4)
    lights = [light for light in scene.lights if light.group == group]
    batches = max(1, round(photons / BATCH))
    size = int(np.ceil(photons / batches))
    for batch in range(batches):
        _batch(loaded, scene, lights, size, batches, _seed(seed, group, batch), record)
        dr.eval()
    dr.sync_thread()


def _batch(
    loaded: Any, scene: Scene, lights: list[Light], size: int, batches: int, seed: int, record: Record
) -> None:
    import drjit as dr
    import mitsuba as mi

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, size)
    ray = emitters.photons(lights, sampler, size)
    membrane = mi.ShapePtr(next(shape for shape in loaded.shapes() if shape.id() == "membrane"))
    context = mi.BSDFContext(mi.TransportMode.Importance)
    # The way from membrane to camera crosses the interface and the window: three segments.
    longest = scene.path_length - (3 if scene.refracts else 1)

    def going(active: Any, *_: Any) -> Any:
        return active

    def step(active: Any, ray: Any, power: Any, depth: Any, sampler: Any) -> Any:
        si = loaded.ray_intersect(ray, active)
        active = active & si.is_valid()
        arrives = active & (si.shape == membrane) & (dr.dot(si.sh_frame.n, ray.d) < 0)
        record(si.p, -ray.d, si.n, power, arrives)
        bsdf = si.bsdf()
        sample, weight = bsdf.sample(context, si, sampler.next_1d(active), sampler.next_2d(active), active)
        power = power * weight.x
        ray = si.spawn_ray(si.to_world(sample.wo))
        depth = depth + 1
        active = active & (power > DIMMEST / (size * batches)) & (depth < longest)
        return active, ray, power, depth, sampler

    dr.while_loop(
        (
            dr.full(mi.Bool, True, size),
            ray,
            dr.full(mi.Float, 1.0 / (size * batches), size),
            dr.zeros(mi.UInt32, size),
            sampler,
        ),
        going,
        step,
        labels=("active", "ray", "power", "depth", "sampler"),
    )


def _seed(seed: int, group: int, batch: int) -> int:
    return int(np.random.SeedSequence([seed, group, batch, 77]).generate_state(1)[0])
