"""The one composition: press, scene, effects, light transport, mixing, camera."""

import base64
import html
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.core.images import png_bytes, tone_map
from designlab.core.types import Array, Mask
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.contact.approach import above_mm, named
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Mechanics, Surface
from designlab.simulation.effects import SensorModel, Sight
from designlab.simulation.imaging import WHOLE, Capture, expected, mixed, through_optics
from designlab.simulation.optics.defocus import radius_px
from designlab.simulation.optics.viewing_rays import Rays, rays
from designlab.simulation.render.estimators import UNBIASED, Bias, Estimator, bias, chosen, trace, traces_lens
from designlab.simulation.render.lightfield import CELL_MM
from designlab.simulation.render.session import SESSION
from designlab.simulation.scene.scene import Scene, build

if TYPE_CHECKING:
    from designlab.simulation.render.shading import Shader

SURFACE_MARGIN_MM = 2.0  # the membrane is modelled finely this far beyond the area in view
OUTSIDE_SHARE = 1.0  # of the gel's diagonal, from its centre, up to which the view may reach outside it
UNDEFORMED_PITCH_MM = 0.05  # of which the mesh keeps every eighth line
# Automatic exposure puts the 99.5th percentile of the untouched gel here: slopes that face grazing light
# double it.
TARGET_SIGNAL = 0.5
TARGET_PERCENTILE = 99.5
GRAIN_PX = 2.0
MOST_SATURATED = 0.001  # of the pixels, as what counts as good of an evaluation


class RenderFailed(RuntimeError):
    """A feasible design of which no usable picture came out; the text says why it may be."""


@dataclass(frozen=True, eq=False)
class Frame:
    """One simulated picture with its ground truth.

    Attributes
    ----------
    basis : array, shape (groups, rows, columns)
        Radiance of each LED group at unit flux (mW/mm2/sr per mW).
    weights : array, shape (3, groups)
        Mixing matrix times flux: what turns the basis into camera channels.
    grain_mm : float
        How far the random error of the picture reaches on the membrane; zero where pixels err independently.
    bias : Bias
        Bounds of the picture's systematic error.
    stray : array, shape (groups, rows, columns), or None
        Part of the basis that did not come straight from the membrane: thrown into the camera by haze or
        mirrored in the window. None where the estimator cannot tell.
    warnings : tuple of str
        Where a sensor model was used beyond what it was fitted to, and what of it is not simulated.
    """

    press: Press | None
    surface: Surface
    rays: Rays
    basis: NDArray[np.float32]
    weights: Array
    grain_mm: float = 0.0
    bias: Bias = UNBIASED
    stray: NDArray[np.float32] | None = None
    warnings: tuple[str, ...] = ()

    @property
    def mixed(self) -> NDArray[np.float32]:
        """Linear radiance of the camera channels, shape (rows, columns, 3)."""
        return np.asarray(mixed(self.basis, self.weights), dtype=np.float32)

    def show(self) -> Any:
        """Draw what the camera sees, brightened to its own white, and its height; returns the figure."""
        import matplotlib.pyplot as plt

        figure, (seen, height) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
        seen.imshow(tone_map(self.mixed))
        seen.set_title("camera")
        drawn = height.imshow(self.height_mm)
        height.set_title("height")
        figure.colorbar(drawn, ax=height, label="mm")
        for axes in (seen, height):
            axes.set_axis_off()
        return figure

    def __repr__(self) -> str:
        """Press and size of the picture in a line."""
        rows, columns = self.basis.shape[1:]
        press = "untouched gel" if self.press is None else self.press.probe.text
        return f"Frame({press}, {columns} x {rows} px, {len(self.basis)} LED groups)"

    def _repr_html_(self) -> str:
        """What a notebook shows of it: the picture."""
        encoded = base64.b64encode(png_bytes(tone_map(self.mixed))).decode()
        return f'<img alt="{html.escape(repr(self))}" src="data:image/png;base64,{encoded}">'

    @property
    def mechanics(self) -> Mechanics | None:
        """Force, contact and bulge of the press; None where the gel is not an elastic layer."""
        return self.surface.mechanics

    @cached_property
    def seen_mm(self) -> tuple[Array, Array]:
        """Membrane point (x, y) every pixel sees."""
        return self.rays.hit(self.surface)

    @cached_property
    def height_mm(self) -> Array:
        """Indentation every pixel sees, shape (rows, columns)."""
        return self.surface.sample(self.surface.height_mm, *self.seen_mm)

    @cached_property
    def gradient(self) -> tuple[Array, Array]:
        """Slopes dz/dx and dz/dy of the indentation every pixel sees."""
        p, q = self.surface.indentation_gradient
        return self.surface.sample(p, *self.seen_mm), self.surface.sample(q, *self.seen_mm)

    @cached_property
    def share_touching(self) -> float | None:
        """Share of what of the probe lies over the picture that touches; None where nothing does.

        It is told of presses along the axis alone.
        """
        if self.press is None or self.press.direction == "normal":
            return None
        over = np.isfinite(above_mm(self.press, np.zeros_like(self.height_mm), *self.seen_mm))
        return float(self.contact[over].mean()) if over.any() else None

    @cached_property
    def contact(self) -> NDArray[np.bool_]:
        """Pixels that see the membrane where the probe touches it."""
        return np.asarray(self.surface.sample(self.surface.contact.astype(float), *self.seen_mm) > 0.5)


class Simulator:
    """Renders one sensor through one view with one estimator setting.

    Parameters
    ----------
    model : Design or SensorModel
        The sensor.
    view : View, optional
        Part of the camera's sensor; the sensing area at `columns` pixels when absent.
    columns : int
        Width of the image in pixels when no view is given.
    samples : int
        Samples per pixel and LED group of the path tracer; photons per LED group are chosen to match.
    seed : int
        Seed of the light transport.
    estimator : str
        "fast", "corrected", "reference" or "path", see `render.estimators.Estimator`.
    traced_samples : int
        Effort of the unbiased part of the estimator "corrected".
    pitch_mm : float, optional
        Distance of points of the membrane; two pixels, from 0.025 to 0.05 mm, when absent.
    like : Design or SensorModel, optional
        Sensor with as many LEDs for which starts of photons are chosen. Pictures of sensors that differ
        little share their random numbers so, and their difference has little noise.
    """

    def __init__(
        self,
        model: Design | SensorModel,
        *,
        view: View | None = None,
        columns: int = 160,
        samples: int = 64,
        seed: int,
        estimator: Estimator = "fast",
        traced_samples: int = 256,
        pitch_mm: float | None = None,
        like: Design | SensorModel | None = None,
    ) -> None:
        self.like = None if like is None else SensorModel.of(like)
        self.model = SensorModel.of(model)
        self.design = self.model.effective_design()
        self.design.require_shapes()
        self.view = view or self.design.view(columns)
        self.samples = samples
        self.seed = seed
        self.estimator: Estimator = estimator
        self.traced_samples = traced_samples
        self.rays = rays(self.design, self.view)
        self.pitch_mm = pitch_mm or float(np.clip(2 * self.rays.pitch_mm[0], 0.025, 0.05))

    def surface(self, press: Press | None) -> Surface:
        """Membrane under a press over the area in view and a margin around it."""
        # A wide lens sees far beyond the gel, where there is no membrane to lay out.
        if press is not None:
            press = self.model.on_press(press)
        gel = self.design.elastomer
        furthest_mm = OUTSIDE_SHARE * float(np.hypot(gel.width_mm, gel.length_mm))
        reach_x, reach_y = (
            min(float(np.abs(seen).max()), furthest_mm) + SURFACE_MARGIN_MM
            for seen in (self.rays.x_mm, self.rays.y_mm)
        )
        surface = indent(
            self.design.elastomer,
            self.design.contact,
            press,
            area_mm=(2 * reach_x, 2 * reach_y),
            pitch_mm=self.pitch_mm,
        )
        return self.model.on_surface(surface, press)

    def scene(self, surface: Surface) -> Scene:
        """Lay out the scene after every effect that acts on it."""
        return self.model.on_scene(build(self.design, surface, self.view))

    @cached_property
    def undeformed(self) -> Scene:
        """Lay out the scene that light fields are traced in: one for every view of the sensor."""
        return self._flat(self.model)

    @cached_property
    def _undeformed_like(self) -> Scene | None:
        """The same of the sensor that this one shares its random numbers with."""
        return None if self.like is None else self._flat(self.like)

    def _flat(self, model: SensorModel) -> Scene:
        design = model.effective_design()
        area_mm = design.sensing_area_mm
        flat = indent(design.elastomer, design.contact, None, area_mm=area_mm, pitch_mm=UNDEFORMED_PITCH_MM)
        return model.on_scene(build(design, flat, self.view))

    @cached_property
    def _untouched(self) -> Surface:
        return self.surface(None)

    def frame(
        self,
        press: Press | None,
        *,
        seed: int | None = None,
        half: int | None = None,
        surface: Surface | None = None,
        following: Surface | None = None,
    ) -> Frame:
        """Simulate one picture.

        Parameters
        ----------
        press : Press or None
            None for the untouched gel.
        seed : int, optional
            Seed of the light transport where each picture is traced; the simulator's own when absent.
        half : int, optional
            0 or 1: shade from that half of the light field alone, or trace with half the effort, which shows
            the random error.
        surface : Surface, optional
            What `surface(press)` gave.
        following : Surface, optional
            That of the press that is simulated next: where pictures are shaded, its light is summed while
            this picture is finished.

        Raises
        ------
        RenderFailed
            If the picture is black or not finite; the text says which LED group and why it may be.
        """
        surface = surface or (self._untouched if press is None else self.surface(press))
        estimator = chosen(self.estimator, self.undeformed)
        same = self._same_coating and not (self._printed and surface.moved is not None)
        scene = self.undeformed if estimator == "fast" and same else self.scene(surface)
        seen, place = self.rays, WHOLE
        sharp = scene.camera.defocus is not None and not traces_lens(estimator)
        if sharp:
            # Light from around the view is blurred into it.
            reach = int(np.ceil(radius_px(self.design, self.view, surface).max()))
            wider, place = self.view.grown(reach, self.design.camera)
            scene, seen = replace(scene, view=wider), rays(self.design, wider)
        seed = self.seed if seed is None else seed
        light, stray = self._light(estimator, scene, surface, seen, seed, half, following)
        capture = self._capture(surface, place)
        if stray is not None:  # smooth: blur would not change it
            stray = through_optics(stray, capture)
        if sharp:
            capture = replace(capture, defocus_px=radius_px(self.design, scene.view, surface))
        basis = through_optics(light, capture)
        for name, image in zip(self.design.group_names, basis, strict=True):
            if not np.isfinite(image).all():
                raise RenderFailed(
                    f"LED group {name!r}: the rendered picture holds values that are not finite"
                )
            if not image.any():
                raise RenderFailed(
                    f"LED group {name!r}: the rendered picture is black; no light of this group reaches "
                    "the camera (is it behind the gelcore's painted side, or facing away?)"
                )
        grain_mm = CELL_MM if estimator in ("fast", "corrected") else 0.0
        weights = self.design.transfer_mw
        warnings = (*self.model.warnings([press]), *surface.warnings, *self._unseen(press, surface))
        return Frame(press, surface, self.rays, basis, weights, grain_mm, bias(estimator), stray, warnings)

    def sight(self, surface: Surface) -> Sight:
        """What the picture of a surface shows, for effects that act on its light."""
        return Sight(self.design, self.view, self.rays.hit(surface), self.rays.pitch_mm)

    def _unseen(self, press: Press | None, surface: Surface) -> tuple[str, ...]:
        """A warning where the probe touches the gel beside the picture alone."""
        if press is None:
            return ()
        left, right = float(self.rays.x_mm.min()), float(self.rays.x_mm.max())
        low, high = float(self.rays.y_mm.min()), float(self.rays.y_mm.max())
        columns = (left <= surface.x_mm) & (surface.x_mm <= right)
        rows = (low <= surface.y_mm) & (surface.y_mm <= high)
        if surface.contact[np.ix_(rows, columns)].any():
            return ()
        x_mm, y_mm = press.centre_mm
        return (
            f"the press lies outside the picture: {named(press)} at ({x_mm:g}, {y_mm:g}) mm touches "
            f"the gel nowhere in x from {left:.3g} to {right:.3g} and y from {low:.3g} to {high:.3g} mm",
        )

    def _capture(self, surface: Surface, place: tuple[slice, slice] = WHOLE) -> Capture:
        """How the camera takes its picture of a surface; light that it sees sharp."""
        sight = self.sight(surface) if self.model.effects else None
        return Capture(self.design.camera, self.model, view=self.view, sight=sight, place=place)

    @property
    def has_light_field(self) -> bool:
        """Whether pictures are shaded from a light field: not on ``scalar_rgb``, nor where all is traced."""
        return chosen(self.estimator, self.undeformed) in ("fast", "corrected")

    def slope_response(self, *, half: int | None = None) -> NDArray[np.float32]:
        """Change of the untouched gel's picture per unit slope, a sum over the light field's directions.

        Defocus is left out: the untouched gel is smooth.

        Parameters
        ----------
        half : int, optional
            0 or 1: from that half of the light field alone.

        Returns
        -------
        array, shape (groups, rows, columns, 2)
            Derivative of a frame's basis by p = dz/dx and q = dz/dy.

        Raises
        ------
        ValueError
            If there is no light field.
        """
        if not self.has_light_field:
            raise ValueError("slope_response: this estimator or back end has no light field")
        response = self._shader(half).response(self.undeformed, self.rays)
        capture = self._capture(self._untouched)
        slopes = [through_optics(response[..., axis], capture) for axis in (0, 1)]
        return np.stack(slopes, axis=-1)

    def _shader(self, half: int | None) -> "Shader":
        return SESSION.shader(
            self.undeformed,
            self._untouched,
            area_mm=self.design.sensing_area_mm,
            samples=self.samples,
            seed=self.seed,
            half=half,
            like=self._undeformed_like,
        )

    @property
    def _same_coating(self) -> bool:
        """Whether a press that moves no skin leaves the coating as it is: nothing shines through."""
        return not self.design.optics.shows_touch

    @property
    def _printed(self) -> bool:
        """Whether the coating has a pattern, which goes with the skin."""
        return bool(self.design.optics.marker_pitch_mm or self.design.optics.albedo_image)

    def _light(
        self,
        estimator: Estimator,
        scene: Scene,
        surface: Surface,
        seen: Rays,
        seed: int,
        half: int | None,
        following: Surface | None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Radiance of every LED group at unit flux, and its stray part where the estimator knows it."""
        effort = self.traced_samples if estimator == "corrected" else self.samples
        if half is not None:
            effort = max(1, effort // 2)
        if estimator in ("reference", "path"):
            return trace(scene, surface, seen, estimator=estimator, samples=effort, seed=seed), None
        shading = self._shader(half)
        shaded = shading.radiance(surface, scene, seen, following=following)
        stray = shading.stray(scene.view)
        if estimator == "fast":
            return shaded, stray
        traced = trace(scene, surface, seen, estimator=estimator, samples=effort, seed=seed)
        # Finer than its own grain the light field is right but for the edges of shadows; averaging over that
        # much takes most of the noise out of the correction.
        width_px = CELL_MM / np.abs(seen.pitch_mm[1]), CELL_MM / np.abs(seen.pitch_mm[0])
        correction = gaussian_filter(traced - shaded, (0, *width_px), mode="nearest")
        return np.asarray(shaded + correction, dtype=np.float32), stray


def exposure(design: Design, *untouched: Frame, grain_px: float = GRAIN_PX) -> float:
    """Signal as a share of full scale per unit of radiance: the design's own, or set by the untouched gel.

    Of several frames of the untouched gel the mean counts; see `metered` for where, `automatic_exposure` for
    `grain_px`.
    """
    fixed = design.fixed_exposure
    if fixed is not None:
        return fixed
    return automatic_exposure(
        np.mean([frame.mixed for frame in untouched], axis=0),
        grain_px=grain_px,
        within=metered(design, untouched[0]),
    )


def metered(design: Design, untouched: Frame) -> Mask | None:
    """Pixels by which the camera sets its exposure: all, or those that see a sensing area that is round."""
    if design.sensing_area_shape == "rectangle":
        return None
    mask = design.sensing_area.holds(*untouched.seen_mm)
    return mask if mask.any() else None


def saturation_share(design: Design, frame: Frame) -> float | None:
    """Share of the picture in which a channel reaches full scale; None where the exposure is automatic."""
    fixed = design.fixed_exposure
    if fixed is None:
        return None
    signal = expected(frame.mixed, Capture(design.camera, exposure=fixed))
    return float((signal >= 1.0).any(axis=-1).mean())


def saturation_warning(share: float | None, of: str = "the picture") -> list[str]:
    """Say that pixels of something are at full scale, where more than `MOST_SATURATED` of them are."""
    if share is None or share <= MOST_SATURATED:
        return []
    return [
        f"{share:.1%} of {of} is at full scale, where light changes nothing; lower the exposure, "
        "camera.gain_db or leds.groups.drive"
    ]


def automatic_exposure(
    mixed: NDArray[np.floating], *, grain_px: float = GRAIN_PX, within: Mask | None = None
) -> float:
    """Exposure that puts the bright end of a picture of the untouched gel at `TARGET_SIGNAL`.

    Parameters
    ----------
    mixed : array, shape (rows, columns, channels)
        Linear radiance.
    grain_px : float
        Smoothing; render noise would pass for brightness. Zero where the radiance is smooth already.
    within : bool array, shape (rows, columns), optional
        Pixels that count; all when absent.
    """
    smooth = gaussian_filter(mixed, (grain_px, grain_px, 0), mode="nearest")
    counted = smooth if within is None else smooth[within]
    return TARGET_SIGNAL / float(np.percentile(counted, TARGET_PERCENTILE))


def render(
    design: Design | SensorModel,
    press: Press | None = None,
    *,
    columns: int = 320,
    samples: int = 64,
    seed: int = 0,
) -> Frame:
    """Simulate one picture of the sensing area.

    Parameters
    ----------
    design : Design or SensorModel
        The sensor.
    press : Press, optional
        The indentation; the untouched membrane when absent.
    columns : int
        Width of the picture in pixels.
    samples : int
        Samples per pixel and LED group; photons per LED group are chosen to match.
    seed : int
        Seed of the light transport.

    Returns
    -------
    Frame
        The picture in linear radiance (`Frame.mixed`, mW/mm2/sr, shape (rows, columns, 3)) and its ground
        truth.

    Raises
    ------
    InfeasibleDesign
        If the design breaks a rule.
    RenderFailed
        If no light reaches the camera, or what was rendered is no picture.
    """
    SensorModel.of(design).effective_design().require_feasible()
    return Simulator(design, columns=columns, samples=samples, seed=seed).frame(press)
