"""How a gel answers a press: as an elastic layer, or by the smoothing kernel of 2020."""

from collections.abc import Mapping
from typing import Any, Literal, Self, TypeVar

from pydantic import field_validator, model_validator

from designlab.mechanics.layer import ElasticLayer
from designlab.sensor.gel_materials import gel_material
from geometries.spec import Spec, quantity

CUSTOM = "custom"


class KernelContact(Spec):
    """The probe displaces the gel, and a kernel smooths the step at its rim; no force is known.

    The kernel is (m + 1) / (m + exp(r / length)), cut at 6 lengths (arXiv 2012.13184).
    """

    model: Literal["kernel"] = "kernel"
    """Which model of contact holds."""
    kernel_length_mm: float = quantity(0.05, unit="mm", ge=0, le=1.0)
    """Length of the smoothing kernel; 0 switches smoothing off."""
    kernel_m: float = quantity(200.0, unit="1", ge=1, le=1e5)
    """Plateau parameter of the smoothing kernel."""
    tail_share: float = quantity(0.0, unit="1", ge=0, lt=1)
    """Height of the gel at the probe's outline, raised there because the gel clings together, as a share of
    the depth; 0 is none."""
    tail_mm: float = quantity(0.7, unit="mm", gt=0, le=10)
    """Distance over which that height falls by e."""


class LayerContact(Spec):
    """The gel is an elastic layer, bonded to its core: it bulges around a press, and force is known."""

    model: Literal["layer"] = "layer"
    """Which model of contact holds."""
    gel: str = "gelsight-mini"
    """Material of the gel, one of the table of gels, or `custom` for stated figures alone."""
    modulus_mpa: float | None = quantity(None, unit="MPa", gt=0, le=1000)
    """Young's modulus; the material's when absent. It scales forces and changes no shape."""
    poisson: float | None = quantity(None, unit="1", gt=0, le=0.5)
    """Poisson's ratio; the material's when absent. At 0.5 the gel keeps its volume."""
    friction: float = quantity(0.0, unit="1", ge=0, le=10)
    """Coefficient of friction between probe and membrane; 0 slips freely, 10 hardly slips at all."""
    skin_length_mm: float = quantity(0.05, unit="mm", ge=0, le=1.0)
    """Standard deviation of the smoothing by the coated skin, which does not follow sharp corners; it keeps
    the volume of the imprint."""

    @model_validator(mode="before")
    @classmethod
    def _no_kernel(cls, content: Any) -> Any:
        if isinstance(content, Mapping):
            for field in KernelContact.model_fields:
                if field != "model" and field in content:
                    raise ValueError(
                        f"{field}: belongs to model = 'kernel', not to 'layer'; state one model's fields"
                    )
        return content

    @field_validator("gel")
    @classmethod
    def _known(cls, gel: str) -> str:
        if gel != CUSTOM:
            gel_material(gel)
        return gel

    @model_validator(mode="after")
    def _has_figures(self) -> Self:
        for field in ("modulus_mpa", "poisson"):
            if self.gel == CUSTOM and getattr(self, field) is None:
                raise ValueError(f"{field}: needed where gel is {CUSTOM!r}, or name a gel of the table")
        return self

    def layer(self, *, thickness_mm: float) -> ElasticLayer:
        """Return the gel as an elastic layer of a thickness (mm)."""
        modulus, poisson = self.modulus_mpa, self.poisson
        if modulus is None or poisson is None:
            material = gel_material(self.gel)
            modulus = material.modulus_mpa if modulus is None else modulus
            poisson = material.poisson if poisson is None else poisson
        return ElasticLayer(modulus, poisson, thickness_mm)


Contact = KernelContact | LayerContact
CONTACT_MODELS = ("kernel", "layer")


class ContactModelAssumed(UserWarning):
    """A file has fields of the smoothing kernel, but does not say that it means that model."""


def with_model(content: Any) -> Any:
    """Name the model of contact in the content of a file: kernel where its fields are given, else layer.

    Raises
    ------
    ValueError
        If fields of both are given.
    """
    if isinstance(content, Mapping) and "model" not in content:
        kernel = [field for field in KernelContact.model_fields if field in content]
        layer = [field for field in LayerContact.model_fields if field in content]
        if kernel and layer:
            raise ValueError(
                f"contact.{kernel[0]}: belongs to model = 'kernel', contact.{layer[0]} to 'layer'; state one "
                "model's fields"
            )
        return {"model": "kernel" if kernel else "layer", **content}
    return content


Model = TypeVar("Model", KernelContact, LayerContact)


def require(contact: Contact, model: type[Model]) -> Model:
    """Return the contact of a design that needs one of the models.

    Raises
    ------
    ValueError
        If it has the other one.
    """
    if not isinstance(contact, model):
        wanted = model.model_fields["model"].default
        raise ValueError(f"contact.model: must be {wanted!r} here, is {contact.model!r}")
    return contact
