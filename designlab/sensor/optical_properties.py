"""What light meets between the LEDs, the membrane and the camera: materials, coating, paint."""

import base64
import zlib
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from designlab.core.images import read_image
from designlab.sensor.optical_constants import material
from geometries.spec import FOLDER, Spec, quantity

LARGEST_IMAGE_PX = 1024


class AlbedoImage(Spec):
    """Reflectance of the membrane by place, from an image file that is read once and then kept in the design.

    A TOML file names `file` and the size; the pixels are read from there when the design is loaded and are
    part of it from then on (grey, 16 bit, compressed), so that designs and sensor models stay whole when
    files move. The image is centred on the sensor's axis, its first row at +y.
    """

    file: str = ""
    """Image file, relative to the design's own file."""
    width_mm: float = quantity(unit="mm", gt=0, le=400)
    """Width of the image on the membrane."""
    height_mm: float = quantity(unit="mm", gt=0, le=400)
    """Height of the image on the membrane."""
    rows: int = Field(0, ge=0, le=LARGEST_IMAGE_PX)
    """Rows of the pixels kept in the design."""
    columns: int = Field(0, ge=0, le=LARGEST_IMAGE_PX)
    """Columns of the pixels kept in the design."""
    pixels: str = Field("", repr=False)
    """Pixels kept in the design; written by the program."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, content: Any, info: ValidationInfo) -> Any:
        if not isinstance(content, dict) or content.get("pixels") or not isinstance(content.get("file"), str):
            return content
        folder = Path((info.context or {}).get(FOLDER, "."))
        grey = np.asarray(read_image(folder / content["file"]), dtype=float)
        grey = grey.reshape(*grey.shape[:2], -1).mean(axis=2)
        if max(grey.shape) > LARGEST_IMAGE_PX:
            raise ValueError(
                f"file: {content['file']} must have at most {LARGEST_IMAGE_PX} pixels a side, "
                f"has {grey.shape[1]} x {grey.shape[0]}"
            )
        if grey.min() < 0 or grey.max() > 1:
            raise ValueError(
                f"file: {content['file']} must hold values of 0 to 1, holds {grey.min():g} to {grey.max():g}"
            )
        packed = np.round(grey * 65535).astype("<u2").tobytes()
        return content | {
            "rows": grey.shape[0],
            "columns": grey.shape[1],
            "pixels": base64.b64encode(zlib.compress(packed, 9)).decode("ascii"),
        }

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if not self.pixels:
            raise ValueError("file: names the image; required")
        try:
            count = len(zlib.decompress(base64.b64decode(self.pixels, validate=True)))
        except (ValueError, zlib.error):
            raise ValueError("pixels: not what this program writes; name the file instead") from None
        if count != 2 * self.rows * self.columns:
            raise ValueError(f"pixels: hold {count} bytes, {self.rows} x {self.columns} need twice as many")
        return self

    @property
    def values(self) -> NDArray[np.float64]:
        """Factor on the albedo, shape (rows, columns), 0 to 1."""
        packed = zlib.decompress(base64.b64decode(self.pixels))
        return np.frombuffer(packed, dtype="<u2").reshape(self.rows, self.columns) / 65535


class Optics(Spec):
    """What light meets between the LEDs, the membrane and the camera."""

    light_path: Literal["air", "core"] = "core"
    """core: light refracts in gelcore and elastomer; air: both are built and exported, but light does not see
    them."""
    gelcore_material: str = "acrylic"
    """Material of the gelcore."""
    elastomer_material: str = "silicone"
    """Material of the clear gel."""
    gelcore_index: float | None = quantity(None, unit="1", ge=1, le=4)
    """Refractive index of the gelcore; its material's when absent."""
    elastomer_index: float | None = quantity(None, unit="1", ge=1, le=4)
    """Refractive index of the gel; its material's when absent."""
    gelcore_absorption_per_mm: tuple[float, ...] | None = Field(None, min_length=1)
    """Absorption coefficient of the gelcore (per mm): one for all LED groups, or one for each; its material's
    when absent."""
    elastomer_absorption_per_mm: tuple[float, ...] | None = Field(None, min_length=1)
    """Absorption coefficient of the gel (per mm): one for all LED groups, or one for each; its material's
    when absent."""
    gelcore_scattering_per_mm: float = quantity(0.0, unit="1/mm", ge=0, le=10)
    """Scattering coefficient of the gelcore: haze, 0 is clear."""
    gelcore_anisotropy: float = quantity(0.9, unit="1", gt=-1, lt=1)
    """Mean cosine of the angle by which haze scatters; 0.9 is strongly forward (assumption)."""
    membrane_albedo: tuple[float, ...] = Field((0.5,), min_length=1)
    """Diffuse reflectance of the membrane's inner side: one for all LED groups, or one for each."""
    coating_specular: float = quantity(0.0, unit="1", ge=0, le=1)
    """Share of the light reflected by the membrane that leaves in a glossy lobe instead of diffusely:
    metallic paint."""
    coating_roughness: float = quantity(0.3, unit="1", ge=0.05, le=1)
    """GGX alpha of the membrane's glossy lobe."""
    coating_transmittance: float = quantity(0.0, unit="1", ge=0, le=1)
    """Share of light that leaks through the membrane's coating."""
    object_reflectance: float = quantity(0.0, unit="1", ge=0, le=1)
    """Diffuse reflectance of what is pressed, seen where it touches a coating that leaks."""
    backing_reflectance: float | None = quantity(None, unit="1", ge=0, lt=1)
    """Diffuse reflectance behind an untouched coating that leaks, part of `membrane_albedo`: 0.54 of a smooth
    silicone skin against air; what leaks out is lost when absent."""
    marker_pitch_mm: float = quantity(0.0, unit="mm", ge=0, le=50)
    """Distance of the printed marker dots, a square grid with a dot at the centre; 0 is none."""
    marker_diameter_mm: float = quantity(0.5, unit="mm", gt=0, le=20)
    """Diameter of the marker dots."""
    marker_reflectance: float = quantity(0.05, unit="1", ge=0, le=1)
    """Diffuse reflectance of the marker dots."""
    albedo_image: AlbedoImage | None = None
    """Factor on the membrane's albedo by place, from an image file."""
    board_reflectance: tuple[float, ...] = Field((0.0,), min_length=1)
    """Diffuse reflectance of the LED boards around the emitters: one, or one for each group."""
    housing_reflectance: tuple[float, ...] = Field((0.0,), min_length=1)
    """Diffuse reflectance of the housing's inside: one, or one for each group; 0 is black."""
    gap_centre_mm: tuple[float, float] = (0.0, 0.0)
    """Middle (x, y) of a patch where gel and core have come apart (mm)."""
    gap_radius_mm: float = quantity(0.0, unit="mm", ge=0, le=50)
    """Radius of that patch, which holds air; 0 is none."""
    path_length: int = Field(4, ge=2, le=64)
    """Longest light path counted, in segments from emitter to camera; refraction counts as well."""

    @field_validator("gelcore_material", "elastomer_material")
    @classmethod
    def _known(cls, name: str) -> str:
        return material(name).name

    @field_validator("membrane_albedo", "board_reflectance", "housing_reflectance")
    @classmethod
    def _physical(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        for value in values:
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"a reflectance lies between 0 and 1, got {value:g}")
        return values

    @field_validator("gelcore_absorption_per_mm", "elastomer_absorption_per_mm")
    @classmethod
    def _absorbing(cls, values: tuple[float, ...] | None) -> tuple[float, ...] | None:
        for value in values or ():
            if not 0.0 <= value <= 100.0:
                raise ValueError(
                    f"an absorption coefficient lies between 0 and 100 per mm, got {value:g} per mm"
                )
        return values

    @model_validator(mode="after")
    def _sound_coating(self) -> Self:
        brightest = max(self.membrane_albedo)
        if self.coating_transmittance and brightest + self.coating_transmittance > 1:
            raise ValueError(
                f"coating_transmittance: together with membrane_albedo ({brightest:g}) must not exceed 1, "
                f"got {self.coating_transmittance:g}"
            )
        if 0 < self.marker_pitch_mm < self.marker_diameter_mm:
            raise ValueError(
                f"marker_pitch_mm: must not be below marker_diameter_mm ({self.marker_diameter_mm:g} mm), "
                f"got {self.marker_pitch_mm:g} mm"
            )
        if self.marker_pitch_mm and self.marker_reflectance + self.coating_transmittance > 1:
            raise ValueError(
                f"marker_reflectance: together with coating_transmittance ({self.coating_transmittance:g}) "
                f"must not exceed 1, got {self.marker_reflectance:g}"
            )
        return self

    @property
    def shows_touch(self) -> bool:
        """Whether the coating reflects otherwise where an object touches it."""
        return bool(self.coating_transmittance) and self.object_reflectance != self.sent_back

    @property
    def sent_back(self) -> float:
        """Diffuse reflectance behind the untouched coating, 0 when not stated."""
        return self.backing_reflectance or 0.0

    @property
    def core_index(self) -> float:
        """Refractive index of the gelcore."""
        return self.gelcore_index or material(self.gelcore_material).index

    @property
    def gel_index(self) -> float:
        """Refractive index of the elastomer."""
        return self.elastomer_index or material(self.elastomer_material).index
